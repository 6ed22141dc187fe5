"""A late fix through the stored steps and updates of a block, entry by entry."""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel, routine
from . import rings
from . import state as fs
from .blocks import NONE, Blocks
from .rings import Log, Past
from .state import State
from .three_rows import add_outer, solve_rows, step_columns, step_rows, whiten, whitener
from .update import USBL, N, cholesky


@kernel
def _pass_update(C: Array, P_cc: Array, z: Array, log: Log, bl: Blocks, u: int, m: int) -> None:
    """Pass a fused update: (3) of late_fixes.md; H C is kept in G, S^-1 H C in SG and small[0]."""
    G = bl.G[u]
    X = bl.small[0]
    H = log.H[u]
    K = log.K[u]
    for a in range(m):
        g_0 = 0.0
        g_1 = 0.0
        g_2 = 0.0
        for k in range(N):
            h = H[a, k]
            if h != 0.0:
                g_0 += h * C[0, k]
                g_1 += h * C[1, k]
                g_2 += h * C[2, k]
        G[a, 0] = g_0
        G[a, 1] = g_1
        G[a, 2] = g_2
        X[a, 0] = g_0
        X[a, 1] = g_1
        X[a, 2] = g_2
    solve_rows(X, log.L[u], m)
    for a in range(m):
        for c in range(3):
            bl.SG[u, a, c] = X[a, c]
    for c in range(3):
        for a in range(m):
            z[c] -= X[a, c] * log.z[u, a]
        for d in range(c + 1):
            s = P_cc[c, d]
            for a in range(m):
                s -= 0.5 * (G[a, c] * X[a, d] + G[a, d] * X[a, c])
            P_cc[c, d] = s
            P_cc[d, c] = s
    for a in range(m):
        g_0 = G[a, 0]
        g_1 = G[a, 1]
        g_2 = G[a, 2]
        for i in range(C.shape[1]):
            k_i = K[a, i]
            C[0, i] -= g_0 * k_i
            C[1, i] -= g_1 * k_i
            C[2, i] -= g_2 * k_i


@kernel
def _change_update(
    C: Array, P_cc: Array, z: Array, R: Array, log: Log, bl: Blocks, u: int, m: int
) -> bool:
    """`_pass_update`; the stored update is replaced by that with the late fix fused before it."""
    B = bl.small[1]
    GB = bl.small[2]
    Q = bl.small[3]
    if not whitener(B, P_cc, R):
        return False
    w_0 = B[0, 0] * z[0]
    w_1 = B[1, 0] * z[0] + B[1, 1] * z[1]
    w_2 = B[2, 0] * z[0] + B[2, 1] * z[1] + B[2, 2] * z[2]
    _pass_update(C, P_cc, z, log, bl, u, m)
    G = bl.G[u]
    X = bl.small[0]
    for a in range(m):
        GB[a, 0] = G[a, 0] * B[0, 0]
        GB[a, 1] = G[a, 0] * B[1, 0] + G[a, 1] * B[1, 1]
        GB[a, 2] = G[a, 0] * B[2, 0] + G[a, 1] * B[2, 1] + G[a, 2] * B[2, 2]
    if not whitener(B, P_cc, R):
        return False
    S = log.S[u]
    for a in range(m):
        log.z[u, a] -= GB[a, 0] * w_0 + GB[a, 1] * w_1 + GB[a, 2] * w_2
        for b in range(a + 1):
            S[a, b] -= GB[a, 0] * GB[b, 0] + GB[a, 1] * GB[b, 1] + GB[a, 2] * GB[b, 2]
            S[b, a] = S[a, b]
    for a in range(m):  # Q = S_m^-1 G S_+^-1, S_m as it was
        v_0 = X[a, 0] * B[0, 0]
        v_1 = X[a, 0] * B[1, 0] + X[a, 1] * B[1, 1]
        v_2 = X[a, 0] * B[2, 0] + X[a, 1] * B[2, 1] + X[a, 2] * B[2, 2]
        Q[a, 0] = v_0 * B[0, 0] + v_1 * B[1, 0] + v_2 * B[2, 0]
        Q[a, 1] = v_1 * B[1, 1] + v_2 * B[2, 1]
        Q[a, 2] = v_2 * B[2, 2]
    K = log.K[u]
    for a in range(m):
        q_0 = Q[a, 0]
        q_1 = Q[a, 1]
        q_2 = Q[a, 2]
        for i in range(C.shape[1]):
            K[a, i] -= q_0 * C[0, i] + q_1 * C[1, i] + q_2 * C[2, i]
    x = log.x[u]
    for i in range(N):
        x[i] = 0.0
    for a in range(m):
        s = log.z[u, a]
        for i in range(C.shape[1]):
            x[i] += s * K[a, i]
    return cholesky(log.L[u], S, m)


