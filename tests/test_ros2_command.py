"""The graph in the hands of the ros2 command: run, launch, topic, node, param, service, interface.

ros2cli is not among the packages that `./polar` installs. These tests run where `ros2` is on the
PATH and knows our packages: a workstation with ROS 2 Jazzy and a sourced workspace. POLAR_ROS2 can
name another program that does what `ros2` does.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from live_support import NODES, polar

pytestmark = [pytest.mark.live, pytest.mark.paced, pytest.mark.timeout(300)]

NODE_COUNT = 13
FOLLOWER = '/follower/follower_node'
# The daemon of another ROS domain or session would answer otherwise.
FRESH = ('--no-daemon', '--spin-time', '3')


class Ros2:
    """The ros2 command in a ROS domain of this test session."""

    def __init__(self, program: str, env: dict[str, str]) -> None:
        self.program = program
        self.env = env

    def call(self, *arguments: str, timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
        """Run one command to its end."""
        command = [self.program, *arguments]
        return subprocess.run(
            command, capture_output=True, text=True, timeout=timeout, env=self.env
        )

    def said(self, *arguments: str, timeout: float = 60.0) -> str:
        """Output of a command that must succeed."""
        done = self.call(*arguments, timeout=timeout)
        assert done.returncode == 0, f'ros2 {" ".join(arguments)}: {done.stderr}'
        return done.stdout

    def start(self, folder: Path, *arguments: str) -> Running:
        """Run a command that goes on, as from a terminal of its own."""
        return Running([self.program, *arguments], folder, self.env)


class Running:
    """A command with all that it started, and its output."""

    def __init__(self, command: list[str], folder: Path, env: dict[str, str]) -> None:
        self._file = folder / f'{"_".join(command[1:4]).replace("/", "_")}.txt'
        with self._file.open('wb') as output:
            self.process = subprocess.Popen(
                command,
                stdout=output,
                stderr=subprocess.STDOUT,
                cwd=folder,
                env=env,
                start_new_session=True,
            )

    @property
    def output(self) -> str:
        return self._file.read_text()

    def wait_for(self, true: Callable[[], bool], timeout: float = 90.0) -> None:
        deadline = time.monotonic() + timeout
        while not true():
            assert self.process.poll() is None, self.output
            assert time.monotonic() < deadline, self.output
            time.sleep(0.2)

    def ctrl_c(self, timeout: float = 60.0) -> int:
        """Do what a terminal does on Ctrl-C: SIGINT for every process; the exit status."""
        os.killpg(self.process.pid, signal.SIGINT)
        return self.process.wait(timeout)

    def end(self) -> None:
        """Leave nothing behind, whatever happened."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()


@pytest.fixture(scope='module')
def ros2(own_domain: dict[str, str]) -> Ros2:
    """Find the command, or skip and say what it would take."""
    named = os.environ.get('POLAR_ROS2')
    program = named or shutil.which('ros2')
    if program is None:
        pytest.skip('no ros2 command: it is not on the PATH, and POLAR_ROS2 names none')
    command = Ros2(program, own_domain)
    found = command.call('pkg', 'executables', 'polar_nav_tools')
    if found.returncode != 0 and not named:
        why = (found.stderr.strip().splitlines() or ['it said nothing'])[-1]
        pytest.skip(f'{program} does not find polar_nav_tools, source its workspace: {why}')
    assert found.returncode == 0, found.stderr
    return command


@pytest.fixture(scope='class')
def graph(ros2: Ros2, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ros2]:
    """The demo in real time, launched by ros2; at the end it must take a Ctrl-C well."""
    folder = tmp_path_factory.mktemp('launch')
    bag = folder / 'bag'
    launch = ros2.start(folder, 'launch', 'polar_nav_tools', 'demo.launch.py', f'bag:={bag}')
    try:
        launch.wait_for(lambda: 'mission demo' in launch.output)
        ros2.said('topic', 'echo', '--once', '/follower/nav/state')
        yield ros2
        status = launch.ctrl_c()
    finally:
        launch.end()
    assert status == 0, launch.output
    assert launch.output.count('process has finished cleanly') == NODE_COUNT, launch.output
    assert_whole(bag)


