"""A row of the experiment `faults`: what is injected into which scene."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from polar_nav_sim.offline_station import StationScenario

from ...inject.faults import Injection
from ..mismatch.row import scene_of
from ..mismatch.scenes import Scene, SinsScene, StationScene

START_S = 120.0
DURATION_S = START_S + 160.0
"""Length of a run: a fault of 60 s, a minute, ten fixes."""


@dataclass(frozen=True)
class Row:
    """Injected faults in a scene.

    Attributes
    ----------
    name : str
    injections : tuple of Injection
        One, or several that act one after another.
    scene : SinsScene or StationScene
    """

    name: str
    injections: tuple[Injection, ...]
    scene: Scene

    @property
    def mode(self) -> str:
        """Mode of the engine."""
        return self.scene.mode

    @property
    def at_s(self) -> float:
        """When the first one begins [s]."""
        return min(one.at_s for one in self.injections)

    @property
    def end_s(self) -> float:
        """When the last one ends; infinite if one lasts [s]."""
        return max(one.end_s for one in self.injections)

    @property
    def about(self) -> str:
        """What they are, in words."""
        return '; '.join(one.fault.doc for one in self.injections)

    @property
    def text(self) -> str:
        """As on the command line."""
        return ' '.join(one.text for one in self.injections)


def inertial(**world: Any) -> SinsScene:  # noqa: ANN401 - of WorldSpec
    """The inertial scene of the rows, in another world."""
    return scene_of(duration_s=DURATION_S, **world)


def station() -> StationScene:
    """The scene of the rows of station mode."""
    return StationScene(replace(StationScenario(), duration_s=DURATION_S))
