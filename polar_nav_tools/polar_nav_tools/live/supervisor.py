"""Runs the processes of a graph, watches them, and ends all of them in order.

In: what each process runs, and a run directory. Out: a :class:`RunOutcome`; in the run directory a
parameter file per node and a log file per process. The run is complete when the truth node exits
with status 0; any process that ends before that ends the run. Each is the leader of a session of
its own, so a Ctrl-C at the terminal reaches the supervisor only, which then stops them from
upstream to downstream and the recorder last.
"""

from __future__ import annotations

import json
import selectors
import signal
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from types import FrameType, TracebackType

from ..graph.processes import ProcessSpec
from ..graph.spec import Stage
from .node_process import ALIVE, COUNTS, PROGRESS, READY, NodeEnd, NodeProcess
from .silence import SilenceWatch

_POLL_S = 0.1
_READY_PATIENCE_S = 60.0

RESPAWN_DELAY_S = 1.0
"""The sensors go on meanwhile; a node that dies at its start shall not keep a processor busy."""
MOST_RESPAWNS = 100
"""Of one node: one that dies more often is not saved by another start."""


class RunStatus(Enum):
    """End of a run."""

    COMPLETED = 'completed'
    INTERRUPTED = 'interrupted'
    FAILED = 'failed'


@dataclass(frozen=True)
class RunOutcome:
    """Result of a run: its end, and the end of each node.

    Attributes
    ----------
    status : RunStatus
        COMPLETED only when the mission ended and every node exited with status 0.
    culprit : NodeEnd or None
        The node whose end made the run fail.
    sentence : str
        What happened.
    wall_s : float
        Wall time from the first start to the last end [s].
    signal : int or None
        The signal that interrupted it.
    counts : mapping
        Node -> 'published' and 'taken' -> fully qualified topic -> messages, as each node counted
        them at its end; without nodes that were started again, which count from then on only.
    """

    status: RunStatus
    culprit: NodeEnd | None
    sentence: str
    wall_s: float
    signal: int | None = None
    counts: Mapping[str, Mapping[str, Mapping[str, int]]] = field(default_factory=dict)


@dataclass(frozen=True)
class Grace:
    """Wall time [s] for nodes to end after SIGINT, and after SIGTERM before SIGKILL."""

    after_sigint_s: float
    after_sigterm_s: float


ORDERLY = Grace(20.0, 5.0)
"""The follower processes its reorder window, the recorder closes the bag."""
HURRIED = Grace(2.0, 0.5)
"""After a failure: the run is lost, only the bag matters, and the user waits."""
RECORDER_HURRIED = Grace(4.0, 1.0)


_TRACEBACK_S = 0.3
"""Wall time for a node that hangs to write where it does."""


class _Interrupts:
    """Counts SIGINT, SIGTERM and SIGHUP."""

    _NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def __init__(self) -> None:
        self.first: int | None = None
        self.count = 0

    def __enter__(self) -> _Interrupts:
        self._before = {number: signal.signal(number, self._note) for number in self._NUMBERS}
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.first = self.first or number
        self.count += 1


