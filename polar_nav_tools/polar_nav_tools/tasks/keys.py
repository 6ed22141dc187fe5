"""Key of a task by its content: what it computes, not when, where or in which order.

A key is a digest of a canonical text of plain values, dataclasses, arrays, files (by their bytes)
and functions (by their names; what they do is the engine's version and the sources, which a row
states beside its key).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from datetime import date
from enum import Enum
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.errors import ConfigError

_DIGITS = 32
"""Hexadecimal digits of a key: 128 bits."""


def key_of(what: str, value: object) -> str:
    """Key of a task: of what is done, the value it is done with, and the engine's version.

    Raises
    ------
    TypeError
        For a value whose content cannot be stated, as of a function defined in another.
    ConfigError
        For a file that cannot be read.
    """
    text = json.dumps([what, ENGINE_VERSION, canonical(value)], separators=(',', ':'))
    return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]


def canonical(value: Any) -> Any:  # noqa: ANN401 - any value of a specification
    """Value in lists and strings that are equal for equal content, and for no other."""
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, Enum):
        return ['enum', _name(type(value)), value.name]
    if isinstance(value, np.generic):
        return canonical(value.item())
    if isinstance(value, int):
        return ['int', str(value)]
    if isinstance(value, float):
        return ['float', value.hex()]
    if isinstance(value, date):  # and datetime, as YAML reads them
        return ['date', value.isoformat()]
    if isinstance(value, bytes):
        return ['bytes', value.hex()]
    if isinstance(value, Path):
        return ['file', _digest_of(value, *_state(value))]
    if isinstance(value, np.ndarray):
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return ['array', value.dtype.str, list(value.shape), digest]
    return _compound(value)


def _compound(value: Any) -> Any:  # noqa: ANN401
    if hasattr(type(value), 'key_content'):
        return ['of', _name(type(value)), canonical(value.key_content())]
    if is_dataclass(value) and not isinstance(value, type):
        held = [[f.name, canonical(getattr(value, f.name))] for f in fields(value)]
        return ['dataclass', _name(type(value)), held]
    if isinstance(value, Mapping):
        pairs = [[canonical(k), canonical(v)] for k, v in value.items()]
        return ['mapping', sorted(pairs, key=json.dumps)]
    if isinstance(value, set | frozenset):
        return ['set', sorted((canonical(v) for v in value), key=json.dumps)]
    if isinstance(value, list | tuple):
        return ['list', [canonical(v) for v in value]]
    if isinstance(value, partial):
        return ['partial', canonical(value.func), canonical(value.args), canonical(value.keywords)]
    if callable(value) and hasattr(value, '__qualname__'):
        return ['function', _name(value)]
    raise TypeError(f'a {_name(type(value))} has no content that a key could state')


def _name(of: Any) -> str:  # noqa: ANN401 - a function or a class
    """Module and name of what can be found by them again."""
    if '<' in of.__qualname__:
        raise TypeError(f'{of.__module__}.{of.__qualname__} has no name that a key could state')
    return f'{of.__module__}.{of.__qualname__}'


def _state(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError as error:
        raise ConfigError(f'{path}: cannot be read ({error.strerror})') from error
    return found.st_mtime_ns, found.st_size


@lru_cache(maxsize=256)
def _digest_of(path: Path, modified_ns: int, size: int) -> str:
    """Digest of a file's bytes; read again when it was modified."""
    del modified_ns, size
    with path.open('rb') as file:
        return hashlib.file_digest(file, 'sha256').hexdigest()
