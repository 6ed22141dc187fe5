"""Graph of a mission: its nodes, namespaces, parameters, topics.

In: a mission and a few options. Out: a :class:`Graph` of :class:`NodeSpec` and topics. The launch
file and the process supervisor of ``polar demo`` are both made from it, so they run the same
thing. Nothing here knows ROS or processes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from polar_nav_core.engine.methods import CONFIGURATIONS
from polar_nav_core.engine.params import NO_COMMON_ERRORS, NO_RESERVE
from polar_nav_core.errors import ConfigError
from polar_nav_follower.params import FollowerParams
from polar_nav_leader.params import LeaderParams
from polar_nav_ros import topics

from .instruments import (
    as_the_mission_says,
    leader_instruments,
    own_aiding,
    own_aiding_topics,
    vehicle_nodes,
)
from .options import GraphOptions
from .parts import (
    FOLLOWER_ID,
    LEADER_ID,
    LOCKSTEP_REORDER_S,
    LOCKSTEP_WINDOW_S,
    initial_state_parameters,
    link_node,
    sim_node,
    usual_sigma,
)
from .recorded_topics import recorded_topics, topics_alone, topics_of_the_root
from .spec import NodeSpec, ParameterValue, Stage
from .station import MODEL_TOPICS, has_station, station_nodes, station_topics

if TYPE_CHECKING:
    from polar_nav_sim.mission import Mission

_STATE_PERIOD_S = 1.0
"""A follower that is started again has its state of one second before."""
REALTIME_GATHER_S = 300.0
"""Longest wait for the nodes to find each other before the first sample: a follower that compiles
its kernels for the first time takes a minute or two, on a busy machine more."""
REALTIME_BEHIND_S = 0.5
"""What a busy machine may be behind the clock. Sensors, link and follower follow one another, so
that a message is late by a few times this at most, which the reorder window has room for."""


@dataclass(frozen=True)
class Graph:
    """Nodes and recorded topics of a mission.

    Attributes
    ----------
    mission : str
        Its name.
    duration_s : float
        Its length.
    options : GraphOptions
        As given.
    nodes : tuple of NodeSpec
        In the order of their stages.
    topics : mapping of str to str
        Every recorded topic with its type.
    """

    mission: str
    duration_s: float
    options: GraphOptions
    nodes: tuple[NodeSpec, ...]
    topics: Mapping[str, str]


def build_graph(mission: Mission, options: GraphOptions) -> Graph:
    """Graph of a mission.

    Raises
    ------
    ConfigError
        When the mission has not exactly one follower, which is what the leader's packets serve.
    """
    if len(mission.followers) != 1:
        names = ', '.join(mission.followers) or 'none'
        raise ConfigError(f'mission {mission.name}: one follower is needed, it has {names}')
    follower = mission.followers[0]
    lockstep = options.pace == 'lockstep'
    station = mission.led and has_station(mission)
    if not station and options.configuration not in CONFIGURATIONS:
        raise ConfigError(
            f'mission {mission.name}: configuration {options.configuration!r} is for a station; '
            f'without one there are {", ".join(CONFIGURATIONS)}'
        )
    if options.leader == 'own' and not mission.led:
        raise ConfigError(f'mission {mission.name} has no leader that could navigate by itself')
    if not mission.led:
        recorded = {**topics_of_the_root(), **topics_alone(mission, follower)}
        nodes = [
            *vehicle_nodes(follower, options, {}),
            *own_aiding(mission, options),
            _follower_node(mission, follower, options),
        ]
    elif station:
        leader = mission.leader
        recorded = {**topics_of_the_root(), **station_topics(leader, follower)}
        nodes = station_nodes(mission, follower, options)
    else:
        leader = mission.leader
        recorded = recorded_topics(leader, follower, options.leader)
        for vehicle in mission.dynamic:
            recorded |= topics.of_vehicle(vehicle, MODEL_TOPICS)
        recorded |= own_aiding_topics(mission)
        if mission.sources(follower) is not None:
            recorded |= topics.of_vehicle(follower, (topics.INPUTS,))
        nodes = [
            *vehicle_nodes(leader, options, leader_instruments(options)),
            *vehicle_nodes(follower, options, {}),
            *own_aiding(mission, options),
            *_acoustic_nodes(mission, leader, follower, options),
            _follower_node(mission, follower, options),
        ]
    nodes = [as_the_mission_says(mission, spec) for spec in nodes]
    if options.respawn:
        nodes = [_respawning(spec, options) for spec in nodes]
        recorded |= topics.of_vehicle(follower, (topics.RESTORE,))
    if not lockstep:  # its times are those of the computer
        recorded |= topics.of_vehicle(follower, (topics.START,))
    nodes += _recorder_node(recorded, options)
    heard = 'lockstep' if lockstep else 'presence'
    nodes = [replace(s, parameters={**s.parameters, heard: True}) for s in nodes]
    truth = _truth_node(mission, options, [spec.full_name for spec in nodes])
    return Graph(mission.name, mission.duration_s, options, (truth, *nodes), recorded)


def follower_parameters(graph: Graph) -> Mapping[str, ParameterValue]:
    """Parameters of the follower that differ from its node's defaults."""
    return next(spec.parameters for spec in graph.nodes if spec.stage is Stage.FOLLOWER)


