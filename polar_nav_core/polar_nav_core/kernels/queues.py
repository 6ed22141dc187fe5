"""Next measurement of several rings in the total order, for the filters of both modes.

A ring holds number i at i % length; ``taken`` numbers of it have been processed, ``come`` have
been received. Within a stamp the ranks of the streams decide (events.Rank).
"""

from __future__ import annotations

from ..arrays import Ints
from .cache import kernel


@kernel
def earlier(
    stamp: int, rank: int, stamps: Ints, taken: int, come: int, ring_rank: int
) -> tuple[int, int]:
    """Stamp [ns] and rank of the earlier of a measurement and the next one of a ring.

    Of equal stamps it is the first one; NEVER_NS stands for no measurement.
    """
    if taken < come:
        next_ns = stamps[taken % stamps.shape[0]]
        if next_ns < stamp:
            return next_ns, ring_rank
    return stamp, rank


@kernel
def is_before(stamp: int, rank: int, until_ns: int, until_rank: int) -> bool:
    """Whether (stamp, rank) stands before (until_ns, until_rank) in the total order."""
    return stamp < until_ns or (stamp == until_ns and rank < until_rank)
