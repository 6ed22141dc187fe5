"""Message definitions for bags: text of a type and its dependencies, from the ament index.

In: a type name. Out: the text that MCAP calls ``ros2msg`` (the .msg file, then each
dependency after a line of 80 equal signs and ``MSG: package/Name``), with which any reader can
decode the messages without having the package.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from .errors import BagError

_SEPARATOR = '=' * 80
_PRIMITIVES = frozenset(('bool', 'byte', 'char', 'float32', 'float64', 'string', 'wstring')) | {
    f'{sign}int{bits}' for sign in ('', 'u') for bits in (8, 16, 32, 64)
}
_TYPE = re.compile(r'([A-Za-z]\w*)(?:/msg)?/([A-Za-z]\w*)')
_FIELD_TYPE = re.compile(r'([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?')
_HEADER_FIRST = re.compile(r'std_msgs/(?:msg/)?Header\s+\w')


@dataclass(frozen=True)
class Definition:
    """A message type as a bag describes it.

    Attributes
    ----------
    type : str
        ``package/msg/Name``.
    text : str
        ros2msg text, dependencies included.
    type_hash : str
        RIHS01 hash of the installed package, empty where the package has none.
    has_header : bool
        Whether the first field is a std_msgs/Header, so that the stamp is in bytes 4 to 12.
    """

    type: str
    text: str
    type_hash: str = ''
    has_header: bool = False


def normalize(type_name: str) -> str:
    """Return ``package/msg/Name`` for ``package/Name`` or ``package/msg/Name``.

    Raises
    ------
    BagError
        If it is neither.
    """
    match = _TYPE.fullmatch(type_name)
    if match is None:
        raise BagError(f'{type_name!r} is not a message type; it should be package/msg/Name')
    return f'{match[1]}/msg/{match[2]}'


def starts_with_header(text: str) -> bool:
    """Return whether the first field of a ros2msg text is a std_msgs/Header."""
    for line in _fields(text):
        if '=' not in line.partition('#')[0]:  # else a constant, which no message holds
            return _HEADER_FIRST.match(line) is not None
    return False


@lru_cache(maxsize=256)
def definition(type_name: str) -> Definition:
    """Definition of an installed message type.

    Raises
    ------
    BagError
        If the type or one of its dependencies has no .msg file in any ament prefix.
    """
    root = normalize(type_name)
    return collect(root, installed_prefixes())


def collect(
    type_name: str, prefixes: Sequence[Path], files: Mapping[str, Path] | None = None
) -> Definition:
    """Definition of a message type from given prefixes (each with ``share/<package>/msg``).

    Files by type name, where they are given, win.
    """
    texts: dict[str, str] = {}
    waiting = [(type_name, '')]
    while waiting:
        name, wanted_by = waiting.pop(0)
        if name in texts:
            continue
        given = (files or {}).get(name)
        texts[name] = (
            _read(name, wanted_by, prefixes)
            if given is None
            else given.read_text(encoding='utf-8')
        )
        package = name.split('/')[0]
        waiting += [(d, name) for d in _dependencies(texts[name], package)]
    parts = [texts.pop(type_name)]
    for name, text in texts.items():
        package, _, short = name.split('/')
        parts.append(f'{_SEPARATOR}\nMSG: {package}/{short}\n{text}')
    return Definition(
        type=type_name,
        text='\n'.join(part.rstrip('\n') for part in parts) + '\n',
        type_hash=_type_hash(type_name, prefixes),
        has_header=starts_with_header(parts[0]),
    )


def _fields(text: str) -> Iterator[str]:
    """Lines of a .msg text that declare a field or a constant, up to the first dependency."""
    for raw in text.splitlines():
        line = raw.strip()
        if line == _SEPARATOR:
            return
        if line and not line.startswith('#'):
            yield line


def _dependencies(text: str, package: str) -> list[str]:
    found = []
    for line in _fields(text):
        match = _FIELD_TYPE.match(line)
        if match is None:
            raise BagError(f'a message definition of {package} has no field in line {line!r}')
        name = match[1]
        if name in _PRIMITIVES:
            continue
        found.append(normalize(name if '/' in name else f'{package}/{name}'))
    return found


def _read(name: str, wanted_by: str, prefixes: Sequence[Path]) -> str:
    path = _find(name, '.msg', prefixes)
    if path is None:
        reason = f' (needed by {wanted_by})' if wanted_by else ''
        raise BagError(
            f'no definition of message type {name}{reason}: package {name.split("/")[0]} '
            'is not installed in this environment'
        )
    return path.read_text(encoding='utf-8')


def _type_hash(name: str, prefixes: Sequence[Path]) -> str:
    path = _find(name, '.json', prefixes)
    if path is None:
        return ''
    for entry in json.loads(path.read_text(encoding='utf-8')).get('type_hashes', []):
        if entry.get('type_name') == name:
            return str(entry.get('hash_string', ''))
    return ''


def _find(name: str, suffix: str, prefixes: Sequence[Path]) -> Path | None:
    package, _, short = name.split('/')
    candidates = (p / 'share' / package / 'msg' / f'{short}{suffix}' for p in prefixes)
    return next((c for c in candidates if c.is_file()), None)


def installed_prefixes() -> list[Path]:
    """Ament prefixes: the sourced workspaces, then the Python environment (PyPI wheels)."""
    sourced = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    return [Path(p) for p in (*sourced, sys.prefix) if p]
