"""Place of a late fix among the stored steps, and its rows and innovation there."""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from . import rings
from .block_products import build
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
from .rings import Log, Past
from .state import State
from .three_rows import inner, rows_times
from .update import N
from .work import Work


@kernel
def find_block(s: State, past: Past, log: Log, bl: Blocks, validity_ns: int) -> tuple[int, int]:
    """Place of a fix and the number of its block; -1, -1 where they are not stored any more.

    That block and all behind it are built.
    """
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
def begin(w: Work, log: Log, bl: Blocks, b: int, u: int, epoch: int, place: int) -> None:
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
def _refer(z: Array, H: Array, log: Log, bl: Blocks, b: int, epoch: int, place: int) -> None:
    """Subtract from z the corrections fed back after the epoch was stored and before ``place``."""
    length = log.kinds.shape[0]
    entry = place - 1
    while entry >= bl.first[b] and log.epochs[entry % length] > epoch:
        e = entry % length
        if log.kinds[e] == rings.UPDATE:
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
    while log.kinds[base % length] != rings.STEP:
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
