"""Graph of a mission with a hydroacoustic station in place of a leader.

A vehicle that moves by its own dynamics, without DVL, with the attitude of an AHRS; its follower
navigates by the vehicle's model and the station's ranges and bearings.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from polar_nav_core import earth
from polar_nav_core.engine.configurations import STATION, STATION_VARIANTS
from polar_nav_core.engine.params import NO_COMMON_ERRORS
from polar_nav_core.errors import ConfigError
from polar_nav_ros import topics
from polar_nav_sim.initial_state import InitialSigma

from .options import GraphOptions
from .parts import (
    FOLLOWER_ID,
    LEADER_ID,
    LOCKSTEP_REORDER_S,
    initial_state_parameters,
    link_node,
    sim_node,
)
from .recorded_topics import NAVIGATION_TOPICS
from .spec import NodeSpec, ParameterValue, Stage

if TYPE_CHECKING:
    from polar_nav_sim.mission import Mission

_START = InitialSigma(position=10.0, height=0.5, velocity=0.1, tilt_deg=0.5, heading_deg=1.0)
"""Of a vehicle that dived at a known place at a known speed through water that moves somehow."""
_SOUND_SPEED = 1500.0
"""Of the paper's scenario [m/s]: in slower water its 2.5 s are too short for its 1130 m."""
_STATION_TOPICS = (
    topics.TRUTH,
    topics.STATION,
    topics.TX,
    topics.RX,
)
MODEL_TOPICS = (
    topics.TRUE_MODEL,
    topics.CONTROL,
    topics.CURRENT,
    topics.MODEL,
    topics.IDENTIFICATION,
)
"""Of a vehicle with dynamics, in either mode."""
_VEHICLE_TOPICS = (
    *MODEL_TOPICS,
    topics.TRUTH,
    topics.IMU,
    topics.AHRS,
    topics.PRESSURE,
    topics.DEPTH,
    topics.ODOMETRY,
    topics.RX,
    topics.STATION_DECODED,
    *NAVIGATION_TOPICS,
)


def has_station(mission: Mission) -> bool:
    """Whether the leader of a mission is a station: a vehicle that does not move."""
    return mission.formation[mission.leader].fixed


def station_topics(station: str, vehicle: str) -> dict[str, str]:
    """Recorded topics of station and vehicle, each with its message type."""
    return {
        **topics.of_vehicle(station, _STATION_TOPICS),
        **topics.of_vehicle(vehicle, _VEHICLE_TOPICS),
    }


def station_nodes(mission: Mission, vehicle: str, options: GraphOptions) -> list[NodeSpec]:
    """Nodes between truth and recorder.

    Raises
    ------
    ConfigError
        When the vehicle has no dynamics, the station is to navigate by itself, or the filter is
        one for a leader.
    """
    station = mission.leader
    if vehicle not in mission.dynamic:
        raise ConfigError(
            f'mission {mission.name}: {vehicle} has no dynamics, and {station} stays where it is: '
            'without a model of the vehicle, ranges and bearings are not enough'
        )
    if options.leader != 'perfect':
        raise ConfigError(
            f'mission {mission.name}: leader {options.leader!r}: {station} is a station, which '
            'knows where it is'
        )
    if options.configuration not in STATION_VARIANTS:
        raise ConfigError(
            f'mission {mission.name}: configuration {options.configuration!r} is for a leader; '
            f'with a station there are {", ".join(STATION_VARIANTS)}'
        )
    seed: dict[str, ParameterValue] = {'seed': options.seed}
    numbers: dict[str, ParameterValue] = {'own_id': LEADER_ID, 'target_id': FOLLOWER_ID}
    water: dict[str, ParameterValue] = {'sound_speed': _SOUND_SPEED}
    link = link_node([station, vehicle], options.seed)
    return [
        sim_node('imu_node', vehicle, Stage.SENSOR, {**seed, 'ahrs': True}),
        sim_node('depth_node', vehicle, Stage.SENSOR, seed),
        sim_node(
            'station_node', station, Stage.LEADER, {**seed, **numbers, **water, 'target': vehicle}
        ),
        replace(link, parameters={**link.parameters, **water}),
        _follower_node(mission, vehicle, options),
    ]


def _follower_node(mission: Mission, vehicle: str, options: GraphOptions) -> NodeSpec:
    lockstep = options.pace == 'lockstep'
    parameters: dict[str, ParameterValue] = {
        # The simulated station knows where it is, and which way its array looks.
        **NO_COMMON_ERRORS,
        'mode': STATION,
        **STATION_VARIANTS[options.configuration],
        'leader_id': LEADER_ID,
        'own_id': FOLLOWER_ID,
        'sea_surface_height': mission.numbers.sea_surface_height_m,
        'reorder_window_s': LOCKSTEP_REORDER_S if lockstep else options.reorder_s,
        **_place_of(mission, mission.leader),
        **initial_state_parameters(mission, vehicle, _START, options.seed, through_water=True),
    }
    return NodeSpec(
        'polar_nav_follower',
        'follower_node',
        'polar_nav_follower.follower_node',
        vehicle,
        Stage.FOLLOWER,
        parameters,
    )


def _place_of(mission: Mission, station: str) -> dict[str, ParameterValue]:
    """Parameters of the station frame's origin: the station's first position."""
    r_e = mission.truth(station).state(mission.start_ns).r_e
    latitude, longitude, height = (float(x) for x in earth.geodetic_from_ecef(r_e))
    return {
        'station_latitude_deg': math.degrees(latitude),
        'station_longitude_deg': math.degrees(longitude),
        'station_height': height,
    }
