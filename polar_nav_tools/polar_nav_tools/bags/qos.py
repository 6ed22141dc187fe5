"""Quality of service in the form of a bag, without ROS.

`ros2 bag play` offers each topic again with the recorded profile.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import yaml

# rmw's "infinite" duration, as rosbag2 writes it.
_FOREVER = {'sec': 9223372036, 'nsec': 854775807}


@dataclass(frozen=True)
class Qos:
    """One offered profile; words as in rosbag2's metadata."""

    reliability: str = 'reliable'
    durability: str = 'volatile'
    history: str = 'keep_last'
    depth: int = 10
    liveliness: str = 'automatic'

    def to_dict(self) -> dict[str, Any]:
        """Return the mapping that rosbag2 (metadata version 9) writes."""
        return {
            'history': self.history,
            'depth': self.depth,
            'reliability': self.reliability,
            'durability': self.durability,
            'deadline': dict(_FOREVER),
            'lifespan': dict(_FOREVER),
            'liveliness': self.liveliness,
            'liveliness_lease_duration': dict(_FOREVER),
            'avoid_ros_namespace_conventions': False,
        }


def to_yaml(profiles: Sequence[Qos]) -> str:
    """Return the text of a channel's ``offered_qos_profiles``; empty for none."""
    if not profiles:
        return ''
    return yaml.safe_dump([q.to_dict() for q in profiles], sort_keys=False).strip()


def request_for(offered: Sequence[Qos]) -> tuple[bool, bool]:
    """Request (reliable, transient local) of a subscription that every offer satisfies.

    A stricter request than one publisher offers would not match that publisher at all.
    """
    reliable = all(q.reliability != 'best_effort' for q in offered)
    latched = bool(offered) and all(q.durability == 'transient_local' for q in offered)
    return reliable, latched
