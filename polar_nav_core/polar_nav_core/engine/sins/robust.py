"""Robust weights of position fixes far off the estimate.

With d^2 = z^T S^-1 z the NIS of m rows and k^2 the quantile below which a good one lies with
probability 0.95, the innovation covariance becomes lambda S:

- `huber`: lambda = max(1, d / k), Huber's weight min(1, k/d) on the length of the whitened
  innovation (Huber 1964, Ann. Math. Statist. 35). A fix pulls with the force of one at the
  threshold however far off it is, so many of them move the estimate, if slowly.
- `mahalanobis`: lambda = max(1, d^2 / k^2), so that the weighted NIS equals the threshold (Chang
  2014, J. Geodesy 88, 391). The pull dies out as 1/d: outliers hardly matter, and neither does the
  truth when the estimate is the one that is far off.

Only the measurement can be at fault, so its R takes the difference: R <- R + (lambda - 1) S. The
update stays a Kalman update with a larger R, in every delay strategy.
"""

from __future__ import annotations

import math

from scipy.special import gammaincinv

_GOOD = 0.95
"""Share of good fixes that keep their full weight."""
THRESHOLDS = {m: 2.0 * float(gammaincinv(0.5 * m, _GOOD)) for m in (1, 2, 3)}
"""Chi-square quantiles k^2 by degrees of freedom."""


def inflation(name: str, nis: float, dof: int) -> float:
    """Factor lambda >= 1 on the innovation covariance by `none`, `huber` or `mahalanobis`."""
    squared = nis / THRESHOLDS[dof]
    if name == 'none' or squared <= 1.0:
        return 1.0
    return math.sqrt(squared) if name == 'huber' else squared
