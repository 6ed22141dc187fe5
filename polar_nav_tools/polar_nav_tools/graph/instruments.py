"""Nodes of the instruments of a simulated vehicle: the usual ones, and what its mission names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from polar_nav_core.params import to_mapping
from polar_nav_ros import topics
from polar_nav_sim.sensors.presets import DVL, IMU

from .options import GraphOptions
from .parts import sim_node
from .spec import NodeSpec, ParameterValue, Stage

if TYPE_CHECKING:
    from polar_nav_sim.mission import Mission
    from polar_nav_sim.sensors.dvl import DvlErrors
    from polar_nav_sim.sensors.imu import ImuErrors

_INSTRUMENTS = {
    'imu_node': 'imu',
    'dvl_node': 'dvl',
    'depth_node': 'depth',
    'ahrs_node': 'ahrs',
    'absolute_fix_node': 'absolute',
    'usbl_node': 'usbl',
    'leader_reference_node': 'heading',
}
"""Kind of instrument of each node that is one."""
_IN_THE_WATER = ('usbl_node', 'dvl_node', 'station_node', 'acoustic_link_node')


def as_the_mission_says(mission: Mission, spec: NodeSpec) -> NodeSpec:
    """Give a node of the simulation the instrument, clock and water that the mission names."""
    parameters = dict(spec.parameters)
    kind = _INSTRUMENTS.get(spec.executable)
    if kind is not None:
        installed = mission.instruments(spec.namespace).get(kind)
        if installed is not None:
            parameters |= to_mapping(installed.errors)
            if installed.rate_hz is not None:
                parameters['rate_hz'] = installed.rate_hz
        vehicle = mission.formation[spec.namespace]
        if vehicle.clock_offset_s or vehicle.clock_drift_ppm:
            parameters['clock_offset_s'] = vehicle.clock_offset_s
            parameters['clock_drift_ppm'] = vehicle.clock_drift_ppm
    if spec.executable in _IN_THE_WATER and mission.water is not None:
        parameters |= to_mapping(mission.water)
    return replace(spec, parameters=parameters)


def vehicle_nodes(
    vehicle: str,
    options: GraphOptions,
    instruments: Mapping[str, Mapping[str, ParameterValue]],
) -> list[NodeSpec]:
    """Nodes of IMU, DVL and depth sensor; ``instruments``: parameters of some, by executable."""
    names = ('imu_node', 'dvl_node', 'depth_node')
    return [
        sim_node(name, vehicle, Stage.SENSOR, {'seed': options.seed, **instruments.get(name, {})})
        for name in names
    ]


_OWN_AIDING = {
    'ahrs': ('ahrs_node', (topics.COMPASS, topics.MAGNETIC)),
    'absolute': ('absolute_fix_node', (topics.ABSOLUTE,)),
}
"""Node and topics of the instruments that a vehicle has only where its mission names them."""


def own_aiding(mission: Mission, options: GraphOptions) -> list[NodeSpec]:
    """Nodes of the AHRS and absolute fixes that vehicles of a mission have."""
    seed: dict[str, ParameterValue] = {'seed': options.seed}
    return [
        sim_node(node, name, Stage.SENSOR, seed)
        for name, vehicle in mission.formation.items()
        for kind, (node, _) in _OWN_AIDING.items()
        if kind in vehicle.instruments
    ]


def own_aiding_topics(mission: Mission) -> dict[str, str]:
    """Recorded topics of `own_aiding`, each with its message type."""
    recorded: dict[str, str] = {}
    for name, vehicle in mission.formation.items():
        for kind, (_, published) in _OWN_AIDING.items():
            if kind in vehicle.instruments:
                recorded |= topics.of_vehicle(name, published)
    return recorded


def leader_instruments(options: GraphOptions) -> dict[str, dict[str, ParameterValue]]:
    """Parameters of the better instruments of a leader that navigates by itself."""
    if options.leader != 'own':
        return {}
    return {
        'imu_node': _differing(IMU['leader'].errors),
        'dvl_node': _differing(DVL['leader'].errors),
    }


def _differing(errors: ImuErrors | DvlErrors) -> dict[str, ParameterValue]:
    """Parameters of an instrument that differ from its node's defaults."""
    usual = to_mapping(type(errors)())
    return {name: value for name, value in to_mapping(errors).items() if value != usual[name]}
