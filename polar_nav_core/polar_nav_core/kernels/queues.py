"""Which of several rings of measurements comes next in the total order, for both filters.

A ring holds number i at i % length; ``taken`` numbers of it have been processed, ``come`` have
been received. Within a stamp the ranks of the streams decide (events.Rank).
"""

from __future__ import annotations

from ..arrays import Ints
from ..order import NEVER_NS
from .cache import kernel


@kernel
def next_stamp(stamps: Ints, taken: int, come: int) -> int:
    """Stamp of the next measurement of a ring [ns]; NEVER_NS when none is waiting."""
    if taken >= come:
        return NEVER_NS
    stamp: int = stamps[taken % stamps.shape[0]]
    return stamp


@kernel
def earlier(stamp: int, rank: int, other: int, other_rank: int) -> tuple[int, int]:
    """Stamp [ns] and rank of the earlier of two measurements; of equal stamps, of the first."""
    if other < stamp:
        return other, other_rank
    return stamp, rank


@kernel
def is_before(stamp: int, rank: int, until_ns: int, until_rank: int) -> bool:
    """Whether (stamp, rank) stands before (until_ns, until_rank) in the total order."""
    return stamp < until_ns or (stamp == until_ns and rank < until_rank)
