"""Nodes that do not answer are named, and fail the run when they never do."""

import os
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest

from polar_nav_tools.live.node_process import NodeProcess
from polar_nav_tools.live.silence import LOST_S, SILENT_S, SilenceWatch


class Fake:
    """A node as far as the watch knows it."""

    def __init__(self, name, heard_at):
        self.spec = SimpleNamespace(title=name)
        self.process = SimpleNamespace(poll=lambda: None)
        self.heard_at = heard_at
        self.stopped = False

    def is_stopped(self):
        return self.stopped


def watch(nodes, times):
    """What was said at each time, and who was lost first."""
    one, said, lost = SilenceWatch(), [], None
    for now in times:
        sentences, gone = one.look(now, nodes)
        said += [(now, *s) for s in sentences]
        if lost is None and gone is not None:
            lost = (now, gone.how())
    return said, lost


def test_a_node_is_named_once_after_ten_seconds_and_lost_after_a_minute():
    frozen = Fake('/dvl_node', 0.0)
    frozen.stopped = True
    said, lost = watch([frozen], range(100))
    sentence = 'has not answered for 10 s: it is stopped (SIGSTOP)'
    assert said == [(SILENT_S, '/dvl_node', sentence)]
    assert lost == (LOST_S, 'has not answered for 60 s: it is stopped (SIGSTOP)')


def test_one_that_never_spoke_is_left_out():
    assert watch([Fake('/compiling', None)], range(200)) == ([], None)


def test_one_that_answers_again_is_told():
    node, one, said = Fake('/a', 0.0), SilenceWatch(), []
    for now in range(30):
        if now >= 15:
            node.heard_at = now
        said += one.look(now, [node])[0]
    assert said == [('/a', 'has not answered for 10 s'), ('/a', 'answers again')]


def test_after_a_pause_of_the_watch_itself_all_have_time_anew():
    assert watch([Fake('/a', 0.0)], [0, 1, 500, 501, 509]) == ([], None)


def test_the_kernel_tells_who_is_stopped():
    child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])
    try:
        asked = SimpleNamespace(process=child)
        assert not NodeProcess.is_stopped(asked)
        os.kill(child.pid, signal.SIGSTOP)
        os.waitid(os.P_PID, child.pid, os.WSTOPPED)
        assert NodeProcess.is_stopped(asked)
    finally:
        child.kill()
        child.wait()


@pytest.mark.parametrize('gone', ['killed', 'before'])
def test_a_node_ends_when_its_launcher_is_gone(gone):
    """A process that watches a launcher that is not its parent, as behind a shell."""
    pytest.importorskip('rclpy')
    launcher = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])
    if gone == 'before':
        launcher.kill()
        launcher.wait()
    program = (
        'import signal; from polar_nav_ros.launcher import watch_launcher; '
        'signal.signal(signal.SIGTERM, lambda *_: exit(7)); watch_launcher(); '
        'print("up", flush=True); signal.pause()'
    )
    node = subprocess.Popen(
        [sys.executable, '-c', program],
        env={**os.environ, 'POLAR_NAV_LAUNCHER': str(launcher.pid)},
        stdout=subprocess.PIPE,
    )
    try:
        if gone == 'killed':
            assert node.stdout.readline() == b'up\n'
            assert node.poll() is None
            launcher.kill()
            launcher.wait()
        assert node.wait(timeout=60.0) == 7
    finally:
        for process in (node, launcher):
            if process.poll() is None:
                process.kill()
            process.wait()
        node.stdout.close()


def test_a_node_without_a_launcher_watches_nobody(monkeypatch):
    pytest.importorskip('rclpy')
    from polar_nav_ros import launcher

    monkeypatch.delenv('POLAR_NAV_LAUNCHER', raising=False)
    monkeypatch.setattr(os, 'kill', lambda *_: pytest.fail('nothing to end'))
    launcher.watch_launcher()
