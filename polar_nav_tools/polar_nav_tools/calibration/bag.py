"""Calibrates the follower of a bag, of this project or mapped."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from polar_nav_core.engine.params import EngineParams
from polar_nav_ros.adapters.mapping import Mapping as Sources

from ..bags import Bag
from ..foreign.recording import Recording, mapped_recording, own_recording
from ..foreign.sources import Source
from .constants import chosen
from .estimate import Estimated, estimate
from .problem import Progress
from .verdicts import Line, correlation, correlations, lines_of, notes, problems


@dataclass(frozen=True)
class Wanted:
    """Constants that are asked for: only these, or these besides the usual ones."""

    only: tuple[str, ...] = ()
    also: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Calibration:
    """Calibration of one recording.

    Attributes
    ----------
    path : Path
    vehicle : str
    params : EngineParams
        As stated.
    recorded : datetime
        Of the first IMU sample, UTC.
    found : Estimated
    lines : tuple of Line
    """

    path: Path
    vehicle: str
    params: EngineParams
    recorded: datetime
    found: Estimated
    lines: tuple[Line, ...]

    @property
    def problems(self) -> list[str]:
        """Sentences on what was not well."""
        return problems(self.found)

    def to_dict(self) -> dict[str, object]:
        """Values for JSON."""
        return {
            'ok': not self.problems,
            'path': str(self.path),
            'vehicle': self.vehicle,
            'recorded': self.recorded.isoformat(),
            'runs': self.found.rounds,
            'constants': [
                {
                    'name': line.constant.name,
                    'add': line.value,
                    'sigma': line.sigma,
                    'unit': line.constant.unit,
                    'prior_sigma': line.constant.prior * line.constant.factor,
                    'verdict': str(line.verdict),
                    'why': line.why,
                    'about': line.constant.doc,
                }
                for line in self.lines
            ],
            'correlation': correlation(self.found).tolist(),
            'correlated': [list(pair) for pair in correlations(self.found)],
            'mean_squared_innovation': {
                name: {'before': before, 'after': after}
                for name, (before, after) in self.found.misfits().items()
            },
            'problems': self.problems,
            'notes': notes(self.found),
        }


def calibrate_bag(
    bag: Bag, vehicle: str, wanted: Wanted, *, changes: Mapping[str, Any], progress: Progress
) -> Calibration:
    """Calibration of a follower's own recording.

    Raises
    ------
    ConfigError
        As `own_recording`, and for constants that it has no data about.
    """
    run = own_recording(
        bag, vehicle, 'calibrated', changes, progress=lambda share: progress(0.2 * share)
    )
    return _calibrated(run, wanted, lambda share: progress(0.2 + 0.8 * share))


def calibrate_mapped(
    source: Source,
    mapping: Sources,
    wanted: Wanted,
    *,
    accept: Iterable[str],
    progress: Progress,
) -> Calibration:
    """Calibration of a bag of any origin; what is added to a lever arm is the same anywhere."""
    return _calibrated(mapped_recording(source, mapping, accept), wanted, progress)


def _calibrated(run: Recording, wanted: Wanted, progress: Progress) -> Calibration:
    constants = chosen(run.params, run.inputs, wanted.only, wanted.also)
    found = estimate(run.params, run.inputs, constants, progress=progress)
    return Calibration(run.path, run.vehicle, run.params, run.recorded, found, lines_of(found))
