"""Parameters of the recorder: topics, times, files; and the two that are texts to be read."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import NodeParams, choice, flag, param, text, texts
from polar_nav_core.user_files import read_text

from ..bags.mcap_writer import COMPRESSIONS
from ..bags.schemas import normalize


@dataclass(frozen=True)
class RecorderParams(NodeParams):
    """Parameters of `recorder_node`."""

    output: str = text(
        '', 'Directory of the bag, which must not exist (but `resume`); empty: bags/<UTC time>'
    )
    topics: tuple[str, ...] = texts(
        (), 'Topics as name:package/msg/Type; empty: all that are found, except those excluded'
    )
    exclude: tuple[str, ...] = texts(
        ('/rosout', '/parameter_events', '/lockstep/ack'),
        'Topics that are not recorded when found',
    )
    run_info: str = text(
        '', 'What describes the run: a JSON object, or the path of a file with one'
    )
    log_time: str = choice(
        'auto',
        ('auto', 'reception', 'simulation'),
        'Time that messages are filed under; auto: simulation with lockstep or use_sim_time',
    )
    compression: str = choice('zstd', COMPRESSIONS, 'Compression of chunks')
    chunk_bytes: int = param(256 * 1024, 'B', 1024, 64 * 1024 * 1024, 'Size of a chunk')
    flush_period: float = param(0.5, 's', 0.01, 2.0, 'Longest time a message stays in memory')
    resume: bool = flag(
        False, 'Go on in a next file of the bag, where it exists: for a recorder started again'
    )
    max_bag_size: int = param(
        0,
        'B',
        0,
        2**53,
        'A file of about this size is ended, the bag goes on in a next one; 0: never',
    )
    max_bag_duration: float = param(
        0.0, 's', 0.0, 1e7, 'The same for a file with so much log time in it; 0: never'
    )
    sync: bool = flag(False, 'Wait for the disk at each flush, against loss of power')
    quiet_time: float = param(
        0.5, 's', 0.0, 10.0, 'At the end: wait for this long without messages'
    )
    drain_time: float = param(3.0, 's', 0.0, 60.0, 'At the end: but no longer than this')

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lockstep and not self.topics:
            raise ConfigError(
                'parameter topics: empty, but with lockstep it must name every topic (name:type)'
            )
        parse_topics(self.topics)
        parse_run_info(self.run_info)


def parse_topics(texts_: Sequence[str]) -> dict[str, str]:
    """Topic names with their types, from ``/name:package/msg/Type``.

    Raises
    ------
    ConfigError
        Naming the entry that is none.
    """
    found: dict[str, str] = {}
    for entry in texts_:
        name, colon, type_name = entry.partition(':')
        if not colon or not name.startswith('/'):
            raise ConfigError(f'parameter topics: {entry!r} is not /name:package/msg/Type')
        if name in found:
            raise ConfigError(f'parameter topics: {name} is named twice')
        found[name] = normalize(type_name)
    return found


def parse_run_info(given: str) -> dict[str, Any]:
    """JSON object in the parameter, or in the file that it names.

    Raises
    ------
    ConfigError
        If there is no such file or it holds something else.
    """
    if not given:
        return {}
    content, where = given, 'parameter run_info'
    if not given.lstrip().startswith('{'):
        where = f'parameter run_info: file {given}'
        try:
            content = read_text(Path(given))
        except ConfigError as error:
            raise ConfigError(f'{where} cannot be read ({error})') from error
    try:
        info = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f'{where} is not JSON ({error})') from error
    if not isinstance(info, dict):
        raise ConfigError(f'{where} is not a JSON object')
    return info
