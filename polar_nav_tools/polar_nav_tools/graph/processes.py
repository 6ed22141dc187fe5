"""Processes of a graph: each node in one of its own, or those of a vehicle together.

In: node specifications. Out: :class:`ProcessSpec`. Nothing here starts them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .spec import NodeSpec, Stage

if TYPE_CHECKING:
    from .build import Graph

COMPOSED = 'polar_nav_ros.composed'
"""Module whose `main` runs several nodes in its process."""


@dataclass(frozen=True)
class ProcessSpec:
    """Nodes that share a process, of one namespace.

    Attributes
    ----------
    nodes : tuple of NodeSpec
        In the order in which they are made and closed.
    """

    nodes: tuple[NodeSpec, ...]

    @property
    def alone(self) -> bool:
        """Whether it is the process of one node."""
        return len(self.nodes) == 1

    @property
    def name(self) -> str:
        """Full name of the node; of several, their namespace and in brackets their names."""
        if self.alone:
            return self.nodes[0].full_name
        return f'/{self.namespace} ({", ".join(node.name for node in self.nodes)})'

    @property
    def title(self) -> str:
        """What it is, and its name, for a sentence."""
        return f'{"node" if self.alone else "process"} {self.name}'

    @property
    def stem(self) -> str:
        """Name of its log file, without suffix."""
        return file_stem(self.nodes[0].full_name if self.alone else self.namespace)

    @property
    def namespace(self) -> str:
        """The vehicle, or '' for the root."""
        return self.nodes[0].namespace

    @property
    def stage(self) -> Stage:
        """When it is ended: with the last of its nodes."""
        return max(node.stage for node in self.nodes)

    @property
    def respawns(self) -> bool:
        """Whether it is started again when it dies."""
        return all(node.respawns for node in self.nodes)

    @property
    def module(self) -> str:
        """Python module with the `main` of the process."""
        return self.nodes[0].module if self.alone else COMPOSED

    def arguments(self, parameters: Sequence[Path]) -> list[str]:
        """Command line arguments of the process.

        Parameters
        ----------
        parameters : sequence of Path
            Parameter file of each node.
        """
        if self.alone:
            return self.nodes[0].ros_args(parameters[0])
        named = [node.module for node in self.nodes]
        files = [part for path in parameters for part in ('--params-file', str(path))]
        return [*named, '--ros-args', '-r', f'__ns:=/{self.namespace}', *files]


def file_stem(full_name: str) -> str:
    """File name, without suffix, of what belongs to a node or vehicle."""
    return full_name.strip('/').replace('/', '.')


def separate(nodes: Iterable[NodeSpec]) -> list[ProcessSpec]:
    """Each node in a process of its own."""
    return [ProcessSpec((node,)) for node in nodes]


def composed(nodes: Iterable[NodeSpec]) -> list[ProcessSpec]:
    """Nodes of one vehicle in one process; processes in the order of their stages.

    Alone are those of the root (truth, water, recorder), each of which has an end of its own, and
    those that are started again when they die, which no other shall do with them.
    """
    together: dict[str, list[NodeSpec]] = {}
    processes: list[ProcessSpec] = []
    for node in nodes:
        if node.namespace and not node.respawns:
            together.setdefault(node.namespace, []).append(node)
        else:
            processes.append(ProcessSpec((node,)))
    # A vehicle's nodes from upstream to downstream, as they are ended.
    vehicles = [sorted(group, key=lambda node: node.stage) for group in together.values()]
    processes += [ProcessSpec(tuple(group)) for group in vehicles]
    return sorted(processes, key=lambda process: process.stage)


def processes_of(graph: Graph) -> list[ProcessSpec]:
    """Processes of a graph, as its options say."""
    return (composed if graph.options.composed else separate)(graph.nodes)