class Supervisor:
    """Starts the nodes of a graph, waits for the end of the run, ends the nodes in order.

    Parameters
    ----------
    processes : sequence of ProcessSpec
        What to run.
    run_dir : Path
        Where ``params/`` and ``logs/`` go.
    env : mapping
        Environment of the nodes (:func:`polar_nav_tools.live.domain.graph_environment`).
    on_progress : callable, optional
        Called with simulated and total time [s] as the truth node reports them.
    on_line : callable, optional
        Called with node name and line for all other output.
    on_problem : callable, optional
        Called with a sentence on a node that does not answer.
    respawn_delay_s : float
        Wall time from the death of a node that respawns to its next start.
    truth_last : bool
        Start the truth node when all others have said that they are ready. At the pace realtime,
        where it waits for nobody, they would miss the beginning.
    """

    def __init__(
        self,
        processes: Sequence[ProcessSpec],
        run_dir: Path,
        env: Mapping[str, str],
        *,
        on_progress: Callable[[float, float], None] | None = None,
        on_line: Callable[[str, str], None] | None = None,
        on_problem: Callable[[str], None] | None = None,
        truth_last: bool = False,
        respawn_delay_s: float = RESPAWN_DELAY_S,
    ) -> None:
        self._processes = sorted(processes, key=lambda spec: -spec.stage)
        self._run_dir = run_dir
        self._env = env
        self._on_progress = on_progress
        self._on_line = on_line
        self._on_problem = on_problem
        self._truth_last = truth_last
        self._respawn_delay_s = respawn_delay_s
        self._respawns: Counter[str] = Counter()
        self._due: list[tuple[float, ProcessSpec]] = []
        self._ready: set[str] = set()
        self._counts: dict[str, Mapping[str, Mapping[str, int]]] = {}
        self._children: list[NodeProcess] = []
        self._selector = selectors.DefaultSelector()
        self._silence = SilenceWatch()

    def pids(self) -> dict[str, int]:
        """Process id of each process that was started."""
        return {child.spec.name: child.process.pid for child in self._children}

    def run(self) -> RunOutcome:
        """Result of a run until the end of the mission, a signal, or the death of a node."""
        started = time.monotonic()
        for name in ('params', 'logs'):
            (self._run_dir / name).mkdir(parents=True, exist_ok=True)
        with _Interrupts() as interrupts:
            try:
                culprit = self._start_and_watch(interrupts)
                if culprit is not None:
                    sentence = (
                        f'{culprit.how()} {time.monotonic() - started:.1f} s after the start'
                    )
                    self._stop_hurried()
                    return self._failed(culprit, sentence, started)
                unclean = self._stop_orderly(interrupts)
                wall_s = time.monotonic() - started
                if interrupts.first is not None:
                    name = signal.Signals(interrupts.first).name
                    sentence = f'ended by {name}'
                    return RunOutcome(
                        RunStatus.INTERRUPTED,
                        unclean,
                        sentence,
                        wall_s,
                        interrupts.first,
                        self._counts,
                    )
                if unclean is not None:
                    return self._failed(unclean, f'{unclean.how()} while it was ended', started)
                return RunOutcome(
                    RunStatus.COMPLETED, None, 'the mission ended', wall_s, None, self._counts
                )
            finally:
                self._sweep()

    def _failed(self, culprit: NodeEnd, how: str, started: float) -> RunOutcome:
        sentence = f'{culprit.title} {how}'
        return RunOutcome(RunStatus.FAILED, culprit, sentence, time.monotonic() - started)

    def _start_and_watch(self, interrupts: _Interrupts) -> NodeEnd | None:
        """Node that died, or None at the end of the mission or after a signal."""
        for spec in self._processes:
            if self._truth_last and spec.stage == Stage.TRUTH:
                died = self._wait_until_ready(interrupts)
                if died is not None:
                    return died
            if interrupts.count > 0:
                return None
            self._start(spec)
        while interrupts.count == 0:
            self._pump(_POLL_S)
            self._respawn()
            died = self._died(for_good=True) or self._hung()
            if died is not None and interrupts.count == 0:
                return died
            if any(c.process.poll() is not None for c in self._of(Stage.TRUTH)):
                return None
        return None

    def _start(self, spec: ProcessSpec) -> None:
        child = NodeProcess(spec, self._run_dir, self._env, self._take_line)
        self._children.append(child)
        self._selector.register(child.pipe, selectors.EVENT_READ, child)
        self._pump(0.0)

    def _respawn(self) -> None:
        """Bury nodes that died and are to be started again; start those whose time has come."""
        for child in [c for c in self._children if c.spec.respawns]:
            if child.process.poll() is None or not self._comes_back(child):
                continue
            name = child.spec.name
            self._respawns[name] += 1
            self._bury(child)
            self._tell(child.spec.title, f'{child.end().how()}: it is started again')
            self._due.append((time.monotonic() + self._respawn_delay_s, child.spec))
        now_s = time.monotonic()
        for due in [d for d in self._due if d[0] <= now_s]:
            self._due.remove(due)
            self._start(due[1])

    def _comes_back(self, child: NodeProcess) -> bool:
        """Whether a node that died is started again; else the run ends by it."""
        lives = self._respawns[child.spec.name]
        return child.spec.respawns and lives < MOST_RESPAWNS and not _gave_up(child)

    def _bury(self, child: NodeProcess) -> None:
        """Read the last output of a node that died, and forget it."""
        child.read()
        if child.pipe.fileno() in self._selector.get_map():
            self._selector.unregister(child.pipe)
        child.close()
        self._children.remove(child)

    def _of(self, stage: Stage) -> list[NodeProcess]:
        return [child for child in self._children if child.spec.stage == stage]

    def _wait_until_ready(self, interrupts: _Interrupts) -> NodeEnd | None:
        """Node that died while nodes got ready, or None."""
        deadline = time.monotonic() + _READY_PATIENCE_S
        waiting = {child.spec.name: child.spec.title for child in self._children}
        while (
            interrupts.count == 0 and time.monotonic() < deadline and waiting.keys() - self._ready
        ):
            self._pump(_POLL_S)
            died = self._died() or self._hung()
            if died is not None:
                return died
        for name in sorted(waiting.keys() - self._ready if interrupts.count == 0 else ()):
            self._tell(
                waiting[name], f'is not ready after {_READY_PATIENCE_S:.0f} s; not waiting for it'
            )
        return None

    def _hung(self) -> NodeEnd | None:
        """Node that has not answered for too long, or None; names those on the way there."""
        said, lost = self._silence.look(time.monotonic(), self._children)
        for title, sentence in said:
            self._tell(title, sentence)
        return None if lost is None else lost.node.hung(lost.how())

    def _tell(self, title: str, sentence: str) -> None:
        if self._on_problem is not None:
            self._on_problem(f'{title} {sentence}')

    def _died(self, *, for_good: bool = False) -> NodeEnd | None:
        """Node that ended too early, or None; ``for_good``: and is not started again."""
        ended = [child for child in self._children if child.process.poll() is not None]
        dead = [c for c in ended if c.spec.stage != Stage.TRUTH or c.process.returncode != 0]
        if for_good:
            dead = [c for c in dead if not self._comes_back(c)]
        if not dead:
            return None
        self._pump(0.0)
        # Of several, a signal explains more than a status, and a bad status more than a good one.
        return min(dead, key=lambda c: _blame(c.process.returncode)).end()

    def _stop_orderly(self, interrupts: _Interrupts) -> NodeEnd | None:
        """First node that did not end with status 0, while ending all stage by stage; or None."""
        already = interrupts.count
        unclean: NodeEnd | None = None
        for stage in Stage:
            group = self._of(stage)
            self._end(group, ORDERLY, lambda: interrupts.count > already)
            bad = [child for child in group if child.process.returncode != 0]
            if bad and unclean is None:
                unclean = bad[0].end()
        return unclean

    def _stop_hurried(self) -> None:
        recorder = self._of(Stage.RECORDER)
        self._end([child for child in self._children if child not in recorder], HURRIED)
        self._end(recorder, RECORDER_HURRIED)

    def _end(
        self,
        group: Sequence[NodeProcess],
        grace: Grace,
        impatient: Callable[[], bool] = lambda: False,
    ) -> None:
        """End nodes by SIGINT, then SIGTERM, then SIGKILL; if ``impatient`` by SIGKILL.

        Before that SIGQUIT has a node that hangs write where it does (`child`).
        """
        steps = (
            (signal.SIGINT, grace.after_sigint_s),
            (signal.SIGTERM, grace.after_sigterm_s),
            (signal.SIGQUIT, _TRACEBACK_S),
            (signal.SIGKILL, 5.0),
        )
        for number, wait_s in steps:
            for child in group:
                child.signal(number)
            deadline = time.monotonic() + wait_s
            while (
                any(child.process.poll() is None for child in group)
                and time.monotonic() < deadline
            ):
                if impatient() and number != signal.SIGKILL:
                    break
                self._pump(0.02)
        self._pump(0.0)

    def _sweep(self) -> None:
        """Kill all processes that are left, and read every pipe to its end."""
        for child in self._children:
            child.signal(signal.SIGKILL)
            child.process.wait()
            child.read()
            child.close()
        self._selector.close()

    def _pump(self, timeout_s: float) -> None:
        if not self._selector.get_map():
            time.sleep(timeout_s)  # all pipes are at their end: nothing wakes the selector
            return
        for key, _ in self._selector.select(timeout_s):
            if not key.data.read():
                self._selector.unregister(key.fileobj)

    def _take_line(self, name: str, line: str) -> None:
        if line.startswith(PROGRESS):
            now_s, total_s = (float(word) for word in line.split()[1:3])
            if self._on_progress is not None:
                self._on_progress(now_s, total_s)
        elif line.startswith(READY):
            self._ready.add(name)
        elif line.startswith(COUNTS):
            if name not in self._respawns:
                node, _, counts = line.removeprefix(COUNTS).partition(' ')
                self._counts[node] = json.loads(counts)
        elif self._on_line is not None and not line.startswith(ALIVE):
            self._on_line(name, line)


def _gave_up(child: NodeProcess) -> bool:
    """Whether a node ended by itself for a reason that its next life would find, too.

    A recorder ends when it cannot write: the disk is full, or the bag was removed.
    """
    return child.spec.stage is Stage.RECORDER and child.process.returncode >= 0


def _blame(returncode: int) -> int:
    return 0 if returncode < 0 else 1 if returncode > 0 else 2
