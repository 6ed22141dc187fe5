"""Parameters of follower_node and of an offline replay: the engine's and the link's."""

from __future__ import annotations

from dataclasses import dataclass

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.output_params import OutputParams
from polar_nav_core.params import flag, param, text


@dataclass(frozen=True)
class FollowerParams(EngineParams, OutputParams):
    """Parameters of follower_node and of an offline replay."""

    leader_id: int = param(1, '', 0, 255, 'Number of the leader or the station in its packets')
    own_id: int = param(2, '', 0, 255, 'Number of this vehicle in the packets')
    sources: str = text(
        '', 'Mapping file of the sensors and fixes (docs/live.md); empty: topics of this project'
    )
    state_file: str = text(
        '', 'File that the state is saved to, and restored from after a restart; empty: none'
    )
    state_period_s: float = param(5.0, 's', 0.1, 3600.0, 'Stamp time between two saved states')
    state_max_age_s: float = param(
        60.0, 's', 0.0, 3600.0, 'Oldest saved state from which navigation goes on'
    )
    autostart: bool = flag(
        True, 'Navigate and publish at once; false: wait for the lifecycle transitions'
    )
    frame_id: str = text('earth', 'frame_id of positions')
