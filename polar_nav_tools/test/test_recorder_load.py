"""The recorder under load: 25 topics, 2,000 messages/s, half a minute or ten; nothing is lost."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy')

from polar_nav_tools.bags import open_bag

TOPICS, RATE_HZ = 25, 2000
MOST_GROWTH_KB = {30.0: 10_000, 600.0: 20_000}
DOMAIN = '44'
# Waits for the recorder on every topic, publishes at a steady rate, says how many, and waits until
# the recorder has acknowledged all: what is lost then is the recorder's loss.
TALKER = """
    import sys, time
    import rclpy
    from sensor_msgs.msg import Imu
    from polar_nav_ros.cdr import to_bytes
    from polar_nav_ros.qos import DATA_QOS
    topics, rate, seconds = (float(x) for x in sys.argv[1:])
    rclpy.init()
    node = rclpy.create_node('talker')
    out = [node.create_publisher(Imu, f'/load/imu_{k}', DATA_QOS) for k in range(int(topics))]
    end = time.monotonic() + 60.0
    while any(o.get_subscription_count() == 0 for o in out):
        assert time.monotonic() < end, 'the recorder was not found'
        time.sleep(0.05)
    message, begin, sent, total = Imu(), time.monotonic(), 0, int(rate * seconds)
    while sent < total:
        due = min(total, int((time.monotonic() - begin) * rate))
        while sent < due:
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(sent, 10**9)
            out[sent % len(out)].publish(to_bytes(message))
            sent += 1
        time.sleep(0.002)
    for o in out:
        assert o.wait_for_all_acked(rclpy.duration.Duration(seconds=30))
    print(sent, round(time.monotonic() - begin, 2), flush=True)
    time.sleep(1.0)
"""


def resident_kb(pid):
    text = Path(f'/proc/{pid}/status').read_text()
    return next(int(line.split()[1]) for line in text.splitlines() if line.startswith('VmRSS'))


@pytest.mark.live
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    'seconds',
    [
        pytest.param(30.0, marks=pytest.mark.slow, id='30 s'),
        pytest.param(600.0, marks=[pytest.mark.slow, pytest.mark.long], id='10 min'),
    ],
)
def test_nothing_is_lost_and_memory_is_flat(tmp_path, seconds):
    env = {
        **os.environ,
        'ROS_DOMAIN_ID': DOMAIN,
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'HOME': str(tmp_path),
    }
    command = [sys.executable, '-m', 'polar_nav_tools.record.recorder_node', '--ros-args']
    command += ['-p', f'output:={tmp_path / "b"}']
    recorder = subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True)
    talker = subprocess.Popen(
        [sys.executable, '-c', textwrap.dedent(TALKER), str(TOPICS), str(RATE_HZ), str(seconds)],
        env=env,
        stdout=subprocess.PIPE,
        text=True,
    )
    memory = []
    try:
        while talker.poll() is None:
            memory.append(resident_kb(recorder.pid))
            time.sleep(0.5)
        said, _ = talker.communicate(timeout=10)
        assert talker.returncode == 0
    finally:
        talker.kill()
        recorder.send_signal(signal.SIGINT)
        _, errors = recorder.communicate(timeout=60)
    assert recorder.returncode == 0, errors
    sent, took = int(said.split()[0]), float(said.split()[1])
    assert sent == RATE_HZ * seconds
    assert took < 1.2 * seconds, 'the machine is too busy for the rate that is to be tested'
    bag = open_bag(tmp_path / 'b')
    assert bag.problems == []
    counts = [bag.topics[f'/load/imu_{k}'].count for k in range(TOPICS)]
    assert counts == [sent // TOPICS] * TOPICS
    # From a quarter of the time on, when all buffers have been filled once, nothing grows.
    early = np.array(memory[len(memory) // 4 : len(memory) // 2])
    late = np.array(memory[3 * len(memory) // 4 :])
    assert late.max() - early.max() < MOST_GROWTH_KB[seconds], (early.max(), late.max())
