"""Whatever the sources of a mapping file and the services bring: navigation goes on."""

import math

import numpy as np
import pytest
from closed_loop import START_NS, World
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip('rclpy')

from geometry_msgs.msg import TwistWithCovarianceStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import FluidPressure, Imu, NavSatFix, NavSatStatus

from polar_nav_core import attitude, earth
from polar_nav_follower.params import FollowerParams
from polar_nav_follower.session import Session
from polar_nav_msgs.msg import Command, NavState
from polar_nav_ros import topics
from polar_nav_ros.adapters.live import Sources, Taken
from polar_nav_ros.adapters.mapping_file import parse
from polar_nav_ros.source_ports import bound
from polar_nav_ros.stamps import to_msg

MAPPING = """
version: 2
vehicle: auv
imu: {topic: /imu, type: sensor_msgs/msg/Imu, rotation: flu, lever_b: [0.4, -0.2, 0.1]}
heading: {topic: /ahrs, type: sensor_msgs/msg/Imu, rotation: flu, world: enu, reference: grid,
  bias_sigma_deg: 2.0}
dvl: {topic: /dvl, type: geometry_msgs/msg/TwistWithCovarianceStamped, reference: bottom,
  sigma: 0.02}
depth: {topic: /pressure, type: sensor_msgs/msg/FluidPressure, sigma: 0.1}
fixes: {topic: /gnss, type: sensor_msgs/msg/NavSatFix, source: gnss, sigma: 2.0, delay_s: 0.3}
noise: {imu: vn100, dvl: a50_standard}
"""
SECONDS = 14.0
ODD = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True, width=64),
    st.sampled_from([0.0, -1.0, 5e-324, 1e-300, 1e12, 1e300, 90.0, 360.0, math.nan]),
)
STAMPS = st.one_of(
    st.integers(START_NS, START_NS + round(SECONDS * 1e9)),
    st.sampled_from([0, START_NS + 10**15, (2**31 - 1) * 10**9]),
)
KINDS = {
    topics.IMU: Imu,
    topics.DVL: TwistWithCovarianceStamped,
    topics.DEPTH: FluidPressure,
    topics.HEADING: Imu,
    '/gnss': NavSatFix,
}


def leaves(message):
    """Messages within a message, and the names of their floats and arrays of floats."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if hasattr(value, 'get_fields_and_field_types'):
            yield from leaves(value)
        elif kind == 'double':
            yield message, name, 0
        elif kind.startswith('double['):
            yield message, name, len(value)


@st.composite
def strange(draw):
    """A message of a source of which some numbers are any, or a command with any initial state."""
    topic = draw(st.sampled_from([*KINDS, topics.COMMAND]))
    message = KINDS.get(topic, Command)()
    found = list(leaves(message))
    for inner, name, size in draw(st.lists(st.sampled_from(found), max_size=8)):
        value = draw(ODD)
        setattr(inner, name, [value] * size if size else value)
    message.header.stamp = to_msg(draw(STAMPS))
    if topic == topics.COMMAND:
        # A command is the node's own: it has the stamp of the newest sample.
        message.kind = Command.SET_INITIAL_STATE
    elif topic == '/gnss':
        message.status.status = draw(st.integers(-1, 2))
    return topic, message


def good_stream(world):
    """Time, topic and message of all sources in the order of arrival."""
    out = []
    lat, lon, height = (np.asarray(v) for v in earth.geodetic_from_ecef(world.r_e))
    for k, sample in enumerate(world.imu()):
        ns = sample.stamp_ns
        imu = Imu()
        w, f = imu.angular_velocity, imu.linear_acceleration
        w.x, w.y, w.z = (float(v) for v in sample.omega_ib_b)
        f.x, f.y, f.z = (float(v) for v in sample.f_b)
        messages = [(topics.IMU, imu)]
        if k % 20 == 10:
            i = k + 1
            twist = TwistWithCovarianceStamped()
            v = twist.twist.twist.linear
            v.x, v.y, v.z = (float(a) for a in world.C_b_G[i].T @ world.v_G[i])
            pressure = FluidPressure(fluid_pressure=101325.0 + 1.01e6)
            messages += [(topics.DVL, twist), (topics.DEPTH, pressure)]
            ahrs = Imu()
            x, y, z, q = attitude.quaternion_from_matrix(world.C_b_G[i]).tolist()
            o = ahrs.orientation
            o.x, o.y, o.z, o.w = x, y, z, q
            messages.append((topics.HEADING, ahrs))
        if k % 200 == 150:
            fix = NavSatFix(
                latitude=math.degrees(lat[k + 1]),
                longitude=math.degrees(lon[k + 1]),
                altitude=float(height[k + 1]),
            )
            fix.status.status = NavSatStatus.STATUS_FIX
            messages.append(('/gnss', fix))
        for topic, message in messages:
            message.header.stamp = to_msg(ns)
            out.append((ns, topic, message))
    return out


@pytest.fixture(scope='module')
def world():
    return World(SECONDS)


def sail(world, stream):
    """Session that took a stream, and the stamps and positions of its estimates."""
    mapping = parse(MAPPING, 'mapping.yaml')
    params = world.params(FollowerParams, **mapping.params)
    sources = Sources(mapping, params)
    bound(sources)
    run = Session(params, 'auv', sources)
    states = []
    for arrival_ns, topic, message in stream:
        source = sources.of(topic)
        taken = message
        if source is not None:
            own_ns = source.own_stamp_ns(message, arrival_ns)
            taken = Taken(message, arrival_ns, source.validity_ns(own_ns, arrival_ns))
        else:
            message.header.stamp = to_msg(run.reorder.newest_imu_ns or 0)
        states += [p.data for p in run.take(topic, taken, arrival_ns) if p.topic == topics.STATE]
    states += [p.data for p in run.flush() if p.topic == topics.STATE]
    return run, [deserialize_message(data, NavState) for data in states]


def check(world, data, most):
    stream = good_stream(world)
    # Not in the last seconds, in which it has to navigate.
    room = [i for i, (ns, _, _) in enumerate(stream) if ns < START_NS + (SECONDS - 4.0) * 1e9]
    for topic, message in data.draw(st.lists(strange(), max_size=most)):
        place = data.draw(st.integers(1, len(room)))
        stream.insert(place, (stream[place][0], topic, message))
    run, states = sail(world, stream)
    assert run.engine.navigating, run.engine.divergence
    last_ns = states[-1].header.stamp.sec * 10**9 + states[-1].header.stamp.nanosec
    assert last_ns > START_NS + (SECONDS - 1.0) * 1e9
    assert np.isfinite(states[-1].r_e).all()
    assert np.isfinite(states[-1].position_covariance_g).all()


def test_the_stream_is_good_without_them(world):
    run, states = sail(world, good_stream(world))
    assert set(run.engine.fused) >= {'dvl', 'depth', 'heading'}
    assert run.engine.fix_counts()[1] >= 5
    assert np.linalg.norm(states[-1].r_e - world.r_e[-1]) < 10.0


@pytest.mark.slow
@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_nothing_that_a_source_says_ends_navigation(world, data):
    check(world, data, most=12)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.timeout(3600)
@settings(max_examples=600, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_nothing_that_a_source_says_ends_navigation_for_long(world, data):
    check(world, data, most=40)
