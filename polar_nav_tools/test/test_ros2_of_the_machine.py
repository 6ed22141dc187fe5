"""`polar ros2`: finds the machine's own ros2, and runs it with our packages before its own."""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from polar_nav_tools.live.ros2_command import NoRos2Error, command, find_ros2, surroundings

NOWHERE = Path('/nowhere/bin/ros2')


@pytest.fixture
def prefix(tmp_path):
    """A prefix with a program `ros2` and a package ros2cli that prints what it was called with."""
    site = tmp_path / 'ros' / 'lib' / 'python3.12' / 'site-packages'
    (site / 'ros2cli').mkdir(parents=True)
    (site / 'ros2cli' / '__init__.py').write_text('')
    (site / 'ros2cli' / 'cli.py').write_text(
        'import sys, numpy\n'
        'def main():\n'
        '    print(sys.argv, sys.prefix, numpy.__file__)\n'
        '    return 3\n'
    )
    (site / 'numpy').mkdir()
    (site / 'numpy' / '__init__.py').write_text('raise ImportError("another numpy")')
    program = tmp_path / 'ros' / 'bin' / 'ros2'
    program.parent.mkdir()
    program.write_text('#!/bin/false\n')
    program.chmod(0o755)
    return program.parents[1]


def test_it_is_looked_for_on_the_path_and_where_apt_puts_it(prefix):
    program = prefix / 'bin' / 'ros2'
    assert find_ros2({'PATH': str(program.parent)}, NOWHERE) == program
    assert find_ros2({'PATH': '/nowhere'}, program) == program
    assert find_ros2({'PATH': '/nowhere', 'POLAR_ROS2': '/my/ros2'}, program) == Path('/my/ros2')


def test_where_there_is_none_the_sentence_names_what_to_install():
    own = str(Path(sys.prefix, 'bin'))
    with pytest.raises(NoRos2Error, match='apt install ros-jazzy-ros2cli-common-extensions'):
        find_ros2({'PATH': own}, NOWHERE)


def test_our_packages_come_before_those_of_ros(prefix):
    env = surroundings(prefix / 'bin' / 'ros2', {**os.environ, 'AMENT_PREFIX_PATH': sys.prefix})
    assert env['AMENT_PREFIX_PATH'] == f'{sys.prefix}:{prefix}'
    assert sysconfig.get_path('purelib') in env['PYTHONPATH']
    done = subprocess.run(
        command(['topic', 'list', '--help']), env=env, capture_output=True, text=True
    )
    assert done.returncode == 3, done.stderr
    argv, rest = done.stdout.rsplit(']', 1)
    assert argv == "['ros2', 'topic', 'list', '--help'"
    assert rest.split()[0] == sys.prefix
    assert str(prefix) not in rest


def test_a_program_without_its_package_is_refused(tmp_path):
    program = tmp_path / 'bin' / 'ros2'
    program.parent.mkdir()
    program.write_text('#!/bin/false\n')
    with pytest.raises(NoRos2Error, match='no package ros2cli beside it'):
        surroundings(program, {})
