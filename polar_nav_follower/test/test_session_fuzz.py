"""Whatever comes in on the topics: no exception, and a receipt for every packet."""

import numpy as np
import pytest
from closed_loop import START_NS, World
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip('rclpy')

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu

from polar_nav_core.link import packet
from polar_nav_follower import session
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import AcousticPacket, Depth, Dvl, FixReceipt, NavState
from polar_nav_ros import topics
from polar_nav_ros.stamps import to_msg

ODD = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True, width=64),
    st.sampled_from([0.0, -1.0, 1e-300, 1e300, 9.8, float('nan')]),
)
TIMES = st.one_of(
    st.integers(START_NS, START_NS + 12 * 10**9),
    st.sampled_from([0, START_NS + 10**15, 2**31 * 10**9 - 1]),
)


@st.composite
def strange_messages(draw):
    kind = draw(st.sampled_from([topics.IMU, topics.DVL, topics.DEPTH, topics.RX]))
    stamp = to_msg(draw(TIMES))
    values = draw(st.lists(ODD, min_size=6, max_size=6))
    if kind == topics.IMU:
        message = Imu()
        w, f = message.angular_velocity, message.linear_acceleration
        w.x, w.y, w.z, f.x, f.y, f.z = values
    elif kind == topics.DVL:
        message = Dvl(num_good_beams=draw(st.integers(0, 4)))
        message.velocity.x, message.velocity.y, message.velocity.z = values[:3]
        message.velocity_covar = np.diag(values[3:]).reshape(9)
    elif kind == topics.DEPTH:
        message = Depth(depth=values[0], variance=values[1])
    else:
        message = AcousticPacket(source='leader', destination='follower')
        message.data = draw(st.binary(max_size=2 * packet.SIZE))
        message.transmit_time = to_msg(draw(TIMES))
        message.receive_time = to_msg(draw(TIMES))
        message.sequence = draw(st.integers(0, 2**32 - 1))
    message.header.stamp = stamp
    return kind, message


@st.composite
def strange_packets(draw):
    """Packets with a good CRC and any content."""
    size = packet.SIZE - 2
    body = bytearray(draw(st.binary(min_size=size, max_size=size)))
    body[0:3] = bytes([packet.VERSION, draw(st.integers(1, 2)), 2])
    data = bytes(body) + packet.crc16(bytes(body)).to_bytes(2, 'little')
    message = AcousticPacket(source='leader', destination='follower', data=data)
    message.receive_time = to_msg(draw(TIMES))
    return topics.RX, message


def good_stream(world):
    out = []
    for sample in world.imu():
        message = Imu()
        message.header.stamp = to_msg(sample.stamp_ns)
        w, f = message.angular_velocity, message.linear_acceleration
        w.x, w.y, w.z = (float(v) for v in sample.omega_ib_b)
        f.x, f.y, f.z = (float(v) for v in sample.f_b)
        out.append((topics.IMU, message))
    return out


@pytest.fixture(scope='module')
def world():
    return World(10.0)


@pytest.mark.slow
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_nothing_that_comes_in_raises(world, data):
    strange = data.draw(st.lists(st.one_of(strange_messages(), strange_packets()), max_size=25))
    stream = good_stream(world)
    for item in strange:
        stream.insert(data.draw(st.integers(0, len(stream))), item)
    run = session.Session(world.params(FollowerParams, configuration='default'), 'follower')
    receipts = states = 0
    for topic, message in stream:
        for published in run.take(topic, message):
            receipts += published.topic == topics.RECEIPT and _is_fix(published)
            states += published.topic == topics.STATE
    for published in run.flush():
        receipts += published.topic == topics.RECEIPT and _is_fix(published)
        states += published.topic == topics.STATE
        if published.topic == topics.STATE:
            deserialize_message(published.data, NavState)
    assert receipts == sum(topic == topics.RX for topic, _ in stream)
    assert states or run.engine.divergence or run.engine.verdicts


def _is_fix(published):
    return deserialize_message(published.data, FixReceipt).topic == topics.RX
