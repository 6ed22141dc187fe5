"""Interfaces of noise that is adapted in Python.

`none` and `adaptive_r` are compiled (kernels.sins.judge). The published adaptation
R' = (1 - d) R + d v v^T, d = (1 - b)/(1 - b^k) (eq. 65) throws the stated noise away at k = 1 and
leaves a matrix of rank one. What works, and is compiled: a warm start, as if the stated R had
already been seen k0 = 1/(1 - b) times, and a floor. The adapted quantity is the ratio of observed
to stated variance per axis, so that a stated R that changes from fix to fix (range, geometry)
keeps its meaning, and R stays positive definite.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

from ...arrays import Array


class MeasurementNoise(ABC):
    """Adapted noise R of one kind of measurement.

    ``robust`` names how measurements far off are given less weight (robust.py), on top of it.
    """

    robust = 'none'

    @abstractmethod
    def apply(self, R: Array) -> None:
        """Replace the stated R by the adapted one, in place."""

    @abstractmethod
    def learn(self, z: Array, R_stated: Array, S: Array) -> None:
        """Adapt to an innovation (3,), given the stated R and its covariance S, (3, 3) each."""


class ProcessNoise:
    """Process noise in place of the stated diagonal; the base class keeps the stated one."""

    def add(self, P: Array, Phi: Array, q: Array, dt: float) -> None:
        """Change P, to which diag(q) was added at the end of a step of dt [s]."""

    def learn(self, K: Array, z: Array, S: Array) -> None:
        """Adapt to an update: gain transposed (3, 24), innovation (3,), its covariance (3, 3)."""
