"""IMU samples judged by those before them: a sensor that hangs, and a rate that leaps.

A sensor has noise, so a few equal samples are a coarse resolution or a driver that is faster than
its sensor, and more are no measurement. And a vehicle has inertia: a rate that is there in one
sample and gone in the next turns the attitude by degrees that never were, after which gravity
leaks into the velocity. So a sample that leaps waits for a second one that agrees, as one stamped
ahead does; what is missing then is one sample. Forces may leap: a blow does that.

The rules stand here once, for one sample after another; of columns, only what is odd is judged one
by one. Station mode has no such rules: the attitude of an AHRS on a vehicle at rest may well
repeat, and nothing is integrated.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .. import spilled
from ..arrays import Array
from .inputs import Stamps
from .params import EngineParams
from .verdicts import Refusal, Verdict

Values: TypeAlias = list[float]

SLEW = 20.0
"""Angular acceleration beyond that of vehicles [rad/s^2]: what a rate may change by in between."""


class ImuSequence:
    """Judges IMU samples by those before them.

    Parameters
    ----------
    params : EngineParams
    """

    def __init__(self, params: EngineParams) -> None:
        sins = params.mode == 'sins'
        self._most_repeats = params.max_imu_repeats if sins else 0
        self._most_leap = params.max_rate_leap if sins else np.inf
        self._values: tuple[Values, Values] | None = None
        self._repeats = 0
        self._used: tuple[int, Values] | None = None
        self._odd: tuple[int, Values] | None = None

    @property
    def calm(self) -> bool:
        """Whether the newest sample was like none before it and did not leap."""
        return self._odd is None and not self._repeats

    def refusal(self, stamp_ns: int, omega_ib_b: Values, f_b: Values) -> Refusal | None:
        """Verdict and reason of a sample that those before it refute; None of another one.

        The sample [rad/s], [m/s^2] is the next one that can be used by all other rules.
        """
        return self._repeated(omega_ib_b, f_b) or self._leaps(stamp_ns, omega_ib_b)

    def _repeated(self, omega_ib_b: Values, f_b: Values) -> Refusal | None:
        if not self._most_repeats:
            return None
        values = omega_ib_b, f_b
        self._repeats = self._repeats + 1 if values == self._values else 0
        self._values = values
        if self._repeats <= self._most_repeats:
            return None
        sentence = f'the IMU repeats one sample, {self._repeats} times so far: it hangs'
        return Verdict.IMPLAUSIBLE, sentence

    def _leaps(self, stamp_ns: int, omega_ib_b: Values) -> Refusal | None:
        sample, used, odd = (stamp_ns, omega_ib_b), self._used, self._odd
        if (
            used is None
            or not self._is_leap(used, sample)
            or (odd is not None and not self._is_leap(odd, sample))
        ):
            self._used, self._odd = sample, None
            return None
        self._odd = sample
        size = max(abs(a - b) for a, b in zip(omega_ib_b, used[1], strict=True))
        return Verdict.IMPLAUSIBLE, (
            f'a rate {size:.3g} rad/s off the one before, max_rate_leap is '
            f'{self._most_leap:g} rad/s: a second one has to agree'
        )

    def _is_leap(self, before: tuple[int, Values], after: tuple[int, Values]) -> bool:
        most = self._most_leap + SLEW * ((after[0] - before[0]) * 1e-9)
        return any(abs(a - b) > most for a, b in zip(after[1], before[1], strict=True))


def refusals_in_columns(
    params: EngineParams,
    stamps_ns: Stamps,
    omega_ib_b: Array,
    f_b: Array,
    within: NDArray[np.bool_],
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
    at = 0
    for begin, last in _odd_rows(params, stamps_ns, omega_ib_b, f_b, within):
        if last < at:
            continue
        sequence, used_ns = ImuSequence(params), None
        for row in range(max(begin, at), len(stamps_ns)):
            stamp_ns = int(stamps_ns[row])
            if not within[row] or stamp_ns == used_ns:  # the second of its stamp is refused
                continue
            at = row
            refused = sequence.refusal(stamp_ns, omega_ib_b[row].tolist(), f_b[row].tolist())
            if refused is not None:
                found[row] = refused
                continue
            used_ns = stamp_ns
            if row >= last and sequence.calm:
                break
    return found


def _odd_rows(
    params: EngineParams,
    stamps_ns: Stamps,
    omega_ib_b: Array,
    f_b: Array,
    within: NDArray[np.bool_],
) -> Iterator[tuple[int, int]]:
    """Rows that may be refuted, mostly none, each after the row from which on to look.

    A second sample of a stamp is one, and the next one: which of the two is used is to be seen.
    """
    most = params.max_imu_repeats
    tail = np.zeros(0, dtype=np.intp)
    for part in spilled.parts(len(within)):
        rows = np.r_[tail, part.start + np.flatnonzero(within[part])]
        dt_ns = np.diff(stamps_ns[rows])
        change = np.abs(np.diff(omega_ib_b[rows], axis=0)).max(axis=1, initial=0.0)
        odd = (change > params.max_rate_leap + SLEW * (dt_ns * 1e-9)) | (dt_ns == 0)
        odd[1:] |= dt_ns[:-1] == 0
        if most and len(odd) > most:
            f = f_b[rows]
            same = (change == 0.0) & (f[1:] == f[:-1]).all(axis=1)
            odd |= np.convolve(same, np.ones(most + 1, dtype=np.int64))[: len(odd)] > most
        for k in (np.flatnonzero(odd) + 1).tolist():
            if k >= len(tail):
                yield int(rows[max(k - most - 2, 0)]), int(rows[k])
        tail = rows[len(rows) - min(len(rows), most + 3) :]
