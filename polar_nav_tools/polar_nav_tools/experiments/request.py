"""Request for an experiment: its size, and the choices where a paper states no value."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

from polar_nav_core.errors import ConfigError

from .choices import Choices
from .station_choices import StationChoices


@dataclass(frozen=True)
class Size:
    """Number of seeds and duration of the runs."""

    duration_s: float
    seeds: int


@dataclass(frozen=True)
class Request:
    """Request for an experiment; None stands for the experiment's own value.

    Attributes
    ----------
    choices : Choices
        Choices of an experiment on the polar system.
    station : StationChoices
        Choices of an experiment on the system with a station.
    quick : bool
        The experiment's smaller size.
    duration_s, seeds : float, int or None
    columns : sequence of str or None
        Filters by name.
    jobs : int
        Processes of this machine.
    scheduler : str or None
        Address of a Dask scheduler that has the runs made instead.
    resume : bool
        Whether rows that are there already are used.
    recorded : Path or None
        Errors of a real IMU, as `recorded.save_recorded` writes them.
    sensors, periods_s, delays_s : sequences or None
        Values that ablation combines.
    rows : str or None
        Rows by name, of experiments that have them: shell patterns, comma-separated.
    first_seed : int
        First seed of such an experiment; all others begin at 1.
    """

    choices: Choices = field(default_factory=Choices)
    station: StationChoices = field(default_factory=StationChoices)
    quick: bool = False
    duration_s: float | None = None
    seeds: int | None = None
    columns: Sequence[str] | None = None
    jobs: int = 1
    scheduler: str | None = None
    resume: bool = False
    recorded: Path | None = None
    sensors: Sequence[str] | None = None
    periods_s: Sequence[float] | None = None
    delays_s: Sequence[float] | None = None
    rows: str | None = None
    first_seed: int = 1


def rows_matching(patterns: str | None, names: Iterable[str]) -> list[str]:
    """Names that match one of comma-separated shell patterns, in their own order; all for None.

    Raises
    ------
    ConfigError
        For a pattern that matches none.
    """
    known = list(names)
    wanted = [p.strip() for p in (patterns or '*').split(',')]
    for pattern in wanted:
        if not any(fnmatchcase(name, pattern) for name in known):
            raise ConfigError(f'--rows {pattern}: no such row; there are {"; ".join(known)}')
    return [name for name in known if any(fnmatchcase(name, p) for p in wanted)]
