"""Arrays of a bag, made in the same pass that verifies it.

Opening a bag decompresses every byte of it, and so does reading it: a command that is going to
read a bag can do both at once. The wanted fields and the memory for them follow from the index of
the bag, before it is verified (`claims`). The blocks come from the scan, each after its checksum
was compared. The arrays are used only if the whole bag agrees with its index; otherwise they are
dropped, and reading takes a pass of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from polar_nav_core.errors import PolarNavError

from .claims import agrees, claimed_by_index
from .contents import Block, Channel
from .errors import BagError
from .reader import Bag
from .reading import Reading
from .request import ReadAhead, Request
from .scan import Take

Wants = Callable[[Bag], Request | None]
"""Returns the request for a bag of which only the index was read."""


class Ahead:
    """One reading during the opening of a bag.

    Parameters
    ----------
    bag : Bag
        Bag as its indices describe it.
    request : Request
    """

    def __init__(self, bag: Bag, request: Request) -> None:
        self._claimed = bag
        self._request = request
        self._reading: Reading | None = Reading(bag, request)

    def file(self, number: int) -> Take:
        """Callback for the blocks of a file of the bag, or None."""
        wanted = frozenset[int]()
        if self._reading is not None:
            wanted = self._reading.begin(self._claimed.files[number])

        def take(block: Block, content: bytes) -> None:
            if self._reading is None or wanted.isdisjoint(block.channels):
                return
            try:
                self._reading.take(content, block.usable)
            except BagError:
                self._reading = None  # the reading of the bag reports why

        return take

    def of(self, bag: Bag) -> ReadAhead | None:
        """Return the arrays if the opened bag agrees with its indices, else None."""
        if self._reading is None or not same_bag(self._claimed, bag):
            return None
        try:
            return ReadAhead(self._request, self._reading.tables())
        except BagError:
            return None


def same_bag(claimed: Bag, found: Bag) -> bool:
    """Whether the files of a bag are whole and agree with their indices."""
    same = all(agrees(a, b) for a, b in zip(claimed.files, found.files, strict=True))
    return same and _described(claimed) == _described(found)


def _described(bag: Bag) -> dict[str, Channel]:
    """Channels of a file's topics; of several for one topic those of its first type."""
    return {topic: bag.channel(topic) for topic in bag.topics}


def begin(path: Path, paths: Sequence[Path], wants: Wants) -> Ahead | None:
    """Reading of a bag's files during their opening; None if it must follow the opening."""
    claimed = []
    for one in paths:
        found = claimed_by_index(one)
        if found is None:
            return None
        claimed.append(found)
    bag = Bag(path, claimed, ())
    try:
        request = wants(bag)
        return None if request is None else Ahead(bag, request)
    except (PolarNavError, MemoryError):
        return None  # any error: reported, or not met again, when the bag is read
