"""Conditions of a navigation in station mode, from its fixes, thrust and estimated drag.

A station's fixes are the only aid in the horizontal, so what contradicts them is the model of the
vehicle and its water, or the fixes themselves. A model that is wrong (dead thruster, a vehicle
that is held or tangled, a current that turns round) leaves innovations that have a mean for a
while; outliers leave none. Thresholds: docs/trust-and-hold.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ...arrays import Array, Ints
from ...kernels import watch
from ...kernels.station import state as ss
from .conditions import Condition, Culprit, Level, fixes_followed, lately_s
from .deviation import Deviation
from .drifted import Drifted
from .slow import MOVED, most_likely, shift_in_sigmas, sizes_of
from .statistics import Statistics, statistics
from .view import Envelope, View
from .watchdog import DEPTH, FEWEST, FIX, Watchdog, outside, scatter

_RATIO = (1.6, 2.5)
"""Mean NIS per degree of freedom of the short memory that is a WARN, an ERROR."""
_SIGMAS = 3.0
"""So many above 1 it has to be as well: ten fixes have more by chance in one run of forty."""
_MEAN = (20.0, 40.0)
"""Chi-square (1) of a mean innovation of the short memory that is a WARN, an ERROR."""
_HINT = 12.0
"""Chi-square (1) of a mean that tells a model's error from scatter, where the NIS is too large."""
_REFUSED_SHARE = 0.5
_CAREFUL_SIGMAS = -8.0
_DRAG_SIGMAS = 3.0
_DRAG_FACTOR = 4.0
"""Estimated drag beyond the stated one by this factor is implausible."""
_EITHER = Culprit.MODEL | Culprit.FIXES
_LIMITS = np.full(ss.KINDS, 17.0)
"""T of each kind that is a WARN, by measurement without a fault (signatures.md, 6)."""
_LIMITS[: ss.DRAGS] = 20.0  # pairs, a chi-square (2)


def _growing(x: float, y: float) -> str:
    return f'the current changes by {60.0 * math.hypot(x, y):.2f} m/s a minute, or fixes drift,'


def _begun(x: float, y: float) -> str:
    return f'the current has changed by {math.hypot(x, y):.2f} m/s, or fixes drift,'


def _deviation(x: float, y: float) -> str:
    degrees = math.degrees(math.hypot(x, y))
    return f'the heading of the AHRS has a deviation of {degrees:.1f} deg'


def _changed_drag(x: float) -> str:
    return f'drag is {100.0 * math.expm1(min(x, 5.0)):+.0f} % off, or thrust,'


def _turning(x: float) -> str:
    return f'the heading of the AHRS drifts by {math.degrees(x) * 3600.0:.0f} deg/h'


def _drifting_ranges(x: float) -> str:
    return f'ranges of the station drift by {x:+.2f} m/s'


def _drifting_bearings(x: float) -> str:
    return f'bearings of the station drift by {math.degrees(x) * 3600.0:+.0f} deg/h'


_CULPRITS = {
    ss.GROWS: _EITHER,
    ss.BEGINS: _EITHER,
    ss.DEVIATES: Culprit.HEADING,
    ss.DRAGS: Culprit.MODEL,
    ss.TURNS: Culprit.HEADING,
    ss.RANGES: Culprit.FIXES,
    ss.BEARINGS: Culprit.FIXES,
}
_WORDS: dict[int, Callable[..., str]] = {
    ss.GROWS: _growing,
    ss.BEGINS: _begun,
    ss.DEVIATES: _deviation,
    ss.DRAGS: _changed_drag,
    ss.TURNS: _turning,
    ss.RANGES: _drifting_ranges,
    ss.BEARINGS: _drifting_bearings,
}
"""Of a slow fault of a kind and its size."""


