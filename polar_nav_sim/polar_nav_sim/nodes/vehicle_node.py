"""vehicle_node: truth_node for missions whose vehicles have dynamics, e.g. ``station``.

The same node under another name and with another default: it owns /clock and the windows of the
lockstep, publishes ``<v>/truth`` of every vehicle, and of those with dynamics
``<v>/control/thrust`` and ``<v>/truth/model``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from polar_nav_core.errors import ConfigError
from polar_nav_ros.process import run

from ..params import VehicleParams
from .truth_node import TruthNode


class VehicleNode(TruthNode):
    """The one source of time and motion, of vehicles that move by their dynamics."""

    def __init__(self, **kwargs: Any) -> None:  # noqa: ANN401 - passed on to rclpy
        super().__init__('vehicle_node', VehicleParams, **kwargs)
        if not self.mission.dynamic:
            raise ConfigError(
                f'parameter mission: {self.params.mission!r} has no vehicle with dynamics; use'
                ' truth_node'
            )


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(VehicleNode, args)
