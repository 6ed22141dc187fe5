"""Noise that is adapted in Python: what the filter asks of it.

`none` and `adaptive_r` are compiled (kernels.filter_fuse). The published adaptation
R' = (1 - d) R + d v v^T, d = (1 - b)/(1 - b^k) (eq. 65) throws the stated noise away at k = 1 and
leaves a matrix of rank one. What works, and is compiled: a warm start, as if the stated R had
already been seen k0 = 1/(1 - b) times, and a floor. The adapted quantity is the ratio of observed
to stated variance per axis, so that a stated R that changes from fix to fix (range, geometry)
keeps its meaning, and R stays positive definite.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

from ..events import Array


class MeasurementNoise(ABC):
    """R of one kind of measurement.

    ``robust`` names how measurements far off are given less weight (robust.py), on top of it.
    """

    robust = 'none'

    @abstractmethod
    def apply(self, R: Array) -> None:
        """Change the stated R into the one to use."""

    @abstractmethod
    def learn(self, z: Array, R_stated: Array, S: Array) -> None:
        """Take an innovation, the stated R and the innovation covariance."""


class ProcessNoise:
    """What a filter adds to the covariance instead of its stated diagonal; base: nothing else."""

    def add(self, P: Array, Phi: Array, q: Array, dt: float) -> None:
        """Change P, to which diag(q) was added at the end of a step of dt [s]."""

    def learn(self, K: Array, z: Array, S: Array) -> None:
        """Take gain (3, 24) (transposed), innovation and its covariance of an update."""