@dataclass(frozen=True, kw_only=True)
class StationView(View):
    """Quantities of a navigation in station mode that the watchdog judges at one stamp.

    Attributes
    ----------
    share, share_sigma : float
        Of the drag that is quadratic; beyond [0, 1] one of the two coefficients is negative.
    drag_ratio : float
        Natural logarithm of estimated over stated drag at the stated speed.
    drag_sigma : float
        1-sigma of it.
    thrust_age_s : float
        Of the newest thrust [s]; infinite before the first.
    thrust_timeout_s : float
        After which it is unknown.
    loose : bool
        Whether the velocity follows the fixes, because they contradicted the model.
    loosened_ns : int
        When they did so last; 0 for never.
    turned_ns : int
        When the AHRS turned last against its own rates; 0 for never.
    signatures : (B + 1, SIGNATURE_ROWS, KINDS SLOTS) array or None
        Hypotheses about slow faults, of the bank's members and mixture
        (kernels.station.signatures).
    weight : (B,) array or None
        Of the members in what is published.
    born_ns : (SLOTS,) array of int or None
        When those of each slot began; 0 for an empty one.
    followed : (2,) array or None
        Way to fixes that were refused at first and followed at last, station axes [m].
    jumped : bool
        Whether some of them had jumped farther than the vehicle can have moved.
    current, P_current : (2,) and (2, 2) arrays
        Estimated current, station axes [m/s], and its published covariance.
    psi, turn : float or None
        Heading of the AHRS, and its newest turn that its own rates do not explain [rad].
    heading_sigma : float
        Published 1-sigma of the heading [rad].
    """

    share: float
    share_sigma: float
    drag_ratio: float
    drag_sigma: float
    thrust_age_s: float
    thrust_timeout_s: float
    loose: bool = False
    loosened_ns: int = 0
    turned_ns: int = 0
    signatures: Array | None = None
    weight: Array | None = None
    born_ns: Ints | None = None
    followed: Array | None = None
    jumped: bool = False
    current: Array = field(default_factory=lambda: np.zeros(2))
    P_current: Array = field(default_factory=lambda: np.zeros((2, 2)))
    psi: float | None = None
    turn: float = 0.0
    heading_sigma: float = math.inf


class StationWatchdog(Watchdog):
    """Watchdog of one navigation in station mode; `look` returns its health."""

    def __init__(self, envelope: Envelope) -> None:
        super().__init__(envelope)
        self._deviation = Deviation()
        self._drifted = Drifted()

    def _conditions(self, view: View) -> list[Condition]:
        s = statistics(view.memories)
        found = [*_disagreement(s), *_reopened(view), *_careful(s), *scatter(s, DEPTH)]
        if isinstance(view, StationView):
            slow = _slow(view)
            began_ns = _began_ns(view, slow)
            place = view.current, view.P_current, began_ns, view.P_horizontal
            found += self._drifted.look(view.stamp_ns, *place)
            found += [
                *_loosened(view),
                *slow,
                *_followed(view),
                *_turned(view),
                *_ahrs_gap(view),
                *_thrust(view),
                *_drag(view),
                *_current(view, self._envelope),
            ]
            if view.psi is not None:
                sigma = view.heading_sigma
                found += self._deviation.look(view.stamp_ns, view.psi, view.turn, sigma)
        return [*found, *outside(view, self._envelope)]


def _disagreement(s: Statistics) -> list[Condition]:
    """Fixes and model contradict one another; a mean points to the model or its current."""
    number = s.number[FIX, watch.SHORT]
    nis = float(s.nis[FIX, watch.SHORT])
    scattered = nis > _RATIO[0] and float(s.nis_sigmas[FIX, watch.SHORT]) > _SIGMAS
    refused = float(s.refused[FIX, watch.SHORT])
    along, across = (float(x) for x in s.track[FIX, watch.SHORT, :2])
    east, north = (float(x) for x in s.grid[FIX, watch.SHORT, :2])
    mean = max(along, across, east, north)
    gated = refused > _REFUSED_SHARE
    if number < FEWEST or not (scattered or mean > _MEAN[0] or gated):
        return []
    level = Level.ERROR if nis > _RATIO[1] or mean > _MEAN[1] or gated else Level.WARN
    numbers = f'NIS {nis:.1f} per degree of freedom'
    if refused > 0.0:
        numbers += f', {100.0 * refused:.0f} % refused'
    if mean < _HINT:  # outliers: gate and robust weight are there for them
        level = Level.ERROR if gated else Level.WARN
        sentence = (
            f'position fixes scatter {math.sqrt(nis):.1f} times as much as stated ({numbers})'
        )
        return [Condition('fixes noise', level, Culprit.FIXES, sentence)]
    if along > 2.0 * max(across, east, north):
        where = 'behind' if s.track_mean[FIX, watch.SHORT, 0] > 0.0 else 'ahead of'
        sentence = (
            f'the vehicle does not obey its model: fixes lie {where} it on every course; '
            f'thruster, drag, or something holds it ({numbers})'
        )
        return [Condition('model', level, Culprit.MODEL, sentence)]
    sentence = (
        f'fixes and the model of the vehicle disagree: thruster, current, heading, or fixes that '
        f'are displaced ({numbers})'
    )
    return [Condition('model', level, _EITHER, sentence)]


