"""Topic names: each has a type, and the engine's events name the topics that carry them."""

import pytest

from polar_nav_core.engine import events
from polar_nav_ros import topics

NAMES = {v for k, v in vars(topics).items() if k.isupper() and isinstance(v, str)}


def test_every_topic_has_a_type():
    assert set(topics.TYPES) == NAMES


@pytest.mark.parametrize(
    ('event', 'topic'),
    [
        (events.ImuSample, topics.IMU),
        (events.ControlSample, topics.CONTROL),
        (events.DvlPing, topics.DVL),
        (events.DepthSample, topics.DEPTH),
        (events.Fix, topics.RX),
        (events.Command, topics.COMMAND),
    ],
)
def test_events_of_the_engine_name_the_topic_that_carries_them(event, topic):
    assert event.__dataclass_fields__['topic'].default == topic
