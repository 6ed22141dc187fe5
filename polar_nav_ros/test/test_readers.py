"""Messages of sensors as events: one by one, and as columns, with the same bits."""

import contextlib

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

pytest.importorskip('rclpy')

from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu

from polar_nav_core import attitude
from polar_nav_core.dvl import sound_speed_factors
from polar_nav_msgs.msg import Depth, Dvl
from polar_nav_ros import readers

NUMBER = st.floats(allow_nan=True, allow_infinity=True, width=64)
SMALL = st.floats(-2.0, 2.0)
LENGTH = st.sampled_from([1.0, 1.0 + 2e-4, 1.0 - 9.99e-4, 1.0 + 1e-3, 1.0 - 1e-3, 1.1, 0.0])


def direction(values):
    q = np.array(values)
    norm = np.linalg.norm(q)
    return q / norm if norm > 1e-3 else np.array([0.0, 0.0, 0.0, 1.0])


UNIT = st.tuples(SMALL, SMALL, SMALL, SMALL).map(direction)
QUATERNION = st.one_of(
    st.tuples(UNIT, LENGTH).map(lambda pair: tuple((pair[0] * pair[1]).tolist())),
    st.tuples(NUMBER, NUMBER, NUMBER, NUMBER),
)
COVARIANCE = st.one_of(st.sampled_from([-1.0, 0.0, 1e-4]), NUMBER)
FEW = settings(max_examples=60, deadline=None)


def ahrs(xyzw, covariance):
    message = Imu()
    o = message.orientation
    o.x, o.y, o.z, o.w = xyzw
    message.orientation_covariance[0] = covariance
    return message


@FEW
@example([((0.0, 0.0, 0.0, 1.001), 0.0), ((1e200, 1e200, 0.0, 0.0), 0.0)])
@given(st.lists(st.tuples(QUATERNION, COVARIANCE), min_size=1, max_size=12))
def test_attitudes_as_columns_are_those_of_the_messages(rows):
    found = readers.attitudes(np.array([q for q, _ in rows]), np.array([c for _, c in rows]))
    for (q, covariance), C_b_G in zip(rows, found, strict=True):
        one = readers.ahrs_from_msg(ahrs(q, covariance), 0).C_b_G
        np.testing.assert_array_equal(C_b_G, np.full((3, 3), np.nan) if one is None else one)


def test_an_attitude_is_of_a_quaternion_whose_length_is_one():
    q = attitude.quaternion_from_matrix(attitude.matrix_from_euler(0.3, -0.2, 2.0))
    lengths = np.array([1.0, 1.0009, 0.9991, 1.002, 0.998, 0.0, np.nan, np.inf])
    found = readers.attitudes(lengths[:, None] * q, np.zeros(len(lengths)))
    usable = np.isfinite(found).all((1, 2))
    np.testing.assert_array_equal(usable, [True, True, True] + [False] * 5)
    np.testing.assert_allclose(found[1], attitude.matrix_from_quaternion(q), atol=1e-15)
    assert np.isnan(readers.attitudes(q[None], np.array([-1.0]))).all()


PING = st.tuples(
    st.tuples(NUMBER, NUMBER, NUMBER),
    st.tuples(COVARIANCE, *[NUMBER] * 8),
    st.integers(0, 255),
    st.integers(0, 4),
    st.sampled_from([0.0, 900.0, 1439.0, 1500.0, np.nan]),
    st.sampled_from([Dvl.DVL_TYPE_PISTON, Dvl.DVL_TYPE_PHASED_ARRAY]),
)


def ping_of(v_m, covariance, mode, beams, speed, kind):
    message = Dvl(velocity_mode=mode, num_good_beams=beams, velocity_covar=covariance)
    message.velocity.x, message.velocity.y, message.velocity.z = v_m
    message.sound_speed, message.dvl_type = speed, kind
    return message


