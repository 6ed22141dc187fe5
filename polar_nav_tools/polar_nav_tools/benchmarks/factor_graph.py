"""The linear problem of a run as a factor graph, solved by GTSAM: a smoother of other people.

The filter's transitions, noises and rows are the factors, about the states of a filter that is
corrected by nothing. What was fed back is added to the innovations again, so that all values are
of one reference (docs/derivations/smoother.md). GTSAM is no requirement; `pip install gtsam`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from polar_nav_core import attitude
from polar_nav_core.arrays import Array, Ints
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine import smoothing
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.sins.settings import make_settings
from polar_nav_core.engine.sins.stretch import Stretch
from polar_nav_core.engine.sins.tape import Tape
from polar_nav_core.engine.smoothed import Smoothed, at_validity
from polar_nav_core.engine.track import Track
from polar_nav_core.kernels.sins import rings
from polar_nav_core.kernels.sins.update import COUPLED, MARKOV, NAV, USBL, N

AS_STATED: dict[str, Any] = {
    'configuration': 'custom',
    'gate_probability': 1.0,
    'robust_fixes': 'none',
    'reopen_after_s': 0.0,
    'max_fix_sigma': 0.0,
    'leader_error_tau': 0.0,
    'imu_gap_s': 0.0,
}
"""Parameters of a filter that is linear least squares, and shows all its states.

No gates, no weights, and no reserve for what is not linear.
"""
_LEAST = 1e-4
"""Least noise of a step, of the smoothed sigma: states without noise would be constraints, which
cost GTSAM its precision. After a thousand steps it is 0.3 % of sigma."""


@dataclass(frozen=True)
class Update:
    """A measurement z = H E + noise, after so many steps; m rows.

    Attributes
    ----------
    step : int
    H, R, z : (m, 24), (m, m), (m,) arrays
    """

    step: int
    H: Array
    R: Array
    z: Array


@dataclass(frozen=True)
class LinearRun:
    """Linear problem of a run, and what the engine's smoother makes of it.

    Attributes
    ----------
    P : (24, 24) array
        At the start.
    Phi, q : (steps, 24, 24), (steps, 24) arrays
        Transitions, and variances added in each.
    updates : tuple of Update
    stamps_ns : (rows,) array
    steps : (rows,) array
        Number of steps before each row.
    mean, sigma : (rows, 24) arrays
        Smoothed error of the reference, and its 1-sigma.
    """

    P: Array
    Phi: Array
    q: Array
    updates: tuple[Update, ...]
    stamps_ns: Ints
    steps: Ints
    mean: Array
    sigma: Array

    @property
    def active(self) -> Ints:
        """States that are not known for sure."""
        return np.flatnonzero((np.diagonal(self.P) > 0.0) | self.q.any(axis=0))


def linear_run(params: EngineParams, inputs: Inputs, every_s: float = 1.0) -> LinearRun:
    """Linear problem of a run in one pass, with its smoothed rows.

    Raises
    ------
    ConfigError
        As `smoothing.smooth`.
    """
    stretches = recorded(params, inputs, every_s)
    found = smoothing.smooth(params, inputs, every_s=every_s, covariances=True, passes=1)
    phi = np.concatenate([s.phi for s in stretches])
    Phi = np.zeros((len(phi), N, N))
    Phi[:, :NAV, :COUPLED] = phi[:, : NAV * COUPLED].reshape(-1, NAV, COUPLED)
    Phi[:, range(NAV, N), range(NAV, N)] = phi[:, NAV * COUPLED :]
    updates: list[Update] = []
    rows: list[tuple[int, int, Array]] = []
    fed_back, step = np.zeros(N), 0
    for s in stretches:
        first = np.cumsum(s.sizes) - s.sizes
        at = dict(zip(s.places.tolist(), range(len(s.places)), strict=True))
        for number in range(len(s.kinds) + 1):
            if number in at:
                k = at[number]
                rows.append((int(s.stamps_ns[k]), step, _error(s, k, found, fed_back)))
            if number == len(s.kinds):
                break
            i = int(s.indices[number])
            if s.kinds[number] == rings.STEP:
                fed_back = Phi[step] @ fed_back
                step += 1
                continue
            m = int(s.sizes[i])
            own = slice(first[i], first[i] + m)
            H, K, L = s.H[own], s.K[own], s.L[i, :m, :m]
            S = L @ L.T
            R = S - H @ K.T @ S
            updates.append(Update(step, H, 0.5 * (R + R.T), s.z[i, :m] + H @ fed_back))
            fed_back = fed_back + K.T @ s.z[i, :m]
    kept = [row for row in rows if row[0] in set(found.track.stamps_ns.tolist())]
    stamps = np.array([stamp for stamp, *_ in kept])
    return LinearRun(
        stretches[0].P[0],
        Phi,
        _noise(params, Phi),
        tuple(updates),
        stamps,
        np.array([step for _, step, _ in kept]),
        np.array([error for *_, error in kept]),
        np.sqrt(np.einsum('nii->ni', found.track.P)),
    )


def recorded(params: EngineParams, inputs: Inputs, every_s: float) -> list[Stretch]:
    """What the filter of a smoother's first pass logs, in order."""
    stated = smoothing.in_order(params)
    fixes = (f for f in inputs.fixes if f.refusal is None and f.validity_ns > 0)
    with Tape(max(1, round(every_s / stated.filter_period_s))) as tape:
        engine_run.run(
            stated,
            replace(inputs, fixes=tuple(map(at_validity, fixes))),
            sink=lambda _: None,
            derived=True,
            look_every_s=smoothing.LOOK_S,
            tape=tape,
        )
        return [stretch.copy() for stretch, *_ in tape.backwards()][::-1]


