"""Contents of an MCAP file by the index at its end, not verified.

In: a path. Out: a `FileScan` as `scan` would return it if the index is right, or None without a
complete index. It serves to prepare a reading, which is used only after the scan has confirmed the
index. Messages read before the scan come from single chunks, each compared with its checksum.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from . import chunks
from .checksum import crc32
from .chunks import HEADER, MESSAGE, Damage, Reader
from .contents import Block, FileScan, Tally
from .declarations import Declarations
from .files import MAGIC

_OP_FOOTER, _OP_STATISTICS = 0x02, 0x0B
_FOOTER = struct.Struct('<BQQQI')
_CHUNK_INDEX = struct.Struct('<16xQQI')  # chunk, its length, bytes of index offsets
_COMPRESSION = struct.Struct('<QI')  # bytes of message indices, of the compression's name
_SIZES = struct.Struct('<QQ')
_COUNT = struct.Struct('<HQ')
_BEFORE_COUNTS = 42  # bytes of statistics
_MOST_BYTES = 256 << 20
NOT_WHOLE = 'a chunk has records that are not whole'
_CRC = Block._fields.index('crc')  # the last field


class ClaimedBlock(Block):
    """A chunk listed in the index and not read yet; its checksum is not known."""

    __slots__ = ()

    def load(self, file: BinaryIO, *, checked: bool = True) -> bytes:  # noqa: ARG002 - always
        """Return the uncompressed records, after a check that they are whole."""
        records = self.inflated(file)
        if chunks.walk(records, lambda *_: None, lambda *_: None) < self.size:
            raise Damage(NOT_WHOLE)
        return records

    @property
    def begin(self) -> int:
        """Offset of the chunk's record."""
        return self.offset - HEADER.size - chunks.front_size(self.compression)

    def inflated(self, file: BinaryIO) -> bytes:
        """Return the uncompressed bytes, after their checksum was compared."""
        chunk_at = self.begin
        file.seek(chunk_at)
        front = file.read(HEADER.size + chunks.CHUNK_FRONT)
        if len(front) < HEADER.size:
            raise Damage('the file ends within a record')
        opcode, length = HEADER.unpack_from(front)
        head = chunks.read_chunk_head(front[HEADER.size :][:length], length)
        place = chunk_at + HEADER.size + head.data_at, head.data_size, head.size
        same = place == (self.offset, self.stored, self.size)
        if opcode != chunks.OP_CHUNK or head.compression != self.compression or not same:
            raise Damage('a chunk differs from its entry in the index')
        file.seek(self.offset)
        return chunks.inflate(head.compression, file.read(head.data_size), head.size, head.crc)


def claimed_by_index(path: Path) -> FileScan | None:
    """Contents of a file by the index at its end; None without a complete index.

    Returns
    -------
    FileScan or None
        None for a file without an index, or with one that is damaged, contradicts itself, or does
        not list the chunks of each topic.
    """
    try:
        with path.open('rb') as file:
            status = os.fstat(file.fileno())
            summary = read_summary(file, status.st_size)
        if summary is None:
            return None
        found = FileScan(path, status.st_size, status.st_mtime_ns, finished=True)
        return found if fill(found, summary) else None
    except (OSError, Damage):
        return None


def agrees(claimed: FileScan, found: FileScan) -> bool:
    """Whether a scan found a whole file with exactly the contents of its index."""
    return (
        found.finished
        and not found.problems
        and (claimed.size, claimed.modified_ns) == (found.size, found.modified_ns)
        and claimed.channels == found.channels
        and _counts(claimed) == _counts(found)
        and [block[:_CRC] for block in claimed.blocks] == [block[:_CRC] for block in found.blocks]
    )


def _counts(file: FileScan) -> dict[int, int]:
    return {number: t.count for number, t in file.tallies.items()}


def read_summary(file: BinaryIO, size: int) -> bytes | None:
    """Return the records between the end of the data and the footer; None without an index."""
    end = size - _FOOTER.size - len(MAGIC)
    if end < 0:
        return None
    file.seek(end)
    last = file.read(_FOOTER.size + len(MAGIC))
    if len(last) < _FOOTER.size + len(MAGIC) or not last.endswith(MAGIC):
        return None
    opcode, length, start, _, crc = _FOOTER.unpack_from(last)
    if opcode != _OP_FOOTER or length != _FOOTER.size - HEADER.size:
        return None
    if not end - _MOST_BYTES <= start < end or not start:
        return None
    file.seek(start)
    summary = file.read(end - start)
    if crc and crc32(last[: _FOOTER.size - 4], crc32(summary)) != crc:
        return None
    return summary


def fill(
    found: FileScan, summary: bytes, entry: Callable[[int, bytes], None] = lambda *_: None
) -> bool:
    """Read the records of an index, each also passed to `entry`; False if it is not complete.

    Raises
    ------
    Damage
        If a record is damaged.
    """
    problems: list[str] = []
    declared = Declarations(problems.append)
    sets: dict[bytes, frozenset[int]] = {}
    counts: dict[int, int] | None = None
    at, size = 0, len(summary)
    while at < size:
        if size - at < HEADER.size:
            return False
        opcode, length = HEADER.unpack_from(summary, at)
        body_at, at = at + HEADER.size, at + HEADER.size + length
        if at > size:
            return False
        body = summary[body_at:at]
        entry(opcode, body)
        if opcode == chunks.OP_CHUNK_INDEX:
            found.blocks.append(_block(body, sets))
        elif opcode == _OP_STATISTICS:
            counts = _claimed_counts(body)
        else:
            declared.take(opcode, body)
    if problems or not counts or set(counts) != frozenset().union(*sets.values()):
        return False
    if sum(counts.values()) * MESSAGE.size > sum(block.size for block in found.blocks):
        return False
    found.channels = declared.channels
    found.tallies = {number: Tally(count) for number, count in counts.items()}
    return set(counts) <= set(found.channels)


def _claimed_counts(body: bytes) -> dict[int, int]:
    fields = Reader(body)
    fields.take(_BEFORE_COUNTS)
    size = fields.u32()
    if size % _COUNT.size:
        raise Damage('the statistics have a wrong length')
    return {number: count for number, count in _COUNT.iter_unpack(fields.take(size)) if count}


def _block(body: bytes, sets: dict[bytes, frozenset[int]]) -> ClaimedBlock:
    """Block of a chunk's entry in an index; `sets` shares equal sets of channels."""
    try:
        chunk_at, length, size = _CHUNK_INDEX.unpack_from(body)
        end = _CHUNK_INDEX.size + size
        places = body[_CHUNK_INDEX.size : end]
        _, size = _COMPRESSION.unpack_from(body, end)
        name_at = end + _COMPRESSION.size
        compression = body[name_at : name_at + size].decode()
        stored, size = _SIZES.unpack_from(body, name_at + size)
    except (struct.error, UnicodeDecodeError) as error:
        raise Damage('a chunk index is not whole') from error
    if len(places) % _COUNT.size:
        raise Damage('a chunk index has a wrong length')
    offset = chunk_at + HEADER.size + chunks.front_size(compression)
    if offset + stored != chunk_at + length:
        raise Damage('the lengths of a chunk do not agree')
    low, high = places[:: _COUNT.size], places[1 :: _COUNT.size]
    key = low + high
    channels = sets.get(key)
    if channels is None:
        channels = sets[key] = frozenset(a | b << 8 for a, b in zip(low, high, strict=True))
    return ClaimedBlock(
        offset=offset,
        stored=stored,
        size=size,
        usable=size,
        compression=compression,
        channels=channels,
        crc=0,
    )
