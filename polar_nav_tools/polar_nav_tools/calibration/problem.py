"""Runs of the filter with constants moved, and what their innovations say of them.

A run gives the whitened innovations and how each moves with a constant. The filter's own states
are nuisance, and so is each common error that is not calibrated, with its stated sigma.
Derivation: docs/derivations/calibration.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.arrays import Array
from polar_nav_core.engine.events import Rank
from polar_nav_core.engine.innovations import Innovations, innovations
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.sins.settings import common_sigmas
from polar_nav_core.error_model import X
from polar_nav_core.kernels.sins import consider

from .constants import Constant
from .solve import Normal, least_squares, with_states

Progress = Callable[[float], None]
Noise = Mapping[Rank, float]
MOST_ROUNDS = 12
SENSORS = {Rank.DEPTH: 'depth', Rank.DVL: 'dvl', Rank.HEADING: 'heading', Rank.FIX: 'fix'}
_START_SIGMA = 100.0
"""The start often is a fix, as late as the others: at least so little is known of it [m]."""
_NOISIER = 1.5
"""Mean squared innovation from which on noise counts as larger."""
_STEP = 0.02
"""Differences over this share of the prior give the rows of constants without a common error."""
_SHIFT_S = 0.5
"""Of the last fix, in the differences of a drift."""
_ERRORS, _STATE = X.b_gyro_b.start, 15
"""Where sensor errors begin among the 24 errors, and among a state's leading values."""
_NEAR = 1.0
"""Share of an IMU interval within which a ping is moved no further."""
_HEADING_TAU = 1e6
_KNOWN_SCALE = 1e-6
SIGMAS = {
    consider.RANGE_SCALE: ('fix_range_scale_sigma', 1.0),
    consider.ARRAY_TURN: ('fix_heading_sigma_deg', math.degrees(1.0)),
    consider.CLOCK: ('fix_clock_sigma', 1.0),
    consider.DVL_YAW: ('dvl_misalignment_sigma_deg', math.degrees(1.0)),
    consider.DVL_PITCH: ('dvl_misalignment_sigma_deg', math.degrees(1.0)),
    consider.DVL_LEVER_X: ('dvl_lever_sigma', 1.0),
    consider.DVL_LEVER_Y: ('dvl_lever_sigma', 1.0),
    consider.DVL_LATENCY: ('dvl_latency_sigma', 1.0),
    consider.DEPTH_ZERO: ('depth_offset_sigma', 1.0),
}
"""Parameter of the sigma of a common error, and its unit."""