@kernel
def carry(
    C: Array,
    P_cc: Array,
    z: Array,
    past: Past,
    log: Log,
    bl: Blocks,
    u: int,
    begin: int,
    end: int,
) -> None:
    """Carry a late fix through entries begin..end-1, and late fixes from u on among them."""
    length = log.kinds.shape[0]
    entry = begin
    while True:
        if u != NONE and bl.place[u] == entry:
            update = u
            rows = fs.VECTOR
            u = bl.next[u]
        elif entry == end:
            break
        else:
            e = entry % length
            entry += 1
            if log.kinds[e] == rings.STEP:
                Phi = past.transitions[log.numbers[e] % past.transitions.shape[0]]
                step_columns(C, Phi, bl.scratch)
                continue
            update = log.numbers[e] % log.H.shape[0]
            rows = log.rows[e]
        # Loops of a known length take a third less time.
        if rows == fs.SCALAR:
            _pass_update(C, P_cc, z, log, bl, update, fs.SCALAR)
        else:
            _pass_update(C, P_cc, z, log, bl, update, fs.VECTOR)


@kernel
def mean_change(change: Array, C: Array, P_cc: Array, z: Array, R: Array, bl: Blocks) -> bool:
    """Change = -C S^-1 z, new estimate minus old; B C stays in scratch[3:6]."""
    B = bl.small[1]
    if not whitener(B, P_cc, R):
        return False
    W = bl.scratch[3:6]
    whiten(W, B, C)
    w_0 = B[0, 0] * z[0]
    w_1 = B[1, 0] * z[0] + B[1, 1] * z[1]
    w_2 = B[2, 0] * z[0] + B[2, 1] * z[1] + B[2, 2] * z[2]
    for i in range(N):
        change[i] = -(W[0, i] * w_0 + W[1, i] * w_1 + W[2, i] * w_2)
    return True


@routine
def change_entries(
    C: Array,
    P_cc: Array,
    z: Array,
    R: Array,
    s: State,
    past: Past,
    log: Log,
    bl: Blocks,
    u: int,
    begin: int,
    end: int,
    first_epoch: int,
    last_epoch: int,
    closed: bool,
    change: Array,
) -> bool:
    """`carry`; the stored entries are replaced by those with the late fix fused before them.

    The last step of a closed block is the prior of the next one: it stays.
    """
    length = log.kinds.shape[0]
    last = first_epoch
    good = True
    entry = begin
    while True:
        if u != NONE and bl.place[u] == entry:
            update = u
            rows = fs.VECTOR
            kind = rings.UPDATE
            epochs = bl.epochs[u]
            u = bl.next[u]
        elif entry == end:
            break
        else:
            e = entry % length
            entry += 1
            update = log.numbers[e]
            rows = log.rows[e]
            kind = log.kinds[e]
            epochs = log.epochs[e]
        if epochs > last:
            good = good and mean_change(change, C, P_cc, z, R, bl)
            shift_epochs(past, s, last, epochs, change)
            last = epochs
        if kind == rings.STEP:
            Phi = past.transitions[update % past.transitions.shape[0]]
            step_columns(C, Phi, bl.scratch)
            if not closed or entry < end:
                good = good and whitener(bl.small[1], P_cc, R)
                W = bl.scratch[3:6]
                whiten(W, bl.small[1], C)
                add_outer(log.step_P[update % log.step_P.shape[0]], -1.0, W, W)
            continue
        update %= log.H.shape[0]
        # Loops of a known length take a third less time.
        if rows == fs.SCALAR:
            good = good and _change_update(C, P_cc, z, R, log, bl, update, fs.SCALAR)
        else:
            good = good and _change_update(C, P_cc, z, R, log, bl, update, fs.VECTOR)
    if last_epoch > last:
        good = good and mean_change(change, C, P_cc, z, R, bl)
        shift_epochs(past, s, last, last_epoch, change)
    return good