def _error(s: Stretch, k: int, found: Smoothed[Track], fed_back: Array) -> Array:
    """Smoothed error of the reference at a row: to the filter's state, and what it fed back."""
    track = found.track
    j = int(np.searchsorted(track.stamps_ns, s.stamps_ns[k]))
    if j == len(track.stamps_ns) or track.stamps_ns[j] != s.stamps_ns[k]:
        return fed_back
    row = s.navigation[k]
    x = np.zeros(N)
    x[:3] = attitude.log(track.C_b_G[j] @ row[:9].reshape(3, 3).T)
    x[3:6] = row[9:12] - track.v_G[j]
    x[6:9] = row[12:15] - track.r_e[j]
    x[NAV:] = track.sensor_errors[j] - row[15:30]
    return x + fed_back


def _noise(params: EngineParams, Phi: Array) -> Array:
    """Variances added in each step, (steps, 24); its length is in the decay of the DVL's error."""
    c = make_settings(params)
    dt = -c.markov[1] * np.log(Phi[:, MARKOV, MARKOV])
    q = np.zeros((len(Phi), N))
    for first, density in zip((0, 3, 9, 12), c.densities, strict=True):
        q[:, first : first + 3] = (density * dt)[:, None]
    q[:, MARKOV:USBL] = (c.markov[0] * -np.expm1(-2.0 * dt / c.markov[1]))[:, None]
    q[:, USBL:] = (c.usbl[0] * -np.expm1(-2.0 * dt / c.usbl[1]))[:, None]
    return q


class FactorGraph:
    """Factor graph of a run, in units of the smoothed sigmas.

    Raises
    ------
    ImportError
        Without GTSAM.
    """

    def __init__(self, run: LinearRun) -> None:
        import gtsam

        self._gtsam: Any = gtsam
        self._active = a = run.active
        self._unit = run.sigma[len(run.sigma) // 2, a]
        self._graph = graph = gtsam.GaussianFactorGraph()
        self._keys = len(run.Phi) + 1
        n = len(a)
        one, nothing = np.eye(n), np.zeros(n)
        P = run.P[np.ix_(a, a)] / np.outer(self._unit, self._unit)
        values, V = np.linalg.eigh(P)
        graph.add(gtsam.JacobianFactor(0, V.T, nothing, self._sigmas(np.sqrt(values))))
        for k, (Phi, q) in enumerate(zip(run.Phi, run.q, strict=True)):
            step = -(Phi[np.ix_(a, a)] * self._unit) / self._unit[:, None]
            noise = self._sigmas(np.sqrt(q[a]) / self._unit)
            graph.add(gtsam.JacobianFactor(k + 1, one, k, step, nothing, noise))
        for u in run.updates:
            half = np.linalg.inv(np.linalg.cholesky(u.R))
            unit = gtsam.noiseModel.Unit.Create(len(u.z))
            rows = half @ (u.H[:, a] * self._unit)
            graph.add(gtsam.JacobianFactor(u.step, rows, half @ u.z, unit))

    def _sigmas(self, sigmas: Array) -> Any:  # noqa: ANN401 - gtsam has no types
        """Noise of sigmas, at least `_LEAST`; of a kind that GTSAM eliminates by QR.

        It takes Cholesky's way for others, and stops: the squares differ by ten decades.
        """
        few = np.maximum(sigmas, _LEAST)
        return self._gtsam.noiseModel.Constrained.MixedSigmas(np.full(len(few), 1000.0), few)

    def solve(self, steps: Sequence[int]) -> tuple[Array, Array]:
        """Mean and sigma, both (len(steps), 24), of the errors after so many steps."""
        ordering = self._gtsam.Ordering()
        for k in range(self._keys):
            ordering.push_back(k)
        tree = self._graph.eliminateMultifrontal(ordering)
        found = tree.optimize()
        mean, sigma = np.zeros((len(steps), N)), np.zeros((len(steps), N))
        for row, step in enumerate(steps):
            mean[row, self._active] = self._unit * found.at(step)
            P = tree.marginalCovariance(step)
            sigma[row, self._active] = self._unit * np.sqrt(np.diagonal(P))
        return mean, sigma
