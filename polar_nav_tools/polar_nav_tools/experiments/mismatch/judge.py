"""Judgement of one run with a fault: wrong, reported, visible. Pure functions on arrays.

*Wrong*: position, heading or velocity lies beyond 4 published sigmas on any axis for more than 5 %
of the second half of the run. *Reported*: the first WARN or ERROR after the fault began whose
culprit is right, or `UNEXPLAINED`, at most 60 s after the fault became visible (visible.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.arrays import Array

from .culprits import UNEXPLAINED

BEYOND_SIGMAS = 4.0
COVERED_SIGMAS = 3.0
WRONG_SHARE = 0.05
"""Share of the second half beyond `BEYOND_SIGMAS` from which on an estimate is wrong."""
LASTING_S = 10.0
"""Time [s] for which an estimate must stay beyond to be wrong from its start on."""
REPORT_WITHIN_S = 60.0
"""Latest time [s] of a report after the fault became visible."""
KINDS = ('position', 'heading', 'velocity')

OK, WARN, ERROR = 0, 1, 2
"""Levels of health; the numbers are those of diagnostic_msgs/DiagnosticStatus."""


@dataclass(frozen=True)
class Deviation:
    """Errors of n estimates in one quantity and the filter's own sigmas.

    Attributes
    ----------
    error, sigma : (n, m) arrays
        Per axis [SI units]. A sigma that is not positive and finite is not published.
    nees : (n,) array
        Normalized squared error per degree of freedom, 1 for an honest covariance.
    """

    error: Array
    sigma: Array
    nees: Array

    def ratio(self) -> Array:
        """Largest error of any axis in its own sigmas, shape (n,); 0 where no sigma is published.

        An error that is not finite is infinitely many sigmas.
        """
        published = np.isfinite(self.sigma) & (self.sigma > 0.0)
        safe = np.where(published, self.sigma, 1.0)
        found = np.where(published, np.abs(self.error) / safe, 0.0)
        return np.asarray(np.where(np.isnan(found), np.inf, found).max(axis=1))


@dataclass(frozen=True)
class Course:
    """Errors of a run against its truth.

    Attributes
    ----------
    time_s : (n,) array
        Since the start of the run [s].
    position, heading, velocity : Deviation
        [m] (grid or station axes, the first two horizontal), [rad], [m/s].
    duration_s : float
        Length of the run, which a filter that stopped did not reach [s].
    """

    time_s: Array
    position: Deviation
    heading: Deviation
    velocity: Deviation
    duration_s: float

    @property
    def second_half(self) -> NDArray[np.bool_]:
        """Mask of the judged estimates, shape (n,)."""
        return np.asarray(self.time_s > 0.5 * self.duration_s)


class HealthReport(NamedTuple):
    """Reported health of a run from ``stamp_ns`` on: level, sentence and culprit."""

    stamp_ns: int
    level: int
    sentence: str
    culprit: str


def shares_beyond(course: Course, sigmas: float) -> dict[str, float]:
    """Share of the second half beyond so many sigmas, by `KINDS`; 1 without estimates."""
    rows = course.second_half
    if not rows.any():
        return dict.fromkeys(KINDS, 1.0)
    return {kind: float(np.mean(getattr(course, kind).ratio()[rows] > sigmas)) for kind in KINDS}


def is_wrong(course: Course) -> bool:
    """Whether the estimate is wrong by the definition above."""
    return max(shares_beyond(course, BEYOND_SIGMAS).values()) > WRONG_SHARE


def is_covered(course: Course) -> bool:
    """Whether all quantities stay inside 3 published sigmas for 95 % of the second half."""
    return max(shares_beyond(course, COVERED_SIGMAS).values()) <= WRONG_SHARE


def first_wrong_s(course: Course, start_s: float) -> float:
    """First time from ``start_s`` on [s] that begins `LASTING_S` beyond 4 sigmas; NaN for none."""
    worst = np.max([getattr(course, kind).ratio() for kind in KINDS], axis=0)
    beyond = (worst > BEYOND_SIGMAS) & (course.time_s >= start_s)
    begins_s = np.nan
    for time_s, now in zip(course.time_s, beyond, strict=True):
        if not now:
            begins_s = np.nan
        elif np.isnan(begins_s):
            begins_s = float(time_s)
        elif time_s - begins_s >= LASTING_S:
            return begins_s
    return float('nan')


def errors_of(course: Course) -> dict[str, float]:
    """RMS, NEES and published sigma of the errors in the second half.

    ``rms``, ``end`` and ``said`` (horizontal error and published horizontal sigma, RMS [m]);
    ``nees_*`` (mean per degree of freedom) and ``beyond_*`` (share beyond 4 sigmas) by `KINDS`.
    """
    out = {f'beyond_{k}': v for k, v in shares_beyond(course, BEYOND_SIGMAS).items()}
    rows = course.second_half
    if not rows.any():
        return out
    flat, sigma = course.position.error[rows, :2], course.position.sigma[rows, :2]
    out['rms'] = float(np.sqrt(np.mean(np.sum(flat**2, axis=1))))
    out['end'] = float(np.hypot(*flat[-1]))
    out['said'] = float(np.sqrt(np.mean(np.sum(sigma**2, axis=1))))
    for kind in KINDS:
        nees = getattr(course, kind).nees[rows]
        if np.isfinite(nees).any():
            out[f'nees_{kind}'] = float(np.nanmean(nees))
    return out


class Reported(NamedTuple):
    """First reports after a fault: any WARN or ERROR, and the first with a right culprit."""

    first: HealthReport | None
    named: HealthReport | None


def reported(history: Sequence[HealthReport], fault_ns: int, culprits: Sequence[str]) -> Reported:
    """First reports at WARN or above from the fault's start on.

    Parameters
    ----------
    history : sequence of HealthReport
        In the order of stamps; each holds until the next.
    fault_ns : int
    culprits : sequence of str
        Right ones, besides `UNEXPLAINED`.
    """
    before = [r for r in history if r.stamp_ns < fault_ns]
    # A condition present when the fault begins is no report of it, unless the culprit changes.
    standing = before[-1].culprit if before and before[-1].level > OK else None
    first = named = None
    for r in history:
        if r.stamp_ns < fault_ns or r.level == OK:
            standing = standing if r.stamp_ns < fault_ns else None
            continue
        if r.culprit == standing:
            continue
        first = first or r
        if {*r.culprit.split('|')} & {*culprits, UNEXPLAINED}:
            return Reported(first, r)
    return Reported(first, named)


def onsets(history: Sequence[HealthReport], level: int) -> int:
    """Number of times the level rose to ``level`` or above from below it."""
    count, last = 0, OK
    for r in history:
        count += last < level <= r.level
        last = r.level
    return count


def share_at(history: Sequence[HealthReport], level: int, start_ns: int, end_ns: int) -> float:
    """Share of the time from ``start_ns`` to ``end_ns`` spent at ``level`` or above."""
    if end_ns <= start_ns:
        return 0.0
    total = 0
    until = [*(r.stamp_ns for r in history[1:]), end_ns]
    for r, stop_ns in zip(history, until, strict=False):
        if r.level >= level:
            total += max(0, min(stop_ns, end_ns) - max(r.stamp_ns, start_ns))
    return total / (end_ns - start_ns)


def silent_share(course: Course, history: Sequence[HealthReport], start_ns: int) -> float:
    """Share of the second half beyond `BEYOND_SIGMAS` in any quantity while health is OK.

    Parameters
    ----------
    course : Course
    history : sequence of HealthReport
        In the order of stamps; each holds until the next.
    start_ns : int
        Stamp of the course's time 0.
    """
    rows = course.second_half
    if not rows.any():
        return 1.0
    since_s = np.array([(r.stamp_ns - start_ns) * 1e-9 for r in history])
    levels = np.array([OK, *(r.level for r in history)])
    level = levels[np.searchsorted(since_s, course.time_s[rows], side='right')]
    worst = np.max([getattr(course, kind).ratio()[rows] for kind in KINDS], axis=0)
    return float(np.mean((worst > BEYOND_SIGMAS) & (level == OK)))


def verdict_of(
    *,
    wrong: bool,
    visible: bool,
    covered: bool,
    in_time: bool,
    named: bool,
    spoke: bool,
    beyond_stated: bool = False,
) -> str:
    """Verdict on one run.

    Parameters
    ----------
    wrong, covered : bool
        `is_wrong`, `is_covered`.
    visible : bool
        Whether a filter that knows the fault's shape finds it in this run.
    in_time, named, spoke : bool
        Whether a right report came in time, at all; whether there was any report.
    beyond_stated : bool
        Whether the fault is larger than twice the sigma that is stated for it.
    """
    if not visible:
        if covered:
            return 'invisible, covered'
        return BEYOND_STATED if beyond_stated else 'invisible, not covered'
    if not wrong:
        return 'OK'
    if in_time:
        return 'WRONG, reported'
    if named:
        return 'WRONG+LATE'
    return 'WRONG+MISNAMED' if spoke else 'WRONG+SILENT'


BEYOND_STATED = 'invisible, beyond twice the stated sigma'
SEVERITY = (
    'OK',
    'invisible, covered',
    BEYOND_STATED,
    'invisible, not covered',
    'WRONG, reported',
    'WRONG+LATE',
    'WRONG+MISNAMED',
    'WRONG+SILENT',
)
"""All verdicts, least severe first; the last three are wrong and unreported."""
UNREPORTED = SEVERITY[-3:]
