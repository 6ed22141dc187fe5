"""Files of a bag: one .mcap file, or those of a rosbag2 directory, finished or not."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

from polar_nav_core.errors import ConfigError
from polar_nav_core.user_files import read_yaml, regular

from .errors import BagError, WrongRequestError
from .remote.address import RemotePath
from .rosbag2_metadata import FILE_NAME, ROOT_KEY

MAGIC = b'\x89MCAP0\r\n'
"""An MCAP file begins and ends with it."""
CONVERT = '`polar replay --map` takes it as it is, rosbags-convert makes an MCAP bag of it'
_SPLIT_NUMBER = re.compile(r'_(\d+)\.mcap$')


@dataclass(frozen=True)
class Listing:
    """Files of a bag in order, count of messages by metadata.yaml (None without it), problems."""

    paths: list[Path]
    message_count: int | None = None
    problems: list[str] = field(default_factory=list)


def find(path: Path, *, again: bool = True) -> Listing:
    """Files of a bag, in order.

    Parameters
    ----------
    path : Path
    again : bool
        Ask the storage even where it was asked before.

    Raises
    ------
    BagError
        If the file does not exist, or a directory has no bag or one of another storage.
    """
    if isinstance(path, RemotePath):
        path.found(again=again)
    try:
        if path.is_dir():
            return _directory(path)
        if not path.exists():
            raise WrongRequestError(f'{path} does not exist')
    except OSError as error:
        raise BagError(f'{path}: cannot be read ({error.strerror})') from error
    if path.name == FILE_NAME:
        return _directory(path.parent)
    try:
        return Listing([regular(path)])
    except ConfigError as error:
        raise BagError(str(error)) from error


def check_magic(path: Path, front: bytes) -> None:
    """Raise BagError for a file that does not begin as MCAP; the text names its kind.

    Raises
    ------
    BagError
        Always, unless it does.
    """
    if front == MAGIC:
        return
    if not front:
        raise BagError(f'{path} is empty (0 bytes)')
    if front.startswith(b'SQLite'):
        raise BagError(f'{path} is an sqlite3 bag, not MCAP; {CONVERT}')
    if front.startswith(b'#ROSBAG'):
        raise BagError(f'{path} is a ROS 1 bag, not MCAP; {CONVERT}')
    if MAGIC.startswith(front):
        raise BagError(f'{path} ends within the first {len(MAGIC)} bytes: nothing was recorded')
    raise BagError(f'{path} is not an MCAP file (it begins with {front!r})')


def _directory(path: Path) -> Listing:
    present = in_order(path.glob('*.mcap'))
    metadata_path = path / FILE_NAME
    if not metadata_path.is_file():
        if present:
            return Listing(present)  # killed while recording; the scan of the files reports it
        if any(path.glob('*.db3')):
            raise BagError(f'{path} is an sqlite3 bag, not MCAP; {CONVERT}')
        raise BagError(f'{path} has no bag in it (neither an .mcap file nor {FILE_NAME})')
    try:
        metadata = _read(metadata_path)
    except BagError as error:
        if not present:
            raise
        return Listing(present, problems=[str(error)])
    _refuse_others(path, metadata)
    named = metadata.get('relative_file_paths')
    named = named if isinstance(named, list) else []
    names = [PurePath(n).name for n in named if isinstance(n, str)]
    missing = [n for n in names if not (path / n).is_file()]
    paths = [path / n for n in names if n not in missing] or present
    if not paths:
        raise BagError(f'{path}: {FILE_NAME} names {", ".join(names) or "no file"}, not there')
    problems = [f'{n}, which {FILE_NAME} names, does not exist' for n in missing]
    count = metadata.get('message_count')
    return Listing(paths, count if isinstance(count, int) else None, problems)


def _read(path: Path) -> dict[str, Any]:
    try:
        content = read_yaml(path)
    except ConfigError as error:
        raise BagError(str(error)) from error
    metadata = content.get(ROOT_KEY) if isinstance(content, dict) else None
    if not isinstance(metadata, dict):
        raise BagError(f'{path} has no {ROOT_KEY}')
    return metadata


def _refuse_others(path: Path, metadata: dict[str, Any]) -> None:
    storage = metadata.get('storage_identifier')
    if storage != 'mcap':
        raise BagError(f'{path} is stored as {storage!r}, not MCAP; {CONVERT}')
    mode = str(metadata.get('compression_mode') or 'none').lower()
    if mode != 'none':
        raise BagError(
            f'{path}: compression mode {mode!r} of rosbag2 is not known here; only chunks '
            'compressed by MCAP itself are'
        )


def in_order(paths: Iterable[Path]) -> list[Path]:
    """Files of a bag by the number at the end of their names."""
    return sorted(paths, key=_split_order)


def _split_order(path: Path) -> tuple[int, str]:
    match = _SPLIT_NUMBER.search(path.name)
    return (int(match[1]) if match else 0, path.name)