@kernel
def _adjoint_update(Y: Array, log: Log, bl: Blocks, u: int, m: int, after: bool) -> None:
    """Y <- Y - (Y K + G^T S^-1) H, the second only for updates after the fix."""
    X = bl.small[0]
    H = log.H[u]
    K = log.K[u]
    for a in range(m):
        s_0 = s_1 = s_2 = 0.0
        if after:  # the fix has just passed
            s_0 = bl.SG[u, a, 0]
            s_1 = bl.SG[u, a, 1]
            s_2 = bl.SG[u, a, 2]
        for k in range(N):
            g = K[a, k]
            s_0 += Y[0, k] * g
            s_1 += Y[1, k] * g
            s_2 += Y[2, k] * g
        X[a, 0] = s_0
        X[a, 1] = s_1
        X[a, 2] = s_2
    for a in range(m):
        for i in range(Y.shape[1]):
            h = H[a, i]
            Y[0, i] -= X[a, 0] * h
            Y[1, i] -= X[a, 1] * h
            Y[2, i] -= X[a, 2] * h


@routine
def adjoint(
    Y: Array, past: Past, log: Log, bl: Blocks, b: int, end: int, place: int, H: Array
) -> None:
    """Y with cov(c, x | block) = Y P at the start of block b, by the filter stored inside it.

    c = H x stands before entry ``place``, after the late fixes that stand there, too.
    """
    length = log.kinds.shape[0]
    for a in range(3):
        for k in range(N):
            Y[a, k] = 0.0
    entry = end
    while True:
        if entry == place:
            for a in range(3):
                for k in range(N):
                    Y[a, k] += H[a, k]
        # Late fixes at this place, last first: they are few.
        last = NONE
        while True:
            u = bl.head[b]
            found = NONE
            while u != NONE and u != last:
                if bl.place[u] == entry:
                    found = u
                u = bl.next[u]
            if found == NONE:
                break
            _adjoint_update(Y, log, bl, found, fs.VECTOR, entry > place)
            last = found
        entry -= 1
        if entry < bl.first[b]:
            break
        e = entry % length
        if log.kinds[e] == rings.STEP:
            Phi = past.transitions[log.numbers[e] % past.transitions.shape[0]]
            step_rows(Y, Phi, bl.scratch)
            continue
        update = log.numbers[e] % log.H.shape[0]
        if log.rows[e] == fs.SCALAR:
            _adjoint_update(Y, log, bl, update, fs.SCALAR, entry >= place)
        else:
            _adjoint_update(Y, log, bl, update, fs.VECTOR, entry >= place)


@kernel
def shift_epochs(past: Past, s: State, first: int, until: int, change: Array) -> None:
    """Move the stored positions of epochs first..until-1 by a change of the estimate.

    Grid axes are those of now: over the length of the history they hardly turn.
    """
    length = past.stamps.shape[0]
    begin = max(first, s.counters[fs.EPOCHS] - length)
    for number in range(begin, until):
        i = number % length
        l0 = past.levers[i, 0]
        l1 = past.levers[i, 1]
        l2 = past.levers[i, 2]
        # Chat lever = C lever - phi x (C lever)
        past.levers[i, 0] += l1 * change[2] - l2 * change[1]
        past.levers[i, 1] += l2 * change[0] - l0 * change[2]
        past.levers[i, 2] += l0 * change[1] - l1 * change[0]
        for k in range(3):
            past.positions[i, k] += change[6 + k]
            past.velocities[i, k] += change[3 + k]
            past.usbl_biases[i, k] -= change[USBL + k]
