"""The command line tool as a process, for tests of the live graph."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from polar_nav_tools.bags import BagError, open_bag

TOOL = (sys.executable, '-P', '-m', 'polar_nav_tools.cli')
FOLLOWER = (
    sys.executable,
    '-c',
    'import sys; from polar_nav_follower.follower_node import main; sys.exit(main())',
)
DEMO_SECONDS = 30.0
NODES = {
    'polar_nav_sim': {
        'truth_node',
        'vehicle_node',
        'station_node',
        'ahrs_node',
        'imu_node',
        'dvl_node',
        'depth_node',
        'usbl_node',
        'leader_reference_node',
        'absolute_fix_node',
        'acoustic_link_node',
    },
    'polar_nav_ros': {'modem_bridge'},
    'polar_nav_leader': {'leader_node'},
    'polar_nav_follower': {'follower_node'},
    'polar_nav_tools': {'recorder_node'},
}
"""Nodes of each package, by the names of their programs."""


def polar(*arguments: str | Path, timeout: float = 60.0, **kwargs) -> subprocess.CompletedProcess:
    """Run one command to its end."""
    command = [*TOOL, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout, **kwargs)


def processes_with(text: str) -> dict[int, str]:
    """Return process ids and command lines of the nodes whose arguments contain a text."""
    found = {}
    for entry in Path('/proc').iterdir():
        if not entry.name.isdigit():
            continue
        try:
            command = (entry / 'cmdline').read_bytes().replace(b'\0', b' ').decode()
        except (OSError, UnicodeDecodeError):
            continue  # ended meanwhile
        if text in command and 'polar_nav_tools.live.child' in command:
            found[int(entry.name)] = command
    return found


def written(file: Path, topic: str) -> int:
    """Messages of a topic in a bag that is being written."""
    try:
        return sum(1 for _ in open_bag(file).payloads(topic))
    except (BagError, OSError):
        return 0  # no such file or topic yet


def same_beginning(short: Path, whole: Path) -> dict[str, bool]:
    """By topic, whether two thirds of what a short run published begin a longer one.

    The splines of the truth know in their last bits, some seconds before, where they end.
    """
    found = {}
    for topic, least in (('nav/state', 150), ('nav/receipt', 5)):
        one, other = (list(open_bag(bag).payloads(f'/follower/{topic}')) for bag in (short, whole))
        assert least <= len(one) < len(other), topic
        count = 2 * len(one) // 3
        found[topic] = one[:count] == other[:count]
    return found


class Processes:
    """Processes of one test with a log each; what still runs at its end is killed."""

    def __init__(self, folder: Path, env: Mapping[str, str], setup: Path | None = None) -> None:
        self._folder, self._env = folder, env
        source = [] if setup is None else [f'. "{setup}" && exec "$@"', 'bash']
        self._prefix = ['bash', '-c', *source] if source else []
        self._started: list[subprocess.Popen[bytes]] = []

    def __call__(self, name: str, *command: object) -> subprocess.Popen[bytes]:
        """Start one; its output goes to NAME.log."""
        with (self._folder / f'{name}.log').open('wb') as log:
            process = subprocess.Popen(
                [*self._prefix, *map(str, command)],
                env=self._env,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        self._started.append(process)
        return process

    def wait_for(self, name: str, text: str, timeout: float = 60.0) -> None:
        """Wait until a process has written a text."""
        log, deadline = self._folder / f'{name}.log', time.monotonic() + timeout
        while text not in (said := log.read_text(errors='replace')):
            assert time.monotonic() < deadline, f'{name} did not say {text!r}: {said}'
            time.sleep(0.05)

    def end(self) -> None:
        """Kill what still runs."""
        for process in self._started:
            if process.poll() is None:
                process.kill()
                process.wait()


def interrupt(process: subprocess.Popen[bytes]) -> None:
    """End a node as Ctrl-C does; it has to end well."""
    process.send_signal(signal.SIGINT)
    assert process.wait(60.0) == 0


class RunningDemo:
    """A demo that goes on, with its output."""

    def __init__(
        self,
        folder: Path,
        *arguments: str,
        command: str = 'demo',
        env: Mapping[str, str] | None = None,
    ) -> None:
        self.bag = folder / 'bag'
        self.stderr_file = folder / 'stderr.txt'
        with self.stderr_file.open('wb') as stderr:
            self.process = subprocess.Popen(
                [*TOOL, command, '--bag', str(self.bag), *arguments],
                stdout=subprocess.PIPE,
                stderr=stderr,
                cwd=folder,
                env=env,
            )

    @property
    def stderr(self) -> str:
        return self.stderr_file.read_text()

    def wait_for_progress(self, lines: int, timeout: float) -> None:
        """Wait until that many lines of progress came."""
        deadline = time.monotonic() + timeout
        while self.stderr.count(' of ') < lines:
            assert self.process.poll() is None, self.stderr
            assert time.monotonic() < deadline, f'no progress: {self.stderr}'
            time.sleep(0.05)

    def node_pid(self, full_name: str) -> int:
        """Process id of one node."""
        namespace, _, name = full_name.rpartition('/')
        wanted = f'__node:={name} -r __ns:={namespace or "/"} '
        run_dir = f'{self.bag}.run/'
        pids = [pid for pid, command in self.nodes().items() if wanted in f'{command} ']
        assert len(pids) == 1, f'{full_name}: {pids} in {run_dir}'
        return pids[0]

    def nodes(self) -> dict[int, str]:
        """Return the processes of this demo's nodes."""
        return processes_with(f'{self.bag}.run/')

    def end(self) -> None:
        """End it, whatever state it is in."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.communicate(timeout=30.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.communicate()


@dataclass(frozen=True)
class FinishedDemo:
    """A short demo that ran to its end: exit status, output, figures, bag."""

    process: subprocess.CompletedProcess
    figures: dict
    bag: Path
