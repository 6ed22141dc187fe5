"""One node as a child process: its parameter file, its output, its end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..graph.spec import NodeSpec, parameter_yaml

TAIL_LINES = 30
READY = 'ready '
PROGRESS = 'progress '
COUNTS = 'counts '
ALIVE = 'alive '
"""First words of the lines that a node prints for the supervisor, not for people."""


@dataclass(frozen=True)
class NodeEnd:
    """How one node ended.

    Attributes
    ----------
    name : str
        Fully qualified node name.
    returncode : int
        Exit status; minus the signal number when a signal ended it.
    last_lines : tuple of str
        The end of its output.
    log : str
        File name of all its output in ``logs/``.
    hung : str
        What it did instead of ending, in words; empty when it ended.
    """

    name: str
    returncode: int
    last_lines: tuple[str, ...]
    log: str
    hung: str = ''

    def how(self) -> str:
        """Exit status or signal, in words."""
        if self.hung:
            return self.hung
        if self.returncode >= 0:
            return f'exited with status {self.returncode}'
        return f'was killed by {signal.Signals(-self.returncode).name}'


class NodeProcess:
    """A running node and its output so far.

    Parameters
    ----------
    spec : NodeSpec
        What to run.
    run_dir : Path
        Has ``params/`` and ``logs/``.
    env : mapping
        Environment of the process.
    on_line : callable
        Called with node name and line of output.
    """

    def __init__(
        self,
        spec: NodeSpec,
        run_dir: Path,
        env: Mapping[str, str],
        on_line: Callable[[str, str], None],
    ) -> None:
        self.spec = spec
        self._on_line = on_line
        stem = spec.full_name.strip('/').replace('/', '.')
        parameters = run_dir / 'params' / f'{stem}.yaml'
        parameters.write_text(parameter_yaml(spec), encoding='utf-8')
        self._log = f'{stem}.log'
        self._file = (run_dir / 'logs' / self._log).open('ab')
        self.tail: deque[str] = deque(maxlen=TAIL_LINES)
        self._partial = b''
        self.heard_at: float | None = None
        command = [
            sys.executable,
            '-m',
            'polar_nav_tools.live.child',
            str(os.getpid()),
            spec.module,
        ]
        self.process = subprocess.Popen(
            [*command, *spec.ros_args(parameters)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            # Unbuffered: what a node said last must not come before what it said first.
            env={**env, 'PYTHONUNBUFFERED': '1'},
            start_new_session=True,
        )
        stdout = self.process.stdout
        if stdout is None:
            raise RuntimeError(f'no output pipe of {spec.full_name}')
        self.pipe = stdout
        os.set_blocking(self.pipe.fileno(), False)

    def read(self) -> bool:
        """Read the output in the pipe; False at its end."""
        while True:
            try:
                data = os.read(self.pipe.fileno(), 65536)
            except BlockingIOError:
                return True
            if not data:
                if self._partial:
                    self._take(self._partial)
                    self._partial = b''
                return False
            *lines, self._partial = (self._partial + data).split(b'\n')
            for line in lines:
                self._take(line)

    def _take(self, raw: bytes) -> None:
        line = raw.decode('utf-8', 'replace').rstrip('\r')
        if self.heard_at is not None or line.startswith(ALIVE):
            self.heard_at = time.monotonic()
        if not line.startswith((READY, PROGRESS, COUNTS, ALIVE)):
            self._file.write(raw + b'\n')
            self._file.flush()
            self.tail.append(line)
        self._on_line(self.spec.full_name, line)

    def is_stopped(self) -> bool:
        """Whether the process is stopped (SIGSTOP), as the kernel says."""
        try:
            status = Path(f'/proc/{self.process.pid}/stat').read_text(encoding='utf-8')
        except OSError:
            return False
        return status.rpartition(')')[2].split()[0] in ('T', 't')

    def signal(self, number: int) -> None:
        """Send a signal; to the whole session when it is SIGKILL."""
        if self.process.poll() is not None:
            return
        if number == signal.SIGKILL:
            os.killpg(self.process.pid, number)
        else:
            self.process.send_signal(number)

    def hung(self, how: str) -> NodeEnd:
        """What there is to say of a process that does not end."""
        return NodeEnd(self.spec.full_name, 0, tuple(self.tail), self._log, how)

    def end(self) -> NodeEnd:
        """End of the process: exit status or signal."""
        return NodeEnd(self.spec.full_name, self.process.wait(), tuple(self.tail), self._log)

    def close(self) -> None:
        """Close pipe and log."""
        self.pipe.close()
        self._file.close()
