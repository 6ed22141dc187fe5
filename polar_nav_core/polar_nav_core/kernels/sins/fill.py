"""IMU samples that are missing from a regular stream: interpolated once the next one is there.

Derivation: docs/derivations/missing_samples.md. Between two samples the rates and forces of both
are known, so that what is missing is the bend of their course, and not their change. A gap that is
longer is bridged without its end (`bridge`).

A ping that comes meanwhile cannot wait: up to its stamp the last sample is held. The next sample
makes up for the difference (Work.owed), and until then it is noise of the ping.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from . import state as fs
from .settings import Settings
from .state import State
from .work import Work

FADE_NS = 20_000_000_000
"""Time over which the share of missing samples is taken."""
_MOST_ODD = 64
_ODD = 8
"""An interval that is no multiple of the usual one counts as much as so many that are."""
_SLOWER = 64
"""The usual interval grows by one part in so many with each longer one, to follow a slower IMU."""
_SELDOM = 256
"""It grows by as much in so many where a whole number of samples seems to be missing: every second
one lost at 50 Hz for a minute and a half would be a slower IMU."""
_LEAST_NS = 50_000
"""Stamps that are closer are no interval of an IMU (20 kHz)."""
_MOST_MISSING = 1000
"""More are not interpolated: the time for it has a bound, whatever the stamps are."""


@kernel
def _multiple(interval_ns: int, usual_ns: int) -> int:
    """How many usual intervals an interval has; 0 where it is no multiple of them."""
    if interval_ns == usual_ns:  # nearly always, and divisions take their time
        return 1
    n = (interval_ns + usual_ns // 2) // usual_ns
    return n if abs(interval_ns - n * usual_ns) <= usual_ns // 4 else 0


@kernel
def _is_regular(s: State) -> bool:
    """Whether the IMU has an interval, and the last sample is known."""
    known = s.counters[fs.HAS_PREVIOUS] == 1 and s.counters[fs.USUAL_NS] > 0
    return bool(known and s.counters[fs.ODD] <= _MOST_ODD)


@kernel
def _note_interval(s: State, interval_ns: int) -> None:
    """Note the interval before a sample, and how much of it was missing.

    A shorter one than is usual is believed with a second one: of two stamps that are close by
    chance all others would be multiples.
    """
    usual_ns, before_ns = s.counters[fs.USUAL_NS], s.counters[fs.INTERVAL_NS]
    s.counters[fs.INTERVAL_NS] = interval_ns
    if usual_ns == 0:
        if min(interval_ns, before_ns) >= _LEAST_NS and _multiple(interval_ns, before_ns) == 1:
            s.counters[fs.USUAL_NS] = min(interval_ns, before_ns)
        return
    n = _multiple(interval_ns, usual_ns)
    odd = s.counters[fs.ODD]
    s.counters[fs.ODD] = min(odd + _ODD, 4 * _MOST_ODD) if n == 0 else max(odd - 1, 0)
    slower = _SLOWER if n < 2 else _SELDOM * _SLOWER
    shorter = n == 0 and interval_ns < usual_ns
    if not shorter:
        s.counters[fs.USUAL_NS] = min(interval_ns, usual_ns + usual_ns // slower)
    elif interval_ns >= _LEAST_NS and _multiple(interval_ns, max(before_ns, 1)) == 1:
        s.counters[fs.USUAL_NS] = interval_ns
    missing_ns = s.counters[fs.MISSING_NS]
    if missing_ns > 0:
        left = 1.0 - min(1.0, interval_ns / FADE_NS)
        s.counters[fs.MISSING_NS] = int(missing_ns * left)
    if n > 1 and odd <= _MOST_ODD:
        s.counters[fs.MISSING_NS] += interval_ns - usual_ns


@kernel
def is_overdue(s: State, c: Settings, stamp_ns: int) -> bool:
    """Whether a sample should have come between the newest one and a stamp [ns]."""
    if not c.fills or stamp_ns <= s.counters[fs.STAMP] or not _is_regular(s):
        return False
    return bool(stamp_ns - s.counters[fs.IMU_NS] >= s.counters[fs.USUAL_NS])


@kernel
def _course(
    s: State, w: Work, first_ns: float, last_ns: float, row: int, k: int, value: float
) -> float:
    """Mean rate or force between two times since the last sample, on the course to a value.

    A parabola through both samples with the bend of w.bend; w.line is set.
    """
    length_ns = last_ns - first_ns
    since_ns = 0.5 * (first_ns + last_ns) - w.line[0]
    square = since_ns * (since_ns - w.line[1])
    square += (length_ns * length_ns - w.line[3] * w.line[3]) / 12.0
    change = (value - s.previous[row, k]) * since_ns / w.line[1]
    return float(s.previous[row, k] + change + 0.5 * w.bend[row, k] * square * 1e-18)


@kernel
def until_own_ns(s: State, w: Work) -> int:
    """Stamp [ns] at which the own interval of the sample begins."""
    return int(s.counters[fs.IMU_NS]) + int(w.line[2])


@kernel
def begin_sample(
    s: State, c: Settings, w: Work, stamp_ns: int, omega_ib_b: Array, f_b: Array
) -> bool:
    """Note a sample; whether it has to make up for what was held up to a ping (Work.owed).

    Leaves in w.line the time since the last sample's stamp at which that is valid, the time from
    there to where this one is, how much is missing, and over what the samples are means, all [ns].
    """
    last_ns = s.counters[fs.IMU_NS]
    interval_ns = stamp_ns - last_ns
    usual_ns = s.counters[fs.USUAL_NS]
    missing = 0
    if _is_regular(s):
        missing = max(0, _multiple(interval_ns, usual_ns) - 1)
        if missing > _MOST_MISSING:
            missing = 0
        if missing > 0:  # the usual interval has grown a little since the last shortest one
            usual_ns = interval_ns // (missing + 1)
    own_ns = usual_ns if missing > 0 else interval_ns
    known = s.counters[fs.HAS_PREVIOUS] == 1
    if known or s.counters[fs.USUAL_NS] == 0:  # after a bridge the interval is no usual one
        _note_interval(s, interval_ns)
    w.line[0] = 0.0 if c.instant else -0.5 * usual_ns
    w.line[1] = interval_ns if c.instant else interval_ns - 0.5 * own_ns + 0.5 * usual_ns
    w.line[2] = interval_ns - own_ns
    w.line[3] = 0.0 if c.instant else usual_ns
    held_ns = s.counters[fs.HELD_NS] - last_ns if s.counters[fs.HELD_NS] > 0 else 0
    s.counters[fs.HELD_NS] = 0
    if missing > 0 or held_ns > 0:
        _bend(s, w, interval_ns, omega_ib_b, f_b)
    if missing > 0:
        _add_noise(s, w, missing, usual_ns * 1e-9, interval_ns * 1e-9)
    if known:
        _note_slope(s, interval_ns, omega_ib_b, f_b)
    if held_ns == 0:
        return False
    before_ns = held_ns if c.instant else min(held_ns, interval_ns - own_ns)
    for k in range(3):
        for row in range(2):
            value = omega_ib_b[k] if row == 0 else f_b[k]
            mean = _course(s, w, 0.0, before_ns, row, k, value)
            owed = mean * before_ns + value * (held_ns - before_ns)
            w.owed[row, k] = (owed - s.previous[row, k] * held_ns) * 1e-9
    return True


@kernel
def next_missing(s: State, w: Work, omega_ib_b: Array, f_b: Array) -> int:
    """Stamp [ns] of the next missing sample, with its mean rate and force in the scratch."""
    first_ns = s.counters[fs.STAMP]
    left_ns = until_own_ns(s, w) - first_ns
    usual_ns = max(1, s.counters[fs.USUAL_NS])
    to_ns = first_ns + left_ns // max(1, (left_ns + usual_ns // 2) // usual_ns)
    since_ns, until_ns = first_ns - s.counters[fs.IMU_NS], to_ns - s.counters[fs.IMU_NS]
    for k in range(3):
        w.omega[k] = _course(s, w, since_ns, until_ns, 0, k, omega_ib_b[k])
        w.f[k] = _course(s, w, since_ns, until_ns, 1, k, f_b[k])
    return int(to_ns)


@kernel
def end_missing(s: State, c: Settings, w: Work, omega_ib_b: Array, f_b: Array) -> None:
    """Let values at stamps be averaged from where the own interval of the sample begins."""
    reached_ns = s.counters[fs.STAMP] - s.counters[fs.IMU_NS]
    if c.instant and reached_ns > 0 and s.counters[fs.HAS_PREVIOUS] == 1:
        for k in range(3):
            omega = _course(s, w, reached_ns, reached_ns, 0, k, omega_ib_b[k])
            f = _course(s, w, reached_ns, reached_ns, 1, k, f_b[k])
            s.previous[0, k] = omega
            s.previous[1, k] = f


@kernel
def _bend(s: State, w: Work, interval_ns: int, omega_ib_b: Array, f_b: Array) -> None:
    """Fill w.bend by the change of the slope at the last sample; without a slope before, 0."""
    span, before = interval_ns * 1e-9, s.span[0]
    for k in range(3):
        for row in range(2):
            value = omega_ib_b[k] if row == 0 else f_b[k]
            slope = (value - s.previous[row, k]) / span
            w.bend[row, k] = 0.0
            if before > 0.0:
                w.bend[row, k] = 2.0 * (slope - s.slope[row, k]) / (span + before)


@kernel
def _note_slope(s: State, interval_ns: int, omega_ib_b: Array, f_b: Array) -> None:
    """Note how rate and force change from the last sample to this one."""
    span = interval_ns * 1e-9
    for k in range(3):
        s.slope[0, k] = (omega_ib_b[k] - s.previous[0, k]) / span
        s.slope[1, k] = (f_b[k] - s.previous[1, k]) / span
    s.span[0] = span


@kernel
def _variance(bend: float, span: float, before: float, missing: int, usual: float) -> float:
    """Variance of an integral over missing samples, by the bend that their course seems to have.

    The course bends, and what a parabola leaves of that is less than it corrects, or the samples
    are noisy, and it corrects by their noise; here is either.
    """
    bent = bend * span * span * span / 12.0
    turn = 0.5 * bend * (span + before)
    a, b = 1.0 / span, 1.0 / before
    noise = turn * turn / (a * a + (a + b) * (a + b) + b * b)
    return float(bent * bent + noise * usual * usual * (missing + 0.5 * missing * missing))


@kernel
def _add_noise(s: State, w: Work, missing: int, usual: float, span: float) -> None:
    """Add to P the variance of attitude and velocity over missing samples."""
    before = s.span[0] if s.span[0] > 0.0 else span
    for k in range(3):
        turned = _variance(w.bend[0, k], span, before, missing, usual)
        pushed = _variance(w.bend[1, k], span, before, missing, usual)
        for i in range(3):
            square = s.C_b_G[i, k] * s.C_b_G[i, k]
            s.P[i, i] += square * turned
            s.P[3 + i, 3 + i] += square * pushed


@kernel
def add_held_to_ping(s: State, R: Array) -> None:
    """Add to a ping's R (3, 3) [m^2/s^2] what is not known of a state held up to its stamp."""
    held_ns = s.counters[fs.HELD_NS] - s.counters[fs.IMU_NS]
    if s.counters[fs.HELD_NS] == 0 or held_ns <= 0:
        return
    held = held_ns * 1e-9
    # The last sample is valid half an interval before its stamp.
    share = 0.5 * held * (held + s.counters[fs.USUAL_NS] * 1e-9)
    turned = pushed = speed = 0.0
    for k in range(3):
        turned += s.slope[0, k] * s.slope[0, k]
        pushed += s.slope[1, k] * s.slope[1, k]
        speed += s.v_G[k] * s.v_G[k]
    for k in range(3):
        R[k, k] += share * share * (turned * speed + pushed)
