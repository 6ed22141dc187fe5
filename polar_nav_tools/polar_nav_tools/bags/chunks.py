"""Content of MCAP chunks: decompression within bounds, and the records inside.

All input may be damaged: lengths are checked before memory is allocated, and the only error is
`Damage`.
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable, Collection, Iterator
from typing import NamedTuple

import lz4.frame
import zstandard

from .checksum import crc32

MAX_CHUNK_BYTES = 256 * 1024 * 1024
"""Largest chunk that is read; recorders close theirs at one or a few megabytes."""
CHUNK_FRONT = 128
"""Number of bytes of a chunk record's body that contain all fields before its data."""
COMPRESSIONS = ('', 'lz4', 'zstd')

OP_SCHEMA, OP_CHANNEL, OP_MESSAGE = 0x03, 0x04, 0x05
OP_CHUNK, OP_MESSAGE_INDEX, OP_CHUNK_INDEX = 0x06, 0x07, 0x08
HEADER = struct.Struct('<BQ')
"""Opcode and length before each record."""
MESSAGE = struct.Struct('<BQHIQQ')
"""A message record up to its data: opcode, length, channel, sequence, log and publish time."""
FRONT = struct.Struct('<BQH')
"""The same up to the channel."""
_MESSAGE_FIXED = MESSAGE.size - HEADER.size
_MESSAGE_INDEX = struct.Struct('<BQHI')  # opcode, length, channel, number of bytes that follow
_LEAST_INDEX = 6  # bytes of a message index without entries
_CHUNK = struct.Struct('<QQQII')  # up to the length of the compression's name
_U16 = struct.Struct('<H')
_U32 = struct.Struct('<I')
_U64 = struct.Struct('<Q')


class Damage(Exception):
    """Damaged bytes; the text states the defect as part of a sentence."""


class ChunkHead(NamedTuple):
    """A chunk record without its data."""

    start_ns: int
    stop_ns: int
    size: int  # uncompressed bytes
    crc: int  # of the uncompressed bytes, 0: none
    compression: str
    data_at: int  # where the data starts in the record's body
    data_size: int


class Reader:
    """Reads the fields of a record's body in order, with every length checked."""

    def __init__(self, body: bytes) -> None:
        self._body = body
        self._at = 0

    @property
    def at(self) -> int:
        """Number of bytes read so far."""
        return self._at

    @property
    def left(self) -> int:
        """Number of bytes not yet read."""
        return len(self._body) - self._at

    def take(self, size: int) -> bytes:
        """Return the next bytes."""
        if size > self.left:
            raise Damage('a field is longer than its record')
        self._at += size
        return self._body[self._at - size : self._at]

    def u16(self) -> int:
        """Return the next 2-byte number."""
        return int(_U16.unpack(self.take(2))[0])

    def u32(self) -> int:
        """Return the next 4-byte number."""
        return int(_U32.unpack(self.take(4))[0])

    def u64(self) -> int:
        """Return the next 8-byte number."""
        return int(_U64.unpack(self.take(8))[0])

    def text(self) -> str:
        """Return the next string."""
        return _decoded(self.take(self.u32()))

    def text_map(self) -> dict[str, str]:
        """Return the next map of strings."""
        inner = Reader(self.take(self.u32()))
        found = {}
        while inner.left:
            key = inner.text()
            found[key] = inner.text()
        return found


def whole_indices(view: memoryview) -> int:
    """Number of bytes of whole message and chunk indices at the front of a view.

    Returns
    -------
    int
        Bytes of the whole indices.

    Raises
    ------
    Damage
        If the first one is not whole.
    """
    unpack, header = _MESSAGE_INDEX.unpack_from, HEADER.size
    at, last = 0, len(view) - _MESSAGE_INDEX.size
    while at <= last:
        opcode, length, _, size = unpack(view, at)
        end = at + header + length
        if end > len(view) or opcode not in (OP_MESSAGE_INDEX, OP_CHUNK_INDEX):
            break
        if opcode == OP_MESSAGE_INDEX and (size != length - _LEAST_INDEX or size % 16):
            break
        at = end
    if at:
        return at
    opcode, length = HEADER.unpack_from(view)
    if opcode == OP_CHUNK_INDEX:
        return int(header + length)
    if length < _LEAST_INDEX:
        raise Damage('a field is longer than its record')
    raise Damage('a message index has a wrong length')


def front_size(compression: str) -> int:
    """Return the bytes of a chunk record's body before its data."""
    return _CHUNK.size + len(compression.encode()) + _U64.size


