"""Content of a campaign's mission: it travels with each run, a worker needs no file of it."""

from __future__ import annotations

import copy
import hashlib
import json
import tempfile
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from polar_nav_core.errors import ConfigError
from polar_nav_core.user_files import read_yaml
from polar_nav_sim.mission import mission_from
from polar_nav_sim.resources import find_mission

_FILES = ('csv', 'sound_speed_profile', 'sources')
"""Keys whose value names a file."""


def document_of(mission: str, file: Path) -> dict[str, Any]:
    """Content of a mission that a campaign's file names, beside that file or in the package.

    Files that the mission names get their full path: other machines need them there.

    Raises
    ------
    ConfigError
        Naming the file and what is wrong in it.
    """
    beside = file.parent / mission
    try:
        path = beside if beside.is_file() else find_mission(mission)
    except ConfigError as error:
        raise ConfigError(f'{file}: mission: {error}') from error
    document: dict[str, Any] = copy.deepcopy(_read(path, path.stat().st_mtime_ns))
    _with_paths(document, path)
    return document


@lru_cache(maxsize=64)
def _read(path: Path, modified_ns: int) -> Any:  # noqa: ANN401 - a mapping, which is checked
    del modified_ns
    document = read_yaml(path)
    mission_from(document, path)
    return document


def _with_paths(values: Any, beside: Path) -> None:  # noqa: ANN401 - a part of a document
    for key, value in values.items() if isinstance(values, dict) else ():
        if key in _FILES and isinstance(value, str):
            path = beside.parent / Path(value).expanduser()
            if path.is_file():
                values[key] = str(path.resolve())
        else:
            _with_paths(value, beside)


def files_of(document: Mapping[str, Any]) -> list[Path]:
    """Files that a mission names by their full path."""
    found = []
    for key, value in document.items():
        if key in _FILES and isinstance(value, str) and Path(value).is_absolute():
            found.append(Path(value))
        elif isinstance(value, Mapping):
            found += files_of(value)
    return found


def as_file(document: Mapping[str, Any]) -> str:
    """Path of a file with this content on this machine; empty for no content."""
    if not document:
        return ''
    text = json.dumps(document, sort_keys=True, default=str)
    return _written(hashlib.sha256(text.encode()).hexdigest()[:16], yaml.safe_dump(dict(document)))


@lru_cache(maxsize=64)
def _written(digest: str, text: str) -> str:
    path = Path(_folder().name) / f'{digest}.yaml'
    path.write_text(text, encoding='utf-8')
    return str(path)


@lru_cache(maxsize=1)
def _folder() -> tempfile.TemporaryDirectory[str]:
    """Folder of this process, gone with it."""
    return tempfile.TemporaryDirectory(prefix='polar-missions-')
