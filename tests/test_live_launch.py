"""The launch files of a follower and of a leader, through the launch package.

It is not among the packages that `./polar` installs: these tests run where ROS 2 has it.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip('launch_ros', reason='launch is in no wheel: ROS 2 from apt has it')

pytestmark = [pytest.mark.live, pytest.mark.paced, pytest.mark.timeout(300)]

ROOT = Path(__file__).resolve().parents[1]
FOLLOWER = ROOT / 'polar_nav_follower' / 'launch' / 'follower.launch.py'
LEADER = ROOT / 'polar_nav_leader' / 'launch' / 'leader.launch.py'
PAIR = ROOT / 'polar_nav_follower' / 'config'
RUN = """
import sys
from launch import LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description import LaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource

arguments = [tuple(text.split(':=')) for text in sys.argv[2:]]
service = LaunchService()
included = IncludeLaunchDescription(
    AnyLaunchDescriptionSource(sys.argv[1]), launch_arguments=arguments
)
service.include_launch_description(LaunchDescription([included]))
sys.exit(service.run())
"""


@pytest.fixture
def launch(tmp_path, own_domain):
    """Function that launches a file; what it starts is ended with the test."""
    started = []

    def start(file, *arguments):
        with (tmp_path / 'output.txt').open('wb') as output:
            started.append(
                subprocess.Popen(
                    [sys.executable, '-c', RUN, file, *arguments],
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    cwd=tmp_path,
                    env={**own_domain, 'ROS_LOG_DIR': str(tmp_path / 'log')},
                    start_new_session=True,
                )
            )
        return started[-1]

    yield start
    for process in started:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def wait_for(process, folder, text, times=1):
    deadline = time.monotonic() + 120.0
    while (folder / 'output.txt').read_text().count(text) < times:
        assert process.poll() is None, (folder / 'output.txt').read_text()
        assert time.monotonic() < deadline, (folder / 'output.txt').read_text()
        time.sleep(0.2)
    return (folder / 'output.txt').read_text()


@pytest.mark.parametrize(
    ('file', 'arguments', 'name'),
    [
        (
            FOLLOWER,
            [
                f'sources:={PAIR / "polar_pair_mapping.yaml"}',
                f'params_file:={PAIR / "polar_pair_params.yaml"}',
                'state_file:=pair.state',
            ],
            'one.follower_node',
        ),
        (
            LEADER,
            [f'params_file:={ROOT / "polar_nav_leader" / "config" / "polar_pair_leader.yaml"}'],
            'one.leader_node',
        ),
    ],
)
def test_a_vehicle_is_launched_respawned_and_ended(launch, tmp_path, file, arguments, name):
    process = launch(file, 'namespace:=one', *arguments)
    ready = f'[{name}]: configuration default'
    output = wait_for(process, tmp_path, ready)
    (line,) = (text for text in output.splitlines() if 'process started with pid' in text)
    os.kill(int(line.split('[')[-1].rstrip(']')), signal.SIGKILL)
    wait_for(process, tmp_path, ready, times=2)
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(60.0) == 0
    output = (tmp_path / 'output.txt').read_text()
    assert output.count('process has finished cleanly') == 1, output
    assert 'Traceback' not in output


def test_a_refused_parameter_ends_the_launch(launch, tmp_path):
    (tmp_path / 'wrong.yaml').write_text('/**: {ros__parameters: {colour: 1}}')
    process = launch(FOLLOWER, 'params_file:=wrong.yaml')
    assert process.wait(60.0) == 1
    output = (tmp_path / 'output.txt').read_text()
    assert 'unknown parameter colour' in output
    assert output.count('process started') == 1, output
