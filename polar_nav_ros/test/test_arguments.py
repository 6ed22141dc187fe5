"""What ROS 2 takes for no node, in silence, is refused or told."""

import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_ros.arguments import require_reached, unread


@pytest.mark.parametrize('remap', ['__ns:=/auv', 'dvl_node:__ns:=/auv'])
def test_a_parameter_for_one_node_does_not_reach_into_a_namespace(remap):
    arguments = ['x', '--ros-args', '-r', remap, '-p', 'dvl_node:rate_hz:=5.0']
    with pytest.raises(ConfigError, match='under /auv/dvl_node:'):
        require_reached(arguments)
    require_reached(['--ros-args', '-r', remap, '-p', 'rate_hz:=5.0', '-r', 'dvl_node:a:=b'])
    require_reached(['--ros-args', '-p', 'dvl_node:rate_hz:=5.0'])
    require_reached(['-p', 'dvl_node:rate_hz:=5.0'])


@pytest.mark.parametrize(
    ('section', 'is_read'),
    [
        ('/**:', True),
        ('/auv/follower_node:', True),
        ('auv/follower_node:', True),
        ('/**/follower_node:', True),
        ('/*/follower_node:', True),
        ('auv:\n  follower_node:\n   ', True),
        ('follower_node:', False),
        ('/auv/followernode:', False),
        ('/*/*/follower_node:', False),
    ],
)
def test_a_parameter_file_for_nobody_is_told(tmp_path, section, is_read):
    """The patterns are those of rcl, asked with the nodes of rclpy 7.1."""
    file = tmp_path / 'params.yaml'
    file.write_text(f'{section}\n    ros__parameters: {{now_every: 2}}\n', encoding='utf-8')
    found = unread(['--ros-args', '--params-file', str(file)], ['/auv/follower_node'])
    assert (not found) == is_read
    if not is_read:
        assert f'{file} states nothing for /auv/follower_node' in found[0]


def test_a_file_that_cannot_be_read_is_left_to_ros(tmp_path):
    assert unread(['--ros-args', '--params-file', str(tmp_path / 'none')], ['/a']) == []
