"""Launch description of the demo graph: `ros2 launch polar_nav_tools demo.launch.py`.

The nodes and their parameters are those of `./polar demo` (polar_nav_tools.graph.build). When the
mission is over, or a node died, the follower is ended first, so that it can process
its waiting messages, and the recorder after it, so that it records the follower's last ones; then
the rest. The exit status is 0 only if no node failed.
"""

import os
import signal
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

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
from launch.events.process import ProcessExited, ShutdownProcess
from launch.logging import launch_config
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from polar_nav_core.engine.configurations import NAMES
from polar_nav_core.errors import ConfigError
from polar_nav_ros.launcher import LAUNCHER
from polar_nav_tools.graph.options import (
    LEADERS,
    PACES,
    USUAL_CONFIGURATION,
    WATCHED_REORDER_S,
    GraphOptions,
)
from polar_nav_tools.graph.processes import ProcessSpec, processes_of
from polar_nav_tools.graph.spec import Stage
from polar_nav_tools.live.domain import node_surroundings
from polar_nav_tools.live.node_process import NodeEnd, write_parameters
from polar_nav_tools.live.run import RunFailed, new_bag_path, prepare_graph, read_mission
from polar_nav_tools.live.supervisor import ORDERLY, RESPAWN_DELAY_S

T = TypeVar('T')

NO_BAG = 'none'


def generate_launch_description() -> LaunchDescription:
    """Launch description: arguments, then the nodes that follow from them."""
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
                description='realtime waits for no node; lockstep is fast and loses nothing',
            ),
            DeclareLaunchArgument(
                'duration',
                default_value='0.0',
                description='Simulated seconds; 0: length of the mission',
            ),
            DeclareLaunchArgument(
                'seed',
                default_value='1',
                description='Seed of the run; every random stream is made from it',
            ),
            DeclareLaunchArgument(
                'configuration',
                default_value=USUAL_CONFIGURATION,
                choices=list(NAMES),
                description='Filter configuration of the follower',
            ),
            DeclareLaunchArgument(
                'leader',
                default_value='perfect',
                choices=list(LEADERS),
                description='perfect: knows its position, as the papers assume; own: it navigates',
            ),
            DeclareLaunchArgument(
                'bag',
                default_value='',
                description='Folder of the new bag; empty: a new one in bags/; none: no recorder',
            ),
            DeclareLaunchArgument(
                'network',
                default_value='false',
                choices=['false', 'true'],
                description='true: other hosts may see the graph; false: this host only',
            ),
            DeclareLaunchArgument(
                'composed',
                default_value='false',
                choices=['false', 'true'],
                description='true: the nodes of a vehicle in one process; false: one each',
            ),
            OpaqueFunction(function=_graph),
        ]
    )


def _graph(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    duration_s = _read('duration', value('duration'), float)
    seed, bag = _read('seed', value('seed'), int), value('bag')
    mission = read_mission(value('mission'), duration_s or None)
    folder = Path(bag) if bag else new_bag_path(Path('bags'), mission.name, seed, datetime.now())
    options = GraphOptions(
        pace=value('pace'),
        respawn=value('pace') == 'realtime',
        seed=seed,
        configuration=value('configuration'),
        leader=value('leader'),
        bag=None if bag == NO_BAG else folder,
        reorder_s=WATCHED_REORDER_S,
        composed=value('composed') == 'true',
    )
    run_dir = Path(launch_config.log_dir)
    graph = prepare_graph(mission, options, run_dir)
    network = value('network') == 'true'
    surroundings = node_surroundings(run_dir, os.environ, network=network)
    surroundings[LAUNCHER] = str(os.getpid())  # nodes end by themselves when it is gone
    variables = [SetEnvironmentVariable(name, text) for name, text in surroundings.items()]
    (run_dir / 'params').mkdir(exist_ok=True)
    actions = {_action(spec, run_dir): spec for spec in processes_of(graph)}
    return [*variables, _order_of_the_end(actions), *actions]


def _read(name: str, text: str, kind: Callable[[str], T]) -> T:
    try:
        return kind(text)
    except ValueError:
        raise ConfigError(f'argument {name}: {text!r} is not a number') from None


def _action(spec: ProcessSpec, run_dir: Path) -> Node:
    return Node(
        **_what(spec, run_dir),
        namespace=spec.namespace or '/',
        output='screen',
        sigterm_timeout=str(ORDERLY.after_sigint_s),
        sigkill_timeout=str(ORDERLY.after_sigterm_s),
        respawn=_respawns(spec),
        respawn_delay=RESPAWN_DELAY_S,
    )


def _what(spec: ProcessSpec, run_dir: Path) -> dict[str, Any]:
    """Program, name and parameters of one node, or of several in one process."""
    if spec.alone:
        (node,) = spec.nodes
        return {
            'package': node.package,
            'executable': node.executable,
            'name': node.name,
            'parameters': [dict(node.parameters)],
        }
    return {
        'package': 'polar_nav_ros',
        'executable': 'composed',
        'arguments': [node.module for node in spec.nodes],
        'parameters': [str(path) for path in write_parameters(spec, run_dir)],
    }


def _respawns(spec: ProcessSpec) -> bool:
    """Whether a node is started again: a recorder may have ended because the disk is full."""
    return spec.respawns and spec.stage is not Stage.RECORDER


def _order_of_the_end(specs: Mapping[Node, ProcessSpec]) -> RegisterEventHandler:
    """Handlers that end the graph in order after a node's end, and fail if any node failed."""
    last = [action for action, spec in specs.items() if spec.stage >= Stage.FOLLOWER]
    ended: list[Node] = []
    failures: list[str] = []

    def on_exit(event: ProcessExited, context: LaunchContext) -> EmitEvent | None:
        spec, status = specs[event.action], event.returncode
        if _respawns(spec) and not ended and not context.is_shutdown:
            return None  # it is started again
        how = f'{spec.title} {NodeEnd(spec.name, status, (), "").how()}'
        if context.is_shutdown:
            if status not in (0, -signal.SIGINT):
                failures.append(f'{how} while it was ended')
        elif not ended and (spec.stage != Stage.TRUTH or status != 0):
            failures.append(f'{how} before the mission was over')
        elif status != 0:
            failures.append(how)
        ended.append(event.action)
        if failures and len(ended) == len(specs):
            raise RunFailed(failures[0], ())
        after = last.index(event.action) + 1 if event.action in last else 0
        if after < len(last):
            return EmitEvent(event=ShutdownProcess(process_matcher=matches_action(last[after])))
        return EmitEvent(event=Shutdown(reason='the run is over'))

    return RegisterEventHandler(OnProcessExit(on_exit=on_exit))
