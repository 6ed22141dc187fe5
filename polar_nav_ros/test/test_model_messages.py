"""Attitude and thrust to events; model, current and identification to messages."""

import math

import numpy as np
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import Imu

from polar_nav_core import attitude
from polar_nav_core.engine.events import CommandKind
from polar_nav_core.engine.outputs import ModelEstimate
from polar_nav_core.identification.result import Identification, IdentificationVerdict
from polar_nav_msgs.msg import Command
from polar_nav_msgs.msg import Identification as IdentificationMsg
from polar_nav_ros import readers
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.model_outputs import current_to_msg, identification_to_msg, model_to_msg
from polar_nav_ros.stamps import to_msg, to_ns

T_NS = 1_772_323_200_120_000_000


def ahrs(C_b_G=None, covariance=0.0):
    message = Imu()
    message.header.stamp = to_msg(T_NS)
    message.angular_velocity.z = 0.04
    message.linear_acceleration.z = 9.81
    message.orientation_covariance[0] = covariance
    if C_b_G is not None:
        q = message.orientation
        q.x, q.y, q.z, q.w = (float(v) for v in attitude.quaternion_from_matrix(C_b_G))
    return message


def test_an_ahrs_gives_attitude_rate_and_force_of_one_stamp():
    C_b_G = attitude.matrix_from_euler(0.7, -0.1, 0.05)
    sample = readers.ahrs_from_msg(ahrs(C_b_G), 3)
    assert (sample.stamp_ns, sample.sequence, sample.topic) == (T_NS, 3, 'imu/data')
    np.testing.assert_allclose(sample.C_b_G, C_b_G, atol=1e-12)
    np.testing.assert_array_equal(sample.omega_ib_b, [0.0, 0.0, 0.04])
    np.testing.assert_array_equal(sample.f_b, [0.0, 0.0, 9.81])


def test_a_message_that_says_that_it_has_no_attitude_gives_none():
    assert readers.ahrs_from_msg(ahrs(np.eye(3), covariance=-1.0), 0).C_b_G is None


@pytest.mark.parametrize('scale', [0.0, 0.9, math.nan])
def test_a_quaternion_that_is_no_rotation_is_not_taken_for_one(scale):
    message = ahrs(np.eye(3))
    message.orientation.w = scale
    assert np.isnan(readers.ahrs_from_msg(message, 0).C_b_G).all()


def test_thrust_has_the_stamp_from_which_on_it_holds():
    message = WrenchStamped()
    message.header.stamp = to_msg(T_NS)
    message.wrench.force.x = 52.0
    message.wrench.torque.z = 1.9
    sample = readers.control_from_msg(message, 4)
    assert (sample.stamp_ns, sample.sequence, sample.topic) == (T_NS, 4, 'control/thrust')
    np.testing.assert_array_equal(sample.force_b, [52.0, 0.0, 0.0])
    np.testing.assert_array_equal(sample.torque_b, [0.0, 0.0, 1.9])


def test_identify_is_a_command_without_a_state():
    command = readers.command_from_msg(Command(kind=Command.IDENTIFY, sequence=2), 0)
    assert command.kind is CommandKind.IDENTIFY
    assert command.initial_state is None


ESTIMATE = ModelEstimate(
    v_r_b=np.array([1.1, 0.02, 0.0]),
    v_r_covariance_b=np.diag([1e-4, 2e-4, 3e-4]),
    current_G=np.array([0.4, 0.25, math.nan]),
    current_covariance_G=np.full((3, 3), math.nan),
    drag_linear=25.0,
    drag_linear_sigma=2.9,
    drag_quadratic=19.0,
    drag_quadratic_sigma=2.5,
    drag_correlation=-0.99,
    heading_bias=0.03,
    heading_bias_sigma=0.004,
    current_walk=1e-6,
)


def test_every_number_of_the_model_is_in_its_message():
    message = model_to_msg(ESTIMATE, T_NS)
    assert to_ns(message.header.stamp) == T_NS
    assert message.header.frame_id == 'grid'
    np.testing.assert_array_equal(message.v_r_b, ESTIMATE.v_r_b)
    np.testing.assert_array_equal(
        np.reshape(message.v_r_covariance_b, (3, 3)), ESTIMATE.v_r_covariance_b
    )
    np.testing.assert_array_equal(message.current_g, ESTIMATE.current_G)
    for name in (
        'drag_linear',
        'drag_linear_sigma',
        'drag_quadratic',
        'drag_quadratic_sigma',
        'drag_correlation',
        'heading_bias',
        'heading_bias_sigma',
        'current_walk',
    ):
        assert getattr(message, name) == getattr(ESTIMATE, name)
    current = current_to_msg(ESTIMATE, T_NS)
    np.testing.assert_array_equal(current.velocity_g, ESTIMATE.current_G)
    assert np.isnan(current.covariance_g).all()


def test_an_identification_keeps_its_numbers_and_its_verdict():
    result = Identification(
        stamp_ns=T_NS,
        method='robust',
        verdict=IdentificationVerdict.NOT_EXCITED,
        reason='turn by 90 degrees',
        trigger='command',
        fixes=120,
        first_validity_ns=T_NS - 10**9,
        last_validity_ns=T_NS,
        names=('drag_linear', 'current_x'),
        values=np.array([25.0, 0.4]),
        covariance=np.array([[4.0, 0.1], [0.1, 0.01]]),
        condition_number=1e4,
        cost=120.0,
        iterations=9,
    )
    message = identification_to_msg(result)
    assert message.verdict == IdentificationMsg.NOT_EXCITED
    assert (message.verdict_text, message.reason) == ('NOT_EXCITED', 'turn by 90 degrees')
    assert (message.method, message.trigger, message.fixes) == ('robust', 'command', 120)
    assert list(message.names) == ['drag_linear', 'current_x']
    assert list(message.values) == [25.0, 0.4]
    assert list(message.covariance) == [4.0, 0.1, 0.1, 0.01]
    assert (to_ns(message.first_validity), to_ns(message.last_validity)) == (T_NS - 10**9, T_NS)
    assert to_bytes(message) == to_bytes(identification_to_msg(result))
