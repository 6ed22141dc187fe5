"""ROS in the process of the tests that make nodes."""

import os

import pytest

rclpy = pytest.importorskip('rclpy')


@pytest.fixture(scope='module', autouse=True)
def ros():
    """A ROS context of one module, in a domain that other tests under way hardly have."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    rclpy.init(domain_id=60 + os.getpid() % 20)
    yield
    rclpy.try_shutdown()
