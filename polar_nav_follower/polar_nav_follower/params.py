"""Parameters of follower_node and of an offline replay: the engine's and the link's."""

from __future__ import annotations

from dataclasses import dataclass

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.params import param, text


@dataclass(frozen=True)
class FollowerParams(EngineParams):
    """Parameters of follower_node and of an offline replay."""

    leader_id: int = param(1, '', 0, 255, 'Number of the leader or the station in its packets')
    own_id: int = param(2, '', 0, 255, 'Number of this vehicle in the packets')
    frame_id: str = text('earth', 'frame_id of positions')
