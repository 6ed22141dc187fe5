"""Conditions of a measured heading: weak reference, refused, reopened, silent, far off."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...arrays import Array
from ...kernels import watch
from .conditions import Condition, Culprit, Level, lately_s

FEWEST = 10.0
"""Attempts in the short memory before a share of refusals means anything."""
_REFUSED_SHARE = 0.5
_CAUTION = 6000.0
"""Horizontal field below which a compass is poor [nT]: WMM's caution zone."""
_FAR_OFF, _SURE = 3.0, 2.0
"""A bias beyond so many of its stated sigmas, by one of its own, is a warning.

Of 370 compasses that are as stated one is beyond 3. It is also so many of its own from none.
"""


@dataclass(frozen=True)
class Compass:
    """Quantities of a measured heading at one stamp.

    Attributes
    ----------
    memories : (MEMORIES, WIDTH) array
        Innovation memories (kernels.watch), the heading in the third axis.
    reference : str
        As the parameter heading_reference.
    used, gated, weak : float
        Headings used; refused by the gate; refused because the reference is weak.
    horizontal : float
        Horizontal field at the newest heading [nT].
    bias, bias_sigma, stated_sigma : float
        Estimated bias with its sigma, and the one stated for it [rad].
    used_ns, opened_ns : int
        Newest heading that was used; when the gate was last opened again; 0 for never.
    vouched : bool
        Whether position fixes agree with the navigation that the headings contradict.
    """

    memories: Array
    reference: str
    used: float
    gated: float
    weak: float
    horizontal: float
    bias: float
    bias_sigma: float
    stated_sigma: float
    used_ns: int
    opened_ns: int
    vouched: bool


def heading_conditions(c: Compass | None, stamp_ns: int, silent_s: float) -> list[Condition]:
    """Conditions of a measured heading at a stamp [ns]; none where headings are not used."""
    if c is None:
        return []
    found = [*_weak(c), *_refused(c), *_reopened(c, stamp_ns), *_off(c)]
    since_s = (stamp_ns - c.used_ns) * 1e-9
    if c.used_ns and since_s > silent_s:
        sentence = f'no heading of the compass used for {since_s:.0f} s'
        found.append(Condition('heading silent', Level.WARN, Culprit.HEADING, sentence))
    return found


def _weak(c: Compass) -> list[Condition]:
    """A magnetic heading where the horizontal field is weak."""
    if c.reference != 'magnetic' or not c.used + c.gated + c.weak > 0.0:
        return []
    nanotesla = f'the horizontal magnetic field is {c.horizontal:.0f} nT here'
    if c.horizontal <= 0.0:
        nanotesla = 'the magnetic field is not known: no model is of the date, see magnetic_year'
    elif c.horizontal >= _CAUTION:
        return []
    refused = not c.used_ns or c.horizontal < 2000.0
    sentence = f'{nanotesla}: headings of the compass are {"refused" if refused else "poor"}'
    return [Condition('compass weak', Level.WARN, Culprit.HEADING, sentence)]


def _refused(c: Compass) -> list[Condition]:
    """Headings that the gate refuses: the compass is disturbed, or the estimate is turned."""
    row = c.memories[watch.SHORT]
    number = row[watch.WEIGHT]
    if number < FEWEST or row[watch.REFUSED] <= _REFUSED_SHARE * number:
        return []
    share = 100.0 * row[watch.REFUSED] / number
    cause = 'the compass is disturbed' if c.vouched else 'it is disturbed, or the estimate turned'
    sentence = f'{share:.0f} % of headings of the compass refused: {cause}'
    level = Level.WARN if c.vouched else Level.ERROR
    return [Condition('heading refused', level, Culprit.HEADING, sentence)]


def _reopened(c: Compass, stamp_ns: int) -> list[Condition]:
    since_s = lately_s(stamp_ns, c.opened_ns)
    if since_s is None:
        return []
    sentence = (
        f'headings of the compass were refused until {since_s:.0f} s ago and are used again with '
        'another bias'
    )
    return [Condition('heading reopened', Level.ERROR, Culprit.HEADING, sentence)]


def _off(c: Compass) -> list[Condition]:
    """A bias far beyond the stated one: mounting, deviation, declination added twice or not."""
    if c.reference == 'arbitrary' or abs(c.bias) < _FAR_OFF * c.stated_sigma + c.bias_sigma:
        return []
    if abs(c.bias) < _SURE * c.bias_sigma:
        return []
    sentence = (
        f'the compass is off by {math.degrees(c.bias):+.0f} deg (sigma '
        f'{math.degrees(c.bias_sigma):.0f}, stated {math.degrees(c.stated_sigma):.0f}): '
        'mounting, deviation, or a declination added twice or not at all'
    )
    return [Condition('heading off', Level.WARN, Culprit.HEADING, sentence)]
