"""Whatever comes in on the topics of station mode: no exception, a receipt for every packet."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip('rclpy')

from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu

from polar_nav_core.link import station_packet
from polar_nav_core.link.packet import crc16
from polar_nav_follower import session
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import AcousticPacket, Command, Depth, FixReceipt, NavState
from polar_nav_ros import topics
from polar_nav_ros.stamps import to_msg

START_NS = 1_772_323_200_000_000_000
PARAMS = FollowerParams(mode='station', configuration='default', reorder_window_s=0.2)
ODD = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True, width=64),
    st.sampled_from([0.0, -1.0, 1e-300, 1e300, 9.8, float('nan')]),
)
TIMES = st.one_of(
    st.integers(START_NS, START_NS + 6 * 10**9),
    st.sampled_from([0, START_NS + 10**15, 2**31 * 10**9 - 1]),
)


@st.composite
def strange_messages(draw):
    kind = draw(
        st.sampled_from([topics.AHRS, topics.CONTROL, topics.DEPTH, topics.RX, topics.COMMAND])
    )
    values = draw(st.lists(ODD, min_size=11, max_size=11))
    if kind == topics.AHRS:
        message = Imu()
        w, f, q = message.angular_velocity, message.linear_acceleration, message.orientation
        w.x, w.y, w.z, f.x, f.y, f.z, q.x, q.y, q.z, q.w = values[:10]
        message.orientation_covariance[0] = values[10]
    elif kind == topics.CONTROL:
        message = WrenchStamped()
        force, torque = message.wrench.force, message.wrench.torque
        force.x, force.y, force.z, torque.x, torque.y, torque.z = values[:6]
    elif kind == topics.DEPTH:
        message = Depth(depth=values[0], variance=values[1])
    elif kind == topics.COMMAND:
        message = Command(kind=Command.IDENTIFY, sequence=draw(st.integers(0, 2**40)))
    else:
        message = AcousticPacket(source='station', destination='auv')
        message.data = draw(st.one_of(st.binary(max_size=60), whole_packets()))
        message.transmit_time, message.receive_time = to_msg(draw(TIMES)), to_msg(draw(TIMES))
        message.sequence = draw(st.integers(0, 2**32 - 1))
    message.header.stamp = to_msg(draw(TIMES))
    return kind, message


@st.composite
def whole_packets(draw):
    """Packets with a good CRC and any content."""
    size = station_packet.SIZE - 2
    body = bytearray(draw(st.binary(min_size=size, max_size=size)))
    body[0:3] = bytes([station_packet.VERSION, draw(st.integers(1, 2)), 2])
    return bytes(body) + crc16(bytes(body)).to_bytes(2, 'little')


def good_stream(seconds):
    out = []
    for k in range(round(100 * seconds)):
        stamp = to_msg(START_NS + 10_000_000 * k)
        if k % 10 == 0:
            thrust = WrenchStamped()
            thrust.header.stamp = stamp
            thrust.wrench.force.x = 40.0
            out.append((topics.CONTROL, thrust))
        message = Imu()
        message.header.stamp = stamp
        message.angular_velocity.z = 0.02
        message.linear_acceleration.z = 9.83
        out.append((topics.AHRS, message))
    return out


@pytest.mark.slow
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_nothing_that_comes_in_raises(data):
    strange = data.draw(st.lists(strange_messages(), max_size=25))
    stream = good_stream(4.0)
    for item in strange:
        stream.insert(data.draw(st.integers(0, len(stream))), item)
    run = session.Session(PARAMS, 'auv')
    published = [p for topic, message in stream for p in run.take(topic, message)]
    published += run.flush()
    states = [p for p in published if p.topic == topics.STATE]
    receipts = [
        deserialize_message(p.data, FixReceipt) for p in published if p.topic == topics.RECEIPT
    ]
    packets = sum(topic == topics.RX for topic, _ in stream)
    assert sum(r.topic == topics.RX for r in receipts) == packets
    assert states or run.engine.divergence or run.engine.verdicts
    for p in states[-3:]:
        assert np.isfinite(deserialize_message(p.data, NavState).r_e).all()