class Problem:
    """Runs of the filter with constants moved, and least squares over their innovations."""

    def __init__(
        self,
        params: EngineParams,
        inputs: Inputs,
        constants: Sequence[Constant],
        progress: Progress,
    ) -> None:
        self.moved = [c for c in constants if not c.states]
        self._held = [c for c in constants if c.states]
        self._params, self._inputs = prepared(params, constants), inputs
        sigmas = stated_sigmas(params)
        free = {c.column for c in self.moved}
        self._nuisance = [k for k in np.flatnonzero(sigmas).tolist() if k not in free]
        known = [*(c.prior for c in self.moved), *sigmas[self._nuisance].tolist()]
        self.prior = np.array([*known, *(c.prior for c in self._held)])
        self._known = len(known)
        periods_ns = np.diff(inputs.imu_stamps_ns)
        self._period_s = 1e-9 * max(1.0, float(np.median(periods_ns))) if len(periods_ns) else 1.0
        self._progress, self._runs = progress, 0
        self._noise: Noise = {}
        self._most = MOST_ROUNDS * (1 + 2 * sum(map(_by_differences, self.moved)))

    def place(self, c: Constant) -> int:
        """Place of a constant in what `solved` returns."""
        if not c.states:
            return self.moved.index(c)
        return self._known + self._held.index(c)

    def reachable(self, estimated: Array, at: Array) -> Array:
        """Values (k,) to move constants to, near to an estimate, from where they are.

        A ping is fused with the IMU sample before it: it is moved by whole intervals, and stays
        where the estimate is as near to that place as to the next.
        """
        out = estimated.copy()
        for k, c in enumerate(self.moved):
            if c.column == consider.DVL_LATENCY:
                out[k] = round(out[k] / self._period_s) * self._period_s
                if abs(estimated[k] - at[k]) < _NEAR * self._period_s:
                    out[k] = at[k]
        return out

    def run(self, at: Array, noise: Noise | None = None) -> Innovations:
        """Innovations with the constants moved to (k,) values, and variances times factors.

        Without factors those of the run before are taken.
        """
        params, inputs = self._params, self._inputs
        for c, value in zip(self.moved, at.tolist(), strict=True):
            if c.move is not None and value:
                params, inputs = c.move(params, inputs, value)
        self._runs += 1
        self._progress(min(1.0, self._runs / self._most))
        self._noise = self._noise if noise is None else noise
        return innovations(params, _noisier(inputs, self._noise))

    def solved(self, run: Innovations, at: Array) -> Normal:
        """Constants: those that are moved, common errors beside them, those in states."""
        M, S = self._rows(run, at)
        offset = np.concatenate([at, np.zeros(len(self._nuisance))])
        step = least_squares(M, run.white.ravel(), offset, self.prior[: self._known])
        found = Normal(offset + step.mean, step.covariance)
        states = [k for c in self._held for k in c.states]
        at_state = [k - _ERRORS + _STATE for k in states]
        estimate_now = run.state[at_state]
        # Innovations are linear about where the constants are now, and so are the states.
        u = with_states(step, estimate_now, run.P[np.ix_(states, states)], S[states])
        return Normal(np.concatenate([found.mean, u.mean[len(offset) :]]), u.covariance)

    def _rows(self, run: Innovations, at: Array) -> tuple[Array, Array]:
        """Change of innovations (rows, k), and of the state's error (24, k), per unit of each."""
        columns = run.moved.reshape(-1, run.moved.shape[2])
        M, S = [], []
        for k, c in enumerate(self.moved):
            if not _by_differences(c):
                M.append(c.sign * columns[:, c.column])
                S.append(c.sign * run.sensitivity[:, c.column])
            else:
                by, of_state = self._differences(run, at, k)
                M.append(by)
                S.append(of_state)
        M += [columns[:, k] for k in self._nuisance]
        S += [run.sensitivity[:, k] for k in self._nuisance]
        rows, errors = len(columns), len(run.sensitivity)
        return np.array(M).reshape(-1, rows).T, np.array(S).reshape(-1, errors).T

    def _differences(self, run: Innovations, at: Array, k: int) -> tuple[Array, Array]:
        """Central differences of a constant that no common error stands for."""
        step = np.zeros(len(at))
        step[k] = self._step(self.moved[k])
        more, less = (self.run(at + s) for s in (step, -step))
        same, up, down = in_common(run, more, less)
        white = np.zeros_like(run.white)
        white[same] = (less.white[down] - more.white[up]) / (2.0 * step[k])
        state = np.zeros(X.size)
        state[_ERRORS:] = (more.state - less.state)[_STATE:] / (2.0 * step[k])
        return white.ravel(), state

    def _step(self, c: Constant) -> float:
        """Size of a difference [SI]; of stamps large against a step of the filter."""
        if c.column == consider.DVL_LATENCY:
            return max(1, round(_STEP * c.prior / self._period_s)) * self._period_s
        if c.name == 'clock_drift':
            return _SHIFT_S * 1e9 / float(np.ptp(self._inputs.imu_stamps_ns))
        return _STEP * c.prior


def stated_sigmas(params: EngineParams) -> Array:
    """Sigmas of the common errors, (COLUMNS,), with those of a leader that drifts."""
    sigmas = common_sigmas(params)
    if params.leader_error_tau > 0.0 and not (params.usbl_bias_sigma or params.uses_heading):
        sigmas[consider.LEADER :] = params.leader_drift_sigma
    return sigmas


def _by_differences(c: Constant) -> bool:
    """Whether differences of runs give the rows of a constant that is moved."""
    return c.column < 0 or c.rough


