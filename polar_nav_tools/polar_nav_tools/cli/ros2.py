"""`polar ros2`: the real ros2 command in the environment of this project."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from .app import app


@app.command(
    context_settings={'ignore_unknown_options': True, 'allow_interspersed_args': False},
    epilog='Example: `./polar ros2 topic echo --once /follower/nav/receipt`',
)
def ros2(
    arguments: Annotated[list[str] | None, typer.Argument(help='Of the ros2 command.')] = None,
) -> None:
    """Run the machine's own `ros2` with the nodes and messages of this project.

    It is looked for on the PATH and under /opt/ros/jazzy, and not installed: no index of Python
    packages has it. Nothing has to be sourced. POLAR_ROS2 names another one.
    """
    from ..live.ros2_command import command, find_ros2, surroundings

    env = surroundings(find_ros2(os.environ), os.environ)
    sys.stdout.flush()
    line = command(arguments or [])
    os.execve(line[0], line, env)
