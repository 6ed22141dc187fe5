"""Offsets of the fields of a CDR message, found by walking through one message.

CDR (XCDR1, what ROS 2 sends) aligns each number to its size, counted from the end of the 4-byte
encapsulation. All offsets depend only on the lengths of strings and sequences; so two
messages of one type with the same lengths have the same layout, and NumPy can read all of them at
once. `Layout.lengths` are the places to compare.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from .decode import fields_of
from .errors import BagError

ENCAPSULATION = 4
_FORMATS = {
    'bool': 'u1',
    'byte': 'u1',
    'char': 'u1',
    'octet': 'u1',
    'int8': 'i1',
    'uint8': 'u1',
    'int16': 'i2',
    'uint16': 'u2',
    'int32': 'i4',
    'uint32': 'u4',
    'int64': 'i8',
    'uint64': 'u8',
    'float32': 'f4',
    'float64': 'f8',
}
_MAX_LEAVES = 20_000


@dataclass(frozen=True)
class Leaf:
    """One number, row of numbers or string of a message.

    Attributes
    ----------
    offset : int
        Its first byte, counted from the start of the message.
    format : str
        NumPy format without byte order: ``f8``, or ``V12`` for a string of 12 bytes.
    count : int or None
        Length of a row of numbers; None for a single one.
    """

    offset: int
    format: str
    count: int | None = None

    @property
    def is_text(self) -> bool:
        """Whether it is a string."""
        return self.format.startswith('V')


@dataclass
class Layout:
    """Layout of all messages that share their lengths with one message.

    Attributes
    ----------
    order : str
        ``<`` or ``>``, byte order of the messages.
    leaves : dict of str to Leaf
        By path: ``header.stamp.sec``, ``velocity.x``, ``beam_unit_vec[2].x``.
    lengths : dict of int to int
        Offsets of string and sequence lengths (4-byte numbers), and these lengths.
    """

    order: str
    leaves: dict[str, Leaf] = field(default_factory=dict)
    lengths: dict[int, int] = field(default_factory=dict)


def byte_order(message: bytes) -> str:
    """Return the byte order that a message's encapsulation states.

    Raises
    ------
    BagError
        If it is not plain CDR.
    """
    if len(message) < ENCAPSULATION:
        raise BagError(f'a message has {len(message)} bytes, less than its encapsulation')
    if message[0] != 0 or message[1] > 1:
        raise BagError(f'a message has encapsulation 0x{message[:2].hex()}, not plain CDR')
    return '<' if message[1] else '>'


def layout_of(store: Typestore, type_name: str, message: bytes) -> Layout:
    """Layout of one message.

    Raises
    ------
    BagError
        If the message ends before its fields do, or has a field of a kind that CDR columns cannot
        hold (wide strings, long doubles).
    """
    walk = _Walk(store, message)
    walk.message(type_name, '')
    return walk.layout


class _Walk:
    def __init__(self, store: Typestore, message: bytes) -> None:
        self.layout = Layout(byte_order(message))
        self._store = store
        self._message = message
        self._at = ENCAPSULATION
        self._endian: Any = 'little' if self.layout.order == '<' else 'big'

    def message(self, type_name: str, prefix: str) -> None:
        for name, (kind, what) in fields_of(self._store, type_name):
            path = f'{prefix}{name}'
            if kind == Nodetype.BASE:
                self._base(path, what[0])
            elif kind == Nodetype.NAME:
                self.message(what, f'{path}.')
            elif kind == Nodetype.ARRAY:
                self._row(path, what[0], what[1])
            else:
                self._row(path, what[0], self._length())

    def _base(self, path: str, name: str) -> None:
        if name == 'string':
            length = self._length()
            # The length counts a closing zero byte, which some writers of empty strings leave out.
            self._leaf(path, Leaf(self._at, f'V{max(length - 1, 0)}'), length)
            return
        form = _format(path, name)
        size = int(form[1:])
        self._align(size)
        self._leaf(path, Leaf(self._at, form), size)

    def _row(self, path: str, element: tuple[Nodetype, Any], count: int) -> None:
        kind, what = element
        if kind == Nodetype.BASE and what[0] != 'string':
            form = _format(path, what[0])
            size = int(form[1:])
            if count:  # an empty sequence has no alignment of its own
                self._align(size)
            self._leaf(path, Leaf(self._at, form, count), size * count)
            return
        if count > _MAX_LEAVES:
            raise BagError(f'{path} has {count} elements')
        for i in range(count):
            if kind == Nodetype.BASE:
                self._base(f'{path}[{i}]', what[0])
            else:
                self.message(what, f'{path}[{i}].')

    def _leaf(self, path: str, leaf: Leaf, size: int) -> None:
        if len(self.layout.leaves) >= _MAX_LEAVES:
            raise BagError(f'a message has more than {_MAX_LEAVES} fields')
        self._at += size
        if self._at > len(self._message):
            raise BagError(f'a message of {len(self._message)} bytes ends before its field {path}')
        self.layout.leaves[path] = leaf

    def _length(self) -> int:
        self._align(4)
        end = self._at + 4
        if end > len(self._message):
            raise BagError(f'a message of {len(self._message)} bytes ends before a length')
        value = int.from_bytes(self._message[self._at : end], self._endian)
        self.layout.lengths[self._at] = value
        self._at = end
        return value

    def _align(self, size: int) -> None:
        self._at += -(self._at - ENCAPSULATION) % size


def _format(path: str, name: str) -> str:
    if name not in _FORMATS:
        raise BagError(f'{path} is a {name}, which cannot become a column')
    return _FORMATS[name]
