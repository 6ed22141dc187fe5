"""One topic of an MCAP bag, the messages of all others passed over in compiled code.

A foreign bag is read topic by topic. What stands between the messages of one that is rare, an
IMU's samples mostly, would cost more in Python than everything else.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from polar_nav_tools.bags.kernels import records

from ..bags.columns import Columns, read_columns
from ..bags.decode import store_of
from ..bags.errors import BagError
from ..bags.layout import Layout, layout_of
from ..bags.reader import Bag, blocks_of
from ..bags.tables import read_tables

_AT_ONCE = 4096
_CHANNELS = 1 << 16
_TIMES = struct.Struct('<QQ')
"""Log and publish time: they end where the data of a message begin."""
_NO_LAYOUT = -1
_Ints = NDArray[np.int64]


def topic_records(bag: Bag, topic: str) -> Iterator[tuple[int, bytes]]:
    """Yield (log time [ns], CDR bytes) in the order of the bag.

    Raises
    ------
    BagError
        When the topic is not CDR, or the file is not any more what it was.
    """
    for content, found in _left_over(bag, topic, _NO_LAYOUT, np.zeros(1, dtype=np.int64)):
        for _, _, start, length in found:
            yield _log_ns(content, start), content[start : start + length]


def log_times(bag: Bag, topic: str) -> _Ints:
    """Return the log times of a topic's messages in the order of the bag [ns]; errors as above."""
    out = np.zeros(max(bag.topics[topic].count, 1), dtype=np.int64)
    _, first = next(topic_records(bag, topic))
    # Compiled for all messages as long as the first one, whatever is in them.
    for content, found in _left_over(bag, topic, len(first), out):
        for _, row, start, _ in found:
            out[row] = _log_ns(content, start)
    return out[: bag.topics[topic].count]


def topic_columns(
    bag: Bag, topic: str, fields: Sequence[str], rows: Sequence[tuple[str, ...]]
) -> Columns | None:
    """Read fields of a topic with the compiled reader.

    Parameters
    ----------
    bag : Bag
    topic : str
    fields : sequence of str
    rows : sequence of tuple of str
        Fields that are wanted as one array, shape (n, k), where they stand side by side.

    Returns
    -------
    Columns or None
        By field, or under the first field of a row; None for what that reader does not know, such
        as texts that change.
    """
    channel = bag.channel(topic)
    if not channel.schema_text:
        return None
    _, example = next(topic_records(bag, topic))
    try:
        layout = layout_of(store_of(channel.schema_text, channel.type), channel.type, example)
        if not all(name in layout.leaves for name in fields):
            return None
        joined = [row for row in rows if _side_by_side(layout, row)]
        inside = {name for row in joined for name in row}
        texts = [name for name in fields if layout.leaves[name].is_text]
        single = [name for name in fields if name not in inside and name not in texts]
        if not joined and not single:
            return None
        tables = read_tables(bag, {topic: (*joined, *single)})
        if texts and tables.odd[topic]:
            return None
        columns = dict(tables.columns[topic])
        for name, one in read_columns([example], channel.type, channel.schema_text, texts).items():
            columns[name] = np.full(bag.topics[topic].count, one[0], dtype=object)
    except BagError:
        return None  # the other reader says why, or can
    return columns


def _side_by_side(layout: Layout, names: Sequence[str]) -> bool:
    leaves = [layout.leaves[name] for name in names]
    size = np.dtype(leaves[0].format).itemsize if not leaves[0].is_text else 0
    return size > 0 and all(
        leaf.format == leaves[0].format
        and leaf.count is None
        and leaf.offset == leaves[0].offset + k * size
        for k, leaf in enumerate(leaves)
    )


def _log_ns(content: bytes, start: int) -> int:
    log_ns, _ = _TIMES.unpack_from(content, start - _TIMES.size)
    return int(log_ns)


def _left_over(
    bag: Bag, topic: str, size: int, log_ns: _Ints
) -> Iterator[tuple[bytes, list[list[int]]]]:
    """Write the log times of messages of one size; yield where the others are, block by block.

    Places are rows of slot, number of the message, start and length.
    """
    slots = np.full(_CHANNELS, -1, dtype=np.int16)
    table = np.zeros((1, records.PART_END + 1), dtype=np.int64)
    table[0, [records.CAPACITY, records.ROOM]] = bag.topics[topic].count
    table[0, records.SIZE] = size
    table[0, records.PART_END] = 1
    before_data = np.array([[-_TIMES.size, 8, 0]], dtype=np.int64)
    no_checks = np.zeros((0, 3), dtype=np.int64)
    buffer = log_ns.view(np.uint8)
    left = np.zeros((_AT_ONCE, 4), dtype=np.int64)
    count = np.zeros(1, dtype=np.int64)
    for file in bag.files:
        channels = bag.channels_of(file, [topic])
        slots[:] = -1
        slots[list(channels)] = 0
        for content, usable, _ in blocks_of(file, channels.keys()):
            block, at = np.frombuffer(content, dtype=np.uint8), 0
            while at < usable:
                at = int(
                    records.take(
                        block,
                        at,
                        usable,
                        slots,
                        table,
                        no_checks,
                        buffer,
                        before_data,
                        buffer,
                        log_ns,
                        left,
                        count,
                    )
                )
                if at == records.BROKEN:
                    raise BagError(f'{bag.path} was changed while it was read: {topic}')
                if count[0]:
                    yield content, left[: count[0]].tolist()
                    count[0] = 0
