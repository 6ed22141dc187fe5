"""`polar bench monte-carlo`: a run of arrays, as campaigns and experiments make them.

The world of the long bag (`long_bag`), with `default`: IMU at 100 Hz, DVL at 5 Hz, output at 10
Hz, a fix each 2 s that is 5 to 15 s late. Rows have the covariance that campaigns score, and are
not kept. With looks of the watchdog, and without, and for a filter that is told that its world has
no common errors and no slow biases; nothing is scaled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.track import Track
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.error_model import X

from ..scoring.tables import Column, Table
from .long_bag import CONFIGURATION, long_params, long_world
from .rounds import Entry, Timing, interleave

DISTRIBUTIONS = ('numpy', 'numba')
MOST_S_PER_12_H = 5.0
_TOLD = 'told of no common errors'
_LOOKS_S = {'filter': 0.0, _TOLD: 0.0, 'with a look each second': 1.0}


@dataclass(frozen=True)
class MonteCarloBenchmark:
    """Processor time of whole runs.

    Attributes
    ----------
    hours : float
    fused : int
        Fixes that a run used.
    timings : dict of str to Timing
        Seconds per run, by what is run.
    """

    hours: float
    fused: int
    timings: dict[str, Timing]

    def seconds(self, name: str) -> float:
        """Median processor time of a run [s]."""
        return self.timings[name].median_us * 1e-6

    def table(self) -> Table:
        """Table of the times, each with its rounds, for 12 h as well."""
        columns = (
            Column('what', ''),
            Column('s', 'processor', 's'),
            Column('span', 'rounds', 's'),
            Column('twelve', 'for 12 h', 's'),
        )
        rows = []
        for name, timing in self.timings.items():
            times = timing.seconds_per_item
            rows.append(
                {
                    'what': name,
                    's': self.seconds(name),
                    'span': f'{min(times):.3g} to {max(times):.3g}',
                    'twelve': self.seconds(name) * 12.0 / self.hours,
                }
            )
        goal = f'goal: at most {MOST_S_PER_12_H:g} s for 12 h without looks'
        return Table(f'A run of {self.hours:g} h ({goal})', columns, tuple(rows))

    def to_dict(self) -> dict[str, object]:
        """All results as values for JSON."""
        times = {name: list(t.seconds_per_item) for name, t in self.timings.items()}
        return {'hours': self.hours, 'fused': self.fused, 'seconds': times}


def run(*, hours: float, rounds: int, report: Callable[[str], None]) -> MonteCarloBenchmark:
    """Times of a run of some hours, in interleaved rounds."""
    report(f'the world of {hours:g} h')
    world = long_world(hours)
    usual, told = long_params(world), world.params(configuration=CONFIGURATION)
    fused = 0

    def once(name: str) -> None:
        nonlocal fused
        params = told if name == _TOLD else usual
        found = engine_run.run(
            params, world.inputs, sink=_drop, states=X.dr_e.stop, look_every_s=_LOOKS_S[name]
        )
        fused = found.verdicts[Verdict.FUSED]

    report(f'{rounds} rounds')
    entries = [Entry(name, name, 1, partial(once, name)) for name in _LOOKS_S]
    timings = interleave(entries, rounds)
    return MonteCarloBenchmark(hours, fused, timings)


def _drop(_: Track) -> None:
    """Keep no estimates."""
