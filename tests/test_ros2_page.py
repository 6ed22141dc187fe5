"""Lists in docs/ros2-cli.md that the code determines; the transcripts need a real ros2."""

import subprocess
import sys
from pathlib import Path

import pytest
from live_support import NODES

from polar_nav_core.engine.configurations import NAMES

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / 'docs' / 'ros2-cli.md').read_text(encoding='utf-8')
LAUNCH = (ROOT / 'polar_nav_tools' / 'launch' / 'demo.launch.py').read_text(encoding='utf-8')


def test_missions_configurations_and_programs_are_those_of_the_code():
    missions = sorted(path.stem for path in (ROOT / 'polar_nav_sim' / 'missions').glob('*.yaml'))
    assert f'neither a file nor one of {", ".join(missions)}\n' in PAGE
    assert f'Valid choices are: {list(NAMES)}' in PAGE
    programs = ''.join(f'polar_nav_sim {name}\n' for name in sorted(NODES['polar_nav_sim']))
    assert f'$ ros2 pkg executables polar_nav_sim\n{programs}```' in PAGE


@pytest.mark.parametrize(
    'name', [part.split("'")[1] for part in LAUNCH.split('DeclareLaunchArgument(\n')[1:]]
)
def test_every_argument_of_the_launch_file_is_shown(name):
    assert f"    '{name}':\n" in PAGE


@pytest.mark.live
@pytest.mark.slow
@pytest.mark.timeout(400)
def test_topics_of_the_follower_are_those_of_its_node(own_domain, tmp_path):
    """As `ros2 node info` shows them, of a follower of demo.launch.py."""
    program = """
import rclpy, sys, time
from polar_nav_follower.follower_node import FollowerNode
rclpy.init(args=sys.argv)
node = FollowerNode()
name = ('follower_node', '/follower')
for found in (
    node.get_subscriber_names_and_types_by_node(*name),
    node.get_publisher_names_and_types_by_node(*name),
):
    print(''.join(f'    {topic}: {kinds[0]}\\n' for topic, kinds in sorted(found)), end='--\\n')
rclpy.shutdown()
"""
    told = subprocess.run(
        [sys.executable, '-c', program, '--ros-args', '-r', '__ns:=/follower',
         '-p', f'state_file:={tmp_path}/follower.state'],
        capture_output=True, text=True, timeout=360.0, env=own_domain, cwd=tmp_path, check=False,
    )  # fmt: skip
    assert told.returncode == 0, told.stderr
    subscribers, publishers, _ = told.stdout.split('--\n')
    shown = PAGE.split('$ ros2 node info /follower/follower_node\n')[1]
    assert f'  Subscribers:\n{subscribers}  Publishers:\n{publishers}  Service Servers:' in shown
    listed = PAGE.split('$ ros2 topic list -t\n')[1].split('\n\n')[0].splitlines()
    assert listed == sorted(listed)
    for line in (subscribers + publishers).splitlines():
        topic, kind = line.strip().split(': ')
        assert f'{topic} [{kind}]' in listed
