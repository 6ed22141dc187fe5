"""Measurement noise as the filter uses it: as stated, or adapted to innovations (`adaptive_r`).

The published adaptation R' = (1 - d) R + d v v^T, d = (1 - b)/(1 - b^k) (polar-math 6, eq. 65)
throws the stated noise away at k = 1 and leaves a matrix of rank one. What works: a warm start, as
if the stated R had already been seen k0 = 1/(1 - b) times, and a floor. The adapted quantity is
the ratio of observed to stated variance per axis, so that a stated R that changes from fix to fix
(range, geometry) keeps its meaning, and R stays positive definite.
"""

from __future__ import annotations

import numpy as np

from ..events import Array


class StatedNoise:
    """R as the measurement states it.

    ``robust`` names how measurements far off are given less weight (robust.py), on top of it.
    ``compiled``: whether compiled loops over many events know this kind of noise.
    """

    robust = 'none'
    compiled = True

    def apply(self, R: Array) -> None:
        """Leave R as it is."""

    def learn(self, z: Array, R_stated: Array, S: Array) -> None:
        """Learn nothing."""

    def reset(self) -> None:
        """Forget nothing."""


class ProcessNoise:
    """What a filter adds to the covariance instead of its stated diagonal; base: nothing else."""

    def add(self, P: Array, Phi: Array, q: Array, dt: float) -> None:
        """Change P, to which diag(q) was added at the end of a step of dt [s]."""

    def learn(self, K: Array, z: Array, S: Array) -> None:
        """Take gain (3, 24) (transposed), innovation and its covariance of an update."""


class AdaptiveNoise(StatedNoise):
    """Variance per axis scaled by a fading average of v^2 / R_stated, warm started and floored.

    Parameters
    ----------
    forgetting : float
        b, in (0, 1).
    floor : float
        Smallest ratio.
    """

    def __init__(self, forgetting: float, floor: float) -> None:
        self._b = forgetting
        self._floor = floor
        self.reset()

    def reset(self) -> None:
        """Start again with the stated noise."""
        self._weight = self._b ** (1.0 / (1.0 - self._b))  # b^k with k = k0
        self.ratio = np.ones(3)

    def apply(self, R: Array) -> None:
        """R <- D R D with D^2 the ratio per axis, floored."""
        scale = np.sqrt(np.maximum(self.ratio, self._floor))
        R *= scale[:, None] * scale[None, :]

    def learn(self, z: Array, R_stated: Array, S: Array) -> None:  # noqa: ARG002 - S: see Sage-Husa
        """Take one innovation (3,) of a measurement with stated covariance (3, 3)."""
        self._weight *= self._b
        d = (1.0 - self._b) / (1.0 - self._weight)
        self.ratio = (1.0 - d) * self.ratio + d * z * z / np.diagonal(R_stated)
