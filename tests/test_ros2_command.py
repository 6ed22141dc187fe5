"""The graph as the ros2 command sees it: where ROS 2 is installed, with its own tools.

ros2cli is not among the packages that `./polar` installs, so these tests run on a workstation with
ROS 2 Jazzy, or where its sources are on the path.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from live_support import TOOL

ROOT = Path(__file__).resolve().parents[1]

pytestmark = [
    pytest.mark.live,
    pytest.mark.slow,
    pytest.mark.timeout(240),
    pytest.mark.skipif(shutil.which('ros2') is None, reason='no ros2 command on this machine'),
]

NODES = {
    'polar_nav_sim': (
        'truth_node',
        'imu_node',
        'dvl_node',
        'depth_node',
        'usbl_node',
        'leader_reference_node',
        'acoustic_link_node',
    ),
    'polar_nav_leader': ('leader_node',),
    'polar_nav_follower': ('follower_node',),
    'polar_nav_tools': ('recorder_node',),
}


def ros2(*arguments: str, env: dict[str, str], timeout: float = 60.0, cwd=None) -> str:
    """Output of one ros2 command that must succeed."""
    done = subprocess.run(
        ['ros2', *arguments], capture_output=True, text=True, timeout=timeout, env=env, cwd=cwd
    )
    assert done.returncode == 0, f'ros2 {" ".join(arguments)}: {done.stderr}'
    return done.stdout


@pytest.fixture(scope='module')
def graph(own_domain, tmp_path_factory) -> Iterator[dict[str, str]]:
    """The graph in real time; the environment to look at it."""
    command = [*TOOL, 'launch', '--no-record', '--duration', '230']
    folder = tmp_path_factory.mktemp('launch')
    with (folder / 'stderr.txt').open('wb') as stderr:
        process = subprocess.Popen(command, env=own_domain, cwd=folder, stderr=stderr)
    try:
        ros2('topic', 'echo', '--once', '/follower/nav/state', env=own_domain, timeout=90.0)
        yield own_domain
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=40.0)
    assert process.returncode == 0, (folder / 'stderr.txt').read_text()


def test_topic_list_shows_topics_with_types(graph):
    listed = ros2('topic', 'list', '-t', '--no-daemon', '--spin-time', '5', env=graph)
    for topic, kind in {
        '/clock': 'rosgraph_msgs/msg/Clock',
        '/follower/imu/data_raw': 'sensor_msgs/msg/Imu',
        '/follower/nav/state': 'polar_nav_msgs/msg/NavState',
        '/follower/nav/receipt': 'polar_nav_msgs/msg/FixReceipt',
        '/leader/usbl/fix': 'polar_nav_msgs/msg/UsblFix',
        '/leader/acomms/tx': 'polar_nav_msgs/msg/AcousticPacket',
    }.items():
        assert f'{topic} [{kind}]' in listed


def test_topic_echo_shows_what_became_of_a_fix(graph):
    said = ros2('topic', 'echo', '--once', '/follower/nav/receipt', env=graph)
    assert 'verdict_text: FUSED' in said


def test_topic_hz_of_the_imu(graph):
    process = subprocess.Popen(
        ['ros2', 'topic', 'hz', '--window', '300', '/follower/imu/data_raw'],
        stdout=subprocess.PIPE,
        text=True,
        env=graph,
    )
    try:
        rates = [float(line.split()[-1]) for line in _lines(process, 'average rate', 4)]
    finally:
        process.kill()
        process.communicate()
    assert rates[-1] == pytest.approx(100.0, rel=0.2)


def _lines(process: subprocess.Popen, text: str, count: int) -> Iterator[str]:
    for line in process.stdout:
        if text in line:
            yield line
            count -= 1
            if count == 0:
                return


def test_node_info_shows_topics_and_services(graph):
    said = ros2('node', 'info', '/follower/follower_node', '--no-daemon', env=graph)
    for text in (
        '/follower/imu/data_raw: sensor_msgs/msg/Imu',
        '/follower/nav/state: polar_nav_msgs/msg/NavState',
        '/follower/follower_node/set_initial_state: polar_nav_msgs/srv/SetInitialState',
    ):
        assert text in said


def test_parameters_describe_themselves(graph):
    node = '/follower/follower_node'
    assert 'max_delay_s' in ros2('param', 'list', node, '--no-daemon', env=graph)
    described = ros2('param', 'describe', node, 'max_delay_s', '--no-daemon', env=graph)
    for text in ('Type: double', 'Oldest fix that is still used [s]', 'Max value: 120.0'):
        assert text in described
    assert '60.0' in ros2('param', 'get', node, 'max_delay_s', '--no-daemon', env=graph)


def test_interface_show_has_the_comments():
    import os

    said = ros2('interface', 'show', 'polar_nav_msgs/msg/FixReceipt', env=dict(os.environ))
    assert 'uint8 FUSED=0' in said
    assert 'one sentence, with the numbers that decided' in said


@pytest.mark.parametrize(
    ('package', 'node'), [(package, node) for package, names in NODES.items() for node in names]
)
def test_ros2_run_starts_each_node_and_ctrl_c_ends_it(package, node, own_domain, tmp_path):
    command = ['ros2', 'run', package, node, '--ros-args', '-r', '__ns:=/alone']
    process = subprocess.Popen(
        command, env=own_domain, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    try:
        listed = ''
        while f'/alone/{node}' not in listed:
            assert process.poll() is None
            listed = ros2('node', 'list', '--no-daemon', '--spin-time', '2', env=own_domain)
    finally:
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=30.0)
    assert b'Traceback' not in output


@pytest.mark.timeout(300)
def test_ros2_launch_runs_the_demo_to_its_end(own_domain, tmp_path):
    bag = tmp_path / 'bag'
    file = ROOT / 'polar_nav_tools' / 'launch' / 'demo.launch.py'
    arguments = ('duration:=10.0', 'pace:=lockstep', f'bag:={bag}')
    ros2('launch', str(file), *arguments, env=own_domain, timeout=200.0, cwd=tmp_path)
    verified = subprocess.run([*TOOL, 'verify', str(bag)], capture_output=True, text=True)
    assert verified.returncode == 0, verified.stderr