def _truth_node(mission: Mission, options: GraphOptions, others: list[str]) -> NodeSpec:
    parameters: dict[str, ParameterValue] = {
        'mission': str(mission.file),
        'duration_s': mission.duration_s,
        'pace': options.pace,
        'exit_at_end': True,
    }
    if getattr(mission.path, 'as_recorded', False):
        parameters['overrides'] = ['path.as_recorded=true']
    parameters['expected_nodes'] = others
    if options.pace == 'lockstep':
        parameters['window_s'] = LOCKSTEP_WINDOW_S
    else:
        parameters['gather_s'] = REALTIME_GATHER_S
        if not options.respawn:
            # Nobody waits for a node that is away; without such nodes, nothing need come late.
            parameters['max_behind_s'] = REALTIME_BEHIND_S
    executable = 'vehicle_node' if mission.dynamic else 'truth_node'
    return sim_node(executable, '', Stage.TRUTH, parameters)


def _acoustic_nodes(
    mission: Mission, leader: str, follower: str, options: GraphOptions
) -> list[NodeSpec]:
    """Nodes between the leader's truth and the follower's modem."""
    seed: dict[str, ParameterValue] = {'seed': options.seed}
    nodes = [
        sim_node('usbl_node', leader, Stage.SENSOR, {**seed, 'targets': [follower]}),
        _leader_node(mission, leader, follower, options),
        link_node([leader, follower], options.seed),
    ]
    if options.leader == 'perfect':
        return [sim_node('leader_reference_node', leader, Stage.SENSOR, seed), *nodes]
    return nodes


def _leader_node(mission: Mission, leader: str, follower: str, options: GraphOptions) -> NodeSpec:
    parameters: dict[str, ParameterValue] = {
        'own_id': LEADER_ID,
        'follower': follower,
        'follower_id': FOLLOWER_ID,
        'sea_surface_height': mission.numbers.sea_surface_height_m,
    }
    if options.leader == 'own':
        if 'heading' in mission.formation[leader].instruments:
            raise ConfigError(
                f'mission {mission.name}: {leader} has a heading instrument, which plays its'
                ' navigation: run it with --leader perfect'
            )
        parameters['navigation'] = 'own'
        parameters |= initial_state_parameters(
            mission, leader, usual_sigma(LeaderParams), options.seed
        )
        parameters |= NO_COMMON_ERRORS | NO_RESERVE
        if options.pace == 'lockstep':
            parameters['reorder_window_s'] = LOCKSTEP_REORDER_S
    return NodeSpec(
        'polar_nav_leader',
        'leader_node',
        'polar_nav_leader.leader_node',
        leader,
        Stage.LEADER,
        parameters,
    )


def _follower_node(mission: Mission, follower: str, options: GraphOptions) -> NodeSpec:
    parameters: dict[str, ParameterValue] = {
        'configuration': options.configuration,
        'sea_surface_height': mission.numbers.sea_surface_height_m,
    }
    if mission.led:
        parameters |= {'leader_id': LEADER_ID, 'own_id': FOLLOWER_ID}
    sources = mission.sources(follower)
    if sources is not None:
        # What its instruments are worth, and where it is, is up to that file.
        parameters['sources'] = str(sources)
    else:
        # The instruments of section 6.1, which the simulation draws its errors from.
        parameters |= NO_COMMON_ERRORS | NO_RESERVE
        parameters |= {'dvl_scale_sigma': 1e-4, 'dvl_markov_sigma': 0.005}
        parameters |= initial_state_parameters(
            mission, follower, usual_sigma(FollowerParams), options.seed
        )
        if follower in mission.dynamic:
            parameters['model_aiding'] = True
    if options.pace == 'lockstep':
        parameters['reorder_window_s'] = LOCKSTEP_REORDER_S
        if options.leader == 'own':
            # The leader's packets come as much later as the leader itself waits.
            parameters['reorder_window_s'] = 2.0 * LOCKSTEP_REORDER_S
    elif options.leader == 'perfect':
        parameters['reorder_window_s'] = options.reorder_s
    return NodeSpec(
        'polar_nav_follower',
        'follower_node',
        'polar_nav_follower.follower_node',
        follower,
        Stage.FOLLOWER,
        parameters,
    )


_RESPAWNING = (Stage.LEADER, Stage.LINK, Stage.FOLLOWER)


def _respawning(spec: NodeSpec, options: GraphOptions) -> NodeSpec:
    """Node that is started again when it dies, where a run can go on: no sensor."""
    if spec.stage not in _RESPAWNING:
        return spec
    parameters = dict(spec.parameters)
    if spec.stage is Stage.FOLLOWER and options.state_file is not None:
        parameters['state_file'] = str(options.state_file.absolute())
        parameters['state_period_s'] = _STATE_PERIOD_S
    return replace(spec, parameters=parameters, respawns=True)


def _recorder_node(recorded: Mapping[str, str], options: GraphOptions) -> list[NodeSpec]:
    if options.bag is None:
        return []
    parameters: dict[str, ParameterValue] = {
        'output': str(options.bag.absolute()),
        'topics': [f'{name}:{kind}' for name, kind in recorded.items()],
        'log_time': 'simulation',
    }
    if options.respawn:
        parameters['resume'] = True
    if options.max_bag_bytes:
        parameters['max_bag_size'] = options.max_bag_bytes
    if options.run_info is not None:
        parameters['run_info'] = str(options.run_info.absolute())
    module = 'polar_nav_tools.record.recorder_node'
    return [
        NodeSpec(
            'polar_nav_tools',
            'recorder_node',
            module,
            '',
            Stage.RECORDER,
            parameters,
            respawns=options.respawn,
        )
    ]