def read_chunk_head(front: bytes, length: int) -> ChunkHead:
    """Return the fields before a chunk's data.

    Parameters
    ----------
    front : bytes
        The first 128 bytes of the record's body, or all if it is shorter.
    length : int
        Length of the whole body.
    """
    if len(front) < _CHUNK.size:
        raise Damage('a field is longer than its record')
    start_ns, stop_ns, size, crc, name_size = _CHUNK.unpack_from(front)
    end = _CHUNK.size + name_size
    if len(front) < end:
        raise Damage('a field is longer than its record')
    compression = _decoded(front[_CHUNK.size : end])
    if len(front) < end + _U64.size:
        raise Damage('a field is longer than its record')
    (data_size,), data_at = _U64.unpack_from(front, end), end + _U64.size
    if data_at + data_size != length:
        raise Damage('the length of a chunk and of its data do not agree')
    if max(size, data_size) > MAX_CHUNK_BYTES:
        most = max(size, data_size)
        raise Damage(f'a chunk claims {most} bytes (at most {MAX_CHUNK_BYTES} are read)')
    return ChunkHead(start_ns, stop_ns, size, crc, compression, data_at, data_size)


def inflate(compression: str, data: bytes | memoryview, size: int, crc: int) -> bytes:
    """Data of a chunk, decompressed to exactly `size` bytes, its checksum compared.

    Memory stays below about twice `size`, whatever length the compressed bytes claim.
    """
    raw = _INFLATE[compression](data, size)
    if len(raw) != size:
        raise Damage(f'a chunk decompresses to {len(raw)} instead of {size} bytes')
    if crc and crc32(raw) != crc:
        raise Damage('the checksum of a chunk does not match')
    return raw


class _Own(threading.local):
    """One decompressor for each thread: making one lasts as long as using it on a small chunk."""

    def __init__(self) -> None:
        self.zstd = zstandard.ZstdDecompressor()


_OWN = _Own()


def _inflate_zstd(data: bytes | memoryview, size: int) -> bytes:
    try:
        claimed = zstandard.frame_content_size(data)
        if claimed not in (-1, size):
            raise Damage(f'compressed data claims {claimed} instead of {size} bytes')
        return _OWN.zstd.decompress(data, max_output_size=size)
    except zstandard.ZstdError as error:
        raise Damage(f'a chunk cannot be decompressed ({error})') from error


def _inflate_lz4(data: bytes | memoryview, size: int) -> bytes:
    try:
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size))
    except RuntimeError as error:
        raise Damage(f'a chunk cannot be decompressed ({error})') from error


_INFLATE: dict[str, Callable[[bytes | memoryview, int], bytes]] = {
    '': lambda data, _: bytes(data),
    'lz4': _inflate_lz4,
    'zstd': _inflate_zstd,
}


class RawMessage(NamedTuple):
    """One message record."""

    channel: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    data: bytes


def messages(block: bytes, size: int) -> Iterator[RawMessage]:
    """Yield the messages among the first `size` bytes of records that `check_block` accepted."""
    unpack, skip = MESSAGE.unpack_from, HEADER.unpack_from
    at = 0
    while at < size:
        if block[at] != OP_MESSAGE:
            at += HEADER.size + skip(block, at)[1]
            continue
        _, length, channel, sequence, log_time, publish_time = unpack(block, at)
        end = at + HEADER.size + length
        yield RawMessage(channel, sequence, log_time, publish_time, block[at + MESSAGE.size : end])
        at = end


def payloads(block: bytes, size: int, channels: Collection[int]) -> Iterator[bytes]:
    """Yield the data of the messages of some channels, without times and numbers."""
    unpack, skip, start = FRONT.unpack_from, HEADER.unpack_from, MESSAGE.size
    at = 0
    while at < size:
        if block[at] != OP_MESSAGE:
            at += HEADER.size + skip(block, at)[1]
            continue
        _, length, channel = unpack(block, at)
        end = at + HEADER.size + length
        if channel in channels:
            yield block[at + start : end]
        at = end


def walk(
    block: bytes,
    on_message: Callable[[int, int, int], None],
    on_other: Callable[[int, bytes], None],
) -> int:
    """Number of bytes of whole records in a decompressed chunk, each passed to a callback.

    Parameters
    ----------
    block : bytes
        Uncompressed content.
    on_message : callable
        Called with channel, sequence and log time of each message.
    on_other : callable
        Called with opcode and body of each other record; may raise Damage.

    Returns
    -------
    int
        Number of bytes up to which records are whole: ``len(block)`` unless it is damaged.
    """
    unpack, size = MESSAGE.unpack_from, len(block)
    at = 0
    while at < size:
        if size - at < HEADER.size:
            return at
        if block[at] == OP_MESSAGE:
            if size - at < MESSAGE.size:
                return at
            _, length, channel, sequence, log_time, _ = unpack(block, at)
            end = at + HEADER.size + length
            if length < _MESSAGE_FIXED or end > size:
                return at
            on_message(channel, sequence, log_time)
        else:
            end = other(block, at, on_other)
            if end is None:
                return at
        at = end
    return size


def other(block: bytes, at: int, on_other: Callable[[int, bytes], None]) -> int | None:
    """End of a record that is no message, after its callback; None if it is not whole."""
    if len(block) - at < HEADER.size:
        return None
    opcode, length = HEADER.unpack_from(block, at)
    end = at + HEADER.size + int(length)
    if end > len(block):
        return None
    try:
        on_other(opcode, block[at + HEADER.size : end])
    except Damage:
        return None
    return end


def _decoded(data: bytes) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise Damage('a text is not UTF-8') from error
