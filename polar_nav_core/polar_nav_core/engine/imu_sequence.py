"""IMU samples judged by those before them: a sensor that hangs, and a rate that leaps.

A sensor has noise, so a few equal samples are a coarse resolution or a driver that is faster than
its sensor, and more are no measurement. One instrument may hang while the other goes on: its
gyros, or its accelerometers. One with noise seldom says the same twice, and one that hangs says
nothing else. But a coarse one at rest repeats its values, too, as does a fast driver. They do so
all the time, and a coarse axis of a vehicle in motion wherever its rate turns round. So an
instrument of which no axis did for `LIVELY` samples hangs where all three repeat their values.

And a vehicle has inertia: a rate that is there in one sample and gone in the next turns the
attitude by degrees that never were, after which gravity leaks into the velocity. So a sample that
leaps waits for a second one that agrees, as one stamped ahead does; what is missing then is one
sample. Forces may leap: a blow does that.

Station mode has no such rules: the attitude of an AHRS on a vehicle at rest may well repeat, and
nothing is integrated.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import spilled
from ..arrays import Array, Bools
from ..kernels.imu_sequence import (
    FINE,
    GYROS_HANG,
    LEAPS,
    REPEATED,
    Samples,
    judge,
    judge_many,
    make_samples,
)
from .inputs import Stamps
from .params import EngineParams
from .verdicts import Refusal, Verdict

LIVELY = 300
"""Samples without an axis that repeats its value: of an instrument that never does."""
SLEW = 20.0
"""Angular acceleration beyond that of vehicles [rad/s^2]: what a rate may change by in between."""


class ImuSequence:
    """Judges IMU samples by those before them.

    Parameters
    ----------
    params : EngineParams
    """

    def __init__(self, params: EngineParams) -> None:
        self._params = params
        self._sequence = _sequence(params)
        self._omega_ib_b, self._f_b = np.zeros(3), np.zeros(3)

    def refusal(self, stamp_ns: int, omega_ib_b: Array, f_b: Array) -> Refusal | None:
        """Verdict and reason of a sample that those before it refute; None of another one.

        The sample [rad/s], [m/s^2], shape (3,) each, is the next one that can be used by all
        other rules.
        """
        self._omega_ib_b[:], self._f_b[:] = omega_ib_b, f_b
        code = judge(self._sequence, stamp_ns, self._omega_ib_b, self._f_b)
        if code == FINE:
            return None
        return _refusal(self._params, code, float(self._sequence.number[0]))


def refusals_in_columns(
    params: EngineParams,
    stamps_ns: Stamps,
    omega_ib_b: Array,
    f_b: Array,
    within: Bools,
) -> dict[int, Refusal]:
    """Verdict and reason by row of the samples that those before them refute.

    Parameters
    ----------
    params : EngineParams
    stamps_ns : (n,) array
        In order.
    omega_ib_b, f_b : (n, 3) arrays
    within : (n,) array of bool
        Samples within the limits of a sensor: only they count.
    """
    found: dict[int, Refusal] = {}
    sequence = _sequence(params)
    for part in spilled.parts(len(within)):
        stamps, good = _plain(stamps_ns[part]), _plain(within[part])
        codes, numbers = np.zeros(len(stamps), dtype=np.int64), np.zeros(len(stamps))
        rates, forces = _plain(omega_ib_b[part]), _plain(f_b[part])
        judge_many(sequence, stamps, rates, forces, good, codes, numbers)
        for k in np.flatnonzero(codes != FINE).tolist():
            found[part.start + k] = _refusal(params, int(codes[k]), float(numbers[k]))
    return found


def _plain(column: NDArray[Any]) -> NDArray[Any]:
    """Return a column as kernels know it: one of a file that nobody writes to is another type."""
    return np.require(column, requirements=['C', 'W', 'E'])


def _sequence(params: EngineParams) -> Samples:
    if params.mode != 'sins':
        return make_samples(0, 0, LIVELY, math.inf, SLEW)
    repeats, alone = params.max_imu_repeats, params.max_instrument_repeats
    return make_samples(repeats, alone, LIVELY, params.max_rate_leap, SLEW)


def _refusal(params: EngineParams, code: int, number: float) -> Refusal:
    """Verdict and reason of what `judge` returns, with its number."""
    if code == REPEATED:
        why = f'the IMU repeats one sample, {number:.0f} times so far: it hangs'
    elif code == LEAPS:
        why = (
            f'a rate {number:.3g} rad/s off the one before, max_rate_leap is '
            f'{params.max_rate_leap:g} rad/s: a second one has to agree'
        )
    else:
        name, other = ('gyros', 'forces') if code == GYROS_HANG else ('accelerometers', 'rates')
        sentence = f'the {name} repeat one sample, {number:.0f} times so far'
        why = f'{sentence}, and the {other} go on: they hang'
    return Verdict.IMPLAUSIBLE, why
