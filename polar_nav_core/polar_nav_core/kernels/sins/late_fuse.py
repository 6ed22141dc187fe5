"""A late fix, gated and fused exactly through blocks of stored steps.

Derivation: docs/derivations/late_fixes.md, 3. Nothing is filtered again: the fix is carried to
the present as three combinations of a past error, and once it is fused everything stored on its
way changes by terms of rank three.
"""

from __future__ import annotations

from ..cache import kernel, routine
from . import state as fs
from .block_products import change_block, change_prior, correct_for_prior, cross_block
from .blocks import NONE, OPEN, Blocks
from .consider import COLUMNS, innovation_sensitivity, late_sensitivity, update_sensitivity
from .enlarged import tell_bend
from .entries import adjoint, carry, change_entries, mean_change
from .fuse import correct_and_remember
from .judge import adapt_noise, judge_wide, passes, remember
from .late_place import begin
from .rings import Log, Past
from .settings import Settings
from .signatures import note
from .state import State
from .three_rows import add_outer
from .update import N, cholesky, gain_of, nis_of
from .work import Work

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
    place: int,
    m: int,
) -> int:
    """Fuse the late fix in H, R, z of the scratch; FUSED, REFUSED or S_NOT_DEFINITE.

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
    place, m : int
        Where the fix belongs: see `find_block`.
    """
    n = bl.first.shape[0]
    b = m % n
    # The late fix of its block that it comes after, and the next.
    before = NONE
    after = bl.head[b]
    while after != NONE and bl.place[after] <= place:
        before = after
        after = bl.next[after]
    u = s.counters[fs.CORRECTIONS] % log.H.shape[0]
    begin(w, log, bl, b, u, epoch, place)
    _carry_to_now(past, w, log, bl, m, place, after)
    adapt_noise(s, c, w, fs.FIX_ROW, fs.VECTOR)
    w.age[0] = (s.counters[fs.STAMP] - validity_ns) * 1e-9
    if not _judge(s, c, w, bl, w.age[0]):
        return fs.S_NOT_DEFINITE
    fused = passes(s, c, w, w.z, fs.FIX_ROW, fs.VECTOR)
    is_evidence = remember(s, c, w, w.z, fs.FIX_ROW, fs.VECTOR, fused)
    if not fused:
        return fs.REFUSED
    gain_of(w.K, w.D, bl.columns[0], w.L, w.S, 3)
    if s.counters[fs.CONSIDERS] == 1:
        update_sensitivity(s.sensitivity, w.K, w.moved, 3)
    if is_evidence:
        note(s, past, w, fs.FIX_ROW, 3, w.age[0])
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
    # Of a closed block only another fix inside it reads the entries: most never come.
    if m == bl.counts[OPEN]:
        good = good and _change_own(s, past, log, bl, m, u)
    else:
        bl.newest[b] = u
    if c.gap_ns > 0:
        tell_bend(s, w, log)
    correct_and_remember(s, c, past, w.C_e_G, w.x)
    return fs.FUSED if good else fs.S_NOT_DEFINITE


@kernel
def settle(s: State, past: Past, log: Log, bl: Blocks, m: int) -> bool:
    """Whether block m is positive definite, its entries changed by all late fixes inside it.

    The newest of them changes them only now that another fix shall be put among them.
    """
    b = m % bl.first.shape[0]
    u = bl.newest[b]
    if u == NONE:
        return True
    bl.newest[b] = NONE
    good: bool = _change_own(s, past, log, bl, m, u)
    return good


@kernel
def _carry_to_now(
    past: Past, w: Work, log: Log, bl: Blocks, m: int, place: int, after: int
) -> None:
    """Carry a fix from its place in block m to now; each block stores the rows that entered it."""
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
    if s.counters[fs.CONSIDERS] == 1:
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
    """Replace the blocks from m on, the open one too, by those with the fix fused.

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
        change_prior(bl, b)
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
def _change_own(s: State, past: Past, log: Log, bl: Blocks, m: int, u: int) -> bool:
    """Replace the entries after the fix of correction u in its own block m by those with it fused.

    What it was at its place is stored there: C = S K^T, and S = P_cc + R, which enter as a sum.
    """
    C = bl.columns[0]
    S = bl.small[6]
    z = bl.small[5, 1]
    for a in range(3):
        z[a] = log.z[u, a]
        for d in range(3):
            S[a, d] = log.S[u, a, d]
            bl.small[7, a, d] = 0.0
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
        S,
        z,
        bl.small[7],
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
