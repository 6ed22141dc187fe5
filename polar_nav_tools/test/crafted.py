"""MCAP files of any messages, without this project's writer."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mcap.writer import CompressionType, Writer

TEXT = 'uint32 a\n'


def crafted(
    path: Path, messages: Iterable[tuple[int, int, bytes]], channels: int = 1, text: str = TEXT
) -> Path:
    """An MCAP file of one type with messages (channel, log time, bytes)."""
    with path.open('wb') as file:
        writer = Writer(file, compression=CompressionType.ZSTD, chunk_size=16 << 20)
        writer.start('ros2', 'test')
        schema = writer.register_schema('p/msg/T', 'ros2msg', text.encode())
        numbers = [writer.register_channel(f'/t{k}', 'cdr', schema) for k in range(channels)]
        for channel, log_ns, data in messages:
            writer.add_message(numbers[channel], log_ns, data, log_ns)
        writer.finish()
    return path
