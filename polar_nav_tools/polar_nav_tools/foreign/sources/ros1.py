"""A ROS 1 bag as a source: its messages are turned into CDR."""

from __future__ import annotations

from pathlib import Path

from rosbags.interfaces.typing import Typesdict
from rosbags.rosbag1 import Reader
from rosbags.typesys.store import Typestore

from ...bags.errors import BagError
from ..definitions import Definitions
from .rosbags import RosbagsSource

_MAGIC = b'#ROSBAG V2.0'
_LITTLE_ENDIAN = b'\x00\x01\x00\x00'
_HEADER = 'std_msgs/msg/Header'


class Ros1Source(RosbagsSource):
    """A .bag file of ROS 1.

    Raises
    ------
    BagError
        When it is none, or is damaged.
    """

    kind = 'ROS 1 bag'
    advice = '`rosbag reindex` of ROS 1 makes a new index for what is whole'

    def __init__(self, path: Path, definitions: Definitions | None = None) -> None:
        _check(path)
        super().__init__(path, definitions)

    def reader(self) -> Reader:
        """Return the library's reader, not opened."""
        return Reader(self.path)

    def understood(self, types: Typesdict) -> Typesdict:
        """Return the types with the header of ROS 2.

        It has no `seq`; rosbags leaves that out when it turns the bytes into CDR.
        """
        if _HEADER in types:
            constants, fields = types[_HEADER]
            types[_HEADER] = (constants, [f for f in fields if f[0] != 'seq'])
        return types

    def cdr(self, data: bytes | memoryview, kind: str, store: Typestore) -> bytes:
        """Return the bytes of a message as CDR."""
        return bytes(store.ros1_to_cdr(data, kind))

    def front(self, data: bytes | memoryview) -> bytes:
        """Return a CDR head and the stamp, which follows the number that ROS 1 counts with."""
        return _LITTLE_ENDIAN + bytes(data[4:12])


def _check(path: Path) -> None:
    """Refuse what is no ROS 1 bag at all, which the library takes for one."""
    if not path.is_file():
        raise BagError(f'{path}: no such file')
    try:
        with path.open('rb') as file:
            front = file.read(len(_MAGIC))
    except OSError as error:
        raise BagError(f'{path}: cannot be read ({error.strerror})') from error
    if not front:
        raise BagError(f'{path} is empty (0 bytes)')
    if front != _MAGIC:
        raise BagError(f'{path} is not a ROS 1 bag (it begins with {front!r}, not {_MAGIC!r})')
