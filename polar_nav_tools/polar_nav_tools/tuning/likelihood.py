"""Likelihood of a recording as a function of its noise, over runs of the compiled filter.

Each run has the same measurements, whatever its noise: no gate, no robust weights, nothing that
opens or doubts; what is grossly wrong is left out of all runs (`plausible`). The independent
innovations of a run are its likelihood. Derivation: docs/derivations/tuning.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.arrays import Array, Ints
from polar_nav_core.engine.events import Rank
from polar_nav_core.engine.innovations import Innovations, independent, innovations
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.smoothing import in_order
from polar_nav_core.errors import FilterDivergence

from ..calibration.move import Move
from ..calibration.problem import SENSORS, stated_sigmas
from ..foreign.recording import until
from .parameters import Parameter

Mask = NDArray[np.bool_]
_START_SIGMA = 100.0
"""The start often is a fix, and then as good as that: at least so little is known of it [m]."""
_OUTPUT_S = 10.0


@dataclass(frozen=True)
class Rows:
    """Independent innovations of a run.

    Attributes
    ----------
    stamps_ns, ranks, sizes : (n,) arrays
        Of the measurements, as `Innovations` has them.
    white, log_sigma : (n, 3) arrays
        Numbers of unit variance in a world as stated, and logarithms of what they were divided by.
    dof : (n,) array
        How many of those say something: of a fix without height two.
    """

    stamps_ns: Ints
    ranks: Ints
    sizes: Ints
    white: Array
    log_sigma: Array
    dof: Ints

    def ln_density(self) -> Array:
        """Logarithm of the density of each measurement given all before it, shape (n,)."""
        constant = 0.5 * math.log(2.0 * math.pi) * self.sizes
        return np.asarray(
            -self.log_sigma.sum(axis=1) - 0.5 * np.sum(self.white**2, axis=1) - constant
        )

    def part(self, chosen: Mask) -> Rows:
        """Rows of some measurements, by mask."""
        return Rows(*(getattr(self, name)[chosen] for name in vars(self)))

    def same_measurements(self, other: Rows) -> bool:
        """Whether another run fused the same."""
        return np.array_equal(self.stamps_ns, other.stamps_ns) and np.array_equal(
            self.ranks, other.ranks
        )


class Problem:
    """Runs of a recording with noise that is so many times what is stated.

    Parameters
    ----------
    params : EngineParams
        As stated.
    inputs : Inputs
        Without what is left out.
    parameters : sequence of Parameter
    first_ns, last_ns : int
        Measurements between these stamps count; the filter begins before.
    counted : callable
        Called once for each run.
    """

    def __init__(
        self,
        params: EngineParams,
        inputs: Inputs,
        parameters: Sequence[Parameter],
        first_ns: int,
        last_ns: int,
        counted: Callable[[], None] = lambda: None,
    ) -> None:
        self.parameters = tuple(parameters)
        self._params = ungated(params)
        self._sigmas = stated_sigmas(params)
        self._inputs = until(inputs, last_ns)
        self._first_ns, self._last_ns = first_ns, last_ns
        self._counted = counted

    def moved(self, move: Move) -> Problem:
        """The same measurements with something stated otherwise, by 1; noise is as it was."""
        there = copy(self)
        there._params, there._inputs = move(self._params, self._inputs, 1.0)
        return there

    def noisier(self, at: Array) -> tuple[EngineParams, Inputs]:
        """Parameters without a gate and inputs, with logarithms of factors (k,) on the noise."""
        return noisier(self._params, self._inputs, self.parameters, at)

    def rows(self, at: Array) -> Rows | None:
        """Independent innovations with logarithms of factors (k,) on the noise that is stated.

        None where a filter with that noise is lost.
        """
        params, inputs = self.noisier(at)
        self._counted()
        try:
            run = innovations(params, inputs)
        except FilterDivergence:
            return None
        if run.divergence or run.filters > 1:
            return None
        rows = rows_of(run, self._sigmas)
        found = rows.part((rows.stamps_ns >= self._first_ns) & (rows.stamps_ns < self._last_ns))
        return found if np.isfinite(found.ln_density()).all() else None


def rows_of(run: Innovations, sigmas: Array) -> Rows:
    """Independent innovations of a run."""
    white, log_sigma = independent(run, sigmas)
    return Rows(run.stamps_ns, run.ranks, run.sizes, white, log_sigma, run.dof)


def ungated(params: EngineParams) -> EngineParams:
    """Parameters with which all measurements are fused, each at its validity, as stated.

    Raises
    ------
    ConfigError
        For parameters that have no linear steps.
    """
    return replace(
        each_at_its_validity(params),
        gate_probability=1.0,
        robust_fixes='none',
        max_fix_sigma=0.0,
        min_fix_sigma=0.0,
        reopen_after_s=0.0,
    )


def each_at_its_validity(params: EngineParams) -> EngineParams:
    """Parameters with which each fix is fused at its validity; gates are as stated."""
    return replace(
        in_order(params),
        initial_sigma_position=max(params.initial_sigma_position, _START_SIGMA),
        output_period_s=max(params.output_period_s, _OUTPUT_S),
    )


def noisier(
    params: EngineParams, inputs: Inputs, parameters: Sequence[Parameter], at: Array
) -> tuple[EngineParams, Inputs]:
    """Parameters and inputs with logarithms of factors (k,) on the noise."""
    for parameter, value in zip(parameters, at.tolist(), strict=True):
        params, inputs = parameter.scaled(params, inputs, math.exp(value))
    return params, inputs


_MEDIAN = {1: 0.4549, 2: 1.3863, 3: 2.3660}
"""Median of chi-square."""
_ROUNDS = 5
_GROSS = 1.0 - 1e-6
"""Share of good measurements that the gate keeps: to cut noise off would make it look smaller."""
_ALIKE = 1.2


@dataclass(frozen=True)
class Kept:
    """Measurements that are not grossly wrong, as masks over those of a recording.

    Attributes
    ----------
    dvl, depth, fixes : (n,) arrays of bool
    first_ns : int
        Stamp of the first that was fused [ns].
    larger : mapping of Rank to float
        Factors on the variances of sensors with which they were judged.
    """

    dvl: Mask
    depth: Mask
    fixes: Mask
    first_ns: int
    larger: Mapping[Rank, float]

    def of(self, inputs: Inputs) -> Inputs:
        """Inputs of the recording without the others; all headings stay."""
        fixes = zip(inputs.fixes, self.fixes.tolist(), strict=True)
        return replace(
            inputs,
            dvl_valid=inputs.dvl_valid & self.dvl,
            depth_stamps_ns=inputs.depth_stamps_ns[self.depth],
            depth=inputs.depth[self.depth],
            depth_variance=inputs.depth_variance[self.depth],
            fixes=tuple(f for f, ok in fixes if ok),
        )

    def alike(self, other: Kept) -> bool:
        """Whether another one keeps the same."""
        return all(
            np.array_equal(getattr(self, name), getattr(other, name))
            for name in ('dvl', 'depth', 'fixes')
        )

    def left_out(self, inputs: Inputs) -> dict[str, int]:
        """How many usable measurements it does not keep, by sensor; those with any."""
        usable = np.array([f.refusal is None for f in inputs.fixes], dtype=bool)
        counts = {
            'dvl': int((inputs.dvl_valid & ~self.dvl).sum()),
            'depth': int((~self.depth).sum()),
            'fix': int((usable & ~self.fixes).sum()),
        }
        return {name: count for name, count in counts.items() if count}

    def mostly_wrong(self, inputs: Inputs) -> tuple[str, ...]:
        """Sensors of whose usable measurements it does not keep half."""
        usable = {
            'dvl': int(inputs.dvl_valid.sum()),
            'depth': len(inputs.depth),
            'fix': sum(f.refusal is None for f in inputs.fixes),
        }
        return tuple(n for n, count in self.left_out(inputs).items() if 2 * count > usable[n])


def plausible(params: EngineParams, inputs: Inputs) -> Kept:
    """Measurements of a recording without what is grossly wrong.

    The noise of each sensor is enlarged until the median of its NIS is that of a right model,
    whatever single measurements say; what a wide gate then refuses is left out. First
    without a gate, where gross errors spoil what comes after them, then with it, as often as the
    noise changes.
    """
    stated = stated_sigmas(params)
    calm = replace(each_at_its_validity(params), gate_probability=_GROSS, max_imu_noise_factor=1.0)
    larger = dict.fromkeys(SENSORS, 1.0)
    run = innovations(ungated(params), inputs)
    for _ in range(_ROUNDS):
        before, larger = larger, _larger(rows_of(run, stated), larger)
        run = innovations(calm, _enlarged(inputs, larger))
        if all(1.0 / _ALIKE <= larger[r] / before[r] <= _ALIKE for r in SENSORS):
            break
    valid_ns = np.array([f.validity_ns for f in inputs.fixes], dtype=np.int64)
    return Kept(
        _fused(run, Rank.DVL, inputs.dvl_stamps_ns, inputs),
        _fused(run, Rank.DEPTH, inputs.depth_stamps_ns, inputs),
        _fused(run, Rank.FIX, valid_ns, inputs),
        int(run.stamps_ns[0]),
        larger,
    )


def _larger(rows: Rows, by: dict[Rank, float]) -> dict[Rank, float]:
    """Factors on the variances of sensors with which the median NIS is as modelled, at least 1."""
    out = dict(by)
    for rank in SENSORS:
        of = rows.ranks == rank
        if of.any():
            nis = np.sum(rows.white[of] ** 2, axis=1)
            median = _MEDIAN[int(rows.dof[of].max())]
            out[rank] = max(1.0, by[rank] * float(np.median(nis)) / median)
    return out


def _enlarged(inputs: Inputs, by: dict[Rank, float]) -> Inputs:
    """Inputs with variances times factors; those of headings are a parameter and stay."""
    fixes = inputs.fixes
    if by[Rank.FIX] != 1.0:
        fixes = tuple(f.believed_to(by[Rank.FIX] * f.covariance_e) for f in fixes)
    return replace(
        inputs,
        dvl_covariance_m=by[Rank.DVL] * inputs.dvl_covariance_m,
        depth_variance=by[Rank.DEPTH] * inputs.depth_variance,
        fixes=fixes,
    )


def _fused(run: Innovations, rank: Rank, stamps_ns: Ints, inputs: Inputs) -> Mask:
    """Whether a run has fused the measurements of these stamps (m,), or was not there to do so.

    A measurement stands in the log with the stamp of the IMU sample that it was fused after.
    """
    fused = run.stamps_ns[run.ranks == rank]
    before = np.searchsorted(inputs.imu_stamps_ns, stamps_ns, side='right') - 1
    at = inputs.imu_stamps_ns[np.maximum(before, 0)]
    away = (at < run.stamps_ns[0]) | (at > run.stamps_ns[-1])
    return np.asarray(np.isin(at, fused) | np.isin(stamps_ns, fused) | away)
