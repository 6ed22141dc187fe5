"""Values in the place of some of those of a mission's file."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from polar_nav_core.errors import ConfigError
from polar_nav_core.user_files import parse_yaml


def overrides_from(texts: Sequence[str]) -> dict[str, Any]:
    """Overrides from texts like ``path.speed_mps=2.0``.

    Raises
    ------
    ConfigError
        Naming the text.
    """
    out: dict[str, Any] = {}
    for text in texts:
        key, sign, value = text.partition('=')
        if not sign or not key.strip():
            raise ConfigError(f'override {text!r} is not of the form key=value')
        out[key.strip()] = parse_yaml(value, f'override {text!r}')
    return out


def overridden(
    document: Mapping[str, Any], overrides: Mapping[str, Any], file: Path
) -> dict[str, Any]:
    """Content of a file with other values, e.g. ``{'vehicles.follower.depth_m': 50.0}``.

    Raises
    ------
    ConfigError
        For a key whose section is none in the file.
    """
    out = copy.deepcopy(dict(document))
    for dotted, value in overrides.items():
        section = out
        *parents, last = dotted.split('.')
        for key in parents:
            section = section.setdefault(key, {})
            if not isinstance(section, dict):
                raise ConfigError(f'{file}: {dotted}: {key} is not a section')
        section[last] = value
    return out