def assert_whole(bag: Path) -> None:
    """The recorder finished it."""
    told = polar('info', bag, '--json')
    assert told.returncode == 0, told.stderr
    assert json.loads(told.stdout)['is_complete'] is True
    assert told.stderr == ''


# -- packages, programs, interfaces


@pytest.mark.parametrize('package', NODES)
def test_pkg_executables_are_the_nodes(ros2, package):
    said = ros2.said('pkg', 'executables', package).splitlines()
    assert {line.split()[1] for line in said} - {'polar', 'composed'} == NODES[package]


def test_interface_show_has_units_and_meaning(ros2):
    said = ros2.said('interface', 'show', 'polar_nav_msgs/msg/FixReceipt')
    assert 'uint8 FUSED=0' in said
    assert 'float64[3] innovation_variance_g   # diagonal of its covariance [m^2]' in said


# -- ros2 run


def test_run_starts_every_node_and_ctrl_c_ends_it(ros2, tmp_path):
    pairs = [(package, node) for package, nodes in NODES.items() for node in sorted(nodes)]
    space = ('--ros-args', '-r', '__ns:=/alone')
    running = {node: ros2.start(tmp_path, 'run', p, node, *space) for p, node in pairs}
    try:
        listed: set[str] = set()

        def all_listed() -> bool:
            listed.update(ros2.said('node', 'list', *FRESH).split())
            return listed >= {f'/alone/{node}' for node in running}

        running['truth_node'].wait_for(all_listed, timeout=120.0)
        status = {node: process.ctrl_c() for node, process in running.items()}
    finally:
        for process in running.values():
            process.end()
    output = '\n'.join(process.output for process in running.values())
    assert set(status.values()) == {0}, f'{status}\n{output}'
    assert 'Traceback' not in output


def test_run_refuses_an_unknown_parameter_in_one_sentence(ros2):
    done = ros2.call('run', 'polar_nav_sim', 'imu_node', '--ros-args', '-p', 'colour:=1')
    assert done.returncode != 0
    assert 'unknown parameter colour' in done.stdout + done.stderr
    assert 'Traceback' not in done.stdout + done.stderr


class TestRunningGraph:
    """What is asked of it; it ends with the class, before another one is launched."""

    def test_topic_list_shows_topics_with_types(self, graph):
        listed = graph.said('topic', 'list', '-t', *FRESH)
        for topic, kind in {
            '/clock': 'rosgraph_msgs/msg/Clock',
            '/follower/imu/data_raw': 'sensor_msgs/msg/Imu',
            '/follower/nav/state': 'polar_nav_msgs/msg/NavState',
            '/follower/nav/receipt': 'polar_nav_msgs/msg/FixReceipt',
            '/leader/usbl/fix': 'polar_nav_msgs/msg/UsblFix',
            '/leader/acomms/tx': 'polar_nav_msgs/msg/AcousticPacket',
        }.items():
            assert f'{topic} [{kind}]' in listed

    def test_topic_echo_shows_a_fix_that_was_used(self, graph):
        fused = ('--filter', "m.verdict_text == 'FUSED'")
        said = graph.said('topic', 'echo', '--once', *fused, '/follower/nav/receipt')
        assert 'delay_handling: back_propagate' in said

    def test_topic_hz_of_the_estimate(self, graph, tmp_path):
        watch = graph.start(tmp_path, 'topic', 'hz', '/follower/nav/state')
        try:
            watch.wait_for(lambda: watch.output.count('average rate') >= 5)
            watch.ctrl_c()
        finally:
            watch.end()
        rates = [line.split()[-1] for line in watch.output.splitlines() if 'average rate' in line]
        assert float(rates[-1]) == pytest.approx(10.0, rel=0.3)

    def test_node_info_shows_topics_and_services(self, graph):
        said = graph.said('node', 'info', FOLLOWER, *FRESH)
        for text in (
            '/follower/imu/data_raw: sensor_msgs/msg/Imu',
            '/follower/nav/state: polar_nav_msgs/msg/NavState',
            f'{FOLLOWER}/set_initial_state: polar_nav_msgs/srv/SetInitialState',
        ):
            assert text in said

    def test_parameters_describe_themselves(self, graph):
        assert 'max_delay_s' in graph.said('param', 'list', FOLLOWER, *FRESH).split()
        described = graph.said('param', 'describe', FOLLOWER, 'max_delay_s', *FRESH)
        for text in ('Type: double', 'Oldest fix that is still used [s]', 'Max value: 120.0'):
            assert text in described
        assert '60.0' in graph.said('param', 'get', FOLLOWER, 'max_delay_s', *FRESH)

    def test_services_answer_and_say_why_not(self, graph):
        reset = graph.said('service', 'call', f'{FOLLOWER}/reset', 'std_srvs/srv/Trigger')
        assert 'success=True' in reset
        service = (f'{FOLLOWER}/set_initial_state', 'polar_nav_msgs/srv/SetInitialState')
        refused = graph.said('service', 'call', *service, '{initial_state: {latitude: 1.4}}')
        assert 'success=False' in refused
        assert 'sigma_position_horizontal is 0.0: it must be positive' in refused


