"""Recorded topics of a graph: which of the root and of each vehicle, with their types."""

from __future__ import annotations

from typing import TYPE_CHECKING

from polar_nav_ros import topics

from .instruments import own_aiding_topics

if TYPE_CHECKING:
    from polar_nav_sim.mission import Mission

_SENSOR_TOPICS = (
    topics.TRUTH,
    topics.IMU,
    topics.DVL,
    topics.DVL_TWIST,
    topics.PRESSURE,
    topics.DEPTH,
    topics.ODOMETRY,
)
_LEADER_TOPICS = (
    topics.USBL,
    topics.BROADCAST,
    topics.TX,
    topics.RX,
)
NAVIGATION_TOPICS = (
    topics.STATE,
    topics.RECEIPT,
    topics.HEALTH,
    topics.CLOCK_STEP,
    topics.COMMAND,
    topics.FIX,
)
_FOLLOWER_TOPICS = (
    topics.RX,
    topics.DECODED,
    *NAVIGATION_TOPICS,
)
_ROOT_TOPICS = (
    topics.CLOCK,
    topics.DIAGNOSTICS,
    topics.RUN_INFO,
)


def recorded_topics(leader: str, follower: str, navigates: str = 'perfect') -> dict[str, str]:
    """Recorded topics of the graph, each with its message type."""
    own = (*NAVIGATION_TOPICS, topics.ABSOLUTE) if navigates == 'own' else ()
    return {
        **topics_of_the_root(),
        **topics.of_vehicle(leader, (*_SENSOR_TOPICS, *_LEADER_TOPICS, *own)),
        **topics.of_vehicle(follower, (*_SENSOR_TOPICS, *_FOLLOWER_TOPICS)),
    }


def topics_of_the_root() -> dict[str, str]:
    """Recorded topics that belong to no vehicle, each with its message type."""
    return {topic: topics.TYPES[topic] for topic in _ROOT_TOPICS}


def topics_alone(mission: Mission, follower: str) -> dict[str, str]:
    """Recorded topics of a vehicle without a leader, each with its message type."""
    return {
        **topics.of_vehicle(follower, (*_SENSOR_TOPICS, *NAVIGATION_TOPICS, topics.INPUTS)),
        **own_aiding_topics(mission),
    }
