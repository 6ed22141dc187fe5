"""Findings on the stamps of one topic."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from polar_nav_ros.adapters.arrays import unfilled

from ..bags.finding import Finding, Severity
from .findings import finding, finding_at
from .sources import Stamps

_NS = 1e-9
_FEW = 10
_DRIFT_WARNING, _DRIFT_SEVERE = 1e-4, 1e-2
"""Of stamps against log times [s/s]: a quartz is good to 1e-4; a per cent ruins every speed."""
_DRIFT_SPAN_S, _DRIFT_S, _DRIFT_SEVERE_S = 10.0, 0.2, 1.0
"""Nothing is said of shorter recordings, or of less than so much in all [s]."""
_JUMP_S = 1.0
_GAP_PERIODS = 10.0
_REPEATED_SHARE = 0.05
_ZERO_SHARE = 0.1
"""One stamp of zero among fewer messages than ten is not a slip."""
_SAME_CLOCK_S = 1.0
"""Log times and stamps of an IMU, which nobody delays, are not further apart on one clock."""


class Times(NamedTuple):
    """Times of one topic, in the order of the bag.

    Attributes
    ----------
    topic : str
    stamps_ns, log_ns : (n,) arrays
        Stamps with the offset of the mapping, and when each message was recorded [ns].
    offset_ns : int
        Of the mapping [ns].
    delayed : bool
        Messages come with a delay of their own.
    """

    topic: str
    stamps_ns: Stamps
    log_ns: Stamps
    offset_ns: int = 0
    delayed: bool = False

    def behind_log_ns(self) -> int:
        """Median of log time less stamp, the stamp without the offset [ns]."""
        return round(float(np.median(self.log_ns - self.stamps_ns))) + self.offset_ns


def check_stamps(
    topic: str, stamps_ns: Stamps, log_ns: Stamps, *, delayed: bool = False
) -> Iterator[Finding]:
    """Look at zero, backward, repeated, jumping and drifting stamps.

    Parameters
    ----------
    topic : str
    stamps_ns, log_ns : (n,) arrays
        In the order of the bag.
    delayed : bool
        Messages come with a delay of their own, which may change: no drift is looked for.
    """
    if not len(stamps_ns):
        return
    zero = unfilled(stamps_ns)
    if zero.any():
        several = zero.sum() > 1 or zero.mean() > _ZERO_SHARE
        yield finding_at(
            'stamps_zero',
            Severity.SEVERE if several else Severity.WARNING,
            topic,
            zero,
            stamps_ns,
            float(zero.sum()),
            f'{int(zero.sum())} of {len(zero)} stamps are zero; `stamp: log` takes the log time'
            + ('' if several else '; that message is left out'),
        )
        if zero.all():
            return
    if zero.sum() == 1:
        stamps_ns, log_ns = stamps_ns[~zero], log_ns[~zero]
    steps = np.diff(stamps_ns)
    yield from _backwards(topic, stamps_ns, steps)
    yield from _repeated(topic, stamps_ns, steps)
    yield from _jumps(topic, stamps_ns, log_ns)
    if not delayed:
        yield from _drift(topic, stamps_ns, log_ns)


def _backwards(topic: str, stamps_ns: Stamps, steps: Stamps) -> Iterator[Finding]:
    back = np.r_[False, steps < 0]
    if not back.any():
        return
    worst = float(-steps.min()) * _NS
    yield finding_at(
        'stamps_backwards',
        Severity.SEVERE,
        topic,
        back,
        stamps_ns,
        worst,
        f'{int(back.sum())} stamps are before the one before, by up to {worst:.6g} s (limit 0); '
        'accepted, the messages are sorted by stamp',
    )


def _repeated(topic: str, stamps_ns: Stamps, steps: Stamps) -> Iterator[Finding]:
    same = np.r_[False, steps == 0]
    if not same.any():
        return
    share = float(same.mean())
    many = share > _REPEATED_SHARE
    yield finding_at(
        'stamps_repeated',
        Severity.SEVERE if many else Severity.WARNING,
        topic,
        same,
        stamps_ns,
        share,
        f'{int(same.sum())} of {len(same)} stamps are those of the message before '
        f'({100 * share:.2g} %, limit {100 * _REPEATED_SHARE:.0f} %)',
    )


def _jumps(topic: str, stamps_ns: Stamps, log_ns: Stamps) -> Iterator[Finding]:
    """Stamps that jump while the recording goes on; and gaps that both have."""
    if len(stamps_ns) < _FEW:
        return
    steps = np.diff(stamps_ns) * _NS
    logged = np.diff(log_ns) * _NS
    usual = float(np.median(np.abs(steps)))
    limit = max(_JUMP_S, _GAP_PERIODS * usual)
    jump = np.r_[False, (steps > limit) & (steps - logged > limit)]
    if jump.any():
        largest = float(steps[jump[1:]].max())
        yield finding_at(
            'stamps_jump',
            Severity.SEVERE,
            topic,
            jump,
            stamps_ns,
            largest,
            f'stamps jump ahead {int(jump.sum())} times, by up to {largest:.6g} s, while the '
            f'recording goes on (limit {limit:.3g} s)',
        )
    gap = np.r_[False, (steps > limit)] & ~jump
    if gap.any():
        largest = float(steps[gap[1:]].max())
        yield finding_at(
            'gap',
            Severity.WARNING,
            topic,
            gap,
            stamps_ns,
            largest,
            f'{int(gap.sum())} gaps of up to {largest:.4g} s (usual period {usual:.4g} s)',
        )


def _drift(topic: str, stamps_ns: Stamps, log_ns: Stamps) -> Iterator[Finding]:
    """Slope of stamps against log times; the medians of both ends do not mind delays."""
    n = len(stamps_ns)
    if n < 2 * _FEW:
        return
    tenth = max(n // 10, _FEW // 2)
    ends = [np.median(log_ns[:tenth] - log_ns[0]), np.median(log_ns[-tenth:] - log_ns[0])]
    lag = (stamps_ns - stamps_ns[0]) - (log_ns - log_ns[0])
    span = float(ends[1] - ends[0]) * _NS
    change = float(np.median(lag[-tenth:]) - np.median(lag[:tenth])) * _NS
    if span < _DRIFT_SPAN_S or abs(change) < _DRIFT_S:
        return
    slope = change / span
    if abs(slope) < _DRIFT_WARNING:
        return
    # Less than a second in all can be the jitter of log times, lockstep's windows among them.
    severe = abs(slope) >= _DRIFT_SEVERE and abs(change) >= _DRIFT_SEVERE_S
    limit = _DRIFT_SEVERE if severe else _DRIFT_WARNING
    yield finding(
        'stamps_drift',
        Severity.SEVERE if severe else Severity.WARNING,
        topic,
        int(stamps_ns[0]),
        n,
        slope,
        f'stamps gain {slope:+.3g} s per s of log time, {change:+.3g} s in {span:.0f} s '
        f'(limit {limit:g}); simulations that did not run in real time look like this, too',
    )


def check_spans(reference: Times, others: Iterable[Times]) -> Iterator[Finding]:
    """Look for topics whose stamps lie outside of those of the IMU.

    Where the IMU's stamps are all zero, its log times stand in for them.
    """
    unstamped = len(reference.stamps_ns) > 0 and not reference.stamps_ns.any()
    imu_ns = reference.log_ns if unstamped else reference.stamps_ns
    if not len(imu_ns):
        return
    first, last = int(imu_ns.min()), int(imu_ns.max())
    imu_behind_ns = 0 if unstamped else reference.behind_log_ns() - reference.offset_ns
    for one in others:
        stamps_ns = one.stamps_ns
        if not len(stamps_ns) or not stamps_ns.any():
            continue
        outside = (stamps_ns < first - 1_000_000_000) | (stamps_ns > last + 1_000_000_000)
        share = float(outside.mean())
        if share > 0.5:
            apart = (int(np.median(stamps_ns)) - (first + last) // 2) * _NS
            yield finding_at(
                'stamps_apart',
                Severity.SEVERE,
                one.topic,
                outside,
                stamps_ns,
                apart,
                f'{100 * share:.0f} % of its stamps lie outside of those of the IMU (limit 50 %): '
                f'another clock? {_remedy(one, imu_behind_ns)}',
            )


def _remedy(one: Times, imu_behind_ns: int) -> str:
    """Return what puts stamps on the clock of the IMU, whose log times stand so far behind it."""
    offset = seconds_text(one.behind_log_ns() - imu_behind_ns)
    shift = f'`time_offset_s: {offset}` (median of log time less stamp'
    if one.delayed:
        return f'{shift}, from which the delay has to be taken off) shifts them'
    if abs(imu_behind_ns) * _NS > _SAME_CLOCK_S:
        return f"{shift}, less that of the IMU) shifts them to the IMU's clock"
    return f'`stamp: log` takes the log time, or {shift}) shifts them'


def seconds_text(time_ns: int) -> str:
    """Return a time in seconds with all its digits down to the microsecond."""
    return f'{time_ns * _NS:.6f}'.rstrip('0').rstrip('.')
