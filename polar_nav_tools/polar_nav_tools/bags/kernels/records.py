"""Message records of an MCAP block: counted, and fields of messages of one layout taken out.

A block is a decompressed chunk. Its bytes may be anything: every length is compared with what is
left before a byte is read, and nothing is written outside of the rows that the caller gave. The
callers are polar_nav_tools.bags.scan and .tables.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.kernels.cache import entry, kernel, routine

Bytes: TypeAlias = NDArray[np.uint8]
Ints: TypeAlias = NDArray[np.int64]
Int: TypeAlias = int | np.int64

OP_MESSAGE = 0x05
HEADER = 9
"""Bytes of opcode and length before each record."""
FRONT = 31
"""Bytes of a message record before its data: header, channel, sequence, log and publish time."""

COUNT, FIRST_NS, LAST_NS, FIRST_SEQUENCE, LAST_SEQUENCE = range(5)
"""Columns of tallies, unsigned."""

ROWS, CAPACITY, ROOM, SIZE, CHECK, CHECK_END, PART, PART_END = range(8)
"""Columns of tables, one row for each wanted channel.

Rows taken so far, at most, and those that there is room for now; bytes of a message of the
layout, -1 for none; which rows of checks and of parts belong to it.
"""

OFFSET, LENGTH, PLACE = range(3)
"""Columns of checks and parts: place in the message, bytes, place in the template or buffer."""

ODD_TABLE, ODD_ROW, ODD_START, ODD_LENGTH = range(4)
"""Columns of odd: messages of another layout, left to the caller."""

BROKEN = -1
"""Returned for a record that is not whole, or one message more than a table has rows."""


@kernel
def _u8(block: Bytes, at: Int) -> np.int64:
    # An unsigned index: a signed one could count from the end, and would be looked at for that.
    return np.int64(block[np.uint64(at)])


@kernel
def _u16(block: Bytes, at: Int) -> np.int64:
    return _u8(block, at) | _u8(block, at + 1) << 8


@kernel
def _u32(block: Bytes, at: Int) -> np.int64:
    return _u16(block, at) | _u16(block, at + 2) << 16


@kernel
def _i64(block: Bytes, at: Int) -> np.int64:
    return _u32(block, at) | _u32(block, at + 4) << 32


@kernel
def _u64(block: Bytes, at: Int) -> np.uint64:
    return np.uint64(_i64(block, at))


@kernel
def _equal(a: Bytes, at_a: Int, b: Bytes, at_b: Int, length: Int) -> bool:
    """Whether bytes are the same."""
    i = np.int64(0)
    while i + 8 <= length:
        if _i64(a, at_a + i) != _i64(b, at_b + i):
            return False
        i += 8
    while i < length:
        if _u8(a, at_a + i) != _u8(b, at_b + i):
            return False
        i += 1
    return True


@kernel
def _end(block: Bytes, at: Int, size: Int) -> np.int64:
    """Where the record at a place ends; BROKEN when it is not whole."""
    if size - at < HEADER:
        return np.int64(BROKEN)
    length = _u64(block, at + 1)
    if length > np.uint64(size - at - HEADER):
        return np.int64(BROKEN)
    end = at + HEADER + np.int64(length)
    if _u8(block, at) == OP_MESSAGE and end - at < FRONT:
        return np.int64(BROKEN)
    return end


@entry
@routine
def tally(
    block: Bytes,
    start: Int,
    size: Int,
    tallies: NDArray[np.uint64],
    seen: NDArray[np.bool_],
) -> Int:
    """Count messages up to the next record of another kind.

    Parameters
    ----------
    block : (n,) array of uint8
    start, size : int
        Where to begin, and how many bytes of the block there are.
    tallies : (65536, 5) array of uint64
        By channel: COUNT and so on; added to.
    seen : (65536,) array of bool
        Set for every channel that has a message.

    Returns
    -------
    int
        Where it stopped: ``size`` at the end, else the first record that is not a whole message.
    """
    at = np.int64(start)
    while at < size:
        end = _end(block, at, size)
        if end == BROKEN or _u8(block, at) != OP_MESSAGE:
            return at
        channel = _u16(block, at + 9)
        log_time = _u64(block, at + 15)
        sequence = np.uint64(_u32(block, at + 11))
        row = tallies[channel]
        if row[COUNT] == np.uint64(0):
            row[FIRST_NS] = log_time
            row[LAST_NS] = log_time
            row[FIRST_SEQUENCE] = sequence
        elif log_time > row[LAST_NS]:
            row[LAST_NS] = log_time
        elif log_time < row[FIRST_NS]:
            row[FIRST_NS] = log_time
        row[LAST_SEQUENCE] = sequence
        row[COUNT] += np.uint64(1)
        seen[channel] = True
        at = end
    return at


@entry
@routine
def take(
    block: Bytes,
    start: Int,
    size: Int,
    slots: NDArray[np.int16],
    tables: Ints,
    checks: Ints,
    template: Bytes,
    parts: Ints,
    buffer: Bytes,
    words: Ints,
    odd: Ints,
    io: Ints,
) -> Int:
    """Copy wanted bytes of wanted messages to their columns.

    Parameters
    ----------
    block : (n,) array of uint8
    start, size : int
        Where to begin, and how many bytes of the block there are.
    slots : (65536,) array of int16
        Row of tables by channel, -1 for channels that are not wanted.
    tables : (t, 8) array of int64
        ROWS and so on; ROWS is counted up.
    checks : (c, 3) array of int64
        What has to equal the template for a message to have the layout.
    template : (m,) array of uint8
    parts : (p, 3) array of int64
        What is copied: row k of a table goes to PLACE + k LENGTH in the buffer.
    buffer, words : (8 b,) array of uint8, (b,) array of int64
        The same memory.
    odd : (q, 4) array of int64
        Messages of another layout: their rows are counted and left as they are.
    io : (1,) array of int64
        Number of odd messages, counted up.

    Returns
    -------
    int
        Where it stopped: ``size`` at the end, before it when odd is full or a table has no room
        for the next row, or BROKEN.
    """
    at = np.int64(start)
    while at < size:
        end = _end(block, at, size)
        if end == BROKEN:
            return end
        if _u8(block, at) != OP_MESSAGE:
            at = end
            continue
        slot = slots[_u16(block, at + 9)]
        if slot < 0:
            at = end
            continue
        data, length = at + FRONT, end - at - FRONT
        table = tables[slot]
        row = table[ROWS]
        if row >= table[CAPACITY]:
            return np.int64(BROKEN)
        if row >= table[ROOM]:
            return at
        same = length == table[SIZE]
        c = table[CHECK]
        while same and c < table[CHECK_END]:
            check = checks[c]
            same = _equal(block, data + check[OFFSET], template, check[PLACE], check[LENGTH])
            c += 1
        if same:
            for p in range(table[PART], table[PART_END]):
                width = parts[p, LENGTH]
                source, target = data + parts[p, OFFSET], parts[p, PLACE] + row * width
                if width % 8 == 0:  # places are multiples of 8
                    for i in range(width // 8):
                        words[np.uint64(target // 8 + i)] = _i64(block, source + 8 * i)
                else:
                    for i in range(width):
                        buffer[np.uint64(target + i)] = np.uint8(_u8(block, source + i))
        else:
            n = io[0]
            if n >= odd.shape[0]:
                return at
            odd[n, ODD_TABLE] = slot
            odd[n, ODD_ROW] = row
            odd[n, ODD_START] = data
            odd[n, ODD_LENGTH] = length
            io[0] = n + 1
        table[ROWS] = row + 1
        at = end
    return at