@pytest.mark.parametrize('kind', [Dvl.DVL_TYPE_PISTON, Dvl.DVL_TYPE_PHASED_ARRAY])
def test_a_velocity_is_corrected_by_both_sound_speeds(kind):
    message = ping_of(
        (1.5, -0.2, 0.1), (4e-4, 1e-5, 2e-5) * 3, Dvl.DVL_MODE_BOTTOM, 4, 1500.0, kind
    )
    plain = readers.dvl_from_msg(message, 0, 0.02)
    found = readers.dvl_from_msg(message, 0, 0.02, 1440.0)
    level = 1.0 if kind == Dvl.DVL_TYPE_PHASED_ARRAY else 0.96
    factors = np.array([level, level, 0.96])
    np.testing.assert_allclose(found.v_m, factors * plain.v_m, rtol=1e-15)
    np.testing.assert_allclose(
        found.covariance_m, np.outer(factors, factors) * plain.covariance_m, rtol=1e-15
    )
    message.velocity_covar[0] = -1.0  # the parameter is of the corrected velocity
    found = readers.dvl_from_msg(message, 0, 0.02, 1440.0)
    np.testing.assert_array_equal(found.covariance_m, 0.02**2 * np.eye(3))


@FEW
@example(
    [
        ((1.0, 0.0, 0.0), (1e-4,) * 9, Dvl.DVL_MODE_BOTTOM, beams, 1500.0, Dvl.DVL_TYPE_PISTON)
        for beams in range(5)
    ],
    1440.0,
)
@given(st.lists(PING, min_size=1, max_size=12), st.sampled_from([0.0, 1440.0]))
def test_pings_as_columns_are_those_of_the_messages(rows, water):
    v_m, covariance, mode, beams, speed, kind = (np.array(c) for c in zip(*rows, strict=True))
    factors = sound_speed_factors(speed, water, kind == Dvl.DVL_TYPE_PHASED_ARRAY)
    v_m, found, valid = readers.dvl_pings(v_m, covariance, mode, beams, 0.02, factors)
    for k, row in enumerate(rows):
        message = ping_of(*row)
        one = readers.dvl_from_msg(message, 0, 0.02, water)
        assert one.valid == valid[k]
        np.testing.assert_array_equal(one.v_m, v_m[k])
        np.testing.assert_array_equal(one.covariance_m, found[k])


@FEW
@given(st.lists(COVARIANCE, min_size=1, max_size=12))
def test_variances_of_depth_as_columns_are_those_of_the_messages(variances):
    found = readers.depth_variances(np.array(variances), 0.3)
    ones = [readers.depth_from_msg(Depth(variance=v), 0, 0.3).variance for v in variances]
    np.testing.assert_array_equal(found, ones)


@FEW
@given(st.text('auv/_imü', max_size=20), st.tuples(*[NUMBER] * 6), st.integers(0, 2**31 - 1))
def test_the_bytes_of_an_imu_are_read_as_the_message_is(frame, values, second):
    message = Imu()
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = second, 999_999_999
    w, f = message.angular_velocity, message.linear_acceleration
    w.x, w.y, w.z, f.x, f.y, f.z = values
    message.orientation.x, message.linear_acceleration_covariance[8] = 0.5, 7.0
    row = readers.imu_from_msg(readers.ImuRow.of(serialize_message(message)), 3)
    whole = readers.imu_from_msg(message, 3)
    assert row.key == whole.key
    np.testing.assert_array_equal(row.omega_ib_b, whole.omega_ib_b)
    np.testing.assert_array_equal(row.f_b, whole.f_b)


@given(st.binary(max_size=400))
def test_bytes_that_are_no_imu_message_are_refused(data):
    whole = serialize_message(Imu())
    with pytest.raises(ValueError, match='no sensor_msgs/Imu'):
        readers.ImuRow.of(whole[: len(data) % len(whole)])
    with contextlib.suppress(ValueError):
        readers.ImuRow.of(data)
