"""A case of an experiment on evidence: a scene, what is done to its world, a filter's settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ..mismatch.judge import Course
from ..mismatch.scenes import Scene
from ..world import World

Shape = Callable[[Any], Any]
Measure = Callable[[Course], dict[str, float]]


def unchanged(world: World) -> World:
    """Return the world as it is."""
    return world


def nothing_more(course: Course) -> dict[str, float]:
    """Return no further metric."""
    del course
    return {}


@dataclass(frozen=True)
class Case:
    """One row of a table: all columns of a seed run in the same world.

    Attributes
    ----------
    name : str
    scene : SinsScene or StationScene
    shape : callable
        Makes the world of the case from that of the scene; a function or object of a module, for
        it goes to other processes.
    measure : callable
        Further metrics of a run.
    columns : mapping
        Engine parameters of each filter that is run, by column.
    """

    name: str
    scene: Scene
    columns: Mapping[str, Mapping[str, Any]]
    shape: Shape = unchanged
    measure: Measure = nothing_more
    watched: bool = True
    """Whether the watchdog looks once a second, which takes longer than the filter."""
    fixed: tuple[str, ...] = ()
    """Columns of reference, which `--set` leaves as they are."""
    about: Mapping[str, object] = field(default_factory=dict)
    """Cells of the table that describe the case."""
