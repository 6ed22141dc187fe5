"""Memory of every process of a graph over a long run, and whether its bag is whole.

A mission in lockstep at full speed, recorded into files of a stated size. What a process holds is
read again and again as the run goes on; at the end the bag is replayed, and what the follower
published live has to come out of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from polar_nav_core.errors import PolarNavError

from ..bags import open_bag
from ..graph.options import GraphOptions
from ..live.run import read_mission
from ..replay.verification import verify
from ..scoring import Column, Table
from ..terminal.progress import progress_display
from . import processes
from .whole_graph import run_graph

SAMPLES = 96
"""Times that memory is read in a run."""
FLAT_SHARE = 0.05
"""What memory may grow by from the second quarter of a run to the last."""


@dataclass(frozen=True)
class Memory:
    """Memory of one process over a run.

    Attributes
    ----------
    name : str
    second_quarter_mb, last_quarter_mb : float
        Mean of what it had allocated [MB].
    most_mb : float
        The most at any look [MB].
    """

    name: str
    second_quarter_mb: float
    last_quarter_mb: float
    most_mb: float

    @property
    def growth(self) -> float:
        """Share that it grew by from the second quarter to the last."""
        return self.last_quarter_mb / self.second_quarter_mb - 1.0

    @property
    def flat(self) -> bool:
        """Whether that is no more than `FLAT_SHARE`."""
        return self.growth <= FLAT_SHARE


@dataclass(frozen=True)
class Endurance:
    """What a long run showed.

    Attributes
    ----------
    seconds : float
        Simulated length.
    wall_s : float
        How long it took.
    memory : sequence of Memory
        One for each process.
    files : int
        Of the bag.
    size_mb : float
        Of all of them.
    problems : sequence of str
        What is wrong with the bag; none where it is whole, and live and replay are equal.
    """

    seconds: float
    wall_s: float
    memory: Sequence[Memory]
    files: int
    size_mb: float
    problems: Sequence[str]

    @property
    def ok(self) -> bool:
        """Whether memory is flat in every process, and the bag verified."""
        return not self.problems and all(m.flat for m in self.memory)

    def table(self) -> Table:
        """Memory by process."""
        rows = [
            {
                'process': m.name.partition(' (')[0],
                'second': m.second_quarter_mb,
                'last': m.last_quarter_mb,
                'most': m.most_mb,
                'growth': 100.0 * m.growth,
            }
            for m in self.memory
        ]
        columns = (
            Column('process', 'process'),
            Column('second', 'second quarter', 'MB'),
            Column('last', 'last quarter', 'MB'),
            Column('most', 'most', 'MB'),
            Column('growth', 'growth', '%'),
        )
        title = f'Memory that each process had allocated in {self.seconds / 3600.0:g} h'
        return Table(title, columns, tuple(rows))

    def sentence(self) -> str:
        """Speed, bag, and what is wrong with it."""
        bag = '; '.join(self.problems) or 'whole, and live and replay are equal bit for bit'
        return (
            f'{self.seconds / self.wall_s:.1f} times real time; the bag, {self.files} files and '
            f'{self.size_mb:.0f} MB: {bag}.'
        )

    def to_dict(self) -> dict[str, object]:
        """All as values for JSON."""
        return {
            'ok': self.ok,
            'seconds': self.seconds,
            'wall_s': self.wall_s,
            'memory': [asdict(m) | {'growth': m.growth, 'flat': m.flat} for m in self.memory],
            'files': self.files,
            'size_mb': self.size_mb,
            'problems': list(self.problems),
        }


@dataclass
class Watch:
    """Reads the memory of every process at even distances of simulated time."""

    seconds: float
    every_s: float = field(init=False)
    read: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    """Simulated time [s] and memory [MB] by process."""
    _next_s: float = 0.0

    def __post_init__(self) -> None:
        self.every_s = self.seconds / SAMPLES

    def look(self, now_s: float, pids: Mapping[str, int]) -> None:
        """Read memory, if it is time to."""
        if now_s < self._next_s:
            return
        self._next_s = now_s + self.every_s
        try:
            found = {name: processes.own_mb(pid) for name, pid in pids.items()}
        except OSError:  # one has ended: the run is over
            return
        for name, memory_mb in found.items():
            self.read.setdefault(name, []).append((now_s, memory_mb))

    def memory(self) -> list[Memory]:
        """Memory of each process.

        Raises
        ------
        PolarNavError
            When the run was over before the quarters could be measured.
        """
        return [self._one(name, np.array(pairs)) for name, pairs in self.read.items()]

    def _one(self, name: str, pairs: np.ndarray) -> Memory:
        quarter = np.minimum(4.0 * pairs[:, 0] / self.seconds, 3.0).astype(int)
        if not {1, 3} <= set(quarter):
            raise PolarNavError(f'{name}: the run was over before its memory could be measured')
        second, last = (float(pairs[quarter == q, 1].mean()) for q in (1, 3))
        return Memory(name, second, last, float(pairs[:, 1].max()))


def run(
    folder: Path,
    *,
    hours: float,
    mission: str,
    composed: bool,
    max_bag_bytes: int,
    report: Callable[[str], None],
) -> Endurance:
    """What a long run shows; its bag is left in the folder.

    Raises
    ------
    ConfigError
        For a mission that does not exist, or a bag that does.
    PolarNavError
        When the run did not come to its end.
    """
    seconds = 3600.0 * hours
    watch = Watch(seconds)
    options = GraphOptions(bag=folder / 'bag', composed=composed, max_bag_bytes=max_bag_bytes)
    with progress_display(mission, total=seconds, unit='s') as show:

        def look(now_s: float, total_s: float, pids: Mapping[str, int]) -> None:
            watch.look(now_s, pids)
            show(now_s, total_s)

        outcome = run_graph(read_mission(mission, seconds), options, folder / 'run', look)
    report(f'{outcome.wall_s:.0f} s; verifying {options.bag}')
    files = sorted((folder / 'bag').glob('*.mcap'))
    return Endurance(
        seconds,
        outcome.wall_s,
        watch.memory(),
        len(files),
        sum(f.stat().st_size for f in files) / 1e6,
        _problems(folder / 'bag'),
    )


def _problems(path: Path) -> list[str]:
    bag = open_bag(path)
    found = list(bag.problems)
    if not verify(bag).ok:
        found.append(f'live and replay differ; `./polar verify {path}` says where')
    return found
