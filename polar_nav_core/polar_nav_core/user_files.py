"""Files that a user names: read so that no content makes a command hang or fail, or written.

Comes in: the path of a file, or a text. Goes out: plain values, or one sentence on what is wrong.
YAML is looked at event by event before anything is made of it: depth, and the number of values
with every alias counted as often as it is used (a few lines of aliases can stand for 10^9 values).
"""

from __future__ import annotations

import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from .errors import ConfigError

MOST_BYTES = 16 * 1024 * 1024
MOST_VALUES = 300_000
"""A mission has a few hundred; metadata.yaml of a bag about twenty per topic."""
MOST_NESTED = 50
_MOST_BITS = 64
_LOADER: Any = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


class _Once(_LOADER):  # type: ignore[misc]
    """Loader that refuses a key which stands twice: YAML forbids it, and PyYAML takes the last."""

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:  # noqa: ANN401 - as PyYAML's
        """Mapping of a node, as PyYAML makes it."""
        seen: set[tuple[str, str]] = set()
        for key, _ in node.value:
            # What a merge (<<) has brought in stands elsewhere, and may be replaced.
            own = node.start_mark.index <= key.start_mark.index < node.end_mark.index
            if not own or not isinstance(key, yaml.ScalarNode) or key.tag.endswith(':merge'):
                continue
            if (key.tag, key.value) in seen:
                line = key.start_mark.line + 1
                raise yaml.YAMLError(f'key {key.value!r} stands there twice, again in line {line}')
            seen.add((key.tag, key.value))
        return super().construct_mapping(node, deep)


def regular(path: Path) -> Path:
    """Return the path of a regular file.

    Raises
    ------
    ConfigError
        For a pipe, a device or a socket: reading one may wait for ever, or never end. One that
        does not exist, or is a directory, is left to whoever opens it.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return path
    for is_kind, kind in (
        (stat.S_ISFIFO, 'a pipe (FIFO)'),
        (stat.S_ISCHR, 'a device'),
        (stat.S_ISBLK, 'a device'),
        (stat.S_ISSOCK, 'a socket'),
    ):
        if is_kind(mode):
            raise ConfigError(f'{path} is {kind}, not a regular file')
    return path


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Name a file in errors that come while it is written: a full disk has no name of its own."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def read_text(path: Path, most_bytes: int = MOST_BYTES) -> str:
    """Return the text of a UTF-8 file.

    Raises
    ------
    ConfigError
        When it cannot be read, is no regular file, not UTF-8, or larger than `most_bytes`.
    """
    try:
        with regular(path).open('rb') as stream:
            content = stream.read(most_bytes + 1)
    except OSError as error:
        raise ConfigError(f'{path}: {error.strerror or error}') from error
    if len(content) > most_bytes:
        raise ConfigError(f'{path} is larger than {most_bytes} bytes')
    try:
        return content.decode('utf-8')
    except UnicodeDecodeError as error:
        raise ConfigError(f'{path}: not UTF-8 ({error.reason} at byte {error.start})') from error


def read_yaml(path: Path) -> Any:  # noqa: ANN401 - whatever stands in YAML
    """Return what a YAML file says, in plain values.

    Raises
    ------
    ConfigError
        Naming the file.
    """
    return parse_yaml(read_text(path), str(path))


def parse_yaml(text: str, where: str) -> Any:  # noqa: ANN401 - whatever stands in YAML
    """Return what a YAML text says, in plain values.

    Parameters
    ----------
    text : str
    where : str
        What sentences name: a file, an option.

    Raises
    ------
    ConfigError
        When it is no YAML, or has more or deeper values than a file of a user has.
    """
    try:
        _check_events(text, where)
        content = yaml.load(text, Loader=_Once)
    except (yaml.YAMLError, ValueError, OverflowError, TypeError, RecursionError) as error:
        why = _said(error, text)
        if 'integer string conversion' in why:
            why = 'an integer has thousands of digits'
        raise ConfigError(f'{where}: not YAML: {why}') from error
    for value in _integers(content):
        if value.bit_length() > _MOST_BITS:
            raise ConfigError(f'{where}: an integer of {value.bit_length()} bits is too large')
    return content


def _said(error: Exception, text: str) -> str:
    """Sentence on what is wrong with a YAML text, with the line."""
    at = getattr(error, 'problem_mark', None)
    if not isinstance(error, yaml.MarkedYAMLError) or at is None:
        return ' '.join(str(error).split()) or type(error).__name__
    said = f'line {at.line + 1}, column {at.column + 1}: {error.problem}'
    if error.context:
        began = error.context_mark
        said += f' {error.context}' + (f' of line {began.line + 1}' if began is not None else '')
    line = text.splitlines()[at.line : at.line + 1]
    if line and '\t' in line[0][: len(line[0]) - len(line[0].lstrip())]:
        said += '; a tab stands there, and YAML is indented by spaces'
    return said


def _check_events(text: str, where: str) -> None:
    """Refuse what is too deep, too much, or contains itself."""
    sizes: dict[str, int] = {}  # values behind an anchor
    open_nodes: list[tuple[str | None, int]] = []  # anchor, and values before it
    count = 0
    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, yaml.AliasEvent):
            if event.anchor in (name for name, _ in open_nodes):
                raise ConfigError(f'{where}: *{event.anchor} contains itself')
            count += sizes.get(event.anchor or '', 1)
        elif isinstance(event, yaml.CollectionStartEvent):
            open_nodes.append((event.anchor, count))
            count += 1
            if len(open_nodes) > MOST_NESTED:
                raise ConfigError(f'{where}: nested more than {MOST_NESTED} deep')
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = open_nodes.pop()
            if anchor is not None:
                sizes[anchor] = count - before
        elif isinstance(event, yaml.ScalarEvent):
            count += 1
            if event.anchor is not None:
                sizes[event.anchor] = 1
        if count > MOST_VALUES:
            raise ConfigError(f'{where}: more than {MOST_VALUES} values')


def _integers(content: object) -> Iterator[int]:
    """Yield every integer of a value of YAML."""
    if isinstance(content, int):
        yield content
    elif isinstance(content, dict):
        for key, value in content.items():
            yield from _integers(key)
            yield from _integers(value)
    elif isinstance(content, list | tuple | set):
        for value in content:
            yield from _integers(value)