def larger_noise(run: Innovations, noise: Noise) -> Noise:
    """Factor on the variances of each sensor with which its innovations are as modelled.

    As long as a constant is far off, what is measured is wrong by as much; a filter that believed
    it would be led astray, and the next constants with it.

    Parameters
    ----------
    run : Innovations
    noise : mapping of Rank to float
        Factors of that run; sensors that are as modelled are not in it.
    """
    factors = {rank: noise.get(rank, 1.0) * mean_square(run, rank) for rank in SENSORS}
    return {rank: factor for rank, factor in factors.items() if factor > _NOISIER}


def _noisier(inputs: Inputs, noise: Noise) -> Inputs:
    """Inputs with variances times the factors; that of headings is a parameter and stays."""
    dvl, depth, fix = (noise.get(rank, 1.0) for rank in (Rank.DVL, Rank.DEPTH, Rank.FIX))
    fixes = inputs.fixes
    if fix != 1.0:
        fixes = tuple(f.believed_to(fix * f.covariance_e) for f in fixes)
    return replace(
        inputs,
        dvl_covariance_m=dvl * inputs.dvl_covariance_m,
        depth_variance=depth * inputs.depth_variance,
        fixes=fixes,
    )


def in_common(*runs: Innovations) -> list[NDArray[np.intp]]:
    """Places of the measurements that all of several runs have fused, in each of them.

    A measurement is known by its sensor and number where they fused equally many of it; otherwise
    by the number of the one in the first run whose stamp is nearest: stamps may be moved, by less
    than half of what is between two measurements.
    """
    keys = []
    equal = {rank: len({int((r.ranks == rank).sum()) for r in runs}) == 1 for rank in SENSORS}
    for r in runs:
        key = np.empty((len(r.ranks), 2), dtype=np.int64)
        key[:, 0] = r.ranks
        for rank in SENSORS:
            of = r.ranks == rank
            key[of, 1] = (
                np.arange(int(of.sum()))
                if equal[rank]
                else _numbers(r.stamps_ns[of], runs[0].stamps_ns[runs[0].ranks == rank])
            )
        keys.append([tuple(row) for row in key.tolist()])
    shared = set(keys[0]).intersection(*keys[1:])
    places = [{row: i for i, row in enumerate(key)} for key in keys]
    ordered = sorted(shared, key=places[0].__getitem__)
    return [np.array([p[row] for row in ordered], dtype=np.intp) for p in places]


def _numbers(stamps_ns: NDArray[np.int64], first_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the nearest of the first run's stamps, below 0 where none is near."""
    none = -1 - np.arange(len(stamps_ns))
    if len(first_ns) < 2:
        return none
    after = np.clip(np.searchsorted(first_ns, stamps_ns), 1, len(first_ns) - 1)
    nearer = stamps_ns - first_ns[after - 1] < first_ns[after] - stamps_ns
    number = np.where(nearer, after - 1, after)
    near = np.abs(first_ns[number] - stamps_ns) < 0.5 * float(np.median(np.diff(first_ns)))
    return np.where(near, number, none)


def prepared(params: EngineParams, constants: Sequence[Constant]) -> EngineParams:
    """Parameters of a run that allows for each constant to be as far off as its prior.

    Sigmas of common errors move no estimate, they widen the gate; that of a state that holds a
    constant is its prior, and the start is one that nobody measured.
    """
    changes: dict[str, Any] = {
        'initial_sigma_position': max(params.initial_sigma_position, _START_SIGMA)
    }
    for c in constants:
        if c.column in SIGMAS:
            name, unit = SIGMAS[c.column]
            changes[name] = max(getattr(params, name), c.prior * unit)
        if c.name == 'dvl_scale':
            # The filter's own states of it would hold what is sought.
            changes['dvl_scale_sigma'] = _KNOWN_SCALE
        if c.name == 'heading_bias':
            changes['heading_bias_sigma_deg'] = math.degrees(c.prior)
            changes['heading_bias_tau'] = _HEADING_TAU
    return replace(params, **changes)


def mean_square(run: Innovations, rank: Rank) -> float:
    """Mean squared innovation of a sensor; NaN without any."""
    of = run.ranks == rank
    rows = int(run.dof[of].sum())
    return float(np.sum(run.white[of] ** 2) / rows) if rows else math.nan
