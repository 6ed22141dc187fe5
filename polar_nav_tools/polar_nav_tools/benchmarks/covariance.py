"""Prediction and 3-dim update of 24 states beside filterpy: the same matrices, chained.

Transition and DVL rows are those of the follower at the start of the racetrack. The core's filter
is a closed loop: the error estimate is fed back and is zero before each update. filterpy
has no such step and propagates its state; the covariance does not depend on it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from polar_nav_core import grid
from polar_nav_core.arrays import Array
from polar_nav_core.errors import PolarNavError
from polar_nav_core.kernels.sins import rows as filter_rows
from polar_nav_core.kernels.sins import update as kf
from polar_nav_core.kernels.sins.transition import INVERSE, fill_transition

from . import compiled, twin
from .navigation import Disagreement, Record
from .rounds import Entry

BOUND = 1e-9
"""Largest difference of covariances, relative to the standard deviations of row and column."""

CYCLES = 500

_PREDICTION_S, _MARKOV_S, _DVL_SIGMA = 0.1, 300.0, 0.01
_SIGMAS = np.repeat([1e-3, 0.05, 5.0, 1e-7, 1e-4, 1e-3, 5e-3, 0.5], 3)
_DENSITIES = np.repeat([1e-6, 1e-4, 0.0, 1e-10, 1e-8, 0.0, 4e-4, 0.0], 3)


@dataclass(frozen=True)
class Matrices:
    """One cycle's matrices, and an innovation for each cycle.

    Attributes
    ----------
    P : ndarray, shape (24, 24)
        At the start.
    Phi : ndarray, shape (24, 24)
    q : ndarray, shape (24,)
        Variances added by a prediction.
    H, R : ndarray, shape (3, 24), (3, 3)
    z : ndarray, shape (n, 3)
    """

    P: Array
    Phi: Array
    q: Array
    H: Array
    R: Array
    z: Array


def matrices(r: Record, cycles: int = CYCLES) -> Matrices:
    """Matrices at the start of the record."""
    C, v, p = r.start()
    omega_ib_b, f_b = r.dtheta_b[1] / r.dt, r.dvel_b[1] / r.dt
    Phi, zero = np.zeros((kf.N, kf.N)), np.zeros(3)
    work = np.zeros(INVERSE), kf.scratch()['F15']
    fill_transition(Phi, *work, p, v, C, f_b, _PREDICTION_S, _MARKOV_S, 0.0)
    H, R = np.zeros((3, kf.N)), np.zeros((3, 3))
    filter_rows.dvl_rows(
        H, R, np.zeros(3), np.zeros((3, 3)), C, v, omega_ib_b,
        np.ascontiguousarray(grid.earth_rate(p)), zero, zero, zero, C.T @ v,
        _DVL_SIGMA**2 * np.eye(3), np.eye(3), np.array([0.5, 0.0, -0.2]),
    )  # fmt: skip
    z = _DVL_SIGMA * np.random.default_rng(1).normal(size=(cycles, 3))
    return Matrices(np.diag(_SIGMAS**2), Phi, _DENSITIES**2 * _PREDICTION_S, H, R, z)


# -- the core and its twin ------------------------------------------------------------------------


class Core:
    """Kernels, called from Python in the order of the follower, or in a compiled loop."""

    def __init__(self, m: Matrices) -> None:
        self._m = m
        self._w = kf.scratch()
        self._x = np.zeros(kf.N)
        self._rows = list(m.z)

    def cycles(self) -> Array:
        """Four calls from Python per cycle."""
        m, w, x = self._m, self._w, self._x
        P = m.P.copy()
        for z in self._rows:
            kf.predict(P, m.Phi, m.q, w['M'])
            kf.innovation_covariance(w['S'], w['PHt'], P, m.H, m.R, 3)
            kf.cholesky(w['L'], w['S'], 3)
            kf.update(P, x, w['S'], z, 3, w['K'], w['PHt'], w['L'], w['M'])
        return P

    def loop(self) -> Array:
        """All cycles in one call."""
        m, w = self._m, self._w
        P = m.P.copy()
        compiled.filter_cycles(
            P, m.Phi, m.q, m.H, m.R, m.z, self._x, w['M'], w['S'], w['PHt'], w['L'], w['K']
        )
        return P

    def predictions(self) -> Array:
        """Predictions only, a call each."""
        P = self._m.P.copy()
        for _ in self._rows:
            kf.predict(P, self._m.Phi, self._m.q, self._w['M'])
        return P

    def updates(self) -> Array:
        """Updates only, three calls each."""
        m, w, x = self._m, self._w, self._x
        P = m.P.copy()
        for z in self._rows:
            kf.innovation_covariance(w['S'], w['PHt'], P, m.H, m.R, 3)
            kf.cholesky(w['L'], w['S'], 3)
            kf.update(P, x, w['S'], z, 3, w['K'], w['PHt'], w['L'], w['M'])
        return P


def numpy_cycles(m: Matrices) -> Array:
    """Cycles of the NumPy twin."""
    P, Q = m.P, np.diag(m.q)
    for z in m.z:
        P = twin.predict(P, m.Phi, Q)
        _, P = twin.update(P, m.H, m.R, z)
    return P


# -- filterpy -------------------------------------------------------------------------------------


class FilterPy:
    """`filterpy.kalman.KalmanFilter` with the same matrices.

    Raises
    ------
    PolarNavError
        When filterpy is not installed.
    """

    def __init__(self, m: Matrices) -> None:
        try:
            from filterpy.kalman import KalmanFilter
        except ImportError as error:
            raise PolarNavError(
                f'{error.name} is not installed: the benchmarks need all of requirements.lock'
            ) from error
        self._m = m
        self._rows = list(m.z[:, :, None])
        self._filter = KalmanFilter(kf.N, 3)
        self._filter.F, self._filter.Q = m.Phi, np.diag(m.q)
        self._filter.H, self._filter.R = m.H, m.R

    def _run(self, predicts: bool, updates: bool) -> Array:
        f = self._filter
        f.P, f.x = self._m.P.copy(), np.zeros((kf.N, 1))
        for z in self._rows:
            if predicts:
                f.predict()
            if updates:
                f.update(z)
        return np.asarray(f.P)

    def cycles(self) -> Array:
        """Predict and update."""
        return self._run(True, True)

    def predictions(self) -> Array:
        """Predict only."""
        return self._run(True, False)

    def updates(self) -> Array:
        """Update only."""
        return self._run(False, True)


# -- agreement ------------------------------------------------------------------------------------


def difference(P: Array, reference: Array) -> float:
    """Largest difference of two covariances, relative to sqrt(P_ii P_jj) of the reference."""
    sigma = np.sqrt(np.diagonal(reference))
    return float(np.max(np.abs(P - reference) / np.outer(sigma, sigma)))


def agreement(m: Matrices) -> dict[str, float]:
    """Differences of the covariances at the end from those of filterpy.

    Raises
    ------
    Disagreement
        If a difference is over BOUND.
    """
    core, peer = Core(m), FilterPy(m)
    pairs: dict[str, tuple[Callable[[], Array], Callable[[], Array]]] = {
        'core, called': (core.cycles, peer.cycles),
        'core, loop': (core.loop, peer.cycles),
        'core, predictions': (core.predictions, peer.predictions),
        'core, updates': (core.updates, peer.updates),
        'NumPy twin': (partial(numpy_cycles, m), peer.cycles),
    }
    found = {}
    for name, (ours, theirs) in pairs.items():
        found[name] = difference(ours(), theirs())
        if not found[name] <= BOUND:
            raise Disagreement(
                f'{name}: covariance differs from filterpy by {found[name]:.3g}, over {BOUND}'
            )
    return found


def entries(m: Matrices) -> tuple[list[Entry], list[Entry], list[Entry]]:
    """Entries to time: whole cycles, predictions, updates."""
    core, peer, n = Core(m), FilterPy(m), len(m.z)
    cycles = [
        Entry('loop', 'core, compiled loop', n, core.loop),
        Entry('called', 'core, four calls from Python', n, core.cycles),
        Entry('filterpy', 'filterpy', n, peer.cycles),
        Entry('numpy', 'plain NumPy', n, partial(numpy_cycles, m)),
    ]
    predictions = [
        Entry('called', 'core, one call', n, core.predictions),
        Entry('filterpy', 'filterpy', n, peer.predictions),
    ]
    updates = [
        Entry('called', 'core, three calls', n, core.updates),
        Entry('filterpy', 'filterpy', n, peer.updates),
    ]
    return cycles, predictions, updates
