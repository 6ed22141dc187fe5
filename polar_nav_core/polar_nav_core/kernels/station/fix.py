"""Range and bearing of a station: rows, gate of the bank, update, weights of its members.

Equations: docs/derivations/station.md.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import kernel, routine
from . import state as ss
from .common import fix_common, subtract_state, widen
from .obey import obey
from .reopen import note, open_again, open_gate, opens
from .signatures import note_signatures
from .state import Bank, Settings, Streams, Tape, Work
from .step import lever_arm, turned
from .tape import tape_rows


@kernel
def wrapped(angle: float) -> float:
    """Angle in [-pi, pi]."""
    return math.atan2(math.sin(angle), math.cos(angle))


@routine
def fix_rows(z: Array, H: Array, fix: Array, at: Array, dt: float, w: Work) -> None:
    """Innovation (2,) of range and bearing at a point, and its rows H (2, 12).

    The position is brought forward by dt [s] from the point; ``w`` holds the attitude C_A and the
    ``lever`` arm of the transponder. Range is slant range, bearing counter-clockwise from the
    station's stated heading, whose error is a state.
    """
    turned(w.R, w.C_A, at[ss.HEADING])
    for i in range(3):
        w.v3[i] = w.R[i, 0] * at[0] + w.R[i, 1] * at[1] + w.R[i, 2] * at[2]
    d_x = at[ss.POSITION] + dt * (w.v3[0] + at[ss.CURRENT]) + w.lever[0] - fix[ss.X]
    d_y = at[ss.POSITION + 1] + dt * (w.v3[1] + at[ss.CURRENT + 1]) + w.lever[1] - fix[ss.Y]
    d_z = at[ss.POSITION + 2] + dt * w.v3[2] + w.lever[2] - fix[ss.Z]
    across2 = d_x * d_x + d_y * d_y
    distance = math.sqrt(across2 + d_z * d_z)
    z[0] = fix[ss.RANGE] - distance
    z[1] = wrapped(fix[ss.BEARING] + fix[ss.PSI] - math.atan2(d_y, d_x) - at[ss.STATION])
    for a in range(2):
        if a == 0:
            w.g[0] = d_x / distance
            w.g[1] = d_y / distance
            w.g[2] = d_z / distance
        else:
            w.g[0] = -d_y / across2
            w.g[1] = d_x / across2
            w.g[2] = 0.0
        for j in range(3):
            H[a, j] = dt * (w.g[0] * w.R[0, j] + w.g[1] * w.R[1, j] + w.g[2] * w.R[2, j])
            H[a, ss.POSITION + j] = w.g[j]
        H[a, ss.CURRENT] = dt * w.g[0]
        H[a, ss.CURRENT + 1] = dt * w.g[1]
        H[a, ss.DRAG] = 0.0
        H[a, ss.SHARE] = 0.0
        H[a, ss.HEADING] = dt * (w.g[0] * w.v3[1] - w.g[1] * w.v3[0])
        H[a, ss.STATION] = 0.0
    H[1, ss.STATION] = 1.0


@kernel
def spread_of(PHt: Array, S: Array, H: Array, P: Array, fix: Array) -> None:
    """PHt (2, 12) and S = H P H^T + R as (S00, S01, S11)."""
    for a in range(2):
        for j in range(ss.N):
            s = 0.0
            for k in range(ss.N):
                s += H[a, k] * P[k, j]
            PHt[a, j] = s
    s00 = fix[ss.RANGE_VARIANCE]
    s01 = 0.0
    s11 = fix[ss.BEARING_VARIANCE]
    for k in range(ss.N):
        s00 += H[0, k] * PHt[0, k]
        s01 += H[1, k] * PHt[0, k]
        s11 += H[1, k] * PHt[1, k]
    S[0] = s00
    S[1] = s01
    S[2] = s11


@kernel
def share(b: Bank, c: Settings, w: Work, m: int) -> None:
    """Innovation covariance of member m with the common errors; w.J as `fix_common` left it.

    w.J becomes what the member's state has not yet taken of them.
    """
    if c.shares:
        subtract_state(w.J[m], w.H, b.S[m], 2)
        widen(w.wide[m], w.S[m], w.J[m], c.common)
    else:
        for k in range(3):
            w.wide[m, k] = w.S[m, k]


@kernel
def nis_of(z: Array, S: Array) -> float:
    """z^T S^-1 z of two rows."""
    det = S[0] * S[2] - S[1] * S[1]
    nis: float = (S[2] * z[0] * z[0] - 2.0 * S[1] * z[0] * z[1] + S[0] * z[1] * z[1]) / det
    return nis


@routine
def judge(b: Bank, c: Settings, w: Work, fix: Array, outcome: Array, at: Array) -> None:
    """Decide on a fix by the gate of the whole bank, on w.z and w.wide; fills its row of outcomes.

    An innovation covariance that is not positive definite refuses the fix.
    """
    members = b.x.shape[0]
    z0 = 0.0
    z1 = 0.0
    best = 0
    for m in range(members):
        z0 += b.weight[m] * w.z[m, 0]
        z1 += b.weight[m] * w.z[m, 1]
        if b.weight[m] > b.weight[best]:
            best = m
    s00 = 0.0
    s01 = 0.0
    s11 = 0.0
    for m in range(members):
        o0 = w.z[m, 0] - z0
        o1 = w.z[m, 1] - z1
        s00 += b.weight[m] * (w.wide[m, 0] + o0 * o0)
        s01 += b.weight[m] * (w.wide[m, 1] + o0 * o1)
        s11 += b.weight[m] * (w.wide[m, 2] + o1 * o1)
    outcome[ss.Z0] = z0
    outcome[ss.Z1] = z1
    outcome[ss.S00] = s00
    outcome[ss.S01] = s01
    outcome[ss.S11] = s11
    nis = (s11 * z0 * z0 - 2.0 * s01 * z0 * z1 + s00 * z1 * z1) / (s00 * s11 - s01 * s01)
    outcome[ss.NIS] = nis
    outcome[ss.DECIDED] = ss.FUSED if nis <= c.gates[2] else ss.REFUSED
    for m in range(members):
        S = w.S[m]
        if not (S[0] > 0.0 and S[0] * S[2] > S[1] * S[1] and abs(nis) < math.inf):
            outcome[ss.DECIDED] = ss.REFUSED
        squared = nis_of(w.z[m], w.wide[m]) / c.robust_threshold
        factor = 1.0
        if squared > 1.0 and c.robust == ss.ROBUST_MAHALANOBIS:
            factor = squared
        elif squared > 1.0 and c.robust == ss.ROBUST_HUBER:
            factor = math.sqrt(squared)
        w.inflation[m] = factor
    outcome[ss.INFLATION] = w.inflation[best]
    d_x = at[best, 3] + w.lever[0] - fix[ss.X]
    d_y = at[best, 4] + w.lever[1] - fix[ss.Y]
    outcome[ss.DISTANCE] = math.sqrt(d_x * d_x + d_y * d_y)
    outcome[ss.AZIMUTH] = math.atan2(d_y, d_x)


@routine
def update_members(b: Bank, c: Settings, w: Work, jumps: Array, holds: bool) -> None:
    """Update all members with w.z, w.S, w.PHt and w.inflation; then their weights.

    Only the measurement can be at fault for a large innovation: R takes the inflation of S. While
    the model is loose, drag is a Schmidt state where it ``holds``: what a fix contradicts is not
    the drag. A filter that is to be smoothed has gains that are optimal.
    """
    members = b.x.shape[0]
    loose = holds and b.loose[ss.EXTRA] > 0.0
    for m in range(members):
        f = w.inflation[m]
        s00 = f * w.S[m, 0]
        s01 = f * w.S[m, 1]
        s11 = f * w.S[m, 2]
        det = s00 * s11 - s01 * s01
        z0 = w.z[m, 0]
        z1 = w.z[m, 1]
        y0 = (s11 * z0 - s01 * z1) / det
        y1 = (s00 * z1 - s01 * z0) / det
        h0 = w.PHt[m, 0]
        h1 = w.PHt[m, 1]
        P = b.P[m]
        for i in range(ss.N):
            change = h0[i] * y0 + h1[i] * y1
            held = loose and ss.DRAG <= i <= ss.SHARE
            if held:
                change = 0.0
            b.x[m, i] += change
            if jumps.shape[0] > 0:
                jumps[(b.counters[ss.IMU] - 1) % jumps.shape[0], m, i] += change
            k0 = (s11 * h0[i] - s01 * h1[i]) / det
            k1 = (s00 * h1[i] - s01 * h0[i]) / det
            for j in range(i + 1):
                if held and j >= ss.DRAG:
                    continue
                P[i, j] -= k0 * h0[j] + k1 * h1[j]
                P[j, i] = P[i, j]
            if c.shares and not held:
                for j in range(ss.COMMON):
                    b.S[m, i, j] += k0 * w.J[m, 0, j] + k1 * w.J[m, 1, j]
        log_likelihood = -0.5 * (y0 * z0 + y1 * z1 + math.log(det))
        b.log_weight[m] = c.forgetting * b.log_weight[m] + log_likelihood
    weigh(b)


@kernel
def weigh(b: Bank) -> None:
    """Fill the weights of the members from their logarithms, with sum 1."""
    members = b.x.shape[0]
    if members == 1:
        return
    largest = b.log_weight[0]
    for m in range(1, members):
        largest = max(largest, b.log_weight[m])
    total = 0.0
    for m in range(members):
        b.log_weight[m] -= largest
        b.weight[m] = math.exp(b.log_weight[m])
        total += b.weight[m]
    for m in range(members):
        b.weight[m] /= total


@kernel
def know_station(b: Bank, fix: Array) -> None:
    """Start the state of the station's heading error with the first fix that has one."""
    sigma = fix[ss.PSI_SIGMA]
    if sigma > 0.0 and b.flat[ss.SIGMA] == 0.0:
        b.flat[ss.SIGMA] = sigma
        for m in range(b.x.shape[0]):
            b.P[m, ss.STATION, ss.STATION] = sigma * sigma


