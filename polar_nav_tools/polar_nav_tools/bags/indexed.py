"""Contents of an MCAP file at an address by its index: what is read of it is verified, no more.

In: a path at an address. Out: a `FileScan` of which the end (the index), the header and the
metadata records were fetched. Its blocks are fetched when they are read, together with those that
are wanted besides; each is compared with its checksum, and once all blocks of a topic were read,
its messages are counted. What nobody reads is neither fetched nor verified.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Sequence, Set
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO

from . import chunks, limits
from .chunks import HEADER, Damage, Reader
from .claims import NOT_WHOLE, ClaimedBlock, fill, read_summary
from .contents import Block, FileScan
from .errors import BagError
from .files import MAGIC, check_magic
from .remote.address import RemotePath
from .remote.copy import Range, SparseCopy
from .scan import COMPILED_FROM, compiled_walk

if TYPE_CHECKING:
    from .walk import CompiledWalk

_OP_HEADER, _OP_METADATA, _OP_METADATA_INDEX = 0x01, 0x0C, 0x0D
_TIMES = struct.Struct('<QQ')
_ENTRY = struct.Struct('<QQQQI')  # of a chunk: times, place, length; bytes of what follows
_LENGTH = struct.Struct('<Q')
_MESSAGE_INDEX = struct.Struct('<BQHI')  # up to its times and offsets
_PLACE = struct.Struct('<HQ')  # of a message index: channel, offset
_FRONT_BYTES = 4096
_MOST_METADATA_BYTES = 4 << 20
_MOST_INDEX_BYTES = 16 << 20


@dataclass
class IndexedScan(FileScan):
    """File that is read by its index.

    Attributes
    ----------
    entries : list of bytes
        What the index says of each block.
    """

    entries: list[bytes] = field(default_factory=list)
    _counts: Counter[int] = field(default_factory=Counter)
    _walked: set[int] = field(default_factory=set)
    _compiled: CompiledWalk | None = None

    @property
    def is_verified(self) -> bool:
        """Whether every byte was read and compared: never."""
        return False

    @property
    def copy(self) -> SparseCopy:
        """What was fetched so far."""
        assert isinstance(self.held, SparseCopy)
        return self.held

    def announce(self, blocks: Sequence[Block]) -> None:
        """Fetch these blocks together, the first of them when it is read."""
        self.copy.plan(_range(b) for b in blocks if isinstance(b, ClaimedBlock))

    def load(self, block: Block, stream: BinaryIO, *, checked: bool) -> bytes:
        """Return the records of a block after a check that they are whole."""
        if not isinstance(block, ClaimedBlock):
            return super().load(block, stream, checked=checked)
        records = block.inflated(stream)
        if block.offset not in self._walked:
            if self._walk(records) < block.size:
                raise Damage(NOT_WHOLE)
            self._walked.add(block.offset)
        return records

    def check_read(self, channels: Set[int]) -> None:
        """Compare the numbers of messages with those of the index.

        Raises
        ------
        BagError
            If they differ.
        """
        if self._compiled is not None:
            self._counts = Counter({n: t.count for n, t in self._compiled.tallies().items()})
        for number in channels & self.channels.keys():
            indexed = self.tallies[number].count if number in self.tallies else 0
            if self._counts[number] != indexed:
                raise BagError(
                    f'{self.path}: the index counts {indexed} messages of '
                    f'{self.channels[number].topic}, {self._counts[number]} are there'
                )

    def _walk(self, records: bytes) -> int:
        """Bytes of whole records, whose messages are counted."""
        if self._compiled is None and self.size >= COMPILED_FROM:
            self._compiled = compiled_walk()
        if self._compiled is not None:
            return self._compiled.walk(records, lambda *_: None)[0]

        def count(channel: int, *_: int) -> None:
            self._counts[channel] += 1

        return chunks.walk(records, count, lambda *_: None)


def indexed_file(path: RemotePath, copy: SparseCopy) -> IndexedScan | None:
    """Contents of a file by its index; None if it must be read whole.

    Raises
    ------
    BagError
        If it cannot be fetched, or is no MCAP file.
    """
    with path.open('rb') as file:
        summary = read_summary(file, copy.found.size)
        if summary is None:
            return None
        found = IndexedScan(path, copy.found.size, finished=True, data_ended=True, held=copy)
        places: list[Range] = []

        def entry(opcode: int, body: bytes) -> None:
            if opcode == chunks.OP_CHUNK_INDEX:
                found.entries.append(body)
            elif opcode == _OP_METADATA_INDEX:
                fields = Reader(body)
                start, length = fields.u64(), fields.u64()
                places.append((start, start + length))

        try:
            if not fill(found, summary, entry):
                return None
            _conclude(found, file, places)
        except Damage:
            return None
    return found


def read_times(file: IndexedScan) -> None:
    """Replace the times of each topic by those of its first and last message.

    Until then they are those of the chunks that hold them.

    Raises
    ------
    BagError
        If they cannot be fetched, or the index is wrong.
    """
    wanted: dict[int, list[Range]] = {}
    try:
        for number in file.tallies:
            outer = [file.entries[i] for i in _outer_blocks(file, number)]
            wanted[number] = [_index_ranges(body)[number] for body in outer]
        file.copy.plan(one for ranges in wanted.values() for one in ranges)
        for number, ranges in wanted.items():
            times = [t for one in ranges for t in _index_times(file.copy, one, number)]
            file.tallies[number].first_ns, file.tallies[number].last_ns = min(times), max(times)
    except (Damage, KeyError, ValueError, struct.error) as error:
        raise BagError(f'{file.path}: its index of messages is damaged') from error


def _conclude(found: IndexedScan, file: BinaryIO, places: Sequence[Range]) -> None:
    """Read the header and the metadata records, and give the topics the times of their chunks."""
    front = found.copy.read(0, len(MAGIC)) if found.size > len(MAGIC) else b''
    check_magic(found.path, front)
    inside = [(a, b) for a, b in places if a < b <= found.size]
    if len(inside) < len(places) or sum(b - a for a, b in inside) > _MOST_METADATA_BYTES:
        raise Damage('the index of metadata is wrong')
    found.copy.plan([(0, min(_FRONT_BYTES, found.size)), *inside])
    opcode, fields = _record(file, len(MAGIC), found.size)
    if opcode == _OP_HEADER:
        found.profile, found.library = fields.text(), fields.text()
    for start, _ in sorted(inside):
        opcode, fields = _record(file, start, found.size)
        if opcode != _OP_METADATA:
            raise Damage('the index of metadata is wrong')
        found.metadata.append((fields.text(), fields.text_map()))
    for block, body in zip(found.blocks, found.entries, strict=True):
        found.compressions.add(block.compression)
        found.uncompressed_bytes += block.size
        start_ns, stop_ns = _TIMES.unpack_from(body)
        for number in block.channels & found.tallies.keys():
            tally = found.tallies[number]
            tally.first_ns = min(tally.first_ns or start_ns, start_ns)
            tally.last_ns = max(tally.last_ns, stop_ns)
    found.unknown_compressions = found.compressions - set(chunks.COMPRESSIONS)
    limits.check_size(str(found.path), found.size, found.uncompressed_bytes)


def _record(file: BinaryIO, at: int, size: int) -> tuple[int, Reader]:
    """Opcode and fields of a record."""
    file.seek(at)
    front = file.read(HEADER.size)
    if len(front) < HEADER.size:
        raise Damage('the file ends within a record')
    opcode, length = HEADER.unpack(front)
    if length > min(size, _MOST_METADATA_BYTES):
        raise Damage(f'a record of {length} bytes')
    return opcode, Reader(file.read(length))


def _range(block: ClaimedBlock) -> Range:
    return block.begin, block.offset + block.stored


def _outer_blocks(file: IndexedScan, number: int) -> list[int]:
    """Numbers of the blocks that may hold the first or the last message of a channel."""
    spans = {
        i: _TIMES.unpack_from(file.entries[i])
        for i, block in enumerate(file.blocks)
        if number in block.channels
    }
    least = min(stop for _, stop in spans.values())
    largest = max(start for start, _ in spans.values())
    return [i for i, (start, stop) in spans.items() if start <= least or stop >= largest]


def _index_ranges(body: bytes) -> dict[int, Range]:
    """Where the message index of each channel of a chunk stands, by the chunk's entry."""
    _, _, chunk_at, length, size = _ENTRY.unpack_from(body)
    end_of_places = _ENTRY.size + size
    (indices,) = _LENGTH.unpack_from(body, end_of_places)
    places = sorted((at, n) for n, at in _PLACE.iter_unpack(body[_ENTRY.size : end_of_places]))
    ends = [*(at for at, _ in places[1:]), chunk_at + length + indices]
    return {n: (at, end) for (at, n), end in zip(places, ends, strict=True)}


def _index_times(copy: SparseCopy, place: Range, number: int) -> list[int]:
    """Log times in a message index [ns]."""
    start, end = place
    if not 0 < end - start <= _MOST_INDEX_BYTES:
        raise Damage('a message index has a wrong length')
    record = copy.read(start, end - start)
    opcode, _, channel, size = _MESSAGE_INDEX.unpack_from(record)
    rows = record[_MESSAGE_INDEX.size :]
    if (opcode, channel, size) != (chunks.OP_MESSAGE_INDEX, number, len(rows)):
        raise Damage('a message index differs from its entry')
    return [log_ns for log_ns, _ in _TIMES.iter_unpack(rows)]
