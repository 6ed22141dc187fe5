"""A row of the table: one fault in a scene, and the scenes of many rows.

Unless a row differs: 1200 s straight at 3 m/s from 80 N, 120 E with the attitude sines of
section 6.1, 50 Hz IMU, DVL and depth at 5 Hz, a fix of 1 m every 2 s, 1.5 to 4 s late, 10 % lost;
everything constant is drawn from the filter's prior, and the fault begins after 400 s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.resources import files
from typing import Any

import yaml

from polar_nav_ros.adapters.noise_classes import imu_noise
from polar_nav_sim.offline_station import StationScenario

from ..schedule import FixSpec
from ..world_spec import WorldSpec
from .faults import Fault
from .scenes import Scene, SinsScene, StationScene

CONTROL = 'control'
START_S = 400.0

WORLD = WorldSpec(duration_s=1200.0, constants='prior', dvl_rate_hz=5.0, depth_rate_hz=5.0)
FIX = FixSpec(
    period_s=2.0,
    first_s=2.0,
    delay_kind='uniform',
    delay_least_s=1.5,
    delay_s=4.0,
    loss=0.1,
)
SINS = SinsScene(WORLD, FIX)
STATION = StationScene(StationScenario())


@dataclass(frozen=True)
class Row:
    """One fault with its scene and the right culprits.

    Attributes
    ----------
    name : str
    doc : str
        What is wrong, one sentence.
    size : str
        With its unit.
    fault : Fault
    culprits : tuple of str
        Names that a right report may blame (`culprits.UNEXPLAINED` always may).
    invisible : bool
        Whether no measurement can show it.
    beyond_stated : bool
        Whether it is larger than twice the sigma that the engine's defaults state for it.
    scene : SinsScene or StationScene
    more : bool
        Whether it is of the table of further faults.
    """

    name: str
    doc: str
    size: str
    fault: Fault
    culprits: tuple[str, ...]
    invisible: bool = False
    beyond_stated: bool = False
    scene: Scene = field(default_factory=lambda: SINS)
    more: bool = False

    @property
    def is_control(self) -> bool:
        """Whether the row has no fault."""
        return CONTROL in self.name.split('_')

    @property
    def mode(self) -> str:
        """Mode of the engine."""
        return self.scene.mode


def scene_of(changes: Mapping[str, Any] | None = None, **world: Any) -> SinsScene:  # noqa: ANN401 - of WorldSpec
    """The inertial scene with another world or engine parameters."""
    return replace(SINS, world=replace(WORLD, **world), changes=dict(changes or {}))


def row(
    name: str,
    fault: Fault,
    culprits: tuple[str, ...] = (),
    *,
    invisible: bool = False,
    beyond_stated: bool = False,
    scene: Scene = SINS,
) -> Row:
    """Return a row whose sentence and size stand in rows.yaml under its name."""
    words = texts()[name]
    return Row(
        name,
        words['about'],
        words['size'],
        fault,
        culprits,
        invisible,
        beyond_stated,
        scene,
        more=bool(words.get('more')),
    )


@lru_cache(maxsize=1)
def texts() -> dict[str, dict[str, Any]]:
    """Return sentence (``about``), ``size`` and perhaps ``more`` of each row by its name."""
    loaded: dict[str, dict[str, Any]] = yaml.safe_load(
        files(__package__).joinpath('rows.yaml').read_text(encoding='utf-8')
    )
    return loaded


LEVEL = scene_of(oscillating=False)
RACETRACK = scene_of(mission='racetrack', duration_s=900.0)
# Its biases wander as those of its class; a user states the class.
_WALKS = {name: imu_noise('stim300')[name] for name in ('gyro_bias_walk', 'accel_bias_walk')}
TACTICAL = scene_of(
    _WALKS,
    mission='racetrack',
    duration_s=900.0,
    imu='tactical',
    gyro_bias_dph=5.0,
    accel_bias_g=750e-6,
    initial_sigma_tilt_deg=0.1,
    initial_sigma_heading_deg=1.0,
)


@lru_cache(maxsize=2)
def warm_scene(mode: str) -> Scene:
    """A scene of a few seconds."""
    if mode == 'station':
        return StationScene(StationScenario(duration_s=10.0))
    return SinsScene(replace(WORLD, duration_s=12.0), replace(FIX, first_s=0.5, period_s=0.5))