@routine
def fix_event(
    b: Bank,
    c: Settings,
    w: Work,
    streams: Streams,
    jumps: Array,
    tape: Tape,
    stamp: int,
    frozen: bool,
) -> None:
    """Fuse the next fix at its validity and fill its row of outcomes.

    Where ``frozen``, a fix that was decided on before keeps its decision, its inflation and the
    point where it was linearised.
    """
    i = b.counters[ss.FIX]
    k = i % streams.fix_stamps.shape[0]
    b.counters[ss.FIX] = i + 1
    fix = streams.fixes[k]
    outcome = streams.outcomes[k]
    points = streams.fix_points[k]
    dt = (stamp - b.counters[ss.STAMP]) * 1e-9
    know_station(b, fix)
    lever_arm(b, w, streams, b.counters[ss.IMU] - 1, c.lever_fix_b)
    kept = frozen and outcome[ss.DECIDED] != ss.UNDECIDED
    if kept and outcome[ss.OPENING] != 0.0:
        open_again(b, outcome, jumps, stamp)
    for m in range(b.x.shape[0]):
        if not kept:
            for j in range(ss.N):
                points[m, j] = b.x[m, j]
        fix_rows(w.z[m], w.H, fix, points[m], dt, w)
        fix_common(w.J[m], w.H, fix[ss.RANGE])
        spread_of(w.PHt[m], w.S[m], w.H, b.P[m], fix)
        share(b, c, w, m)
        tape_rows(tape, m, w.H)
        if kept:
            for a in range(2):
                for j in range(ss.N):
                    w.z[m, a] -= w.H[a, j] * (b.x[m, j] - points[m, j])
            w.inflation[m] = streams.fix_inflations[k, m]
    if not kept:
        outcome[ss.OPENING] = 0.0
        judge(b, c, w, fix, outcome, points)
        if outcome[ss.DECIDED] == ss.REFUSED and opens(b, c, w, outcome, stamp):
            open_gate(b, w, outcome, jumps, stamp, True)
            for m in range(b.x.shape[0]):
                for j in range(ss.N):
                    points[m, j] = b.x[m, j]
                fix_rows(w.z[m], w.H, fix, points[m], dt, w)
                fix_common(w.J[m], w.H, fix[ss.RANGE])
                spread_of(w.PHt[m], w.S[m], w.H, b.P[m], fix)
                share(b, c, w, m)
                tape_rows(tape, m, w.H)
            judge(b, c, w, fix, outcome, points)
        for m in range(b.x.shape[0]):
            streams.fix_inflations[k, m] = w.inflation[m]
    note(b, w, outcome, w.v3[0], w.v3[1])
    note_signatures(b, c, w, outcome, stamp)
    if outcome[ss.DECIDED] == ss.FUSED:
        update_members(b, c, w, jumps, tape.Psi.shape[0] == 0)
    obey(b, c, w, outcome, stamp, kept)
