"""An IMU that hangs: the same rates and forces again and again, bit for bit.

A sensor has noise, so a few equal samples are a coarse resolution or a driver that is faster than
its sensor, and more are no measurement. The rule stands here twice, for one sample after another
and for columns; a test compares the two. Station mode has no such rule: the attitude of an AHRS on
a vehicle at rest may well repeat.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from .. import spilled
from ..arrays import Array
from .events import ImuSample, Verdict
from .inputs import Stamps
from .params import EngineParams


class Repeated:
    """Counts the equal samples in a row of an IMU.

    Parameters
    ----------
    params : EngineParams
    """

    def __init__(self, params: EngineParams) -> None:
        self._most = params.max_imu_repeats if params.mode == 'sins' else 0
        self._values: tuple[list[float], list[float]] = ([], [])
        self._repeats = 0

    def refusal(self, sample: ImuSample) -> tuple[Verdict, str] | None:
        """Verdict and reason of a sample that repeats too many before it; None of another one.

        ``sample`` is the next one that can be used by all other rules.
        """
        if not self._most:
            return None
        if sample.repeats:  # counted in columns
            return repeated_refusal(sample.repeats)
        values = sample.omega_ib_b.tolist(), sample.f_b.tolist()
        self._repeats = self._repeats + 1 if values == self._values else 0
        self._values = values
        return repeated_refusal(self._repeats) if self._repeats > self._most else None


def repeated_refusal(repeats: int) -> tuple[Verdict, str]:
    """Verdict and reason of a sample that repeats so many before it."""
    return Verdict.IMPLAUSIBLE, f'the IMU repeats one sample, {repeats} times so far: it hangs'


def repeats_of(
    params: EngineParams,
    stamps_ns: Stamps,
    omega_ib_b: Array,
    f_b: Array,
    within: NDArray[np.bool_],
) -> NDArray[np.int64]:
    """Number (n,) of equal samples before each one, where there are too many; else 0.

    Parameters
    ----------
    params : EngineParams
    stamps_ns : (n,) array
        In order.
    omega_ib_b, f_b : (n, 3) arrays
    within : (n,) array of bool
        Samples within the limits of a sensor: only they count.
    """
    out = np.zeros(len(stamps_ns), dtype=np.int64)
    most = params.max_imu_repeats
    if not most or not _may_hang(most, stamps_ns, omega_ib_b, f_b, within):
        return out
    count, used_ns, before = 0, None, None
    for row in chain.from_iterable(rows.tolist() for rows in _numbers(within)):
        if stamps_ns[row] == used_ns:  # refused as the second of its stamp
            continue
        values = omega_ib_b[row].tolist(), f_b[row].tolist()
        count = count + 1 if values == before else 0
        before = values
        if count > most:
            out[row] = count
        else:
            used_ns = int(stamps_ns[row])
    return out


def _numbers(within: NDArray[np.bool_]) -> Iterator[NDArray[np.intp]]:
    """Numbers of the rows that count, some at a time."""
    return (part.start + np.flatnonzero(within[part]) for part in spilled.parts(len(within)))


def _may_hang(
    most: int, stamps_ns: Stamps, omega_ib_b: Array, f_b: Array, within: NDArray[np.bool_]
) -> bool:
    """Whether more than ``most`` samples in a row equal the one before; or stamps repeat.

    Nearly never, and many times as fast as to count from row to row.
    """
    before = np.zeros(0, dtype=np.intp)
    run = np.zeros(0, dtype=bool)
    for found in _numbers(within):
        rows = np.r_[before, found]
        w, f = omega_ib_b[rows], f_b[rows]
        same = (w[1:] == w[:-1]).all(axis=1) & (f[1:] == f[:-1]).all(axis=1)
        run = np.r_[run, same]
        if len(run) and np.convolve(run, np.ones(most + 1, dtype=np.int64)).max() > most:
            return True
        if (np.diff(stamps_ns[rows]) <= 0).any():
            return True
        before, run = rows[-1:], run[len(run) - min(len(run), most) :]
    return False
