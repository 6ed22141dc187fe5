"""A whole recording as one run of the engine: of this project, or mapped from any origin."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_ros.adapters.mapping import Mapping as Sources

from ..bags import Bag
from ..replay.by_message import parameters
from ..replay.plain import plain_arrays
from ..series.vehicle import TruthSeries
from .lever import at_the_imu
from .load import load
from .sources import Source

Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Recording:
    """Parameters and inputs of a run of mode sins.

    Attributes
    ----------
    path : Path
    vehicle : str
    stated : EngineParams
        Of base_link.
    params : EngineParams
        The same for the point that the IMU is at.
    inputs : Inputs
        At least one IMU sample.
    truth : TruthSeries or None
        Where there is one and it was asked for.
    imu_lever_b : tuple of float
        From base_link to the IMU [m]; the truth is of base_link.
    """

    path: Path
    vehicle: str
    stated: EngineParams
    params: EngineParams
    inputs: Inputs
    truth: TruthSeries | None = None
    imu_lever_b: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def recorded(self) -> datetime:
        """When it began: of the first IMU sample, UTC."""
        return datetime.fromtimestamp(int(self.inputs.imu_stamps_ns[0]) // 1_000_000_000, UTC)


def own_recording(
    bag: Bag,
    vehicle: str,
    done: str,
    changes: Mapping[str, Any],
    *,
    truth: bool = False,
    progress: Progress | None = None,
) -> Recording:
    """Recording of a follower of this project; ``done`` is what one can do with it.

    Raises
    ------
    ConfigError
        As `plain_arrays`, and without an IMU sample.
    """
    arrays = plain_arrays(bag, vehicle, done, truth=truth, progress=progress)
    params = parameters(arrays.params, 'default', changes)
    inputs = arrays.inputs(params).inputs
    if not len(inputs.imu_stamps_ns):
        raise ConfigError(f'{bag.path}: {vehicle} has no IMU sample')
    return Recording(bag.path, vehicle, params, params, inputs, arrays.truth)


def mapped_recording(source: Source, mapping: Sources, accept: Iterable[str]) -> Recording:
    """Recording of any origin.

    Raises
    ------
    Refused, BagError, ConfigError
        As `load`, and without an IMU sample after the start.
    """
    loaded = load(source, mapping, accept)
    params = at_the_imu(loaded)
    if not len(loaded.inputs.imu_stamps_ns):
        raise ConfigError(f'{source.path}: no IMU sample after the start')
    return Recording(
        Path(source.path),
        mapping.vehicle,
        loaded.params,
        params,
        loaded.inputs,
        loaded.truth,
        mapping.imu.lever_b,
    )


_STREAMS = {
    'imu_stamps_ns': ('omega_ib_b', 'f_b'),
    'dvl_stamps_ns': ('dvl_v_m', 'dvl_covariance_m', 'dvl_valid', 'dvl_water'),
    'depth_stamps_ns': ('depth', 'depth_variance'),
    'control_stamps_ns': ('control_force_b', 'control_torque_b'),
    'heading_stamps_ns': ('headings', 'heading_up_b'),
}
"""Columns beside the stamps of each stream; empty ones are left so."""


def until(inputs: Inputs, last_ns: int) -> Inputs:
    """Inputs up to a stamp, which is left out."""
    changes: dict[str, Any] = {
        'fixes': tuple(f for f in inputs.fixes if f.validity_ns < last_ns),
    }
    for stamps, others in _STREAMS.items():
        count = int(np.searchsorted(getattr(inputs, stamps), last_ns))
        for name in (stamps, *others):
            changes[name] = getattr(inputs, name)[:count]
    return replace(inputs, **changes)
