"""kill -9 of a real process that writes a bag, at random moments: 2 s may be gone, no more."""

import os
import random
import signal
import subprocess
import sys
import textwrap
import time

import pytest
from rosbags.highlevel import AnyReader

from polar_nav_tools.bags import BagError, open_bag
from polar_nav_tools.bags.recover import recover

RATE_HZ = 1000
# Writes at a steady rate and says after each message how many it has written, through a pipe, so
# that the test knows what existed when.
SCRIPT = """
    import struct, sys, time
    from pathlib import Path
    sys.path.insert(0, sys.argv[2])
    from bag_samples import IMU, TYPES, imu
    from polar_nav_tools.bags import BagWriter
    out = sys.stdout.buffer
    data = imu(0)
    writer = BagWriter(Path(sys.argv[1]), {'seed': 1}, compression=sys.argv[3])
    writer.add_topic(IMU, TYPES[IMU])
    out.write(b'ready\\n'); out.flush()
    start = time.monotonic()
    k = 0
    while True:
        due = int((time.monotonic() - start) * float(sys.argv[4]))
        while k < due:
            k += 1
            writer.write(IMU, data, time.monotonic_ns())
        time.sleep(0.001)
"""


def killed_writer(directory, compression, seconds):
    """Bag of a writer that was killed; returns when that happened."""
    here = os.path.dirname(__file__)  # noqa: PTH120 - handed on as text
    process = subprocess.Popen(
        [
            sys.executable,
            '-c',
            textwrap.dedent(SCRIPT),
            str(directory),
            here,
            compression,
            str(RATE_HZ),
        ],
        stdout=subprocess.PIPE,
    )
    try:
        assert process.stdout.readline() == b'ready\n'
        time.sleep(seconds)
    finally:
        at_ns = time.monotonic_ns()
        process.send_signal(signal.SIGKILL)
        process.wait(10)
        process.stdout.close()
    return at_ns


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(6))
def test_killed_at_a_random_moment(tmp_path, seed):
    rng = random.Random(seed)
    seconds = rng.uniform(0.05, 3.0)
    at_ns = killed_writer(tmp_path / 'b', rng.choice(['zstd', 'lz4', 'none']), seconds)
    try:
        bag = open_bag(tmp_path / 'b')
    except BagError:
        assert seconds < 2.0  # nothing was older than the flush period
        return
    times = [t for _, t, _ in bag.messages()]
    assert [r.sequence for r in bag.records()] == list(range(1, len(times) + 1))
    assert at_ns - times[-1] < 2e9
    assert not bag.is_complete
    assert 'was not finished; the last message is of' in bag.problems[-1]

    done = recover(tmp_path / 'b', tmp_path / 'r')
    assert done.message_count == len(times)
    with AnyReader([tmp_path / 'r']) as reader:
        assert [t for _, t, _ in reader.messages()] == times
