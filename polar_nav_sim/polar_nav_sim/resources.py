"""Paths of the mission and data files of this package, in each kind of installation."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from polar_nav_core.errors import ConfigError

_PACKAGE = Path(__file__).resolve().parent
DATA = _PACKAGE / 'data'
"""Excerpts of real data, each with its licence beside it."""


def missions_folders() -> list[Path]:
    """List the folders that hold missions of the package: source tree, colcon install, venv."""
    roots = [_PACKAGE.parent]
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    roots += [Path(p) / 'share' / 'polar_nav_sim' for p in [*prefixes, sys.prefix] if p]
    return [r / 'missions' for r in roots if (r / 'missions').is_dir()]


def mission_names() -> list[str]:
    """List the names of the missions that come with the package."""
    return sorted({f.stem for folder in missions_folders() for f in folder.glob('*.yaml')})


def find_mission(name_or_path: str | Path) -> Path:
    """Path of a mission file: a path to a file, or the name of one that comes with the package.

    Raises
    ------
    ConfigError
        When there is neither.
    """
    path = Path(name_or_path).expanduser()
    if path.is_file():
        return path.resolve()
    if path.name == str(name_or_path):
        for folder in missions_folders():
            candidate = folder / (path.name if path.suffix == '.yaml' else f'{path.name}.yaml')
            if candidate.is_file():
                return candidate
    known = ', '.join(mission_names())
    raise ConfigError(f'mission {str(name_or_path)!r} is neither a file nor one of {known}')


def find_data(name: str, beside: Path) -> Path:
    """Path of a data file named in ``beside``: relative to that file, or in the package's data.

    Raises
    ------
    ConfigError
        When there is no such file.
    """
    for candidate in (beside.parent / Path(name).expanduser(), DATA / name):
        if candidate.is_file():
            return candidate
    raise ConfigError(f'{beside}: file {name!r} is neither beside it nor in {DATA}')
