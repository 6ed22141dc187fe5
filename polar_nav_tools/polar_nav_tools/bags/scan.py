"""Scan of one MCAP file in any state: its contents and problems, every checksum compared.

In: a path. Out: `FileScan`: channels with their counts, the readable blocks of messages, metadata,
and one sentence for each problem. A file that was cut off is read up to its last whole record;
behind a damaged stretch the search goes on for the next intact chunk. Every checksum in the file
is compared here, *before* anything is made of its messages.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from . import chunks, limits
from .checksum import crc32
from .chunks import HEADER, Damage, Reader
from .contents import Block, FileScan, Tally
from .declarations import Declarations
from .errors import BagError
from .files import MAGIC, check_magic
from .search import Search
from .window import Window

if TYPE_CHECKING:
    from .walk import CompiledWalk

Progress = Callable[[int], None]
"""Called with the number of scanned bytes of the file."""
Take = Callable[[Block, bytes], None]
"""Called with each block of messages and its records, after its checksum was compared."""

MAX_RECORD_BYTES = 64 * 1024 * 1024
"""Largest single record outside of chunks that is read into memory [bytes]."""
_RAW_BLOCK_BYTES = 1 << 20
_PIECE = 1 << 20
_REPORT_EVERY_BYTES = 4 << 20
COMPILED_FROM = 4 << 20
"""Size of a file from which its records are counted by compiled code [bytes]."""

_OP_HEADER, _OP_FOOTER = 0x01, 0x02
_OP_ATTACHMENT = 0x09
_OP_STATISTICS, _OP_METADATA, _OP_DATA_END = 0x0B, 0x0C, 0x0F
_LAST_KNOWN = 0x0F


def scan_file(path: Path, progress: Progress | None = None, take: Take | None = None) -> FileScan:
    """Contents and problems of one MCAP file.

    Parameters
    ----------
    path : Path
    progress : callable, optional
        Called every few megabytes with the number of scanned bytes of the file.
    take : callable, optional
        Called with each chunk's block, in order, once it is found whole; the state of the rest of
        the file is not known yet.

    Raises
    ------
    BagError
        If the file cannot be opened, is empty, is not MCAP at all, or decompresses to many times
        its size.
    """
    try:
        with path.open('rb') as file:
            status = os.fstat(file.fileno())
            check_magic(path, file.read(len(MAGIC)))
            found = _Scanner(path, Window(file, status.st_size), take).run(progress)
            found.modified_ns = status.st_mtime_ns
            return found
    except OSError as error:
        raise BagError(f'{path}: cannot be read ({error.strerror})') from error


class _Scanner:
    """State of one pass; methods are named after the records they read."""

    def __init__(self, path: Path, window: Window, take: Take | None) -> None:
        self._out = FileScan(path, window.size)
        self._window = window
        self._size = window.size
        self._take = take
        self._at = len(MAGIC)  # start of the current record
        self._crc: int | None = crc32(MAGIC)  # of all bytes before it; None: not computed any more
        self._good_end = self._at  # end of the last record that was surely whole
        self._search_from = self._at
        self._summary_at: int | None = None
        self._summary_crc = 0
        self._declared = Declarations(self._out.problems.append)
        self._raw: list[bytes] = []  # message records outside of chunks, waiting to become a block
        self._raw_at = 0
        self._raw_bytes = 0
        self._raw_channels: set[int] = set()
        self._search = Search(window)
        self._indexed: int | None = None
        self._claimed = 0  # uncompressed bytes that chunks state
        self._compiled = compiled_walk() if self._size >= COMPILED_FROM else None

    def run(self, progress: Progress | None) -> FileScan:
        reported = 0
        while self._at < self._size and not self._out.finished:
            try:
                self._record()
            except Damage as damage:
                if not self._go_on(str(damage)):
                    break
            if progress is not None and self._at >= reported + _REPORT_EVERY_BYTES:
                reported = self._at
                progress(reported)
        self._end_raw_block()
        self._conclude()
        return self._out

    # -- one record

    def _record(self) -> None:
        left = self._size - self._at
        if left < HEADER.size:
            raise Damage('the file ends within a record')
        # A little more than the header: the front of a chunk is read next.
        front = self._window.get(self._at, min(left, HEADER.size + chunks.CHUNK_FRONT))
        opcode, length = HEADER.unpack(self._enough(front, HEADER.size))
        if length > left - HEADER.size:
            raise Damage('the file ends within a record')
        if opcode == 0 or (opcode > _LAST_KNOWN and length > MAX_RECORD_BYTES):
            raise Damage(f'a record of unknown kind 0x{opcode:02x}')
        size = HEADER.size + length
        if opcode == chunks.OP_CHUNK:
            self._chunk(front[HEADER.size :], length)
        elif opcode == _OP_ATTACHMENT or opcode > _LAST_KNOWN:
            self._skip(size)
        elif length > MAX_RECORD_BYTES:
            raise Damage(f'a record of {length} bytes')
        elif opcode in (chunks.OP_MESSAGE_INDEX, chunks.OP_CHUNK_INDEX):
            size = self._indices(size)
        else:
            self._whole(opcode, self._get(self._at, size))
        self._at += size
        if opcode <= _LAST_KNOWN:
            self._good_end = self._at

    def _whole(self, opcode: int, record: memoryview) -> None:
        """Read a record that is small enough to be read as a whole."""
        crc_before, body = self._crc, bytes(record[HEADER.size :])
        if opcode == _OP_FOOTER:
            self._feed(record[: HEADER.size])
            self._footer(body)
        else:
            self._feed(record)
        if opcode in (chunks.OP_SCHEMA, chunks.OP_CHANNEL, chunks.OP_MESSAGE):
            self._plain(opcode, bytes(record))
        else:
            self._end_raw_block()
            self._small(opcode, body, crc_before)

    def _indices(self, size: int) -> int:
        """Number of bytes of the consecutive indices at this offset, which are checked."""
        self._end_raw_block()
        self._get(self._at, size)
        held = self._window.held(self._at)
        whole = chunks.whole_indices(held)
        self._feed(held[:whole])
        return whole

    def _get(self, at: int, size: int) -> memoryview:
        return self._enough(self._window.get(at, size), size)

    def _enough(self, view: memoryview, size: int) -> memoryview:
        if len(view) < size:
            raise Damage('the file ends within a record')
        return view[:size]

    def _feed(self, data: memoryview) -> None:
        if self._crc is not None:
            self._crc = crc32(data, self._crc)
        if self._summary_at is not None:
            self._summary_crc = crc32(data, self._summary_crc)

    def _skip(self, size: int) -> None:
        self._end_raw_block()
        for at in range(0, size, _PIECE):
            self._feed(self._get(self._at + at, min(size - at, _PIECE)))

    def _small(self, opcode: int, body: bytes, crc_before: int | None) -> None:
        fields = Reader(body)
        if opcode == _OP_HEADER:
            self._out.profile, self._out.library = fields.text(), fields.text()
        elif opcode == _OP_METADATA:
            self._out.metadata.append((fields.text(), fields.text_map()))
        elif opcode == _OP_STATISTICS:
            self._indexed = fields.u64()
        elif opcode == _OP_DATA_END:
            self._data_end(fields.u32(), crc_before)

    def _data_end(self, crc: int, crc_before: int | None) -> None:
        if crc and crc_before is not None and crc != crc_before:
            self._problem('the checksum over all data does not match: bytes were changed')
        self._crc = None
        self._out.data_ended = True
        self._summary_at = self._at + HEADER.size + 4

    def _footer(self, body: bytes) -> None:
        """Check the last record; the magic must follow, and then nothing."""
        fields = Reader(body)
        summary_at, _ = fields.u64(), fields.u64()
        if self._summary_at is None:
            raise Damage('the end of the file without the end of its data')
        if summary_at not in (0, self._summary_at):
            raise Damage('the footer points to a wrong place')
        crc = crc32(body[:16], self._summary_crc)
        given = fields.u32()
        if given and given != crc:
            self._problem('the checksum of the index does not match: bytes were changed')
        rest = self._window.get(self._at + HEADER.size + len(body), len(MAGIC) + 1)
        if rest[: len(MAGIC)] != MAGIC:
            raise Damage('the end mark is missing')
        if len(rest) > len(MAGIC):
            self._problem(f'bytes follow behind the end mark at {self._at + 29}')
        self._out.finished = True

    # -- messages

    def _chunk(self, front: memoryview, length: int) -> None:
        self._end_raw_block()
        head = chunks.read_chunk_head(bytes(front[:length]), length)
        self._claimed += head.size
        limits.check_size(str(self._out.path), self._size, self._claimed)
        record = self._get(self._at, HEADER.size + length)
        self._feed(record)
        if head.compression not in chunks.COMPRESSIONS:
            self._out.unknown_compressions.add(head.compression)
            self._ignore(length, f'a chunk is compressed in a way not known: {head.compression!r}')
            return
        data_at = HEADER.size + head.data_at
        try:
            records = chunks.inflate(head.compression, record[data_at:], head.size, head.crc)
        except Damage as damage:
            self._ignore(length, str(damage))
            return
        usable, channels = self._walk(records)
        if usable < len(records):
            self._ignore(len(records) - usable, 'a chunk has records that are not whole')
        self._out.compressions.add(head.compression)
        self._out.uncompressed_bytes += usable
        if not channels:
            return
        block = Block(
            offset=self._at + data_at,
            stored=head.data_size,
            size=head.size,
            usable=usable,
            compression=head.compression,
            channels=channels,
            crc=head.crc,
        )
        self._out.blocks.append(block)
        if self._take is not None:
            self._take(block, records)

    def _plain(self, opcode: int, record: bytes) -> None:
        """Join records outside of chunks to blocks, as if they were chunks."""
        if opcode == chunks.OP_MESSAGE and self._summary_at is not None:
            raise Damage('a message behind the end of the data')
        usable, channels = self._walk(record)
        if usable < len(record):
            raise Damage('a field is longer than its record')
        if opcode == chunks.OP_MESSAGE:
            if not self._raw:
                self._raw_at = self._at
            self._raw_channels |= channels
        elif not self._raw:
            return
        self._raw.append(record)
        self._raw_bytes += len(record)
        if self._raw_bytes >= _RAW_BLOCK_BYTES:
            self._end_raw_block()

    def _end_raw_block(self) -> None:
        if not self._raw:
            return
        size = self._raw_bytes
        crc = 0
        for record in self._raw:
            crc = crc32(record, crc)
        channels = frozenset(self._raw_channels)
        self._out.blocks.append(Block(self._raw_at, size, size, size, '', channels, crc))
        self._out.compressions.add('')
        self._out.uncompressed_bytes += size
        self._raw, self._raw_bytes, self._raw_channels = [], 0, set()

    def _walk(self, records: bytes) -> tuple[int, frozenset[int]]:
        if self._compiled is not None:
            return self._compiled.walk(records, self._declared.take)
        tallies, seen = self._out.tallies, set()

        def on_message(channel: int, sequence: int, log_time: int) -> None:
            tally = tallies.get(channel)
            if tally is None:
                tally = tallies[channel] = Tally()
            if tally.count == 0:
                tally.first_ns = tally.last_ns = log_time
                tally.first_sequence = sequence
            elif log_time > tally.last_ns:
                tally.last_ns = log_time
            elif log_time < tally.first_ns:
                tally.first_ns = log_time
            tally.last_sequence = sequence
            tally.count += 1
            seen.add(channel)

        return chunks.walk(records, on_message, self._declared.take), frozenset(seen)

    # -- what is wrong

    def _problem(self, text: str) -> None:
        self._out.problems.append(text)

    def _ignore(self, size: int, why: str) -> None:
        self._out.ignored_bytes += size
        self._crc = None  # it cannot match any more, which the damage explains
        self._problem(f'{why}; {size} bytes are ignored')

    def _go_on(self, why: str) -> bool:
        """Continue at the next intact chunk behind a damaged stretch; False if there is none."""
        self._end_raw_block()
        start = self._good_end
        found = self._search.next_chunk(max(start, self._search_from))
        self._at = self._good_end = self._size if found is None else found
        self._search_from = self._at + 1
        self._summary_at = None
        self._ignore(self._at - start, f'{why} (byte {start})')
        return found is not None

    def _conclude(self) -> None:
        out = self._out
        out.channels = self._declared.channels
        if self._compiled is not None:
            out.tallies = self._compiled.tallies()
        # Only now: the index repeats the topics whose declaration was in a damaged chunk.
        orphans = sum(out.tallies.pop(c).count for c in set(out.tallies) - set(out.channels))
        if orphans:
            self._problem(f'{orphans} messages belong to no known topic and are ignored')
        indexed = self._indexed if out.finished and not out.ignored_bytes else None
        if indexed is not None and indexed != out.message_count:
            self._problem(f'the index counts {indexed} messages, {out.message_count} can be read')


def compiled_walk() -> CompiledWalk:
    """Return a counter of records for large files."""
    """Return a counter of records for large files."""
    # Imported here: the compiler loads for a third of a second, longer than a small bag.
    from .walk import CompiledWalk

    return CompiledWalk()
