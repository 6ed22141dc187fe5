"""Launch description of one vehicle's node, for the launch files of the packages.

Used by `ros2 launch` only: no node imports this.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from polar_nav_core.errors import ConfigError

from .launcher import LAUNCHER

RESPAWN_DELAY_S = 1.0
REFUSED = 2
"""Exit status of a node whose parameters or files are refused: it would be so again."""
_SWITCHES = ('false', 'true')
_TIMEOUT_S = '15'
"""Until a node that was told to end is told more plainly: it may have messages to process [s]."""


def vehicle_launch(
    package: str, executable: str, namespace: str, files: Mapping[str, str]
) -> LaunchDescription:
    """Launch description: arguments, then the node that follows from them.

    Parameters
    ----------
    package, executable : str
        Of the node; the node has the name of its program.
    namespace : str
        Default name of the vehicle.
    files : mapping of str to str
        Parameters that name files and are arguments, too, each with its description. An empty
        argument leaves the parameter to the YAML file.
    """
    about = {
        'namespace': (namespace, 'Name of the vehicle: namespace of its topics'),
        'params_file': ('', 'YAML file of parameters; empty: none'),
        **{name: ('', text) for name, text in files.items()},
    }
    arguments = [
        *(DeclareLaunchArgument(n, default_value=d, description=t) for n, (d, t) in about.items()),
        DeclareLaunchArgument(
            'use_sim_time',
            default_value='false',
            choices=list(_SWITCHES),
            description='true: the clock of the node follows /clock',
        ),
        DeclareLaunchArgument(
            'respawn',
            default_value='true',
            choices=list(_SWITCHES),
            description='true: start the node again when it dies, after a second',
        ),
    ]

    def node(context: LaunchContext) -> list[LaunchDescriptionEntity]:
        def value(name: str) -> str:
            return str(LaunchConfiguration(name).perform(context))

        stated = value('params_file')
        yaml = [str(_existing('params_file', stated))] if stated else []
        given = {name: value(name) for name in files if value(name)}
        given = {name: str(Path(text).expanduser().absolute()) for name, text in given.items()}
        action = Node(
            package=package,
            executable=executable,
            name=executable,
            namespace=value('namespace'),
            parameters=[*yaml, {'use_sim_time': value('use_sim_time') == 'true', **given}],
            output='screen',
            additional_env={LAUNCHER: str(os.getpid())},  # it ends by itself when that is gone
            respawn=value('respawn') == 'true',
            respawn_delay=RESPAWN_DELAY_S,
            sigterm_timeout=_TIMEOUT_S,
            sigkill_timeout=_TIMEOUT_S,
        )
        return [_end_when_refused(action), action]

    return LaunchDescription([*arguments, OpaqueFunction(function=node)])


def _existing(name: str, text: str) -> Path:
    path = Path(text).expanduser().absolute()
    if not path.is_file():
        raise ConfigError(f'argument {name}: there is no file {path}')
    return path


def _end_when_refused(action: Node) -> RegisterEventHandler:
    """Handler that fails when the node refuses its parameters: a respawn would be refused, too."""

    def on_exit(event: ProcessExited, _context: LaunchContext) -> None:
        if event.returncode == REFUSED:
            raise ConfigError('the node refuses its parameters')

    return RegisterEventHandler(OnProcessExit(target_action=action, on_exit=on_exit))
