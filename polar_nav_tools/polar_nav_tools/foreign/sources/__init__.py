"""Opens any bag: MCAP through this project's reader, sqlite3 and ROS 1 through rosbags.

Out: topics with types and counts, and for a topic its columns with the log times. The bytes of
all three kinds end as CDR with a ros2msg definition, so one vectorised decoder reads them all.
"""

from __future__ import annotations

from pathlib import Path

from ...bags.errors import BagError
from ...bags.opening import Progress, open_bag
from ...bags.remote.address import bag_path, is_remote
from ..definitions import Definitions
from .base import Source, Stamps, Table, field_paths, not_described, read_table, require
from .mcap import McapSource
from .ros1 import Ros1Source
from .sqlite import SqliteSource

__all__ = [
    'Source',
    'Stamps',
    'Table',
    'field_paths',
    'not_described',
    'open_source',
    'read_table',
    'require',
]


def open_source(
    path: str | Path,
    progress: Progress | None = None,
    *,
    msg_path: Path | None = None,
    whole: bool = False,
) -> Source:
    """Open a bag: an MCAP file, a rosbag2 folder (MCAP or sqlite3), a .db3 file or a ROS 1 bag.

    Parameters
    ----------
    path : Path
    progress : callable, optional
    msg_path : Path, optional
        Folder with .msg files of types that the bag does not describe.
    whole : bool
        Fetch and verify all of a bag at an address; only MCAP is read there.

    Raises
    ------
    BagError
        When there is no bag, or it cannot be read.
    """
    path = bag_path(path)
    definitions = Definitions(msg_path)
    if is_remote(path):
        if path.suffix in ('.bag', '.db3'):
            raise BagError(f'{path}: only MCAP is read at an address; copy the bag here')
        return McapSource(open_bag(path, progress, whole=whole), definitions)
    if path.suffix == '.bag':
        return Ros1Source(path, definitions)
    if path.suffix == '.db3':
        path = path.parent
    if path.is_dir() and any(path.glob('*.db3')):
        return SqliteSource(path, definitions)
    return McapSource(open_bag(path, progress), definitions)
