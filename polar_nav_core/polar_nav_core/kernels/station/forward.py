"""Late fixes brought to the present: `ignore`, `tagged` and `back_propagate` of station mode.

Equations: docs/derivations/station.md.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import entry, kernel, routine
from . import state as ss
from .common import fix_common, transform
from .fix import fix_rows, judge, know_station, share, spread_of, update_members
from .obey import obey
from .reopen import note, open_gate, opens
from .signatures import note_signatures
from .state import Bank, Log, Settings, Streams, Work
from .step import lever_arm, prepare_step, slopes

MOST_DECAY = math.log(1e6)
"""`back_propagate` takes no fix since whose validity drag has damped a velocity more than that."""


@kernel
def solve_rows(A: Array, H: Array, Phi: Array) -> None:
    """H (2, 12) <- H Phi^-1, by elimination with pivots on Phi^T."""
    n = ss.N
    for i in range(n):
        for j in range(n):
            A[i, j] = Phi[j, i]
        A[i, n] = H[0, i]
        A[i, n + 1] = H[1, i]
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[best, k]):
                best = i
        if best != k:
            for j in range(n + 2):
                s = A[k, j]
                A[k, j] = A[best, j]
                A[best, j] = s
        for i in range(k + 1, n):
            f = A[i, k] / A[k, k]
            for j in range(k, n + 2):
                A[i, j] -= f * A[k, j]
    for a in range(2):
        for i in range(n - 1, -1, -1):
            s = A[i, n + a]
            for j in range(i + 1, n):
                s -= A[i, j] * H[a, j]
            H[a, i] = s / A[i, i]


@kernel
def walk(
    b: Bank, c: Settings, w: Work, streams: Streams, log: Log, m: int, first: int, move: bool
) -> None:
    """Transition of member m over IMU samples first.. to now, and the corrections since.

    Into w.Phi: columns 0..11 the transition (identity unless ``move``), column 12 what the
    corrections since have come to.
    """
    for i in range(ss.N):
        for j in range(ss.N + 1):
            w.Phi[i, j] = 1.0 if i == j else 0.0
    n = log.points.shape[0]
    for i in range(first, b.counters[ss.IMU]):
        if move:
            prepare_step(b, c, w, streams, i)
            k = streams.imu_stamps.shape[0]
            h = (streams.imu_stamps[i % k] - streams.imu_stamps[(i - 1) % k]) * 1e-9
            f_drag, f_share, g_x, g_y = slopes(log.points[i % n, m], c, w)
            transform(w.Phi, h, f_drag, f_share, g_x, g_y, w)
        for j in range(ss.N):
            w.Phi[j, ss.N] += log.jumps[i % n, m, j]


@kernel
def published_fix(
    b: Bank,
    c: Settings,
    w: Work,
    streams: Streams,
    log: Log,
    fix: Array,
    outcome: Array,
    first: int,
    kind: int,
) -> None:
    """Fuse a fix as printed (Eqs. 10, 12, 13): against the stored position, gain of the present.

    Range becomes horizontal with the own depth; z stands apart, as a depth of its own.
    """
    n = log.points.shape[0]
    x, at = b.x[0], ss.POSITION
    lever_arm(b, w, streams, first - 1, c.lever_fix_b)
    d_z = x[ss.POSITION + 2] + w.lever[2] - fix[ss.Z]
    across = math.sqrt(max(fix[ss.RANGE] * fix[ss.RANGE] - d_z * d_z, 0.0))
    angle = fix[ss.BEARING] + fix[ss.PSI]
    w.z[0, 0] = fix[ss.X] + across * math.cos(angle) - w.lever[0]
    w.z[0, 1] = fix[ss.Y] + across * math.sin(angle) - w.lever[1]
    then = kind != ss.IGNORE and first < b.counters[ss.IMU]
    for a in range(2):
        w.z[0, a] -= log.points[first % n, 0, at + a] if then else x[at + a]
        if then and c.shifted:
            for i in range(first, b.counters[ss.IMU]):
                w.z[0, a] -= log.jumps[i % n, 0, at + a]
        for j in range(ss.N):
            w.PHt[0, a, j] = b.P[0, at + a, j]
    w.S[0, 0] = b.P[0, at, at] + c.fix_variance
    w.S[0, 1] = b.P[0, at, at + 1]
    w.S[0, 2] = b.P[0, at + 1, at + 1] + c.fix_variance
    for k in range(3):
        w.wide[0, k] = w.S[0, k]
    judge(b, c, w, fix, outcome, b.x)
    outcome[ss.DISTANCE] = 1.0  # the innovation is in metres, along x and y
    outcome[ss.AZIMUTH] = 0.0
    note(b, w, outcome, 0.0, 0.0)
    if outcome[ss.DECIDED] == ss.FUSED:
        update_members(b, c, w, log.jumps, True)


@entry
@routine
def forward_fix(
    b: Bank,
    c: Settings,
    w: Work,
    streams: Streams,
    log: Log,
    fix: Array,
    outcome: Array,
    first: int,
    dt: float,
    kind: int,
) -> None:
    """Fuse a fix at the present.

    Parameters
    ----------
    fix, outcome : (FIX_COLUMNS,), (OUTCOME,) arrays
    first : int
        First IMU sample after the fix's validity; the number of the next one for the present.
    dt : float
        From the sample before it to the validity [s].
    kind : int
        IGNORE, TAGGED or BACK_PROPAGATE.
    """
    if c.published:
        published_fix(b, c, w, streams, log, fix, outcome, first, kind)
        return
    know_station(b, fix)
    outcome[ss.OPENING] = 0.0
    _fill_rows(b, c, w, streams, log, fix, first, dt, kind)
    judge(b, c, w, fix, outcome, b.x)
    if outcome[ss.DECIDED] == ss.REFUSED and opens(b, c, w, outcome, b.counters[ss.STAMP]):
        # A fix whose rows are of the past cannot follow a jump that is of now.
        open_gate(b, w, outcome, log.jumps, b.counters[ss.STAMP], False)
        _fill_rows(b, c, w, streams, log, fix, first, dt, kind)
        judge(b, c, w, fix, outcome, b.x)
    note(b, w, outcome, w.v3[0], w.v3[1])
    note_signatures(b, c, w, outcome, b.counters[ss.STAMP])
    if outcome[ss.DECIDED] == ss.FUSED:
        update_members(b, c, w, log.jumps, True)
    obey(b, c, w, outcome, b.counters[ss.STAMP], False)


@kernel
def _fill_rows(
    b: Bank,
    c: Settings,
    w: Work,
    streams: Streams,
    log: Log,
    fix: Array,
    first: int,
    dt: float,
    kind: int,
) -> None:
    """Fill innovations, rows and innovation covariances of all members for `forward_fix`."""
    now = first == b.counters[ss.IMU]
    n = log.points.shape[0]
    for m in range(b.x.shape[0]):
        lever_arm(b, w, streams, first - 1, c.lever_fix_b)
        at = b.x[m] if now else log.points[first % n, m]
        fix_rows(w.z[m], w.H, fix, at, dt, w)
        fix_common(w.J[m], w.H, fix[ss.RANGE])
        if not now and kind != ss.IGNORE:
            walk(b, c, w, streams, log, m, first, kind == ss.BACK_PROPAGATE)
            if kind == ss.BACK_PROPAGATE:
                solve_rows(w.A, w.H, w.Phi)
            for a in range(2):
                for j in range(ss.N):
                    w.z[m, a] -= w.H[a, j] * w.Phi[j, ss.N]
        spread_of(w.PHt[m], w.S[m], w.H, b.P[m], fix)
        share(b, c, w, m)


@entry
@routine
def tame_since(b: Bank, c: Settings, w: Work, streams: Streams, log: Log, first: int) -> int:
    """Number of the oldest IMU sample, ``first`` or later, from which on Phi can be inverted.

    Drag makes the velocity forget what it was; the inverse of the transition brings it back, with
    all that has happened to it since, enlarged by the exponential of the integral of the slopes.
    """
    n = log.points.shape[0]
    k = streams.imu_stamps.shape[0]
    i: int = b.counters[ss.IMU] - 1
    total = 0.0
    while i >= first:
        h = (streams.imu_stamps[i % k] - streams.imu_stamps[(i - 1) % k]) * 1e-9
        prepare_step(b, c, w, streams, i)
        largest = 0.0
        slopes(log.points[i % n, 0], c, w)
        for a in range(3):
            largest = max(largest, -w.F[a, a])
        total += h * largest
        if total > MOST_DECAY:
            return i + 1
        i -= 1
    return first
