"""Whether a recorder may go on in a next file of a bag that is there.

A next file is named after the folder, and takes metadata.yaml away until the bag is finished
again: in a folder of another program, or one that was renamed, that would leave a bag that nobody
reads as one. Nor may it stand in a bag that another recorder is writing: the first to finish would
describe a file of the other that is not complete.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path

from mcap.exceptions import McapError
from mcap.records import Header
from mcap.stream_reader import StreamReader

from .errors import BagError, WrongRequestError
from .files import MAGIC, check_magic, find, in_order
from .mcap_writer import LIBRARY
from .sink import is_written


def require_own(directory: Path) -> None:
    """Refuse a folder whose files are not all of this project's, or where one is being written.

    A file without a readable head passes: a recorder was killed as it began, and is started again.

    Raises
    ------
    WrongRequestError
        With the file that is not.
    """
    others = sorted(p.name for p in directory.glob('*.db3'))
    if others:
        raise WrongRequestError(
            f'{directory}: cannot go on with this bag: {others[0]} is of rosbag2, in sqlite3'
        )
    pattern = re.compile(re.escape(directory.resolve().name) + r'_\d+\.mcap')
    for path in in_order(directory.glob('*.mcap')):
        library = _library(path)
        if library is not None and LIBRARY not in library:
            raise WrongRequestError(
                f'{directory}: cannot go on with this bag: {path.name} was written by '
                f'{library or "another program"}, and only bags of this recorder have a next file'
            )
        if not pattern.fullmatch(path.name):
            raise WrongRequestError(
                f'{directory}: cannot go on with this bag: {path.name} is not named after the '
                'folder, which was renamed; give it back its name'
            )
        if is_written(path):
            raise WrongRequestError(
                f'{directory}: cannot go on with this bag: {path.name} is being written '
                'by another recorder'
            )


def require_bag(directory: Path) -> list[str]:
    """Sentences on files of a bag that were not finished; the bag is one to go on with.

    Raises
    ------
    BagError
        Where there is none, or one of another program, or a file is damaged from its first bytes.
    """
    if not directory.exists():
        raise WrongRequestError(
            f'{directory}: there is no such bag to go on with; without --resume a new one is made'
        )
    if not directory.is_dir():
        raise WrongRequestError(
            f'{directory} is a file; --resume goes on with the folder of a bag'
        )
    require_own(directory)
    find(directory)
    said = []
    for path in in_order(directory.glob('*.mcap')):
        if path.stat().st_size:
            _require_head(path)
        if not _is_finished(path):
            said.append(f'{path.name} was not finished; it stays as it is')
    return said


def _require_head(path: Path) -> None:
    with path.open('rb') as file:
        check_magic(path, file.read(len(MAGIC)))
    if _library(path) is None:
        raise BagError(f'{path} is damaged: it has no head; move it out of the folder')


def _library(path: Path) -> str | None:
    """Program that wrote a file, as its head states it; None without one."""
    try:
        with path.open('rb') as file:
            first = next(iter(StreamReader(file, emit_chunks=True).records), None)
    except OSError as error:
        raise BagError(f'{path}: cannot be read ({error.strerror})') from error
    except (McapError, ValueError, struct.error):
        return None
    return first.library if isinstance(first, Header) else None


def _is_finished(path: Path) -> bool:
    with path.open('rb') as file:
        file.seek(max(0, path.stat().st_size - len(MAGIC)))
        return path.stat().st_size > len(MAGIC) and file.read() == MAGIC
