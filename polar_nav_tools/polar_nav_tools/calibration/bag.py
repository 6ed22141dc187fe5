"""Calibrates the follower of a bag, of this project or mapped."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.errors import ConfigError
from polar_nav_follower.params import FollowerParams
from polar_nav_ros.adapters.mapping import Mapping as Sources

from ..bags import Bag
from ..foreign.lever import at_the_imu
from ..foreign.load import load
from ..foreign.sources import Source
from ..replay.by_message import parameters
from ..replay.plain import plain_arrays
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
    params : FollowerParams
        As stated.
    recorded : datetime
        Of the first IMU sample, UTC.
    found : Estimated
    lines : tuple of Line
    """

    path: Path
    vehicle: str
    params: FollowerParams
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
        As `plain_arrays`, and for constants that it has no data about.
    """
    arrays = plain_arrays(bag, vehicle, 'calibrated', progress=lambda share: progress(0.2 * share))
    params = parameters(arrays.params, 'default', changes)
    inputs = arrays.inputs(params).inputs
    return _calibrated(
        bag.path, vehicle, params, inputs, wanted, lambda share: progress(0.2 + 0.8 * share)
    )


def calibrate_mapped(
    source: Source,
    mapping: Sources,
    wanted: Wanted,
    *,
    accept: Iterable[str],
    progress: Progress,
) -> Calibration:
    """Calibration of a bag of any origin."""
    loaded = load(source, mapping, accept)
    params = at_the_imu(loaded)  # what is added to a lever arm is the same from anywhere
    if not len(loaded.inputs.imu_stamps_ns):
        raise ConfigError(f'{source.path}: no IMU sample after the start')
    path = Path(source.path)
    return _calibrated(path, mapping.vehicle, params, loaded.inputs, wanted, progress)


def _calibrated(
    path: Path,
    vehicle: str,
    params: FollowerParams,
    inputs: Inputs,
    wanted: Wanted,
    progress: Progress,
) -> Calibration:
    constants = chosen(params, inputs, wanted.only, wanted.also)
    found = estimate(params, inputs, constants, progress=progress)
    recorded = datetime.fromtimestamp(int(inputs.imu_stamps_ns[0]) // 1_000_000_000, UTC)
    return Calibration(path, vehicle, params, recorded, found, lines_of(found))
