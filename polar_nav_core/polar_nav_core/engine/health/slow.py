"""Slow faults by their signature: of fixes, of the DVL's scale, of gyros and accelerometers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from ...arrays import Array, Ints
from ...kernels.sins import hypotheses as hy
from .conditions import Condition, Culprit, Level

_OF_PAIR = 27.0
"""T of a pair, a chi-square (2), that is a WARN (docs/derivations/signatures.md, 3)."""
_OF_ONE = 25.0
"""That of a kind alone, a chi-square (1)."""
_LIMITS = np.full(hy.KINDS, _OF_ONE)
for _first in hy.PAIRS:
    _LIMITS[_first : _first + 2] = _OF_PAIR
SEVERE = 4.0
"""So many times that is an ERROR."""
_CERTAIN = 40.0
"""T from which on what a fault has done to the estimate is an ERROR, if it is enough: its size is
6.3 of its own sigmas. In a world as stated once in 9,000 h (signatures.md, 4)."""
MOVED = 3.0
"""Published sigmas of the horizontal position by which that is: what is covered lies inside."""
_FAR = 6.0
_SURE = 33.0
"""Where it is so many, T that is enough for an ERROR. That of a WARN is not: of a drift that began
two minutes ago, chance alone has moved the position by as many then."""
_LASTS = 29.5
"""T of fixes from which on what they have done is said after their evidence has faded."""
_AS_LIKELY = 14.0
"""Another kind whose T is less than this below the largest explains the evidence, too: the ratio
of likelihoods is below exp(7), a thousand."""
_CULPRITS = {
    hy.FIX_EAST: Culprit.FIXES,
    hy.STEP_EAST: Culprit.FIXES,
    hy.SCALE_GROWS: Culprit.DVL,
    hy.SCALE_STEP: Culprit.DVL,
    hy.GYRO_X: Culprit.IMU,
    hy.ACCEL_GROWS: Culprit.IMU | Culprit.DEPTH,
}
_DPH = math.radians(1.0) / 3600.0
_UG = 9.80665e-6


class Evidence(NamedTuple):
    """Evidence about slow faults (kernels.sins.hypotheses).

    Attributes
    ----------
    bank : (ROWS, SLOTS * KINDS) array
        State.bank.
    born_ns : (SLOTS,) array of int
        When the hypotheses of each slot began [ns]; 0 for an empty one.
    per_unit_G : (2, SLOTS * KINDS) array
        Change of the horizontal position by a fault of unit size, grid axes [m].
    """

    bank: Array
    born_ns: Ints
    per_unit_G: Array


def slow_faults(evidence: Evidence | None, stamp_ns: int, P_horizontal: Array) -> list[Condition]:
    """The condition that residuals follow a slow fault, if they do.

    Parameters
    ----------
    evidence : Evidence or None
    stamp_ns : int
    P_horizontal : (2, 2) array
        Published covariance of the horizontal position, grid axes [m^2].
    """
    if evidence is None:
        return []
    bank, born_ns, per_unit_G = evidence
    statistic = bank[hy.STATISTIC].reshape(hy.SLOTS, hy.KINDS)
    if not (statistic > _LIMITS).any():
        return []

    def described(slot: int, kind: int) -> tuple[str, Array]:
        own, per_unit = _of_slot(bank, slot), _of_slot(per_unit_G, slot)
        return _words(own, kind), _shift(own, kind, per_unit)

    ages_ns = stamp_ns - born_ns
    return [most_likely(statistic, _CULPRITS, described, ages_ns, P_horizontal, _LIMITS)]


class Way(NamedTuple):
    """How far fixes have taken the position, by the evidence of a moment.

    Attributes
    ----------
    shift_G : (2,) array
        Horizontal, grid axes [m].
    certain : bool
        Whether the evidence is as good as an ERROR asks for.
    """

    shift_G: Array
    certain: bool


def led_by_fixes(evidence: Evidence | None, P_horizontal: Array) -> Way | None:
    """How far fixes that drift, or have moved, took the horizontal position.

    None if that is no likely explanation of the evidence, or inside MOVED sigmas of P (2, 2).
    Where both are likely, the one that took it further.
    """
    if evidence is None:
        return None
    bank, _, per_unit_G = evidence
    statistic = bank[hy.STATISTIC].reshape(hy.SLOTS, hy.KINDS)
    if not statistic.max() > _LASTS:
        return None
    way: Way | None = None
    most = MOVED
    for kind in (hy.FIX_EAST, hy.STEP_EAST):
        slot = int(np.argmax(statistic[:, kind]))
        if _is_as_likely(statistic, kind):
            shift_G = _shift(_of_slot(bank, slot), kind, _of_slot(per_unit_G, slot))
            moved = shift_in_sigmas(shift_G, P_horizontal)
            if moved > most:
                way, most = Way(shift_G, _is_certain(float(statistic[slot, kind]), moved)), moved
    return way


def most_likely(
    statistic: Array,
    culprits: Mapping[int, Culprit],
    described: Callable[[int, int], tuple[str, Array]],
    ages_ns: Ints,
    P_horizontal: Array,
    limits: Array,
) -> Condition:
    """The condition of the slow fault that explains the evidence best, and of all as likely.

    Another kind of the same culprit is named wherever it is a WARN by itself: fixes that move at
    once, a little after a beginning, look like a drift at first.

    Parameters
    ----------
    statistic : (SLOTS, KINDS) array
        T of each hypothesis; one is beyond its limit.
    culprits : mapping of int to Culprit
        By kind; of a pair, the first.
    described : callable
        Of a slot and a kind: the fault in words, with its size; the way (2,) that it has moved the
        horizontal position [m].
    ages_ns : (SLOTS,) array of int
        Since the hypotheses of each slot began [ns].
    P_horizontal : (2, 2) array
        Published covariance of the horizontal position, axes of that way [m^2].
    limits : (KINDS,) array
        T of each kind that is a WARN.
    """
    largest = {kind: float(statistic[:, kind].max()) for kind in culprits}
    first = max(largest, key=lambda kind: largest[kind])
    culprit = Culprit.NONE
    parts, moved = [], 0.0
    for kind in sorted(largest, key=lambda kind: -largest[kind]):
        same = culprits[kind] == culprits[first]
        if not (_is_as_likely(statistic, kind) or (same and largest[kind] > limits[kind])):
            continue
        culprit |= culprits[kind]
        slot = int(np.argmax(statistic[:, kind]))
        words, way = described(slot, kind)
        parts.append(f'{words} since about {int(ages_ns[slot]) / 60e9:.0f} min')
        here = shift_in_sigmas(way, P_horizontal)
        if same and _is_certain(largest[kind], here):
            moved = max(moved, here)
    worst = largest[first]
    sentence = f'{", or ".join(parts)} ({math.sqrt(worst):.1f} sigma)'
    misled = moved > MOVED
    if misled:
        sentence += f', which has moved the position by {moved:.1f} of its stated sigmas'
    level = Level.ERROR if misled or worst > SEVERE * limits[first] else Level.WARN
    return Condition('slow fault', level, culprit, sentence)


def _is_certain(statistic: float, moved: float) -> bool:
    """Whether the evidence of what has moved the position by so many sigmas makes an ERROR."""
    return statistic > (_SURE if moved > _FAR else _CERTAIN)


def _of_slot(columns: Array, slot: int) -> Array:
    """Columns of the hypotheses of a slot."""
    return columns[:, slot * hy.KINDS : (slot + 1) * hy.KINDS]


def _is_as_likely(statistic: Array, kind: int) -> bool:
    """Whether a kind explains the evidence about as well as the one that does it best."""
    return bool(statistic[:, kind].max() > statistic.max() - _AS_LIKELY)


def _shift(slot: Array, kind: int, per_unit_G: Array) -> Array:
    """How far a fault of the size that fits best has moved the horizontal position (2,) [m]."""
    shift: Array = per_unit_G[:, kind] * size_of(slot, kind)
    if kind in hy.PAIRS:
        shift = per_unit_G[:, kind : kind + 2] @ pair_of(slot, kind)
    return shift


def shift_in_sigmas(d: Array, P: Array) -> float:
    """Length of a horizontal shift d (2,) in sigmas of P (2, 2), in its worst direction.

    0 where P is no covariance.
    """
    det = P[0, 0] * P[1, 1] - P[0, 1] * P[1, 0]
    if not (det > 0.0 and P[0, 0] > 0.0):
        return 0.0
    square = P[1, 1] * d[0] ** 2 - (P[0, 1] + P[1, 0]) * d[0] * d[1] + P[0, 0] * d[1] ** 2
    return math.sqrt(max(0.0, float(square / det)))


def pair_of(slot: Array, kind: int) -> tuple[float, float]:
    """Sizes of a pair of kinds that fit best together, in their unit, of a slot's columns."""
    pair = slice(kind, kind + 2)
    return sizes_of(slot[hy.LAMBDA, pair], float(slot[hy.CROSS, kind]), slot[hy.ZETA, pair])


