"""The MCAP library's writer: made as bags want it, and told of topics that it would drop."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from mcap.writer import CompressionType, IndexType, Writer

from .sink import Sink

LIBRARY = 'polar_nav_tools'
"""What the head of a file names as its writer."""
_COMPRESSIONS = {
    'zstd': CompressionType.ZSTD,
    'lz4': CompressionType.LZ4,
    'none': CompressionType.NONE,
}
COMPRESSIONS = tuple(_COMPRESSIONS)


def make_writer(sink: Sink, compression: str, chunk_bytes: int) -> Writer:
    """Writer of an MCAP file with checksums; ``compression`` is one of `COMPRESSIONS`."""
    return Writer(
        sink,
        chunk_size=chunk_bytes,
        compression=_COMPRESSIONS[compression],
        # There are no attachments; the library would point to an index of none.
        index_types=IndexType.ALL & ~IndexType.ATTACHMENT,
        enable_data_crcs=True,
    )


def declare_silent(writer: Writer, silent: Collection[int]) -> None:
    """Put channels without a message, by their numbers, among the data.

    The library drops a chunk that has declarations only, and would then repeat in its summary
    what stands nowhere else. The metadata record that follows takes these with it.
    """
    library: Any = writer
    schemas, channels = library._Writer__schemas, library._Writer__channels
    written = {0, *(c.schema_id for c in channels.values() if c.id not in silent)}
    for number in silent:
        record = channels[number]
        if record.schema_id not in written:
            schemas[record.schema_id].write(library._Writer__record_builder)
            written.add(record.schema_id)
        record.write(library._Writer__record_builder)