# -- ros2 launch


def test_launch_shows_its_arguments(ros2):
    said = ros2.said('launch', 'polar_nav_tools', 'demo.launch.py', '--show-args')
    for name in ('mission', 'pace', 'duration', 'seed', 'configuration', 'bag'):
        assert f"'{name}':" in said


@pytest.mark.parametrize(
    ('argument', 'sentence'),
    [
        ('duration:=long', "argument duration: 'long' is not a number"),
        ('mission:=nowhere', "mission 'nowhere' is neither a file nor one of"),
        ('seed:=-1', 'seed -1 is outside of'),
    ],
)
def test_launch_refuses_a_bad_argument_before_it_starts_anything(ros2, argument, sentence):
    done = ros2.call('launch', 'polar_nav_tools', 'demo.launch.py', argument)
    assert done.returncode == 1
    assert sentence in done.stdout + done.stderr
    assert 'process started' not in done.stdout + done.stderr


def test_launch_runs_the_demo_to_its_end(ros2, tmp_path):
    bag = tmp_path / 'bag'
    arguments = ('duration:=10.0', 'pace:=lockstep', f'bag:={bag}')
    launch = ros2.start(tmp_path, 'launch', 'polar_nav_tools', 'demo.launch.py', *arguments)
    try:
        assert launch.process.wait(200.0) == 0, launch.output
    finally:
        launch.end()
    assert launch.output.count('process has finished cleanly') == NODE_COUNT, launch.output
    assert_whole(bag)
    verified = polar('verify', bag)
    assert verified.returncode == 0, verified.stderr


def test_launch_fails_and_names_the_node_that_died(ros2, tmp_path):
    bag = tmp_path / 'bag'
    launch = ros2.start(
        tmp_path, 'launch', 'polar_nav_tools', 'demo.launch.py', f'bag:={bag}', 'duration:=200'
    )
    try:
        launch.wait_for(lambda: 'mission demo' in launch.output)
        (line,) = (
            text for text in launch.output.splitlines() if 'usbl_node' in text and 'pid' in text
        )
        os.kill(int(line.split('[')[-1].rstrip(']')), signal.SIGKILL)
        assert launch.process.wait(90.0) == 1, launch.output
    finally:
        launch.end()
    assert 'node /leader/usbl_node was killed by SIGKILL before the mission' in launch.output
    assert launch.output.count('process has finished cleanly') == NODE_COUNT - 1, launch.output
    assert_whole(bag)
