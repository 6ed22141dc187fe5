"""Goes through one MCAP file from front to back, whatever its state, and says what is in it.

Comes in: a path. Goes out: `FileScan`: channels with their counts, where the readable blocks of
messages are, metadata, and one sentence for each thing that is wrong. A file that was cut off is
read up to its last whole record; behind a damaged stretch the search goes on for the next intact
chunk. Every checksum the file has is compared here, so that what is read later is known to be
whole *before* anything is made of it.
"""

from __future__ import annotations

import os
import re
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from . import chunks
from .chunks import HEADER, Damage, Reader
from .contents import Block, Channel, FileScan, Tally
from .errors import BagError
from .files import MAGIC, check_magic

if TYPE_CHECKING:
    from .walk import CompiledWalk

Progress = Callable[[int], None]
"""Called with the bytes of the file that were looked at."""

MAX_RECORD_BYTES = 64 * 1024 * 1024
"""Largest single record outside of chunks that is taken into memory."""
_RAW_BLOCK_BYTES = 1 << 20
_PIECE = 1 << 20
_TELL_EVERY_BYTES = 4 << 20
_CHUNK_FRONT = 128
_MAX_SEARCHES = 1000
_COMPILED_FROM = 4 << 20
"""Bytes of a file from which its records are counted by compiled code."""
_COMPILED_BLOCK = 4096
# Opcode, length, three times, checksum, then the compression's name: what a chunk looks like.
_CHUNK_LIKE = re.compile(rb'\x06.{36}(?:\x04\x00\x00\x00zstd|\x03\x00\x00\x00lz4)', re.DOTALL)
_CHUNK_LIKE_BYTES = 45

_OP_HEADER, _OP_FOOTER = 0x01, 0x02
_OP_CHUNK, _OP_MESSAGE_INDEX, _OP_CHUNK_INDEX, _OP_ATTACHMENT = 0x06, 0x07, 0x08, 0x09
_OP_STATISTICS, _OP_METADATA, _OP_DATA_END = 0x0B, 0x0C, 0x0F
_LAST_KNOWN = 0x0F


def scan_file(path: Path, progress: Progress | None = None) -> FileScan:
    """Scan one MCAP file.

    Parameters
    ----------
    path : Path
    progress : callable, optional
        Told every few megabytes how many bytes of the file are behind.

    Raises
    ------
    BagError
        If the file cannot be opened, is empty, or is not MCAP at all.
    """
    try:
        with path.open('rb') as file:
            status = os.fstat(file.fileno())
            check_magic(path, file.read(len(MAGIC)))
            found = _Scanner(path, file, status.st_size).run(progress)
            found.modified_ns = status.st_mtime_ns
            return found
    except OSError as error:
        raise BagError(f'{path}: cannot be read ({error.strerror})') from error


