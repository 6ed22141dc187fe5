"""Judgement of a run with a fault beside the run of the same seed without it.

Rule: from one minute and ten fixes after the fault's end on, the error is at most 3 times the RMS
of the run without the fault plus 1 m, and the stated sigma at most 3 times its own; at no time
from the start of the fault on is a component beyond 5 stated sigmas unless ERROR stands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from polar_nav_core.arrays import Array

from .shown import shown_by_fixes
from .trace import Trace, Word

RECOVER_S = 60.0
RECOVER_FIXES = 10
_FACTOR = 3.0
_PLUS_M = 1.0
_BEYOND = 5.0
_GONE_S = 10.0
"""A run without estimates for so long at its end is dead."""
_STOOD_S = 30.0
"""Reports in this time before a fault stood before it."""

DEAD, SILENT, LOST = 'DEAD', 'SILENT', 'NOT RECOVERED'
RECOVERED, REPORTED, HONEST = 'recovered', 'reported', 'covered'
SEVERITY = (RECOVERED, REPORTED, HONEST, LOST, SILENT, DEAD)
"""Verdicts, the best first; the last three break the rule."""
BROKEN = SEVERITY[-3:]


@dataclass(frozen=True)
class Judged:
    """Judgement of one run.

    Attributes
    ----------
    verdict : str
        One of `SEVERITY`.
    recovered_s : float
        Time after the fault's end from which on the rule holds [s]; NaN if it does not, or if the
        fault has no end.
    reported_s : float
        Time after the fault's start of the first new report [s]; NaN for none.
    sentence : str
        That report.
    worst_m, end_m : float
        Largest and last horizontal error from the fault on [m].
    unsaid_s : float
        Seconds beyond 5 sigma without ERROR [s].
    shown_s, shown_sigmas : float
        Time after the fault's start at which the best test of the fixes shows it [s], NaN if it
        never does; evidence of all fixes.
    unsaid_since_s : float
        Those of `unsaid_s` that are later than that.
    sigma_ratio : float
        Largest ratio of the stated sigma to that without the fault, after the time of recovery.
    """

    verdict: str
    recovered_s: float
    reported_s: float
    sentence: str
    worst_m: float
    end_m: float
    unsaid_s: float
    shown_s: float
    shown_sigmas: float
    unsaid_since_s: float
    sigma_ratio: float


@dataclass(frozen=True)
class Errors:
    """Errors (n, 3) in grid axes [m] of estimates at true times (n,) [s], with their sigmas."""

    time_s: Array
    d_r_G: Array
    sigma_G: Array

    @property
    def horizontal(self) -> Array:
        """[m], shape (n,); an error that is not finite is infinite."""
        flat = np.hypot(self.d_r_G[:, 0], self.d_r_G[:, 1])
        return np.asarray(np.where(np.isfinite(flat), flat, np.inf))

    @property
    def stated(self) -> Array:
        """Stated horizontal sigma [m], shape (n,)."""
        return np.asarray(np.hypot(self.sigma_G[:, 0], self.sigma_G[:, 1]))

    def sigmas(self) -> Array:
        """Largest error of an axis in its own sigmas, shape (n,)."""
        with np.errstate(divide='ignore', invalid='ignore'):
            ratio = np.abs(self.d_r_G) / self.sigma_G
        return np.asarray(np.where(np.isnan(ratio), np.inf, ratio).max(axis=1))


def judge(
    clean: Errors, clean_trace: Trace, found: Errors, trace: Trace,
    start_s: float, end_s: float, until_s: float,
) -> Judged:  # fmt: skip
    """Judgement of a run.

    Parameters
    ----------
    clean, found : Errors
        Without and with the fault.
    clean_trace, trace : Trace
        Of the run without the fault, and with it.
    start_s, end_s, until_s : float
        Of the fault; its end is infinite if it lasts. End of the run.
    """
    word = first_new(trace.words, clean_trace.words, start_s)
    reported_s = math.nan if word is None else word.time_s - start_s
    sentence = '' if word is None else ('', 'WARN', 'ERROR')[word.level] + ': ' + word.sentence
    after = found.time_s >= start_s
    flat = found.horizontal[after]
    worst_m, end_m = (float(flat.max()), float(flat[-1])) if len(flat) else (math.nan, math.nan)
    unsaid = _unsaid(clean, found, trace.level, start_s)
    shown = shown_by_fixes(clean_trace.fixes, trace.fixes, start_s)
    since = [second for second in unsaid if second >= shown.time_s]
    recovered_s, ratio = _recovered_s(clean, found, end_s)
    gone = not len(found.time_s) or found.time_s[-1] < until_s - _GONE_S or bool(trace.ended)
    lasts = math.isinf(end_s)
    if gone and (trace.ended or not lasts):
        verdict = DEAD
    elif unsaid:
        verdict = SILENT
    elif lasts:
        verdict = HONEST if word is None else REPORTED
    elif recovered_s <= _allowed_s(trace.fused_s, end_s):
        verdict = RECOVERED
    else:
        verdict = SILENT if word is None else LOST
    return Judged(
        verdict,
        recovered_s,
        reported_s,
        sentence,
        worst_m,
        end_m,
        unsaid_s=float(len(unsaid)),
        shown_s=shown.time_s - start_s,
        shown_sigmas=shown.sigmas,
        unsaid_since_s=float(len(since)),
        sigma_ratio=ratio,
    )


def first_new(words: tuple[Word, ...], clean: tuple[Word, ...], start_s: float) -> Word | None:
    """First report from a time on of a kind that neither stood before nor comes without fault."""
    known = {w.kind for w in words if start_s - _STOOD_S <= w.time_s < start_s}
    known |= {w.kind for w in clean if w.time_s >= start_s}
    return next((w for w in words if w.time_s >= start_s and w.kind not in known), None)


def _allowed_s(fused_s: Array, end_s: float) -> float:
    """Time for recovery: a minute, and ten fixes if they take longer [s]."""
    later = fused_s[fused_s > end_s]
    tenth_s = float(later[RECOVER_FIXES - 1]) if len(later) >= RECOVER_FIXES else math.nan
    return max(RECOVER_S, 0.0 if math.isnan(tenth_s) else tenth_s - end_s)


def _unsaid(clean: Errors, found: Errors, level: Array, start_s: float) -> set[int]:
    """Seconds beyond 5 sigma without ERROR in this second or the next, nor without the fault."""
    beyond = (found.sigmas() > _BEYOND) & (found.time_s >= start_s)
    usual = {round(t) for t in clean.time_s[clean.sigmas() > _BEYOND]}
    unsaid = set()
    for second in {int(t) for t in found.time_s[beyond]}:
        stood = level[max(0, second - 1) : second + 2]
        if not (len(stood) and stood.max() >= 2) and not usual & {second, second + 1}:
            unsaid.add(second)
    return unsaid


def _recovered_s(clean: Errors, found: Errors, end_s: float) -> tuple[float, float]:
    """Time from the end of the fault until error and sigma are as usual [s]; largest ratio."""
    rows = found.time_s >= end_s
    base = clean.time_s >= end_s
    if math.isinf(end_s) or not rows.any() or not base.any():
        return math.nan, math.nan
    usual_m = float(np.sqrt(np.mean(clean.horizontal[base] ** 2)))
    stated = np.interp(found.time_s[rows], clean.time_s, clean.stated)
    with np.errstate(invalid='ignore'):
        share = found.stated[rows] / stated
    good = (found.horizontal[rows] <= _FACTOR * usual_m + _PLUS_M) & (share <= _FACTOR)
    times = found.time_s[rows] - end_s
    late = share[times >= RECOVER_S]
    ratio = float(late.max()) if len(late) else math.nan
    if good.all():
        return 0.0, ratio
    last = int(np.flatnonzero(~good)[-1])
    return (math.inf if last + 1 == len(times) else float(times[last + 1])), ratio
