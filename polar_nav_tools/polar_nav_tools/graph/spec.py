"""One node of a graph as data: executable, namespace, parameters, stage of its end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path

import yaml

ParameterValue = bool | int | float | str | list[float] | list[str]


class Stage(IntEnum):
    """Order in which nodes are ended: from the source of the data to its sink."""

    TRUTH = 0
    SENSOR = 1
    LEADER = 2
    LINK = 3
    FOLLOWER = 4
    RECORDER = 5


@dataclass(frozen=True)
class NodeSpec:
    """One node of the graph.

    Attributes
    ----------
    package, executable : str
        What ``ros2 run`` takes.
    module : str
        Python module with the ``main`` of the executable.
    namespace : str
        The vehicle, or '' for the root.
    stage : Stage
        When it is ended.
    parameters : mapping
        Values that differ from the node's defaults.
    respawns : bool
        Whether it is started again when it dies, instead of ending the run.
    """

    package: str
    executable: str
    module: str
    namespace: str
    stage: Stage
    parameters: Mapping[str, ParameterValue] = field(default_factory=dict)
    respawns: bool = False

    @property
    def name(self) -> str:
        """Node name, equal to the executable's."""
        return self.executable

    @property
    def full_name(self) -> str:
        """Fully qualified node name."""
        return f'/{self.namespace}/{self.name}' if self.namespace else f'/{self.name}'

    def ros_args(self, parameters: Path) -> list[str]:
        """Command line arguments of the process."""
        names = ['-r', f'__node:={self.name}', '-r', f'__ns:=/{self.namespace}']
        return ['--ros-args', *names, '--params-file', str(parameters)]


def parameter_yaml(spec: NodeSpec) -> str:
    """Text of a node's parameter file for ``--params-file``."""
    values = {name: list(v) if isinstance(v, tuple) else v for name, v in spec.parameters.items()}
    return str(yaml.safe_dump({spec.full_name: {'ros__parameters': values}}, sort_keys=True))