class _Scanner:
    """State of one pass; methods named after the records they take."""

    def __init__(self, path: Path, file: BinaryIO, size: int) -> None:
        self._out = FileScan(path, size)
        self._file = file
        self._size = size
        self._at = len(MAGIC)  # start of the record that is looked at
        self._crc: int | None = zlib.crc32(MAGIC)  # of all bytes before it; None: not to be told
        self._good_end = self._at  # end of the last record that was surely whole
        self._search_from = self._at
        self._summary_at: int | None = None
        self._summary_crc = 0
        self._schemas: dict[int, tuple[str, str, str]] = {}
        self._raw: list[bytes] = []  # message records outside of chunks, waiting to become a block
        self._raw_at = 0
        self._raw_bytes = 0
        self._raw_channels: set[int] = set()
        self._searches = 0
        self._indexed: int | None = None
        self._compiled: CompiledWalk | None = None

    def run(self, progress: Progress | None) -> FileScan:
        told = 0
        while self._at < self._size and not self._out.finished:
            try:
                self._record()
            except Damage as damage:
                if not self._search(str(damage)):
                    break
            if progress is not None and self._at >= told + _TELL_EVERY_BYTES:
                told = self._at
                progress(told)
        self._end_raw_block()
        self._conclude()
        return self._out

    # -- one record

    def _record(self) -> None:
        left = self._size - self._at
        if left < HEADER.size:
            raise Damage('the file ends within a record')
        head = self._file.read(HEADER.size)
        opcode, length = HEADER.unpack(head)
        if length > left - HEADER.size:
            raise Damage('the file ends within a record')
        if opcode == 0 or (opcode > _LAST_KNOWN and length > MAX_RECORD_BYTES):
            raise Damage(f'a record of unknown kind 0x{opcode:02x}')
        crc_before = self._crc
        self._feed(head)
        if opcode == _OP_CHUNK:
            self._chunk(length)
        elif opcode == _OP_ATTACHMENT or opcode > _LAST_KNOWN:
            self._skip(length)
        else:
            if length > MAX_RECORD_BYTES:
                raise Damage(f'a record of {length} bytes')
            body = self._file.read(length)
            if len(body) != length:
                raise Damage('the file ends within a record')
            if opcode == _OP_FOOTER:
                self._footer(body)
            else:
                self._feed(body)
            if opcode in (chunks.OP_SCHEMA, chunks.OP_CHANNEL, chunks.OP_MESSAGE):
                self._plain(opcode, head + body)
            else:
                self._end_raw_block()
                self._small(opcode, body, crc_before)
        self._at += HEADER.size + length
        if opcode <= _LAST_KNOWN:
            self._good_end = self._at

    def _feed(self, data: bytes) -> None:
        if self._crc is not None:
            self._crc = zlib.crc32(data, self._crc)
        if self._summary_at is not None:
            self._summary_crc = zlib.crc32(data, self._summary_crc)

    def _skip(self, length: int) -> None:
        self._end_raw_block()
        while length:
            piece = self._file.read(min(length, _PIECE))
            if not piece:
                raise Damage('the file ends within a record')
            self._feed(piece)
            length -= len(piece)

    def _small(self, opcode: int, body: bytes, crc_before: int | None) -> None:
        fields = Reader(body)
        if opcode == _OP_HEADER:
            self._out.profile, self._out.library = fields.text(), fields.text()
        elif opcode == _OP_METADATA:
            self._out.metadata.append((fields.text(), fields.text_map()))
        elif opcode == _OP_MESSAGE_INDEX:
            fields.u16()
            if fields.u32() != fields.left or fields.left % 16:
                raise Damage('a message index has a wrong length')
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
        """Take the last record; behind it stands the magic, and then nothing."""
        fields = Reader(body)
        summary_at, _ = fields.u64(), fields.u64()
        if self._summary_at is None:
            raise Damage('the end of the file without the end of its data')
        if summary_at not in (0, self._summary_at):
            raise Damage('the footer points to a wrong place')
        crc = zlib.crc32(body[:16], self._summary_crc)
        given = fields.u32()
        if given and given != crc:
            self._problem('the checksum of the index does not match: bytes were changed')
        rest = self._file.read(len(MAGIC) + 1)
        if rest[: len(MAGIC)] != MAGIC:
            raise Damage('the end mark is missing')
        if len(rest) > len(MAGIC):
            self._problem(f'bytes follow behind the end mark at {self._at + 29}')
        self._out.finished = True

    # -- messages

    def _chunk(self, length: int) -> None:
        self._end_raw_block()
        front = self._file.read(min(length, _CHUNK_FRONT))
        head = chunks.read_chunk_head(front, length)
        body_at = self._at + HEADER.size
        self._file.seek(body_at + head.data_at)
        data = self._file.read(head.data_size)
        if len(data) != head.data_size:
            raise Damage('the file ends within a record')
        self._feed(front[: head.data_at])
        self._feed(data)
        if head.compression not in chunks.COMPRESSIONS:
            self._out.unknown_compressions.add(head.compression)
            self._ignore(length, f'a chunk is compressed in a way not known: {head.compression!r}')
            return
        block = Block(
            offset=body_at + head.data_at,
            stored=head.data_size,
            size=head.size,
            usable=head.size,
            compression=head.compression,
            crc=head.crc,
            channels=frozenset(),
        )
        try:
            records = chunks.inflate(head.compression, data, head.size, head.crc)
        except Damage as damage:
            self._ignore(length, str(damage))
            return
        self._take_block(block, records)

    def _plain(self, opcode: int, record: bytes) -> None:
        """Join records that stand outside of chunks to blocks, as if they were chunks."""
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
            crc = zlib.crc32(record, crc)
        channels = frozenset(self._raw_channels)
        self._out.blocks.append(Block(self._raw_at, size, size, size, '', crc, channels))
        self._out.compressions.add('')
        self._out.uncompressed_bytes += size
        self._raw, self._raw_bytes, self._raw_channels = [], 0, set()

    def _take_block(self, block: Block, records: bytes) -> None:
        usable, channels = self._walk(records)
        if usable < len(records):
            self._ignore(len(records) - usable, 'a chunk has records that are not whole')
        self._out.compressions.add(block.compression)
        self._out.uncompressed_bytes += usable
        if channels:
            self._out.blocks.append(
                Block(
                    block.offset,
                    block.stored,
                    block.size,
                    usable,
                    block.compression,
                    block.crc,
                    channels,
                )
            )

    def _walk(self, records: bytes) -> tuple[int, frozenset[int]]:
        if self._size >= _COMPILED_FROM and len(records) >= _COMPILED_BLOCK:
            return self._counted().walk(records, self._declaration)
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

        return chunks.walk(records, on_message, self._declaration), frozenset(seen)

    def _counted(self) -> CompiledWalk:
        if self._compiled is None:
            # Here: the compiler takes a third of a second to load, more than a small bag.
            from .walk import CompiledWalk

            self._compiled = CompiledWalk(self._out.tallies)
        return self._compiled

    def _declaration(self, opcode: int, body: bytes) -> None:
        fields = Reader(body)
        if opcode == chunks.OP_SCHEMA:
            number, schema = fields.u16(), (fields.text(), fields.text(), fields.text())
            if self._schemas.setdefault(number, schema) != schema:
                self._problem(f'schema {number} is {self._schemas[number][0]} and something else')
        elif opcode == chunks.OP_CHANNEL:
            number, schema_number = fields.u16(), fields.u16()
            name, schema_encoding, text = self._schemas.get(schema_number, ('', '', ''))
            topic, encoding = fields.text(), fields.text()
            channel = Channel(topic, name, encoding, schema_encoding, text, fields.text_map())
            if self._out.channels.setdefault(number, channel) != channel:
                self._problem(f'channel {number} is {topic} and something else')

    # -- what is wrong

    def _problem(self, text: str) -> None:
        self._out.problems.append(text)

    def _ignore(self, size: int, why: str) -> None:
        self._out.ignored_bytes += size
        self._crc = None  # it cannot match any more, which would be no news
        self._problem(f'{why}; {size} bytes are ignored')

    def _search(self, why: str) -> bool:
        """Go on at the next intact chunk behind a damaged place; False if there is none."""
        self._end_raw_block()
        start = self._good_end
        found = self._next_chunk(max(start, self._search_from))
        self._at = self._good_end = self._size if found is None else found
        self._search_from = self._at + 1
        self._summary_at = None
        self._ignore(self._at - start, f'{why} (byte {start})')
        return found is not None

    def _next_chunk(self, start: int) -> int | None:
        """Return where the next intact chunk begins, with the file at that place."""
        at = start
        while at < self._size and self._searches < _MAX_SEARCHES:
            self._file.seek(at)
            window = self._file.read(_PIECE + _CHUNK_LIKE_BYTES)
            match = _CHUNK_LIKE.search(window)
            if match is None:
                at += _PIECE
                continue
            at += match.start()
            self._searches += 1
            if self._is_intact_chunk(at):
                self._file.seek(at)
                return at
            at += 1
        return None

    def _is_intact_chunk(self, at: int) -> bool:
        self._file.seek(at)
        _, length = HEADER.unpack(self._file.read(HEADER.size))
        if length > self._size - at - HEADER.size:
            return False
        try:
            head = chunks.read_chunk_head(self._file.read(min(length, _CHUNK_FRONT)), length)
            self._file.seek(at + HEADER.size + head.data_at)
            chunks.inflate(head.compression, self._file.read(head.data_size), head.size, head.crc)
        except Damage:
            return False
        return True

    def _conclude(self) -> None:
        out = self._out
        # Only now: the index repeats the topics whose declaration was in a damaged chunk.
        orphans = sum(out.tallies.pop(c).count for c in set(out.tallies) - set(out.channels))
        if orphans:
            self._problem(f'{orphans} messages belong to no known topic and are ignored')
        indexed = self._indexed if out.finished and not out.ignored_bytes else None
        if indexed is not None and indexed != out.message_count:
            self._problem(f'the index counts {indexed} messages, {out.message_count} can be read')