def sizes_of(own: Array, both: float, zeta: Array) -> tuple[float, float]:
    """Sizes of two hypotheses that fit best together, from Lambda of each, of both, and zeta."""
    (l_i, l_j), (z_i, z_j) = own, zeta
    det = l_i * l_j - both * both
    return float((z_i * l_j - z_j * both) / det), float((z_j * l_i - z_i * both) / det)


def size_of(slot: Array, kind: int) -> float:
    """Size of a fault of one kind that fits best, in its unit, of a slot's columns."""
    return float(slot[hy.ZETA, kind] / slot[hy.LAMBDA, kind])


def _words(slot: Array, kind: int) -> str:
    """The fault with its size."""
    if kind in (hy.FIX_EAST, hy.STEP_EAST):
        east, north = pair_of(slot, kind)
        size, heading = math.hypot(east, north), math.degrees(math.atan2(east, north)) % 360.0
        how = f'drift by {size:.3f} m/s' if kind == hy.FIX_EAST else f'have moved by {size:.1f} m'
        return f'fixes {how} to grid {heading:03.0f} deg'
    if kind == hy.GYRO_X:
        size = math.hypot(*pair_of(slot, kind)) / _DPH
        return f'the bias of the horizontal gyros has changed by {size:.2f} deg/h'
    size = size_of(slot, kind)
    if kind == hy.ACCEL_GROWS:
        size = 60.0 * size / _UG
        how = f'grows by {size:+.2f} ug per minute, or depth drifts,'
        return f'the bias of the vertical accelerometer {how}'
    if kind == hy.SCALE_GROWS:
        return f'the scale of the DVL changes by {6000.0 * size:+.2f} % per minute'
    return f'the scale of the DVL is {100.0 * size:+.1f} % off'
