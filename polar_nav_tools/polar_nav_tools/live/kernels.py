"""Kernels that the nodes of a graph load at their start, while others are compiled.

After the first set-up all kernels are compiled in the background for minutes. A node that waits
for its own does not answer meanwhile: the graph starts when those are there, and not when all are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

from polar_nav_core import background
from polar_nav_core.engine.params import EngineParams

from ..graph.build import Graph, follower_parameters


def wait_for_kernels(graph: Graph, say: Callable[[str], None] = background.to_stderr) -> None:
    """Load here what the graph's follower will load, if that is still to be compiled.

    A leader that navigates by itself loads no others.
    """
    if not background.compiles():
        return
    from polar_nav_core.warm import telling, warm_engine  # brings numba, which others do without

    say('the graph waits for the kernels of its nodes')
    with telling(lambda text: say(f'the graph waits: {text}'), every_s=15.0):
        warm_engine(engine_parameters(graph))


def engine_parameters(graph: Graph) -> EngineParams:
    """Return the parameters of the follower that are its engine's."""
    known = {f.name for f in fields(EngineParams)}
    stated = follower_parameters(graph)
    return EngineParams(**{name: v for name, v in stated.items() if name in known})  # type: ignore[arg-type]
