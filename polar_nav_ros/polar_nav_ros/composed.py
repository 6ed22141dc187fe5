"""Several nodes in one process, with one executor: `composed MODULE MODULE ... --ros-args ...`.

The nodes are those of `ros2 run`, by the same names; each is stated by the Python module that it
is in, as polar_nav_sim.nodes.imu_node or polar_nav_follower.follower_node. What stands after
`--ros-args` is for all of them: `-r __ns:=/auv` puts all into one namespace, a `--params-file` has
a section for each node by its full name (`/auv/dvl_node:`), and `-r dvl_node:truth:=other` is for
one of them, as anywhere in ROS 2. A container of rclcpp's components cannot hold them, and
rclpy has none.

The nodes are made in the order given and closed in it, so that who hears others stands after them.
The process ends when one of its nodes ends or fails.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Sequence
from importlib import import_module

from polar_nav_core.errors import ConfigError
from polar_nav_core.warm import forgo_blas

from .node import PolarNode
from .process import Kind, run_together


def class_of(module: str) -> Kind:
    """Class of the one node that is in a module.

    Raises
    ------
    ConfigError
        When there is no such module, or not one node of this project in it.
    """
    try:
        members = vars(import_module(module))
    except ModuleNotFoundError as error:
        if not f'{module}.'.startswith(f'{error.name}.'):
            raise  # what the module needs is missing
        raise ConfigError(f'node {module}: there is no Python module of this name') from None
    found = [
        kind
        for kind in members.values()
        if inspect.isclass(kind)
        and issubclass(kind, PolarNode)
        and kind.__module__ == module
        and not inspect.isabstract(kind)
    ]
    if len(found) != 1:
        raise ConfigError(f'node {module}: the module has {len(found)} nodes, not one')
    return found[0]


def main(args: Sequence[str] | None = None) -> int:
    """Exit status of the nodes."""
    given = list(sys.argv[1:] if args is None else args)
    named = given[: given.index('--ros-args')] if '--ros-args' in given else given
    if {'-h', '--help'} & set(named):
        print(inspect.getdoc(sys.modules[__name__]))  # noqa: T201 - asked for
        return 0
    try:
        kinds = _classes(named)
    except ConfigError as error:
        print(f'composed: {error}', file=sys.stderr)  # noqa: T201 - before there is a logger
        return 2
    forgo_blas()
    return run_together(kinds, args)


def _classes(named: Sequence[str]) -> list[Kind]:
    if not named:
        raise ConfigError('no node is stated; as its module, like polar_nav_sim.nodes.imu_node')
    for name in named:
        if named.count(name) > 1:
            raise ConfigError(f'node {name} is stated twice')
    return [class_of(name) for name in named]


if __name__ == '__main__':
    sys.exit(main())
