"""Opened bags: their files, verified, and sentences about missing parts.

With `ahead`, the requested arrays of a bag are made in the same pass.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from polar_nav_core.errors import PolarNavError

from . import files
from .contents import FileScan
from .errors import BagError
from .indexed import indexed_file
from .reader import Bag, listed
from .remote.address import RemotePath, bag_path
from .scan import scan_file

if TYPE_CHECKING:
    from .ahead import Ahead, Wants

Progress = Callable[[float], None]
"""Called with the share of a bag that was scanned."""


def open_bag(
    path: str | Path,
    progress: Progress | None = None,
    *,
    ahead: Wants | None = None,
    whole: bool = False,
) -> Bag:
    """Bag of a directory or an .mcap file, opened and verified.

    One at an address (``s3://``, ``https://``) is opened by its index, and what is read of it
    later is verified then; without an index it is fetched and verified whole.

    Parameters
    ----------
    path : Path
    progress : callable, optional
        Called with the scanned share of the bag; every checksum of it is compared, so that a
        bag of gigabytes takes seconds.
    ahead : callable, optional
        Returns the request for the later reading of the bag (see `ahead`). It is read in the same
        pass if possible, and `read_tables` then returns it at once for the same request. At an
        address its topics are fetched together.
    whole : bool
        Fetch and verify all of a bag at an address.

    Raises
    ------
    BagError
        If nothing can be read: no such file, a directory without a bag, not an MCAP file,
        empty, no message in it, compressed in an unknown way.
    """
    path = bag_path(path)
    listing = files.find(path)
    if isinstance(path, RemotePath):
        reading = None
        bag = _at_address(path, listing, progress, whole=whole)
    else:
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
    elif ahead is not None and not bag.is_verified:
        _announce(bag, ahead)
    return bag


def _at_address(
    path: Path, listing: files.Listing, progress: Progress | None, *, whole: bool
) -> Bag:
    """Bag at an address, by the index of each file that has one unless all is wanted."""
    scans: list[FileScan] = []
    remarks = []
    for number, one in enumerate(listing.paths):
        assert isinstance(one, RemotePath)
        copy = one.copy_here()
        found: FileScan | None = None if whole else indexed_file(one, copy)
        if found is None:
            if not whole:
                size = copy.found.size
                remarks.append(f'{one}: has no whole index; all its {size} bytes are read')
            copy.plan_all()
            part = _part(progress, number, len(listing.paths))
            (found,) = _scanned(files.Listing([one]), part, None)
            found.held = copy
        scans.append(found)
        if progress is not None:
            progress((number + 1) / len(listing.paths))
    bag = Bag(path, scans, listing.problems)
    bag.remarks = tuple(remarks)
    return bag


def _part(progress: Progress | None, number: int, count: int) -> Progress | None:
    """Progress of one of several files as that of all."""
    if progress is None:
        return None
    return lambda share: progress((number + share) / count)


def _announce(bag: Bag, wants: Wants) -> None:
    """Tell a bag at an address which topics are going to be read."""
    try:
        request = wants(bag)
    except PolarNavError:
        return  # reported, or not met again, when the bag is read
    if request is not None:
        bag.announce([*request.wanted, *request.raw])


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
