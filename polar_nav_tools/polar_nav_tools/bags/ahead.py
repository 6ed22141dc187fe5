"""Makes arrays of a bag in the same pass that verifies it.

Opening a bag decompresses every byte of it, and so does reading it: whoever knows that a bag is
going to be read can have both done at once. What is wanted, and how much memory it takes, is
decided on what the index of the bag claims (`claims`). The blocks come from the scan, each after
its checksum was compared. What came out is given away only when the whole bag was found to be what
its index said; in every other case it is dropped, and reading takes its own pass.
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
"""Told a bag of which only the index was read; answers what is going to be wanted of it."""


class Ahead:
    """One reading that goes along with the opening of a bag.

    Parameters
    ----------
    bag : Bag
        Of what the indices claim.
    request : Request
    """

    def __init__(self, bag: Bag, request: Request) -> None:
        self._claimed = bag
        self._request = request
        self._reading: Reading | None = Reading(bag, request)

    def file(self, number: int) -> Take:
        """Begin with a file of the bag; returns what takes its blocks."""
        wanted = frozenset[int]()
        if self._reading is not None:
            wanted = self._reading.begin(self._claimed.files[number])

        def take(block: Block, content: bytes) -> None:
            if self._reading is None or wanted.isdisjoint(block.channels):
                return
            try:
                self._reading.take(content, block.usable)
            except BagError:
                self._reading = None  # whoever reads the bag is told why

        return take

    def of(self, bag: Bag) -> ReadAhead | None:
        """Return what was read, if the bag that was opened is the one that was claimed."""
        if self._reading is None or not same_bag(self._claimed, bag):
            return None
        try:
            return ReadAhead(self._request, self._reading.tables())
        except BagError:
            return None


def same_bag(claimed: Bag, found: Bag) -> bool:
    """Whether the files of a bag are whole and what their indices claimed."""
    same = all(agrees(a, b) for a, b in zip(claimed.files, found.files, strict=True))
    return same and _described(claimed) == _described(found)


def _described(bag: Bag) -> dict[str, Channel]:
    """Channels that count, where a topic has several."""
    return {topic: bag.channel(topic) for topic in bag.topics}


def begin(path: Path, paths: Sequence[Path], wants: Wants) -> Ahead | None:
    """Prepare a reading of a bag's files; None when it has to wait until the bag is open."""
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
        return None  # whatever it is: said, or not met again, when the bag is read
