"""Processor time, wall time and memory of a whole graph: a process per node, or per vehicle.

Both run the mission `demo` in lockstep, in turn, with a recorder each; what the followers publish
is compared byte by byte. Times per simulated second are those between two moments in which all
nodes are at work; what a run takes beside them is its start and end.
"""

from __future__ import annotations

import math
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

from polar_nav_core.errors import PolarNavError

from ..bags import open_bag
from ..graph.options import GraphOptions
from ..live.run import read_mission
from ..scoring import Column, Table
from . import processes
from .rounds import Ratio
from .whole_graph import run_graph

SECONDS = 120.0
_BEGIN_S = 5.0
"""Simulated time after which every node has loaded what it needs."""
_WAYS = {'separate': False, 'composed': True}
_COMPARED = ('/follower/nav/state', '/follower/nav/receipt')


@dataclass(frozen=True)
class GraphRun:
    """Figures of one run.

    Attributes
    ----------
    processes : int
        Their number.
    cpu_ms, wall_ms : float
        Processor time of all of them, and wall time, per simulated second [ms].
    around_cpu_s, around_wall_s : float
        The same of start and end [s].
    memory_mb : float
        Sum of their proportional memory in the middle of the run [MB].
    """

    processes: int
    cpu_ms: float
    wall_ms: float
    around_cpu_s: float
    around_wall_s: float
    memory_mb: float


_TITLES = {
    'processes': ('processes', ''),
    'cpu_ms': ('processor time per simulated second', 'ms'),
    'wall_ms': ('wall time per simulated second', 'ms'),
    'around_cpu_s': ('processor time of start and end', 's'),
    'around_wall_s': ('wall time of start and end', 's'),
    'memory_mb': ('memory, shared parts once', 'MB'),
}


@dataclass(frozen=True)
class GraphBenchmark:
    """Figures of all rounds.

    Attributes
    ----------
    seconds : float
        Simulated length of each run.
    runs : mapping of str to list of GraphRun
        By way, `separate` and `composed`, one for each round.
    """

    seconds: float
    runs: Mapping[str, Sequence[GraphRun]]

    def ratio(self, name: str) -> Ratio:
        """Figure of separate processes over that of composed ones, within each round."""
        pairs = zip(self.runs['separate'], self.runs['composed'], strict=True)
        found = [getattr(one, name) / getattr(other, name) for one, other in pairs]
        return Ratio(statistics.median(found), min(found), max(found))

    def table(self) -> Table:
        """Medians of the rounds, and ratios."""
        rows = []
        for name in (f.name for f in fields(GraphRun)):
            title, unit = _TITLES[name]
            medians = {
                way: statistics.median(getattr(run, name) for run in runs)
                for way, runs in self.runs.items()
            }
            ratio = self.ratio(name)
            between = f'{ratio.lowest:.2f} to {ratio.highest:.2f}'
            rows.append(
                {'what': title, 'unit': unit, **medians, 'ratio': ratio.median, 'between': between}
            )
        columns = (
            Column('what', ''),
            Column('unit', ''),
            Column('separate', 'separate'),
            Column('composed', 'composed'),
            Column('ratio', 'ratio'),
            Column('between', 'of the rounds'),
        )
        return Table(f'The graph of demo, {self.seconds:g} s in lockstep', columns, tuple(rows))

    def to_dict(self) -> dict[str, object]:
        """All as values for JSON."""
        return {
            'seconds': self.seconds,
            'rounds': {way: [asdict(run) for run in runs] for way, runs in self.runs.items()},
            'ratios': {f.name: asdict(self.ratio(f.name)) for f in fields(GraphRun)},
        }


def run(
    rounds: int = 3, seconds: float = SECONDS, report: Callable[[str], None] = print
) -> GraphBenchmark:
    """Figures of both ways, in turn; every second round in reverse order.

    Raises
    ------
    PolarNavError
        When a run fails, or the followers did not publish the same bytes.
    """
    found: dict[str, list[GraphRun]] = {way: [] for way in _WAYS}
    with tempfile.TemporaryDirectory(prefix='polar_nav_') as folder:
        for number in range(rounds):
            for way in _WAYS if number % 2 == 0 else reversed(_WAYS):
                report(f'round {number + 1} of {rounds}: {way}')
                one = Path(folder) / f'{way}_{number}'
                found[way].append(_measure(one, seconds, composed=_WAYS[way]))
            _compare(*(Path(folder) / f'{way}_{number}' / 'bag' for way in _WAYS))
    return GraphBenchmark(seconds, found)


@dataclass
class _Meter:
    """Takes figures as a run goes on.

    Attributes
    ----------
    clock : callable
        Wall time [s].
    memory_mb : float
        Sum of the proportional memory of all processes in the middle of the run [MB].
    count : int
        Number of processes.
    """

    clock: Callable[[], float] = time.monotonic
    memory_mb: float = math.nan
    count: int = 0
    taken: list[tuple[float, float, float]] = field(default_factory=list)
    """First and last: simulated, wall and processor time [s]."""

    def take(self, now_s: float, total_s: float, pids: Mapping[str, int]) -> None:
        """Take figures of processes at a simulated time."""
        self.count = len(pids)
        if now_s < _BEGIN_S:
            return
        try:
            cpu_s = sum(processes.cpu_s(pid) for pid in pids.values())
            if math.isnan(self.memory_mb) and now_s >= 0.5 * total_s:
                self.memory_mb = sum(processes.proportional_mb(pid) for pid in pids.values())
        except OSError:  # one has ended: the run is over
            return
        self.taken = [*self.taken[:1], (now_s, self.clock(), cpu_s)]


def _measure(folder: Path, seconds: float, *, composed: bool) -> GraphRun:
    options = GraphOptions(bag=folder / 'bag', composed=composed)
    meter, children = _Meter(), _children_cpu_s()
    outcome = run_graph(read_mission('demo', seconds), options, folder / 'run', meter.take)
    if len(meter.taken) < 2 or math.isnan(meter.memory_mb):
        raise PolarNavError(f'a run of {seconds:g} s was over before it could be measured')
    (from_s, began_s, before_s), (until_s, ended_s, after_s) = meter.taken
    simulated_s = until_s - from_s
    cpu, wall = (after_s - before_s) / simulated_s, (ended_s - began_s) / simulated_s
    return GraphRun(
        processes=meter.count,
        cpu_ms=1e3 * cpu,
        wall_ms=1e3 * wall,
        around_cpu_s=_children_cpu_s() - children - cpu * seconds,
        around_wall_s=outcome.wall_s - wall * seconds,
        memory_mb=meter.memory_mb,
    )


def _children_cpu_s() -> float:
    """Processor time of all children of this process that have ended [s]."""
    times = os.times()
    return times.children_user + times.children_system


def _compare(one: Path, other: Path) -> None:
    for topic in _COMPARED:
        if list(open_bag(one).payloads(topic)) != list(open_bag(other).payloads(topic)):
            raise PolarNavError(f'{topic} differs between separate and composed processes')
