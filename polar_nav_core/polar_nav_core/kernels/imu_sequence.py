"""IMU samples judged by those before them: a sensor that hangs, one instrument of it, a leap.

What the rules are for: `engine.imu_sequence`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Array, Bools, Ints
from .cache import entry, kernel, routine

FINE, REPEATED, GYROS_HANG, ACCELEROMETERS_HANG, LEAPS = range(5)
"""What those before say of a sample."""
SEEN, REPEATS, HAS_USED, HAS_ODD = range(4)
"""Places in `Samples.counters`."""
RUNS, MOVED, HUNG = 0, 3, 4
"""Places in a row of `Samples.instruments`; the runs of the three axes come first."""
USED, ODD = 0, 1
"""Rows of `Samples.stamps` and `Samples.rates`."""


class Samples(NamedTuple):
    """What of the samples so far decides on the next one.

    Attributes
    ----------
    counters : (4,) array of int
        Whether there was a sample; how often the newest one was like that before it; whether one
        was used, and whether the newest one leapt.
    stamps : (2,) array of int
        Of the sample used last and of the one that leapt [ns].
    rates : (2, 3) array
        Theirs [rad/s].
    newest : (2, 3) array
        Rates and forces of the newest sample [rad/s], [m/s^2].
    instruments : (2, 5) array of int
        Of gyros and accelerometers: repeats in a row of each axis, samples without any so far,
        whether it hangs.
    most_repeats : (2,) array of int
        Equal samples in a row that an IMU may give, and one instrument alone; 0 judges nothing.
    lively : (1,) array of int
        Samples without an axis that repeats its value: of an instrument that never does.
    limits : (2,) array
        What a rate may leap by [rad/s], and change by in a second besides [rad/s^2].
    number : (1,) array
        Of the newest refusal: repeats so far, or size of the leap [rad/s].
    """

    counters: Ints
    stamps: Ints
    rates: Array
    newest: Array
    instruments: Ints
    most_repeats: Ints
    lively: Ints
    limits: Array
    number: Array


def make_samples(
    most_repeats: int, most_alone: int, lively: int, most_leap: float, slew: float
) -> Samples:
    """Return the `Samples` before the first sample."""
    return Samples(
        counters=np.zeros(4, dtype=np.int64),
        stamps=np.zeros(2, dtype=np.int64),
        rates=np.zeros((2, 3)),
        newest=np.zeros((2, 3)),
        instruments=np.zeros((2, 5), dtype=np.int64),
        most_repeats=np.array([most_repeats, most_alone], dtype=np.int64),
        lively=np.array([lively], dtype=np.int64),
        limits=np.array([most_leap, slew]),
        number=np.zeros(1),
    )


@kernel
def _hangs(own: Ints, before: Array, values: Array, most: int, lively: int) -> int:
    """Return how often an instrument has repeated itself, if that shows that it hangs; else 0.

    An instrument of which no axis repeated its value for ``lively`` samples hangs where all three
    do more than ``most`` times.
    """
    x, y, z = values[0] == before[0], values[1] == before[1], values[2] == before[2]
    if not (x or y or z):  # nearly always
        own[0] = own[1] = own[2] = own[HUNG] = 0
        own[MOVED] += 1
        return 0
    hung = own[HUNG] == 1 and not (x and y and z)
    for k in range(3):
        if values[k] != before[k]:
            own[RUNS + k] = 0
        elif hung:  # what it had hung at it says by chance, not since long
            own[RUNS + k] = 1
        else:
            own[RUNS + k] += 1
    repeats: int = min(own[0], own[1], own[2])
    longest = max(own[0], own[1], own[2])
    if repeats > most and own[MOVED] >= lively:
        own[HUNG] = 1
        return repeats
    own[HUNG] = 0
    if repeats > most or (repeats == 0 and longest > most):
        own[MOVED] = 0
    else:
        own[MOVED] += 1
    return 0


@kernel
def _farthest(a: Array, b: Array) -> float:
    farthest: float = max(abs(a[0] - b[0]), abs(a[1] - b[1]), abs(a[2] - b[2]))
    return farthest


@kernel
def _is_leap(q: Samples, row: int, stamp_ns: int, omega_ib_b: Array) -> bool:
    """Whether rates lie farther from those of a row than a vehicle can turn until then."""
    most: float = q.limits[0] + q.limits[1] * ((stamp_ns - q.stamps[row]) * 1e-9)
    return _farthest(omega_ib_b, q.rates[row]) > most


@kernel
def _put(q: Samples, row: int, stamp_ns: int, omega_ib_b: Array) -> None:
    q.stamps[row] = stamp_ns
    for k in range(3):
        q.rates[row, k] = omega_ib_b[k]


@kernel
def _judge(q: Samples, stamp_ns: int, omega_ib_b: Array, f_b: Array) -> int:
    """`judge` where it is inlined: a call copies all arrays of ``q``."""
    gyros, accelerometers = 0, 0
    same = q.counters[SEEN] == 1
    if same:
        most, lively = q.most_repeats[1], q.lively[0]
        if most > 0:
            gyros = _hangs(q.instruments[0], q.newest[0], omega_ib_b, most, lively)
            accelerometers = _hangs(q.instruments[1], q.newest[1], f_b, most, lively)
        for k in range(3):
            same = same and omega_ib_b[k] == q.newest[0, k] and f_b[k] == q.newest[1, k]
    q.counters[SEEN] = 1
    q.counters[REPEATS] = q.counters[REPEATS] + 1 if same else 0
    for k in range(3):
        q.newest[0, k] = omega_ib_b[k]
        q.newest[1, k] = f_b[k]
    if q.most_repeats[0] > 0 and q.counters[REPEATS] > q.most_repeats[0]:
        q.number[0] = q.counters[REPEATS]
        return REPEATED
    if gyros > 0:
        q.number[0] = gyros
        return GYROS_HANG
    if accelerometers > 0:
        q.number[0] = accelerometers
        return ACCELEROMETERS_HANG
    if (
        q.counters[HAS_USED] == 1
        and _is_leap(q, USED, stamp_ns, omega_ib_b)
        and (q.counters[HAS_ODD] == 0 or _is_leap(q, ODD, stamp_ns, omega_ib_b))
    ):
        _put(q, ODD, stamp_ns, omega_ib_b)
        q.counters[HAS_ODD] = 1
        q.number[0] = _farthest(omega_ib_b, q.rates[USED])
        return LEAPS
    _put(q, USED, stamp_ns, omega_ib_b)
    q.counters[HAS_USED], q.counters[HAS_ODD] = 1, 0
    return FINE


@entry
@routine
def judge(q: Samples, stamp_ns: int, omega_ib_b: Array, f_b: Array) -> int:
    """Return what those before say of the next sample; the number with it goes into ``q``.

    Parameters
    ----------
    q : Samples
        In place.
    stamp_ns : int
    omega_ib_b, f_b : (3,) arrays
        Of a sample that can be used by all other rules [rad/s], [m/s^2].
    """
    code: int = _judge(q, stamp_ns, omega_ib_b, f_b)
    return code


@entry
@routine
def judge_many(
    q: Samples,
    stamps_ns: Ints,
    omega_ib_b: Array,
    f_b: Array,
    within: Bools,
    codes: Ints,
    numbers: Array,
) -> None:
    """Fill what those before say of each of n samples in order, and the number with it.

    Parameters
    ----------
    q : Samples
        In place.
    stamps_ns : (n,) array of int
    omega_ib_b, f_b : (n, 3) arrays
        [rad/s], [m/s^2]
    within : (n,) array of bool
        Samples within the limits of a sensor: only they count, and of one stamp only those after
        which none was used.
    codes : (n,) array of int
        Out; FINE where nothing is said.
    numbers : (n,) array
        Out, where something is.
    """
    for k in range(stamps_ns.shape[0]):
        codes[k] = FINE
        if not within[k]:
            continue
        if q.counters[HAS_USED] == 1 and stamps_ns[k] == q.stamps[USED]:
            continue
        codes[k] = _judge(q, stamps_ns[k], omega_ib_b[k], f_b[k])
        numbers[k] = q.number[0]
