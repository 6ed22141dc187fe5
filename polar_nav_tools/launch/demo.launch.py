"""Starts the whole demo graph: `ros2 launch polar_nav_tools demo.launch.py`.

The nodes and their parameters are those of `./polar demo` (polar_nav_tools.graph). When the
mission is over, or a node died, the follower is ended first, so that it can process what it holds,
and the recorder after it, so that it has the follower's last words; then the rest.
"""

from datetime import datetime
from itertools import pairwise
from pathlib import Path
from tempfile import mkdtemp

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown, matches_action
from launch.events.process import ShutdownProcess
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from polar_nav_follower.params import CONFIGURATIONS
from polar_nav_tools.graph import PACES, GraphOptions
from polar_nav_tools.live import new_bag_path, prepare_graph, read_mission
from polar_nav_tools.node_spec import NodeSpec, Stage

NO_BAG = 'none'


def generate_launch_description() -> LaunchDescription:
    """Arguments, then the nodes that follow from them."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'mission',
                default_value='demo',
                description='Name of a mission of polar_nav_sim, or a YAML file',
            ),
            DeclareLaunchArgument(
                'pace',
                default_value='realtime',
                choices=list(PACES),
                description='realtime waits for nobody; lockstep is fast and loses nothing',
            ),
            DeclareLaunchArgument(
                'duration',
                default_value='0.0',
                description='Simulated seconds; 0: as long as the mission says',
            ),
            DeclareLaunchArgument(
                'seed',
                default_value='1',
                description='Seed of the run; every random stream is made from it',
            ),
            DeclareLaunchArgument(
                'configuration',
                default_value='modified_akf',
                choices=list(CONFIGURATIONS),
                description='Filter configuration of the follower',
            ),
            DeclareLaunchArgument(
                'bag',
                default_value='',
                description='Folder of the new bag; empty: a new one in bags/; none: no recorder',
            ),
            SetEnvironmentVariable('OPENBLAS_NUM_THREADS', '1'),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    duration_s, seed, bag = float(value('duration')), int(value('seed')), value('bag')
    mission = read_mission(value('mission'), duration_s or None)
    folder = Path(bag) if bag else new_bag_path(Path('bags'), mission.name, seed, datetime.now())
    options = GraphOptions(
        pace=value('pace'),
        seed=seed,
        configuration=value('configuration'),
        bag=None if bag == NO_BAG else folder,
    )
    graph = prepare_graph(mission, options, Path(mkdtemp(prefix='polar_nav_')))
    actions = {spec.full_name: _action(spec) for spec in graph.nodes}
    last = [actions[s.full_name] for s in graph.nodes if s.stage >= Stage.FOLLOWER]
    handlers = [
        _when_ended(action, _end(last[0])) for action in actions.values() if action not in last
    ]
    for action, following in pairwise(last):
        handlers.append(_when_ended(action, _end(following)))
    handlers.append(_when_ended(last[-1], EmitEvent(event=Shutdown(reason='the run is over'))))
    return [*handlers, *actions.values()]


def _action(spec: NodeSpec) -> Node:
    return Node(
        package=spec.package,
        executable=spec.executable,
        name=spec.name,
        namespace=spec.namespace or '/',
        parameters=[dict(spec.parameters)],
        output='screen',
        sigterm_timeout='15',  # the default of 5 s is short for a dozen nodes on a busy machine
    )


def _when_ended(action: Node, then: EmitEvent) -> RegisterEventHandler:
    return RegisterEventHandler(OnProcessExit(target_action=action, on_exit=[then]))


def _end(action: Node) -> EmitEvent:
    return EmitEvent(event=ShutdownProcess(process_matcher=matches_action(action)))
