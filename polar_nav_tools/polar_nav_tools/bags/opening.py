"""Opened bags: their files, verified, and sentences about missing parts.

With `ahead`, the requested arrays of a bag are made in the same pass.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from . import files
from .contents import FileScan
from .errors import BagError
from .reader import Bag, listed
from .scan import scan_file

if TYPE_CHECKING:
    from .ahead import Ahead, Wants

Progress = Callable[[float], None]
"""Called with the share of a bag that was scanned."""


def open_bag(
    path: str | Path, progress: Progress | None = None, *, ahead: Wants | None = None
) -> Bag:
    """Bag of a directory or an .mcap file, opened and verified.

    Parameters
    ----------
    path : Path
    progress : callable, optional
        Called with the scanned share of the bag; every checksum of it is compared, so that a
        bag of gigabytes takes seconds.
    ahead : callable, optional
        Returns the request for the later reading of the bag (see `ahead`). It is read in the same
        pass if possible, and `read_tables` then returns it at once for the same request.

    Raises
    ------
    BagError
        If nothing can be read: no such file, a directory without a bag, not an MCAP file,
        empty, no message in it, compressed in an unknown way.
    """
    path = Path(path)
    listing = files.find(path)
    reading = None if ahead is None else _begin(path, listing, ahead)
    bag = Bag(path, _scanned(listing, progress, reading), listing.problems)
    if bag.message_count == 0:
        unknown = sorted({c for s in bag.files for c in s.unknown_compressions})
        if unknown:
            raise BagError(
                f'{path}: its chunks are compressed with {listed(unknown)}, which is not known '
                'here; zstd and lz4 are'
            )
        why = f' ({"; ".join(bag.problems)})' if bag.problems else ''
        raise BagError(f'{path} holds no message{why}')
    if listing.message_count is not None and listing.message_count != bag.message_count:
        bag.problems.append(
            f'metadata.yaml counts {listing.message_count} messages, '
            f'{bag.message_count} can be read'
        )
    if reading is not None:
        bag.read_ahead = reading.of(bag)
    return bag


def _begin(path: Path, listing: files.Listing, wants: Wants) -> Ahead | None:
    # Imported here: arrays need the compiler, which loads more slowly than a small bag.
    from .ahead import begin

    return begin(path, listing.paths, wants)


def _scanned(
    listing: files.Listing, progress: Progress | None, reading: Ahead | None
) -> list[FileScan]:
    """Scans of the files of a bag; reports the scanned share of all bytes."""
    sizes = [0] if progress is None else [p.stat().st_size for p in listing.paths]
    total = max(1, sum(sizes))
    scans: list[FileScan] = []

    def report(at: int) -> None:
        if progress is not None:
            progress((sum(sizes[: len(scans)]) + at) / total)

    for number, path in enumerate(listing.paths):
        take = None if reading is None else reading.file(number)
        scans.append(scan_file(path, None if progress is None else report, take))
    if progress is not None:
        progress(1.0)
    return scans
