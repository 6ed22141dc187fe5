"""Rows of the experiment: a constant that is off, in a scene that shows it or does not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files

from polar_nav_core.engine.params import EngineParams

from ..mismatch.dvl_faults import DvlGain, DvlPlace
from ..mismatch.faults import Fault, FixClock, LeaderFrame
from ..schedule import FixSpec
from ..world import World, make_world
from ..world_spec import WorldSpec

SCENES = ('lawnmower', 'circle', 'straight')
_DISTANCE_M = 300.0
_FIXES = FixSpec(period_s=2.0, first_s=2.0, delay_s=3.0)


@dataclass(frozen=True)
class Row:
    """One or several constants that are off.

    Attributes
    ----------
    name : str
    faults : tuple of Fault
    off : mapping of str to float
        What has to be added to each constant, in its unit.
    """

    name: str
    faults: tuple[Fault, ...] = ()
    off: Mapping[str, float] = field(default_factory=dict)

    def world(self, scene: str, duration_s: float, seed: int) -> World:
        """World of a scene in which the constants are off."""
        world = world_of(scene, duration_s, seed)
        for fault in self.faults:
            world = fault.applied(world, 1.0)
        return world


def world_of(scene: str, duration_s: float, seed: int, fixes: FixSpec = _FIXES) -> World:
    """World of a scene in which nothing is off, with a leader that stays where it is."""
    world = make_world(_spec(scene, duration_s), fixes, seed)
    return LeaderFrame(distance_m=_DISTANCE_M, formation=False).applied(world, 1.0)


def params_of(world: World) -> EngineParams:
    """Parameters of a user who states the sensors as they are, and nothing of the constants."""
    return world.params(configuration='default')


_DELAY = FixClock(offset_s=0.3)
_YAW = DvlGain(turn_deg=-0.3)
_SCALE = DvlGain(scale=0.005)
_LEVER = DvlPlace(lever_b=(1.0, 0.0, 0.0))
_LATENCY = DvlPlace(lag_s=0.1)


def _leader(turn_deg: float = 0.0, scale: float = 0.0) -> LeaderFrame:
    return LeaderFrame(turn_deg=turn_deg, scale=scale, distance_m=_DISTANCE_M, formation=False)


ROWS = (
    Row('delay', (_DELAY,), {'delay': 0.3}),
    Row('dvl_yaw', (_YAW,), {'dvl_yaw': 0.3}),
    Row('dvl_scale', (_SCALE,), {'dvl_scale': 0.5}),
    Row('dvl_lever', (_LEVER,), {'dvl_lever_x': 1.0}),
    Row('dvl_latency', (_LATENCY,), {'dvl_latency': 0.1}),
    Row('array_yaw', (_leader(turn_deg=-0.5),), {'array_yaw': 0.5}),
    Row('range_scale', (_leader(scale=0.01),), {'range_scale': 1.0}),
    Row(
        'all',
        # Scale and turn of what the DVL shows where it really is.
        (_DELAY, _LEVER, _YAW, _SCALE, _leader(turn_deg=-0.5, scale=0.01)),
        {
            'delay': 0.3,
            'dvl_yaw': 0.3,
            'dvl_scale': 0.5,
            'dvl_lever_x': 1.0,
            'array_yaw': 0.5,
            'range_scale': 1.0,
        },
    ),
)


@cache
def _spec(scene: str, duration_s: float) -> WorldSpec:
    mission = '' if scene == 'straight' else str(files(__package__).joinpath(f'{scene}.yaml'))
    return WorldSpec(
        duration_s=duration_s,
        mission=mission,
        latitude_deg=85.0,
        speed_mps=2.0,
        constants='prior',
        dvl_scale=1e-9,  # the scale that is off is the row's
        dvl_rate_hz=5.0,
        depth_rate_hz=2.0,
    )
