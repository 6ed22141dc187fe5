"""One node, or those of a vehicle, as a child process: parameter files, output, end."""

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

from ..graph.processes import ProcessSpec, file_stem
from ..graph.spec import parameter_yaml

TAIL_LINES = 30
READY = 'ready '
PROGRESS = 'progress '
COUNTS = 'counts '
ALIVE = 'alive '
FAILED = 'failed '
"""First words of the lines that a node prints for the supervisor, not for people."""


@dataclass(frozen=True)
class NodeEnd:
    """How one node ended, or a process of several.

    Attributes
    ----------
    name : str
        Fully qualified node name, or that of the process.
    returncode : int
        Exit status; minus the signal number when a signal ended it.
    last_lines : tuple of str
        The end of its output.
    log : str
        File name of all its output in ``logs/``.
    hung : str
        What it did instead of ending, in words; empty when it ended.
    kind : str
        node or process.
    """

    name: str
    returncode: int
    last_lines: tuple[str, ...]
    log: str
    hung: str = ''
    kind: str = 'node'

    @property
    def title(self) -> str:
        """What ended, and its name."""
        return f'{self.kind} {self.name}'

    def how(self) -> str:
        """Exit status or signal, in words."""
        if self.hung:
            return self.hung
        if self.returncode >= 0:
            return f'exited with status {self.returncode}'
        return f'was killed by {signal.Signals(-self.returncode).name}'


def write_parameters(spec: ProcessSpec, run_dir: Path) -> list[Path]:
    """Parameter file of each node of a process, written into ``params/`` of a run's folder."""
    files = {run_dir / 'params' / f'{file_stem(n.full_name)}.yaml': n for n in spec.nodes}
    for path, node in files.items():
        path.write_text(parameter_yaml(node), encoding='utf-8')
    return list(files)


class NodeProcess:
    """A running process and its output so far.

    Parameters
    ----------
    spec : ProcessSpec
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
        spec: ProcessSpec,
        run_dir: Path,
        env: Mapping[str, str],
        on_line: Callable[[str, str], None],
    ) -> None:
        self.spec = spec
        self._on_line = on_line
        parameters = write_parameters(spec, run_dir)
        self._log = f'{spec.stem}.log'
        self._file = (run_dir / 'logs' / self._log).open('ab')
        self._failed = ''
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
            [*command, *spec.arguments(parameters)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            # Unbuffered: what a node said last must not come before what it said first.
            env={**env, 'PYTHONUNBUFFERED': '1'},
            start_new_session=True,
        )
        stdout = self.process.stdout
        if stdout is None:
            raise RuntimeError(f'no output pipe of {spec.name}')
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
        if line.startswith(FAILED):
            self._failed = line.removeprefix(FAILED)
            return
        if not line.startswith((READY, PROGRESS, COUNTS, ALIVE)):
            self._file.write(raw + b'\n')
            self._file.flush()
            self.tail.append(line)
        self._on_line(self.spec.name, line)

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
        return self._end(0, how)

    def end(self) -> NodeEnd:
        """End of the process: exit status or signal; of the node that it says has failed."""
        return self._end(self.process.wait())

    def _end(self, returncode: int, hung: str = '') -> NodeEnd:
        for node in self.spec.nodes:
            if self.spec.alone or node.name == self._failed:
                name, kind = node.full_name, 'node'
                break
        else:
            name, kind = self.spec.name, 'process'
        return NodeEnd(name, returncode, tuple(self.tail), self._log, hung, kind)

    def close(self) -> None:
        """Close pipe and log."""
        self.pipe.close()
        self._file.close()
