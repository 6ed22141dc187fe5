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
from . import imu_instruments
from .imu_instruments import Instrument, beginnings
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
        most_alone = params.max_instrument_repeats if sins else 0
        self._gyros, self._accelerometers = Instrument(most_alone), Instrument(most_alone)
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
        hangs = self._hangs(omega_ib_b, f_b)
        return self._repeated(omega_ib_b, f_b) or hangs or self._leaps(stamp_ns, omega_ib_b)

    def _hangs(self, omega_ib_b: Values, f_b: Values) -> Refusal | None:
        gyros, accelerometers = self._gyros.hangs(omega_ib_b), self._accelerometers.hangs(f_b)
        if not (gyros or accelerometers):
            return None
        name, other = ('gyros', 'forces') if gyros else ('accelerometers', 'rates')
        sentence = f'the {name} repeat one sample, {gyros or accelerometers} times so far'
        return Verdict.IMPLAUSIBLE, f'{sentence}, and the {other} go on: they hang'

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
    back = _rows_back(params)
    at, usual, used_ns = -1, 0, None  # the next row, and samples in a row that were as any other
    sequence = ImuSequence(params)
    for begin, last in _odd_rows(params, stamps_ns, omega_ib_b, f_b, within):
        if begin > at:
            sequence, at, usual, used_ns = ImuSequence(params), begin, 0, None
        while at < len(stamps_ns) and not (at > last + back and usual > back and sequence.calm):
            row, at = at, at + 1
            if not within[row]:
                continue
            stamp_ns = int(stamps_ns[row])
            if stamp_ns == used_ns:  # the second of its stamp is refused
                usual = 0
                continue
            refused = sequence.refusal(stamp_ns, omega_ib_b[row].tolist(), f_b[row].tolist())
            if refused is None:
                used_ns, usual = stamp_ns, usual + 1
            else:
                found[row], usual = refused, 0
    return found


def _rows_back(params: EngineParams) -> int:
    """Samples before one that decide on it, at most."""
    alone = params.max_instrument_repeats
    lively = imu_instruments.LIVELY + 2 * alone if alone else 0
    return max(params.max_imu_repeats, lively) + 2


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
    most, alone, back = params.max_imu_repeats, params.max_instrument_repeats, _rows_back(params)
    tail = np.zeros(0, dtype=np.intp)
    for part in spilled.parts(len(within)):
        rows = np.r_[tail, part.start + np.flatnonzero(within[part])]
        dt_ns = np.diff(stamps_ns[rows])
        change = np.abs(np.diff(omega_ib_b[rows], axis=0)).max(axis=1, initial=0.0)
        odd = (change > params.max_rate_leap + SLEW * (dt_ns * 1e-9)) | (dt_ns == 0)
        odd[1:] |= dt_ns[:-1] == 0
        f = f_b[rows] if most or alone else f_b[:0]
        if most and len(odd) > most:
            same = (change == 0.0) & (f[1:] == f[:-1]).all(axis=1)
            odd |= np.convolve(same, np.ones(most + 1, dtype=np.int64))[: len(odd)] > most
        if alone:
            odd |= (beginnings(omega_ib_b[rows], alone) | beginnings(f, alone))[1:]
        for k in (np.flatnonzero(odd) + 1).tolist():
            if k >= len(tail):
                yield int(rows[max(k - back, 0)]), int(rows[k])
        tail = rows[len(rows) - min(len(rows), back + 1) :]