def _reopened(view: View) -> list[Condition]:
    """The gate of the fixes was opened again."""
    since_s = lately_s(view.stamp_ns, view.opened_ns[FIX])
    if since_s is None:
        return []
    sentence = (
        f'position fixes were refused until {since_s:.0f} s ago and are used again with enlarged '
        'covariance: the vehicle did not obey its model, or fixes are displaced'
    )
    return [Condition('fixes reopened', Level.ERROR, _EITHER, sentence)]


def _loosened(view: StationView) -> list[Condition]:
    """Fixes contradicted the model, which was loosened."""
    since_s = (view.stamp_ns - view.loosened_ns) * 1e-9
    recent = lately_s(view.stamp_ns, view.loosened_ns) is not None
    if not view.loose and not recent:
        return []
    sentence = (
        f'fixes contradicted the model of the vehicle until {since_s:.0f} s ago: the velocity '
        'follows the fixes, with enlarged covariance; thruster, current, heading, something that '
        'holds it, or fixes that are displaced'
    )
    level = Level.ERROR if recent else Level.WARN
    return [Condition('model loosened', level, _EITHER, sentence)]


def _slow(view: StationView) -> list[Condition]:
    """Fixes show the signature of a slow fault; every kind that is as likely is named."""
    if view.signatures is None or view.born_ns is None or view.weight is None:
        return []
    signatures, weight = view.signatures, view.weight
    statistic = signatures[-1, ss.STATISTIC].reshape(ss.SLOTS, ss.KINDS)
    if not (statistic > _LIMITS).any():
        return []

    def described(slot: int, kind: int) -> tuple[str, Array]:
        sizes, way = _size(signatures[:, :, slot * ss.KINDS :], weight, kind)
        return _WORDS[kind](*sizes), way

    ages_ns = view.stamp_ns - view.born_ns
    return [most_likely(statistic, _CULPRITS, described, ages_ns, view.P_horizontal, _LIMITS)]


def _began_ns(view: StationView, slow: list[Condition]) -> int | None:
    """When the likeliest hypothesis began of fixes that drift or a current that changes [ns].

    None where nothing of the kind is said.
    """
    shown = any(condition.culprit & Culprit.FIXES for condition in slow)
    if not shown or view.signatures is None or view.born_ns is None:
        return None
    statistic = view.signatures[-1, ss.STATISTIC].reshape(ss.SLOTS, ss.KINDS)
    of_fixes = [kind for kind, culprit in _CULPRITS.items() if culprit & Culprit.FIXES]
    return int(view.born_ns[np.argmax(statistic[:, of_fixes].max(axis=1))])


def _size(slot: Array, weight: Array, kind: int) -> tuple[tuple[float, ...], Array]:
    """Size of a fault that fits best, of a slot's columns, and the way it has moved x and y.

    The size is that of the mixture where its statistic is the bank's, else of the member to which
    the fault is likeliest; the way is that of the mixture.
    """
    best, members = slot[-1], slot[:-1, :, kind]
    if best[ss.OWN, kind] < best[ss.STATISTIC, kind]:
        likelihood = members[:, ss.PRIOR] + members[:, ss.LIKELIHOOD] + 0.5 * members[:, ss.OWN]
        best = slot[int(np.argmax(likelihood))]
    per_unit = np.einsum('m,mij->ij', weight, slot[:-1, ss.HORIZONTAL])
    if kind < ss.DRAGS:
        pair = best[:, kind : kind + 2]
        size = sizes_of(pair[ss.LAMBDA], float(pair[ss.CROSS, 0]), pair[ss.ZETA])
        return size, per_unit[:, kind : kind + 2] @ np.array(size)
    one = float(best[ss.ZETA, kind] / best[ss.LAMBDA, kind])
    return (one,), per_unit[:, kind] * one


