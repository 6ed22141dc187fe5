"""Classes of IMUs as hypotheses: which of them explains a recording best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_ros.adapters.noise_classes import IMU as CLASSES

from .likelihood import Problem
from .parameters import IMU, Parameter

GRADES = {
    'navigation': 'navigation grade',
    'fog': 'tactical grade, fibre optic',
    'stim300': 'tactical grade',
    'vn100': 'industrial MEMS',
    'bmi088': 'consumer MEMS',
    'icm20948': 'cheapest consumer MEMS',
}
"""Words for the classes of `noise_classes.IMU`."""
STATED = 'as stated'
DECISIVE = 5.0
"""Logarithm of a ratio of likelihoods from which on a class is preferred to what is stated."""


@dataclass(frozen=True)
class ClassFit:
    """How well the noise of a class of IMUs explains a recording.

    Attributes
    ----------
    name : str
        Of the class, or `STATED`.
    ln_likelihood : float
        Of the data; minus infinity where the filter is lost with it.
    """

    name: str
    ln_likelihood: float


def at_class(parameters: Sequence[Parameter], at: Array, name: str) -> Array:
    """Logarithms of factors (k,) with those of the IMU as its class has them."""
    values = CLASSES.get(name, {p.name: p.stated for p in parameters})
    out = at.copy()
    for k, parameter in enumerate(parameters):
        if parameter.name in IMU:
            out[k] = math.log(values[parameter.name] / parameter.stated)
    return out


def judge_classes(problem: Problem, at: Array) -> tuple[ClassFit, ...]:
    """All classes and the stated noise, the best first, with the noise of other sensors as given.

    Parameters
    ----------
    problem : Problem
    at : (k,) array
        Logarithms of factors; those of the IMU do not count.
    """
    out = []
    for name in (STATED, *CLASSES):
        rows = problem.rows(at_class(problem.parameters, at, name))
        value = -math.inf if rows is None else float(rows.ln_density().sum())
        out.append(ClassFit(name, value))
    return tuple(sorted(out, key=lambda c: -c.ln_likelihood))


def preferred(found: Sequence[ClassFit]) -> str:
    """Class to begin from: what is stated, unless another one is decisively better."""
    stated = next(c for c in found if c.name == STATED)
    best = found[0]
    return best.name if best.ln_likelihood > stated.ln_likelihood + DECISIVE else STATED


def nearest(parameters: Sequence[Parameter], at: Array, sigma: Array) -> str:
    """Class whose numbers are nearest to what was estimated, in logarithms; empty without any.

    Parameters
    ----------
    parameters : sequence of Parameter
    at, sigma : (k,) arrays
        Logarithms of factors, and the 1-sigma that the data leave.
    """
    weights = np.array(
        [1.0 / (1.0 + sigma[k] ** 2) if p.name in IMU else 0.0 for k, p in enumerate(parameters)]
    )
    if not (np.isfinite(sigma) & (weights > 0.5)).any():
        return ''

    def distance(name: str) -> float:
        return float(np.sum(weights * (at_class(parameters, at, name) - at) ** 2))

    return min(CLASSES, key=distance)
