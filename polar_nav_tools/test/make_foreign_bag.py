"""Makes a long bag of `foreign_worlds`, with a mapping beside it: `--help` says how."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import yaml
from foreign_worlds import (
    Column,
    Recorder,
    aiding_columns,
    imu_column,
    mapping,
    rows_of,
    stamps_of,
    truth_of,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

PART_S = 600.0


def columns_of(
    make: Recorder, hours: float, first_s: float, lever_b: tuple[float, ...]
) -> list[Column]:
    """Ten minutes of everything."""
    truth = truth_of(3600.0 * hours)
    last_s = min(first_s + PART_S, 3600.0 * hours)
    imu = imu_column(make, truth, stamps_of(truth, first_s, last_s, 0.01), lever_b=lever_b)
    return [imu, *aiding_columns(make, truth, first_s, last_s)]


def main() -> None:
    """Write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('out', type=Path, help='folder to make')
    parser.add_argument('--hours', type=float, default=1.0)
    parser.add_argument('--storage', choices=('mcap', 'sqlite3'), default='mcap')
    parser.add_argument('--lever', type=float, nargs=3, default=(0.0, 0.0, 0.0), metavar='M')
    chosen = parser.parse_args()
    make = Recorder()
    plugin = StoragePlugin.MCAP if chosen.storage == 'mcap' else StoragePlugin.SQLITE3
    writer = Writer(chosen.out, version=9, storage_plugin=plugin)
    if plugin is StoragePlugin.MCAP:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        first_s, links = 0.0, {}
        while first_s < 3600.0 * chosen.hours:
            columns = columns_of(make, chosen.hours, first_s, tuple(chosen.lever))
            for c in columns:
                if c.topic not in links:
                    links[c.topic] = writer.add_connection(c.topic, c.kind, typestore=make.store)
            for topic, log_ns, data in rows_of(make, columns):
                writer.write(links[topic], log_ns, data)
            first_s += PART_S
    imu = {'lever_b': [float(v) for v in chosen.lever]}
    path = chosen.out / 'mapping.yaml'
    path.write_text(yaml.safe_dump(mapping(imu), sort_keys=False))
    sys.stdout.write(f'{path}\n')


if __name__ == '__main__':
    main()
