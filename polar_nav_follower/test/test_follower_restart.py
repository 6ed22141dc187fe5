"""A follower that is ended and started again goes on from its saved state. Ring 2."""

import time

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import Imu  # noqa: E402

from polar_nav_core.engine.saved import pack  # noqa: E402
from polar_nav_follower.follower_node import FollowerNode  # noqa: E402
from polar_nav_follower.params import FollowerParams  # noqa: E402
from polar_nav_follower.session import Session, inputs_of  # noqa: E402
from polar_nav_msgs.msg import NavState, Restore  # noqa: E402
from polar_nav_ros.qos import DATA_QOS  # noqa: E402
from polar_nav_ros.stamps import to_msg, to_ns  # noqa: E402
from polar_nav_ros.topics import IMU, RESTORE, STATE  # noqa: E402

START_NS = 1_772_323_200_000_000_000
STEP_NS = 10_000_000


def sample(stamp_ns):
    """An IMU at rest."""
    message = Imu()
    message.header.stamp = to_msg(stamp_ns)
    # A sensor has noise: one that repeats itself hangs.
    message.linear_acceleration.z = 9.83 + 1e-12 * (stamp_ns // STEP_NS % 2)
    return message


class Life:
    """One life of a follower node, with a peer that feeds it and listens."""

    def __init__(self, state_file):
        args = ['--ros-args', '-r', '__ns:=/follower', '-p', f'state_file:={state_file}']
        args += ['-p', 'initialize:=parameters', '-p', 'state_period_s:=1.0']
        rclpy.init(args=args, domain_id=64)
        self.node = FollowerNode()
        self.peer = rclpy.create_node('peer', use_global_arguments=False)
        self.states, self.restored = [], []
        listen = self.peer.create_subscription
        listen(NavState, '/follower/nav/state', self.states.append, DATA_QOS)
        listen(Restore, '/follower/nav/restore', self.restored.append, DATA_QOS)
        self._imu = self.peer.create_publisher(Imu, '/follower/imu/data_raw', DATA_QOS)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)
        self.until(lambda: self._imu.get_subscription_count() == 1)
        self.until(lambda: self.peer.count_publishers('/follower/nav/restore') == 1)

    def until(self, done, seconds=20.0):
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
        assert done()

    def feed(self, begin_ns, count):
        """Publish IMU samples, all taken when this returns."""
        for k in range(count):
            self._imu.publish(sample(begin_ns + k * STEP_NS))
        self.until(lambda: self.node.taken_counts()['/follower/imu/data_raw'] == count)

    def kill(self):
        """End without a word, as by SIGKILL."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.peer.destroy_node()
        rclpy.shutdown()


@pytest.mark.slow
def test_a_killed_follower_goes_on_from_its_file(tmp_path):
    path = tmp_path / 'follower.state'
    first = Life(path)
    try:
        first.feed(START_NS, 500)
        first.until(lambda: len(first.states) > 30)
        assert not first.restored
        before = first.states[-1]
    finally:
        first.kill()
    assert path.exists()

    again_ns = START_NS + 8 * 10**9
    second = Life(path)
    try:
        second.feed(again_ns, 300)
        second.until(lambda: second.restored and len(second.states) > 10)
        (restore,) = second.restored
        assert to_ns(restore.header.stamp) == again_ns
        assert 3.0 < 1e-9 * (again_ns - to_ns(restore.saved_time)) < 5.0
        # Without a DVL it waits for one for a second.
        assert to_ns(second.states[0].header.stamp) - again_ns <= 1_200_000_000
        # It is where it was, and less sure of it: it may have moved meanwhile.
        state = second.states[0]
        assert float(np.linalg.norm(state.r_e - before.r_e)) < 1.0
        assert state.position_covariance_g[0] > before.position_covariance_g[0]
        assert state.gyro_bias_sigma[0] < 1.01 * before.gyro_bias_sigma[0]
        assert 'saved at' in str(second.node.diagnose().values['saved_state'])
    finally:
        second.kill()


def test_live_equals_replay_across_a_restart():
    params = FollowerParams(state_file='anywhere')
    assert inputs_of(params)[-1] == RESTORE
    early = Session(params, 'follower')
    for k in range(500):
        list(early.take(IMU, sample(START_NS + k * STEP_NS)))
    saved = early.engine.saved()
    again_ns = START_NS + 8 * 10**9
    restore = Restore(data=pack(saved))
    restore.header.stamp = to_msg(again_ns)
    messages = [(IMU, sample(again_ns + k * STEP_NS)) for k in range(400)]

    live = Session(params, 'follower')
    published = list(live.take(*messages[0]))
    published += live.take(RESTORE, restore)
    for topic, message in messages[1:]:
        published += live.take(topic, message)
    published += live.flush()

    replay = Session(params, 'follower')
    events = [replay.event_of(t, m) for t, m in [(RESTORE, restore), *messages]]
    replayed = []
    for event in sorted(events, key=lambda e: e.key):
        replayed += replay.process(event)
    replayed += replay.flush()
    states = [p.data for p in published if p.topic == STATE]
    assert len(states) > 25
    assert states == [p.data for p in replayed if p.topic == STATE]
