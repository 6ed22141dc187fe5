"""Commands that switch a sensor off and on: a replay gives the bytes that were published live."""

import numpy as np
import pytest
from closed_loop import START_NS, World

pytest.importorskip('rclpy')

from sensor_msgs.msg import Imu

from polar_nav_core.engine.events import CommandKind
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_follower import session
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import Command, Depth, Dvl
from polar_nav_ros import topics
from polar_nav_ros.stamps import to_msg, to_ns

LATE_NS = 37_000_000
"""By which messages of the DVL and of the depth sensor come later than their stamps."""


def messages(world):
    """(arrival, topic, message) of a vehicle's sensors, in order of arrival."""
    rng = np.random.default_rng(4)
    out = []
    for sample in world.imu():
        message = Imu()
        w, f = message.angular_velocity, message.linear_acceleration
        w.x, w.y, w.z = (float(v) for v in sample.omega_ib_b)
        f.x, f.y, f.z = (float(v) for v in sample.f_b)
        out.append((sample.stamp_ns, topics.IMU, message))
    for ping in world.dvl(rng=rng):
        message = Dvl(velocity_mode=Dvl.DVL_MODE_BOTTOM, num_good_beams=4)
        v = message.velocity
        v.x, v.y, v.z = (float(x) for x in ping.v_m)
        message.velocity_covar = ping.covariance_m.reshape(9)
        out.append((ping.stamp_ns, topics.DVL, message))
    for sample in world.depth(rng=rng):
        message = Depth(depth=float(sample.depth), variance=float(sample.variance))
        out.append((sample.stamp_ns, topics.DEPTH, message))
    for stamp_ns, _, message in out:
        message.header.stamp = to_msg(stamp_ns)
    late = [(s + (LATE_NS if t != topics.IMU else 0), t, m) for s, t, m in out]
    return sorted(late, key=lambda row: row[0])


def switch(kind, topic, number, stamp_ns):
    message = Command(kind=int(kind), sequence=number, taken_topics=[topic], taken_counts=[0])
    message.header.stamp = to_msg(stamp_ns)
    return message


def test_live_equals_replay_with_sensors_switched_off_and_on():
    world = World(10.0)
    params = world.params(FollowerParams, configuration='default', reorder_window_s=0.1)
    live = session.Session(params, 'follower')
    calls = iter(
        [
            (3, CommandKind.SENSOR_OFF, topics.DVL),
            (4, CommandKind.SENSOR_OFF, topics.DEPTH),
            (6, CommandKind.SENSOR_ON, topics.DVL),
            (8, CommandKind.SENSOR_ON, topics.DEPTH),
            (99, None, None),
        ]
    )
    recorded, published, due, number = [], [], next(calls), 0
    for arrival_ns, topic, message in messages(world):
        if arrival_ns >= START_NS + due[0] * 10**9:
            command = switch(due[1], due[2], number, live.reorder.newest_imu_ns)
            recorded.append((topics.COMMAND, command))
            published += live.take(topics.COMMAND, command)
            due, number = next(calls), number + 1
        recorded.append((topic, message))
        published += live.take(topic, message)
    published += live.flush()

    again = session.Session(params, 'follower')
    events = [again.recorded_event_of(topic, message) for topic, message in recorded]
    replayed = []
    for event in sorted(events, key=lambda e: e.key):
        replayed += again.process(event)
    replayed += again.advance(to_ns(recorded[-1][1].header.stamp) + 10**9)
    assert [(p.topic, p.data) for p in published] == [(p.topic, p.data) for p in replayed]

    refused = [p.message for p in published if p.topic == topics.RECEIPT]
    assert {r.verdict for r in refused} == {int(Verdict.SWITCHED_OFF)}
    assert {r.topic for r in refused} == {topics.DVL, topics.DEPTH}
    health = [p.message for p in published if p.topic == topics.HEALTH]
    named = [h for h in health if any('switched off' in c for c in h.conditions)]
    assert 4 <= len(named) <= 6


@pytest.mark.parametrize('named', [[], ['dvl/data', 'depth/data']])
def test_a_command_that_names_no_sensor_or_several_is_refused(named):
    message = Command(kind=int(CommandKind.SENSOR_OFF), taken_topics=named)
    run = session.Session(FollowerParams(), 'follower')
    with pytest.raises(ValueError, match='names one topic'):
        run.event_of(topics.COMMAND, message)