def _followed(view: StationView) -> list[Condition]:
    """The estimate has followed fixes that it refused at first: one of the two is wrong."""
    if view.followed is None or not shift_in_sigmas(view.followed, view.P_horizontal) > MOVED:
        return []
    return [fixes_followed(float(np.hypot(*view.followed)), _EITHER, jumped=view.jumped)]


def _current(view: StationView, envelope: Envelope) -> list[Condition]:
    """A current that there is not: nothing else can explain what moves fixes like that."""
    speed = math.hypot(*view.current)
    if speed <= envelope.max_current:
        return []
    sentence = (
        f'a current of {speed:.1f} m/s is stronger than max_current '
        f'{envelope.max_current:.1f} m/s: fixes drift, or the vehicle does not move as its model'
    )
    return [Condition('current', Level.ERROR, _EITHER, sentence)]


def _turned(view: StationView) -> list[Condition]:
    """The heading of the AHRS has turned while its rates have not."""
    since_s = lately_s(view.stamp_ns, view.turned_ns)
    if since_s is None:
        return []
    sentence = (
        f'the heading of the AHRS turned against its own rates {since_s:.0f} s ago: it is '
        'estimated anew, with enlarged covariance'
    )
    return [Condition('AHRS heading', Level.ERROR, Culprit.HEADING | Culprit.IMU, sentence)]


def _careful(s: Statistics) -> list[Condition]:
    """Fixes that scatter much less, or for long more, than stated."""
    sigmas, number = s.nis_sigmas[FIX, watch.LONG], s.number[FIX, watch.LONG]
    nis = float(s.nis[FIX, watch.LONG])
    if number < 5.0 * FEWEST or not sigmas < _CAREFUL_SIGMAS:
        return scatter(s, FIX)
    sentence = (
        f'position fixes scatter {math.sqrt(nis):.2f} times as much as stated: their stated '
        'errors are too large'
    )
    return [Condition('fixes noise', Level.WARN, Culprit.FIXES, sentence)]


def _ahrs_gap(view: StationView) -> list[Condition]:
    """A gap between AHRS samples not long ago."""
    gaps = view.gaps
    since_s = lately_s(view.stamp_ns, gaps.end_ns)
    if since_s is None:
        return []
    sentence = (
        f'AHRS gap of {gaps.last_s:.1f} s ended {since_s:.0f} s ago: the model ran on by the mean '
        f'attitude, with enlarged covariance ({gaps.number} so far)'
    )
    return [Condition('AHRS gap', Level.ERROR, Culprit.IMU, sentence)]


def _thrust(view: StationView) -> list[Condition]:
    """No recent thrust."""
    if view.thrust_age_s <= view.thrust_timeout_s:
        return []
    sentence = (
        'no thrust yet: the model of the vehicle guesses'
        if math.isinf(view.thrust_age_s)
        else f'no thrust for {view.thrust_age_s:.0f} s: the last one is held, with the noise of a '
        'guess'
    )
    return [Condition('thrust', Level.WARN, Culprit.MODEL, sentence)]


def _drag(view: StationView) -> list[Condition]:
    """A drag that pushes, or that is not the one of this vehicle."""
    low, high = (view.share + k * _DRAG_SIGMAS * view.share_sigma for k in (-1.0, 1.0))
    if high < 0.0 or low > 1.0:
        which = 'quadratic' if high < 0.0 else 'linear'
        sentence = f'the {which} drag of surge comes out negative: the model does not fit'
        return [Condition('drag', Level.WARN, Culprit.MODEL, sentence)]
    beyond = abs(view.drag_ratio) - _DRAG_SIGMAS * view.drag_sigma
    if beyond > math.log(_DRAG_FACTOR):
        sentence = (
            f'drag comes out {math.exp(view.drag_ratio):.2g} times the stated one: thrust or '
            'model are wrong'
        )
        return [Condition('drag', Level.WARN, Culprit.MODEL, sentence)]
    return []
