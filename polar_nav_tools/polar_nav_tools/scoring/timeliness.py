"""Timeliness: delay of each fix, age of information, time without an estimate."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.spilled import by_rows

from ..series.vehicle import EstimateSeries, ReceiptRecord, last_revisions
from .json_values import record
from .statistics import Statistics, statistics
from .verdicts import VerdictSeries
from .windows import Window

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

NAVIGATING = 1  # NavState.STATUS_NAVIGATING


@dataclass(frozen=True)
class Lag:
    """Position lag from treating late fixes as current: expected and found."""

    fixes: int  # fused ones that were received in the window
    mean_delay: float  # receive minus validity [s]
    mean_speed: float  # true horizontal speed [m/s]
    found: float  # 2-D RMS [m]
    along_mean: float  # mean along-track error [m]; negative: behind

    @property
    def expected(self) -> float:
        """Expected lag [m]: speed times mean delay."""
        return self.mean_speed * self.mean_delay

    @property
    def ratio(self) -> float:
        """Found lag over expected lag; NaN if none is expected."""
        return self.found / self.expected if self.expected > 0.0 else float('nan')

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return record({**asdict(self), 'expected': self.expected, 'ratio': self.ratio})


@dataclass(frozen=True)
class Availability:
    """Share of the truth's span with a valid estimate."""

    share: float
    longest_outage: float  # [s]
    first_after: float  # from the first truth sample to the first good estimate [s]
    diverged: int  # estimates with another status, or not finite

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return record(asdict(self))


class TimedFix(NamedTuple):
    """A receipt whose validity and reception are both known."""

    receipt: ReceiptRecord
    validity_ns: int
    receive_ns: int

    @property
    def delay(self) -> float:
        """Delay [s]: reception minus validity."""
        return (self.receive_ns - self.validity_ns) * 1e-9


def timed_fixes(
    receipts: Sequence[ReceiptRecord], verdicts: Collection[str] | None = None
) -> list[TimedFix]:
    """Last revisions of fixes with known times, in order of reception; all verdicts if None."""
    found = [
        TimedFix(r, r.validity_ns, r.receive_ns)
        for r in last_revisions(receipts)
        if (verdicts is None or r.verdict_text in verdicts)
        and r.validity_ns is not None
        and r.receive_ns is not None
    ]
    return sorted(found, key=lambda f: (f.receive_ns, f.receipt.source, f.receipt.sequence))


def delays(verdicts: VerdictSeries, window: Window) -> Statistics:
    """Delays [s] of the fused fixes that were received in the window."""
    used = verdicts.fused()
    delay = (used.receive_ns - used.validity_ns) * 1e-9
    return statistics(delay[window.mask(used.receive_ns)])


def age_of_information(stamp_ns: Ints, verdicts: VerdictSeries) -> Floats:
    """Time since the validity of the newest fused fix [s], at each estimate.

    A fix is in the estimates from its reception on, however far back in the history it was
    applied.

    Parameters
    ----------
    stamp_ns : ndarray of int64, shape (n,)
        Times to ask for, in any order.
    verdicts : VerdictSeries

    Returns
    -------
    ndarray, shape (n,)
        [s]; NaN before the first fused fix.
    """
    used = verdicts.fused()
    used = used.rows(np.argsort(used.receive_ns, kind='stable'))
    newest_ns = np.maximum.accumulate(used.validity_ns)
    known = np.searchsorted(used.receive_ns, stamp_ns, side='right')
    out = np.full(stamp_ns.shape, np.nan)
    some = known > 0
    out[some] = (stamp_ns[some] - newest_ns[known[some] - 1]) * 1e-9
    return out


def _good(r_e: Floats, v_G: Floats, status: NDArray[np.uint8]) -> NDArray[np.bool_]:
    finite = (*np.isfinite(r_e).T, *np.isfinite(v_G).T)
    return reduce(np.logical_and, finite, status == NAVIGATING)


def availability(estimate: EstimateSeries, window: Window, *, hold: float = 2.5) -> Availability:
    """Availability of estimates in a window.

    Parameters
    ----------
    estimate : EstimateSeries
    window : Window
        Usually the truth's span.
    hold : float
        A good estimate counts until the next one, at most for this many of the series' median
        interval.
    """
    estimate = estimate.in_order()
    stamp_ns = estimate.stamp_ns
    good = by_rows(_good, estimate.r_e, estimate.v_G, estimate.status)
    inside = window.mask(stamp_ns)
    diverged = int((inside & ~good).sum())
    good_ns = stamp_ns[inside & good]
    if good_ns.size == 0 or window.duration == 0.0:
        share = float(good_ns.size > 0)
        return Availability(share, window.duration, float('nan'), diverged)
    interval = float(np.median(np.diff(stamp_ns))) if stamp_ns.size > 1 else 0.0
    ends_of_gaps = np.append(good_ns, window.end_ns)
    starts_of_gaps = np.append(window.start_ns, good_ns)
    starts_of_gaps[1:] += int(hold * interval)
    # In place: there may be a million of them.
    np.minimum(starts_of_gaps[1:], ends_of_gaps[1:], out=starts_of_gaps[1:])
    np.subtract(ends_of_gaps, starts_of_gaps, out=ends_of_gaps)
    gaps = np.maximum(ends_of_gaps, 0, out=ends_of_gaps) * 1e-9
    # The last estimate of a run is at most one interval before its end: that is no outage.
    gaps[gaps <= hold * interval * 1e-9] = 0.0
    return Availability(
        share=float(1.0 - gaps.sum() / window.duration),
        longest_outage=float(gaps.max()),
        first_after=float((good_ns[0] - window.start_ns) * 1e-9),
        diverged=diverged,
    )
