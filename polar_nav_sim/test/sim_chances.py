"""Chi-square bands: whether numbers that were drawn have the sigma that is stated."""

import numpy as np
from scipy.stats import chi2

CHANCE = 1e-4
"""That a right model fails in one column."""


def inside(values, sigma, chance=CHANCE):
    """Whether the mean square of each column of (n, c) values is that of its sigma, two-sided."""
    n, _ = np.shape(values)
    total = np.sum(np.square(values / np.asarray(sigma)), axis=0)
    return bool(np.all((chi2.ppf(0.5 * chance, n) < total) & (total < chi2.isf(0.5 * chance, n))))
