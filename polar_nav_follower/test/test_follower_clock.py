"""Session of a follower across a step of its clocks: live equals replay, byte for byte."""

import pytest

pytest.importorskip('rclpy')

from sensor_msgs.msg import Imu

from polar_nav_follower.params import FollowerParams
from polar_nav_follower.session import Session
from polar_nav_msgs.msg import Depth
from polar_nav_ros.navigation_outputs import clock_step_from_msg
from polar_nav_ros.stamps import to_msg, to_ns
from polar_nav_ros.topics import CLOCK_STEP, DEPTH, IMU, RECEIPT, STATE

START_NS = 1_772_323_200_000_000_000
STEP_NS = 10_000_000


def messages(by_ns):
    """Arrival, topic and message of a vehicle at rest whose clocks step after 4 s."""
    out = []
    for k in range(800):
        stamp_ns = START_NS + k * STEP_NS
        own = to_msg(stamp_ns + (by_ns if k >= 400 else 0))
        imu = Imu()
        imu.header.stamp = own
        imu.linear_acceleration.z = 9.83 + 1e-9 * (k % 7)
        out.append((stamp_ns, IMU, imu))
        if k % 20 == 0:
            depth = Depth(depth=100.0 + 0.01 * (k % 3), variance=0.01)
            depth.header.stamp = own
            out.append((stamp_ns, DEPTH, depth))
    return out


@pytest.mark.slow
@pytest.mark.parametrize('by_s', [3600, -10, 2, -2])
def test_live_equals_replay_across_a_step_of_all_clocks(by_s):
    params = FollowerParams()
    live = Session(params, 'follower')
    published = []
    for arrival_ns, topic, message in messages(by_s * 10**9):
        published += live.take(topic, message, arrival_ns)
    published += live.flush()

    replay = Session(params, 'follower')
    steps = [p.message for p in published if p.topic == CLOCK_STEP]
    assert {s.source.split()[0] for s in steps} == {IMU, DEPTH}
    for step in steps:
        replay.engine.clock.note(clock_step_from_msg(step))
    events = [replay.recorded_event_of(t, m) for _, t, m in messages(by_s * 10**9)]
    replayed = []
    for event in sorted(events, key=lambda e: e.key):
        replayed += replay.process(event)
    replayed += replay.flush()
    for topic, least in ((STATE, 80), (RECEIPT, 0)):
        found = [p.data for p in published if p.topic == topic]
        assert len(found) >= least
        assert found == [p.data for p in replayed if p.topic == topic]
    last = [p.message for p in published if p.topic == STATE][-1]
    moved_ns = to_ns(live.odometry(last).header.stamp) - to_ns(last.header.stamp)
    assert moved_ns == to_ns(replay.odometry(last).header.stamp) - to_ns(last.header.stamp)
    assert moved_ns == by_s * 10**9


def test_a_damaged_step_is_refused():
    from sensor_msgs.msg import TimeReference

    for source in ('', 'imu/data_raw', 'imu/data_raw -1', 'imu/data_raw x'):
        with pytest.raises(ValueError, match='not a topic and a number'):
            clock_step_from_msg(TimeReference(source=source))
