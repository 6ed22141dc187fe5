"""What a user asks of an experiment: its size, and the numbers that a paper leaves open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from .choices import Choices
from .station_choices import StationChoices


@dataclass(frozen=True)
class Size:
    """How much is run."""

    duration_s: float
    seeds: int


@dataclass(frozen=True)
class Request:
    """What was asked for; None stands for the experiment's own.

    Attributes
    ----------
    choices : Choices
        Of an experiment on the polar system.
    station : StationChoices
        Of one on the system with a station.
    quick : bool
        The experiment's smaller size.
    duration_s, seeds : float, int or None
    columns : sequence of str or None
        Filters by name.
    jobs : int
        Processes.
    recorded : Path or None
        Errors of a real IMU, as `recorded.save_recorded` writes them.
    sensors, periods_s, delays_s : sequences or None
        What ablation crosses.
    rows : str or None
        Faults of mismatch by name: shell patterns, comma-separated.
    first_seed : int
        Of mismatch; all others begin at 1.
    """

    choices: Choices = field(default_factory=Choices)
    station: StationChoices = field(default_factory=StationChoices)
    quick: bool = False
    duration_s: float | None = None
    seeds: int | None = None
    columns: Sequence[str] | None = None
    jobs: int = 1
    recorded: Path | None = None
    sensors: Sequence[str] | None = None
    periods_s: Sequence[float] | None = None
    delays_s: Sequence[float] | None = None
    rows: str | None = None
    first_seed: int = 1
