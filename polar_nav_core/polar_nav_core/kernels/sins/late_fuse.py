"""A late fix, gated and fused exactly through blocks of stored steps.

Derivation: docs/derivations/late_fixes.md, 3. Nothing is filtered again: the fix is carried to
the present as three combinations of a past error, and once it is fused everything stored on its
way changes by terms of rank three.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel, routine
from . import state as fs
from .block_products import build, change_block, change_prior, correct_for_prior, cross_block
from .blocks import (
    NONE,
    OPEN,
    PER_BLOCK,
    STEPS,
    Blocks,
    close_early,
    is_stored,
    place_of,
    sort_in,
)
from .consider import COLUMNS, innovation_sensitivity, late_sensitivity, update_sensitivity
from .entries import adjoint, carry, change_entries, mean_change
from .fuse import adapt_noise, correct_and_remember, judge_wide, passes, remember
from .state import Log, Past, Settings, State, Work
from .three_rows import add_outer, inner, rows_times
from .update import N, cholesky, gain_of, nis_of

OUT_OF_REACH = -9


@routine
def fuse_late(
    s: State,
    c: Settings,
    past: Past,
    w: Work,
    log: Log,
    bl: Blocks,
    validity_ns: int,
    epoch: int,
) -> int:
    """FUSED, REFUSED, S_NOT_DEFINITE or OUT_OF_REACH, of the late fix in H, R, z of the scratch.

    It is judged by its innovation against all that was received so far, which w.z and w.S hold
    afterwards. The frames are left behind.

    Parameters
    ----------
    s, past, log, bl : in place
        State, stored past, linear steps and their blocks.
    c : Settings
    w : Work
        Scratch; z is the innovation against a stored epoch.
    validity_ns : int
        When the fix is valid [ns].
    epoch : int
        Number of the epoch that z is of.
    """
    n = bl.first.shape[0]
    place, m = _reach(s, past, log, bl, validity_ns)
    if place < 0:
        return OUT_OF_REACH
    b = m % n
    # The late fix of its block that it comes after, and the next.
    before = NONE
    after = bl.head[b]
    while after != NONE and bl.place[after] <= place:
        before = after
        after = bl.next[after]
    u = s.counters[fs.CORRECTIONS] % log.H.shape[0]
    _begin(w, log, bl, b, u, epoch, place)
    _carry_to_now(past, w, log, bl, m, place, after)
    adapt_noise(s, c, w, fs.FIX_ROW, fs.VECTOR)
    w.age[0] = (s.counters[fs.STAMP] - validity_ns) * 1e-9
    if not _judge(s, c, w, bl, w.age[0]):
        return fs.S_NOT_DEFINITE
    fused = passes(s, c, w, w.z, fs.FIX_ROW, fs.VECTOR)
    remember(s, w, w.z, fs.FIX_ROW, fs.VECTOR, fused)
    if not fused:
        return fs.REFUSED
    if c.considers:
        gain_of(w.K, w.D, bl.columns[0], w.L, w.S, 3)
        update_sensitivity(s.sensitivity, w.K, w.moved, 3)
    change = bl.columns[2, 0]
    if not mean_change(change, bl.columns[0], bl.small[4], bl.small[5, 0], w.R, bl):
        return fs.S_NOT_DEFINITE
    add_outer(s.P, -1.0, bl.scratch[3:6], bl.scratch[3:6])
    for i in range(N):
        w.x[i] = -change[i]
    good = m == bl.counts[OPEN] or _change_blocks(s, past, w, log, bl, m)
    good = good and _store_fix(w, log, bl, u)
    bl.place[u] = place
    bl.epochs[u] = epoch + 1
    bl.next[u] = after
    if before == NONE:
        bl.head[b] = u
    else:
        bl.next[before] = u
    good = good and _change_own(s, past, w, log, bl, m, u)
    correct_and_remember(s, past, w.x)
    return fs.FUSED if good else fs.S_NOT_DEFINITE


@kernel
def _reach(s: State, past: Past, log: Log, bl: Blocks, validity_ns: int) -> tuple[int, int]:
    """Place of a fix and the number of its block, which with all behind it is built; -1, -1."""
    n = bl.first.shape[0]
    sort_in(log, bl)
    count = log.counts[0]
    place = place_of(log, max(0, count - log.kinds.shape[0]), validity_ns)
    if place < bl.first[bl.counts[OPEN] % n] and 2 * bl.counts[STEPS] >= bl.counts[PER_BLOCK]:
        close_early(log, bl)
    now = bl.counts[OPEN]
    m = now
    while m > 0 and m > now - n + 1 and bl.first[m % n] > place:
        m -= 1
    first = bl.first[m % n]
    if first > place or not is_stored(s, log, first, count):
        return -1, -1
    for i in range(m, now):
        if bl.built[i % n] == 0:
            build(past, log, bl, i % n, bl.first[(i + 1) % n])
    return place, m


@kernel
def _begin(w: Work, log: Log, bl: Blocks, b: int, u: int, epoch: int, place: int) -> None:
    """C = P H^T, P_cc and z of a fix at its place, by the filter stored in block b.

    Those are columns[0], small[4] and small[5, 0]; what stands there stays in K and H of
    correction u, small[6] and small[5, 1].
    """
    C = bl.columns[0]
    P_cc = bl.small[4]
    _refer(w.z, w.H, log, bl, b, epoch, place)
    _rows_of_P(C, w, log, bl, b, place)
    inner(P_cc, w.H, C)
    for a in range(3):
        bl.small[5, 0, a] = w.z[a]
        bl.small[5, 1, a] = w.z[a]
        for d in range(a):
            P_cc[a, d] = 0.5 * (P_cc[a, d] + P_cc[d, a])
            P_cc[d, a] = P_cc[a, d]
    for a in range(3):
        for d in range(3):
            bl.small[6, a, d] = P_cc[a, d]
        for k in range(N):
            log.K[u, a, k] = C[a, k]
            log.H[u, a, k] = w.H[a, k]


@kernel
def _carry_to_now(
    past: Past, w: Work, log: Log, bl: Blocks, m: int, place: int, after: int
) -> None:
    """Carry a fix from its place in block m to the present; how it entered a block stays there."""
    n = bl.first.shape[0]
    now = bl.counts[OPEN]
    count = log.counts[0]
    C = bl.columns[0]
    Y = bl.columns[1]
    P_cc = bl.small[4]
    z = bl.small[5, 0]
    end = count if m == now else bl.first[(m + 1) % n]
    carry(C, P_cc, z, past, log, bl, after, place, end)
    if m < now:
        adjoint(Y, past, log, bl, m % n, end, place, w.H)
        correct_for_prior(C, P_cc, z, Y, bl, m % n)
        for i in range(m + 1, now):
            cross_block(C, P_cc, z, bl, i % n)
        o = now % n
        for a in range(3):
            bl.z[o, a] = z[a]
            for d in range(3):
                bl.P_cc[o, a, d] = P_cc[a, d]
            for k in range(N):
                bl.C[o, a, k] = C[a, k]
        carry(C, P_cc, z, past, log, bl, bl.head[o], bl.first[o], count)
    for a in range(3):
        w.z[a] = z[a]


@kernel
def _judge(s: State, c: Settings, w: Work, bl: Blocks, delay: float) -> bool:
    """Whether S = P_cc + R is positive definite; S, its factor and NIS are in the scratch.

    NIS is that of S with the common errors, whose sensitivity at the validity, ``delay`` [s] ago,
    is that of now less what the velocity has moved since.
    """
    for a in range(3):
        for d in range(3):
            w.S[a, d] = bl.small[4, a, d] + 0.5 * (w.R[a, d] + w.R[d, a])
    if not cholesky(w.L, w.S, 3):
        return False
    w.nis[0] = nis_of(w.L, w.z, w.w, 3)
    if c.considers:
        for a in range(3):
            for k in range(COLUMNS):
                w.moved[a, k] = w.J[a, k]
        late_sensitivity(w.moved, s.sensitivity, delay)
        innovation_sensitivity(w.moved, w.H, s.sensitivity, 3)
        return judge_wide(c, w, w.z, 3)
    for a in range(3):
        for d in range(3):
            w.wide[a, d] = w.S[a, d]
    return True


@kernel
def _change_blocks(s: State, past: Past, w: Work, log: Log, bl: Blocks, m: int) -> bool:
    """Change closed blocks from m on and the open one to what they are with the fix fused.

    The entries of block m itself stay: they are relative to its stored prior.
    """
    n = bl.first.shape[0]
    now = bl.counts[OPEN]
    length = log.kinds.shape[0]
    change = bl.columns[2, 0]
    e = (m + 1) % n
    good = change_block(bl, m % n, bl.C[e], bl.P_cc[e], bl.z[e], w.R, bl.columns[1], 1.0)
    for i in range(m + 1, now):
        b = i % n
        e = (i + 1) % n
        good = good and change_prior(bl, b, w.R)
        good = good and change_block(bl, b, bl.C[e], bl.P_cc[e], bl.z[e], w.R, bl.V[b], -1.0)
    # The open block is as filtered now: its prior, too, is that of now.
    o = now % n
    good = good and mean_change(change, bl.C[o], bl.P_cc[o], bl.z[o], w.R, bl)
    step = log.numbers[(bl.first[o] - 1) % length]
    add_outer(log.step_P[step % log.step_P.shape[0]], -1.0, bl.scratch[3:6], bl.scratch[3:6])
    return good and change_entries(
        bl.C[o],
        bl.P_cc[o],
        bl.z[o],
        w.R,
        s,
        past,
        log,
        bl,
        bl.head[o],
        bl.first[o],
        log.counts[0],
        log.epochs[(bl.first[o] - 1) % length],
        s.counters[fs.EPOCHS],
        False,
        change,
    )


@kernel
def _change_own(s: State, past: Past, w: Work, log: Log, bl: Blocks, m: int, u: int) -> bool:
    """Change what is stored behind the fix of correction u in its own block m."""
    C = bl.columns[0]
    for a in range(3):
        for k in range(N):
            t = 0.0
            for d in range(3):
                t += log.S[u, a, d] * log.K[u, d, k]
            C[a, k] = t
    closed = m < bl.counts[OPEN]
    end = bl.first[(m + 1) % bl.first.shape[0]] if closed else log.counts[0]
    last_epoch = log.epochs[(end - 1) % log.kinds.shape[0]] if closed else s.counters[fs.EPOCHS]
    return change_entries(
        C,
        bl.small[6],
        bl.small[5, 1],
        w.R,
        s,
        past,
        log,
        bl,
        bl.next[u],
        bl.place[u],
        end,
        bl.epochs[u],
        last_epoch,
        closed,
        bl.columns[2, 0],
    )


@kernel
def _refer(z: Array, H: Array, log: Log, bl: Blocks, b: int, epoch: int, place: int) -> None:
    """Take out of z what was fed back after the epoch was stored and before ``place``."""
    length = log.kinds.shape[0]
    entry = place - 1
    while entry >= bl.first[b] and log.epochs[entry % length] > epoch:
        e = entry % length
        if log.kinds[e] == fs.UPDATE:
            _take_out(z, H, log.x[log.numbers[e] % log.H.shape[0]])
        entry -= 1
    u = bl.head[b]
    while u != NONE and bl.place[u] <= place:
        if bl.epochs[u] > epoch:
            _take_out(z, H, log.x[u])
        u = bl.next[u]


@kernel
def _take_out(z: Array, H: Array, x: Array) -> None:
    for a in range(3):
        s = 0.0
        for k in range(N):
            s += H[a, k] * x[k]
        z[a] -= s


@kernel
def _rows_of_P(C: Array, w: Work, log: Log, bl: Blocks, b: int, place: int) -> None:
    """C = H P at a place, by the filter stored in block b."""
    length = log.kinds.shape[0]
    base = place - 1
    while log.kinds[base % length] != fs.STEP:
        base -= 1
    rows_times(C, w.H, log.step_P[log.numbers[base % length] % log.step_P.shape[0]])
    u = bl.head[b]
    while u != NONE and bl.place[u] <= base:
        u = bl.next[u]
    for entry in range(base + 1, place + 1):
        while u != NONE and bl.place[u] == entry:
            _drop(C, w.H, log, bl, u, 3)
            u = bl.next[u]
        if entry < place:
            e = entry % length
            _drop(C, w.H, log, bl, log.numbers[e] % log.H.shape[0], log.rows[e])


@kernel
def _drop(C: Array, H: Array, log: Log, bl: Blocks, u: int, m: int) -> None:
    """C <- C - H K S K^T: H P after an update whose gain and S are stored."""
    X = bl.small[0]
    K = log.K[u]
    S = log.S[u]
    for c in range(3):
        for a in range(m):
            s = 0.0
            for k in range(N):
                s += H[c, k] * K[a, k]
            X[a, c] = s
    for c in range(3):
        for a in range(m):
            s = 0.0
            for d in range(m):
                s += S[a, d] * X[d, c]
            for k in range(C.shape[1]):
                C[c, k] -= s * K[a, k]


@kernel
def _store_fix(w: Work, log: Log, bl: Blocks, u: int) -> bool:
    """Store gain, S and innovation of a fix at its place; K held H P there."""
    P_cc = bl.small[6]
    z = bl.small[5, 1]
    S = log.S[u]
    for a in range(3):
        log.z[u, a] = z[a]
        for d in range(3):
            S[a, d] = P_cc[a, d] + 0.5 * (w.R[a, d] + w.R[d, a])
    if not cholesky(log.L[u], S, 3):
        return False
    L = log.L[u]
    K = log.K[u]
    for i in range(N):
        for a in range(3):
            t = K[a, i]
            for d in range(a):
                t -= L[a, d] * K[d, i]
            K[a, i] = t / L[a, a]
        for r in range(3):
            a = 2 - r
            t = K[a, i]
            for d in range(a + 1, 3):
                t -= L[d, a] * K[d, i]
            K[a, i] = t / L[a, a]
        log.x[u, i] = K[0, i] * z[0] + K[1, i] * z[1] + K[2, i] * z[2]
    return True
