"""The log of linear steps, cut into blocks (docs/derivations/late_fixes.md, 3)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ..cache import kernel
from . import rings
from . import state as fs
from .rings import Log
from .state import State
from .update import Ints, N

NONE = -1

# Blocks.counts
OPEN = 0  # number of the block that still grows
SCANNED = 1  # entries of the log that are sorted into blocks
STEPS = 2  # steps in the open block
PER_BLOCK = 3  # steps of a closed one


class Blocks(NamedTuple):
    """Blocks of the log in a ring; number i stands at i % length. Fixes by number of correction.

    Attributes
    ----------
    counts : (4,) see above
    first : (n,) first entry of each; the one before it is a step
    built : (n,) 1 once the arrays of a closed block hold
    head : (n,) first late fix inside, as its place in the log's updates, or NONE
    newest : (n,) late fix that is fused but has not yet changed the entries of its closed block
    T : (n, 24, 24) transposed Psi
    Lambda, Delta : (n, 24, 24), symmetric
    means : (n, 2, 24) lambda, delta
    C, V : (n, 3, 24) a late fix on its way: cov(c, x) at the start, and that times Lambda
    P_cc, z : (n, 3, 3), (n, 3) its covariance and innovation at the start
    next, place, epochs : (updates,) of a late fix: the one after it in its block, the entry before
        which it stands, epochs stored before it
    G, SG : (updates, 3, 3) H C of every update that a late fix passes, and S^-1 H C
    scratch : (9, 24)
    small : (8, 3, 3)
    columns : (3, 3, 24)
    """

    counts: Ints
    first: Ints
    built: Ints
    head: Ints
    newest: Ints
    T: Array
    Lambda: Array
    Delta: Array
    means: Array
    C: Array
    V: Array
    P_cc: Array
    z: Array
    next: Ints
    place: Ints
    epochs: Ints
    G: Array
    SG: Array
    scratch: Array
    small: Array
    columns: Array


def make_blocks(log: Log, steps_per_block: int) -> Blocks:
    """Return blocks for a log whose first entry is the step that it starts from."""
    n = 2 * log.step_P.shape[0] // steps_per_block + 3  # they are half as long at least
    updates = log.H.shape[0]
    first = np.zeros(n, dtype=np.int64)
    first[0] = 1
    return Blocks(
        counts=np.array([0, 1, 0, steps_per_block], dtype=np.int64),
        first=first,
        built=np.zeros(n, dtype=np.int64),
        head=np.full(n, NONE, dtype=np.int64),
        newest=np.full(n, NONE, dtype=np.int64),
        T=np.zeros((n, N, N)),
        Lambda=np.zeros((n, N, N)),
        Delta=np.zeros((n, N, N)),
        means=np.zeros((n, 2, N)),
        C=np.zeros((n, 3, N)),
        V=np.zeros((n, 3, N)),
        P_cc=np.zeros((n, 3, 3)),
        z=np.zeros((n, 3)),
        next=np.full(updates, NONE, dtype=np.int64),
        place=np.zeros(updates, dtype=np.int64),
        epochs=np.zeros(updates, dtype=np.int64),
        G=np.zeros((updates, 3, 3)),
        SG=np.zeros((updates, 3, 3)),
        scratch=np.zeros((9, N)),
        small=np.zeros((8, 3, 3)),
        columns=np.zeros((3, 3, N)),
    )


@kernel
def place_of(log: Log, oldest: int, validity_ns: int) -> int:
    """First entry that a fix valid then stands before."""
    length = log.kinds.shape[0]
    low = oldest
    high = log.counts[0]
    while low < high:
        middle = (low + high) // 2
        i = middle % length
        stamp = log.stamps[i]
        if stamp < validity_ns or (stamp == validity_ns and log.ranks[i] <= fs.FIX_RANK):
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def is_stored(s: State, log: Log, first: int, count: int) -> bool:
    """Whether all that a block needs is still in the rings."""
    length = log.kinds.shape[0]
    if first - 1 < count - length:
        return False
    step = log.numbers[(first - 1) % length]
    if s.counters[fs.STEPS] - step >= log.step_P.shape[0]:
        return False
    for entry in range(first, count):
        e = entry % length
        if log.kinds[e] == rings.UPDATE:
            kept: bool = s.counters[fs.CORRECTIONS] - log.numbers[e] < log.H.shape[0]
            return kept
    return True


@kernel
def sort_in(log: Log, bl: Blocks) -> None:
    """Close the blocks that are full."""
    length = log.kinds.shape[0]
    n = bl.first.shape[0]
    count = log.counts[0]
    if count - bl.counts[SCANNED] > length:  # nobody asked for longer than the log reaches
        bl.counts[SCANNED] = count - length
        while log.kinds[bl.counts[SCANNED] % length] != rings.STEP:
            bl.counts[SCANNED] += 1
        bl.counts[SCANNED] += 1
        _open(bl, bl.counts[SCANNED], n)
    for entry in range(bl.counts[SCANNED], count):
        if log.kinds[entry % length] == rings.STEP:
            bl.counts[STEPS] += 1
            if bl.counts[STEPS] == bl.counts[PER_BLOCK]:
                _open(bl, entry + 1, n)
    bl.counts[SCANNED] = count


@kernel
def close_early(log: Log, bl: Blocks) -> None:
    """Close the open block after its last step.

    An open block has to follow every late fix entry by entry, a closed one does not.
    """
    length = log.kinds.shape[0]
    n = bl.first.shape[0]
    old = bl.counts[OPEN] % n
    last = log.counts[0] - 1
    while log.kinds[last % length] != rings.STEP:
        last -= 1
    _open(bl, last + 1, n)
    new = bl.counts[OPEN] % n
    before = NONE
    u = bl.head[old]
    while u != NONE and bl.place[u] <= last:
        before = u
        u = bl.next[u]
    bl.head[new] = u
    if before == NONE:
        bl.head[old] = NONE
    else:
        bl.next[before] = NONE


@kernel
def _open(bl: Blocks, first: int, n: int) -> None:
    bl.counts[OPEN] += 1
    b = bl.counts[OPEN] % n
    bl.first[b] = first
    bl.built[b] = 0
    bl.head[b] = NONE
    bl.newest[b] = NONE
    bl.counts[STEPS] = 0
