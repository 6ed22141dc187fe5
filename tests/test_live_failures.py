"""A live run when a node is killed, when the user interrupts, when input is bad."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from live_support import RunningDemo, polar

pytestmark = [pytest.mark.live, pytest.mark.timeout(240)]

LIMIT_S = 10.0
RUNNING = 200_000
"""Bytes of a bag in which all nodes are at work."""
USUAL_VICTIMS = ('/follower/follower_node', '/recorder_node', '/leader/usbl_node')
OTHER_VICTIMS = (
    '/truth_node',
    '/acoustic_link_node',
    '/leader/leader_node',
    '/leader/leader_reference_node',
    '/leader/imu_node',
    '/leader/dvl_node',
    '/leader/depth_node',
    '/follower/imu_node',
    '/follower/dvl_node',
    '/follower/depth_node',
)
VICTIMS = [
    *USUAL_VICTIMS,
    *(pytest.param(name, marks=pytest.mark.long) for name in OTHER_VICTIMS),
]


@pytest.mark.parametrize('name', VICTIMS)
def test_a_killed_node_is_named_in_time_and_the_bag_is_readable(running_demo, name, tmp_path):
    os.kill(running_demo.node_pid(name), signal.SIGKILL)
    killed = time.monotonic()
    stdout, _ = running_demo.process.communicate(timeout=60.0)
    took_s = time.monotonic() - killed
    assert running_demo.process.returncode == 1
    assert took_s < LIMIT_S
    assert f'node {name} was killed by SIGKILL' in running_demo.stderr
    assert stdout == b''
    assert running_demo.nodes() == {}
    info = polar('info', running_demo.bag, '--json')
    said = json.loads(info.stdout)
    assert said['message_count'] > 1000
    # Only a recorder that was killed itself leaves a bag with something missing.
    assert said['ok'] is (name != '/recorder_node')
    if name == '/recorder_node':
        recover_makes_it_whole(running_demo.bag, tmp_path / 'mended')


def recover_makes_it_whole(bag, mended):
    done = polar('recover', bag, '--out', mended, '--json')
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)['message_count'] > 1000
    assert (mended / 'metadata.yaml').is_file()
    info = polar('info', mended, '--json')
    assert 'recovered from a broken bag' in info.stderr
    assert json.loads(info.stdout)['message_count'] == json.loads(done.stdout)['message_count']


@pytest.mark.parametrize(('number', 'status'), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interrupted_also_after_nodes_froze_a_demo_ends_in_order(running_demo, number, status):
    if number == signal.SIGINT:
        # In lockstep all others wait for frozen nodes: without names a run only stands still.
        freeze(running_demo, ['/follower/dvl_node', '/recorder_node'])
    running_demo.process.send_signal(number)
    running_demo.process.communicate(timeout=60.0)
    assert running_demo.process.returncode == status, running_demo.stderr
    assert number.name in running_demo.stderr
    assert running_demo.nodes() == {}
    done = polar('verify', running_demo.bag, '--json')
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)['equal'] is True
    info = json.loads(polar('info', running_demo.bag, '--json').stdout)
    assert info['ok'] is True
    assert info['message_count'] > 1000


def test_nothing_is_left_when_the_tool_itself_is_killed(running_demo):
    assert len(running_demo.nodes()) == 13
    running_demo.process.kill()
    running_demo.process.communicate()
    deadline = time.monotonic() + LIMIT_S
    while running_demo.nodes() and time.monotonic() < deadline:
        time.sleep(0.1)
    assert running_demo.nodes() == {}
    assert polar('info', running_demo.bag).returncode in (0, 1)


NODES = (
    'polar_nav_sim.nodes.truth_node',
    'polar_nav_sim.nodes.imu_node',
    'polar_nav_sim.nodes.dvl_node',
    'polar_nav_sim.nodes.depth_node',
    'polar_nav_sim.nodes.usbl_node',
    'polar_nav_sim.nodes.leader_reference_node',
    'polar_nav_sim.nodes.acoustic_link_node',
    'polar_nav_leader.leader_node',
    'polar_nav_follower.follower_node',
    'polar_nav_tools.record.recorder_node',
)


def run_node(module, environment, *arguments, cwd):
    command = [sys.executable, '-c', f'import sys; from {module} import main; sys.exit(main())']
    return subprocess.run(
        [*command, '--ros-args', *arguments],
        capture_output=True,
        text=True,
        timeout=60.0,
        env=environment,
        cwd=cwd,
    )


@pytest.mark.parametrize('module', NODES)
def test_an_unknown_parameter_stops_a_node_with_one_sentence(module, own_domain, tmp_path):
    done = run_node(module, own_domain, '-p', 'colour:=blue', cwd=tmp_path)
    assert done.returncode != 0
    assert 'unknown parameter colour' in done.stderr
    assert 'Traceback' not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ('module', 'setting', 'name'),
    [
        ('polar_nav_follower.follower_node', 'max_delay_s:=-1.0', 'max_delay_s'),
        ('polar_nav_follower.follower_node', 'configuration:=best', 'configuration'),
        ('polar_nav_follower.follower_node', 'max_delay_s:=soon', 'max_delay_s'),
        ('polar_nav_sim.nodes.imu_node', 'seed:=-1', 'seed'),
        ('polar_nav_sim.nodes.truth_node', 'mission:=nowhere', 'nowhere'),
        ('polar_nav_tools.record.recorder_node', 'compression:=zip', 'compression'),
    ],
)
def test_a_value_out_of_range_stops_a_node_with_one_sentence(
    module, setting, name, own_domain, tmp_path
):
    done = run_node(module, own_domain, '-p', setting, cwd=tmp_path)
    assert done.returncode != 0
    assert name in done.stderr
    assert 'Traceback' not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def freeze(run, names):
    """Stop nodes until all are named, and let them go on until all answer again."""
    pids = {name: run.node_pid(name) for name in names}
    seen = run.stderr.count('\n')
    for pid in pids.values():
        os.kill(pid, signal.SIGSTOP)
    for number, sentence in (
        (signal.SIGCONT, 'node {} has not answered for 10 s: it is stopped (SIGSTOP)'),
        (0, 'node {} answers again'),
    ):
        wanted = {sentence.format(name) for name in names}
        deadline = time.monotonic() + 60.0
        while (missing := wanted - said_since(run, seen)) and time.monotonic() < deadline:
            assert run.process.poll() is None, run.stderr
            time.sleep(0.2)
        assert not missing, run.stderr
        for pid in pids.values():
            os.kill(pid, number)


def said_since(run, line):
    """Sentences on stderr from a line on, without the name of the program."""
    return {text.partition(': ')[2] for text in run.stderr.splitlines()[line:]}


def end_in_order(run):
    """Interrupt a run; nothing is left of it, and its bag can be read: what info found."""
    run.process.send_signal(signal.SIGINT)
    run.process.communicate(timeout=60.0)
    assert run.nodes() == {}
    said = json.loads(polar('info', run.bag, '--json').stdout)
    assert said['message_count'] > 1000
    return said


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.parametrize('arguments', [(), ('--pace', 'realtime'), None])
def test_every_frozen_node_is_named(arguments, tmp_path):
    """One by one, in one run of each command and pace."""
    command = 'launch' if arguments is None else 'demo'
    run = RunningDemo(tmp_path, '--duration', '5000', *(arguments or ()), command=command)
    try:
        recorded = run.bag / 'bag_0.mcap'
        deadline = time.monotonic() + 120.0
        while not (recorded.is_file() and recorded.stat().st_size > RUNNING):
            assert time.monotonic() < deadline, run.stderr
            time.sleep(0.2)
        for name in (*USUAL_VICTIMS, *OTHER_VICTIMS):
            freeze(run, [name])
        said = end_in_order(run)
        assert said['ok'] is True, said['problems']
    finally:
        run.end()
