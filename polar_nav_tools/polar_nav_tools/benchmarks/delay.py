"""`polar bench delay`: time of a late fix by each strategy, and stepped with Stone Soup."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from polar_nav_core.engine.methods import DELAY_HANDLING

from ..scoring import Column, Table
from . import late_fixes, stepped
from .rounds import Entry, Ratio, Timing, interleave, ratio

ROUNDS = 7
DISTRIBUTIONS = ('numpy', 'numba', 'stonesoup')

SINGLE_GOAL, OVERLAP_GOAL, STEPPED_GOAL = 5.0, 1.0, 50.0
"""Least `rewind` / `clone` for one late fix and for overlapping ones; Stone Soup / `rewind`."""


@dataclass(frozen=True)
class Goal:
    """A goal for a ratio, and its measured value."""

    what: str
    wanted: float
    found: Ratio

    @property
    def met(self) -> bool:
        """Whether the median reaches the goal."""
        return self.found.median >= self.wanted

    def to_dict(self) -> dict[str, object]:
        """Goal as values for JSON."""
        return {'what': self.what, 'wanted': self.wanted, 'met': self.met, **_plain(self.found)}


@dataclass(frozen=True)
class DelayBenchmark:
    """Times of one run.

    Attributes
    ----------
    fix : dict
        Timings of one late fix: by its age [s], then by strategy.
    runs : dict
        Timings of whole runs: by fixes per second (0: none), then by strategy.
    peer : dict
        Timings of a fix `peer_age_s` old and of the same work stepped with Stone Soup.
    agreement_sigma, agreement_peer : dict
        Differences of results, found before anything was timed.
    """

    rounds: int
    run_s: float
    run_age_s: float
    peer_age_s: float
    fix: Mapping[float, Mapping[str, Timing]]
    runs: Mapping[float, Mapping[str, Timing]]
    peer: Mapping[str, Timing]
    agreement_sigma: Mapping[str, float]
    agreement_peer: Mapping[str, float]

    def cost(self, rate_hz: float, strategy: str) -> Ratio:
        """Time of a run with late fixes over that of the same run without."""
        return ratio(_both(self.runs[rate_hz], self.runs[0.0]), strategy, f'{strategy} before')

    def goals(self) -> list[Goal]:
        """Goals with their measured values."""
        oldest = max(self.fix)
        found = [
            Goal(
                f'one fix {oldest:g} s old: rewind / clone',
                SINGLE_GOAL,
                ratio(self.fix[oldest], 'rewind', 'clone'),
            )
        ]
        found += [
            Goal(
                f'fixes {self.run_age_s:g} s old at {rate_hz:g} Hz: rewind / clone',
                OVERLAP_GOAL,
                ratio(timings, 'rewind', 'clone'),
            )
            for rate_hz, timings in self.runs.items()
            if rate_hz > 0.0
        ]
        found.append(
            Goal(
                f'one fix {self.peer_age_s:g} s old: Stone Soup / rewind',
                STEPPED_GOAL,
                ratio(self.peer, 'stone_soup', 'rewind'),
            )
        )
        return found

    def tables(self) -> list[Table]:
        """Tables of the times."""
        return [self._fix_table(), self._run_table(), self._peer_table(), self._goal_table()]

    def _fix_table(self) -> Table:
        names = [Column(name, name, 'us') for name in DELAY_HANDLING]
        columns = (Column('age', 'age', 's'), *names, Column('ratio', 'rewind / clone'))
        rows = [
            {
                'age': age_s,
                **{name: t.median_us for name, t in timings.items()},
                'ratio': ratio(timings, 'rewind', 'clone').median,
            }
            for age_s, timings in self.fix.items()
        ]
        return Table('One late fix, the whole of it in the engine', columns, tuple(rows))

    def _run_table(self) -> Table:
        names = late_fixes.RUN_STRATEGIES
        columns = (
            Column('rate', f'fixes {self.run_age_s:g} s old', 'Hz'),
            *(Column(name, name, 'ms') for name in names),
            *(Column(f'{name}_cost', f'{name} / its run with none') for name in names),
            Column('ratio', 'rewind / clone'),
        )
        rows = []
        for rate_hz, timings in self.runs.items():
            row: dict[str, object] = {
                'rate': rate_hz,
                **{name: 1e-3 * timings[name].median_us for name in names},
                'ratio': ratio(timings, 'rewind', 'clone').median,
            }
            if rate_hz > 0.0:
                row |= {f'{name}_cost': self.cost(rate_hz, name).median for name in names}
            rows.append(row)
        return Table(f'A run of {self.run_s:g} s', columns, tuple(rows))

    def _peer_table(self) -> Table:
        columns = (
            Column('title', ''),
            Column('us', 'time', 'us'),
            Column('ratio', 'Stone Soup takes times as long'),
        )
        rows = [
            {
                'title': t.title,
                'us': t.median_us,
                'ratio': ratio(self.peer, 'stone_soup', key).median,
            }
            for key, t in self.peer.items()
        ]
        return Table(
            f'A fix {self.peer_age_s:g} s old, all 24 states in use', columns, tuple(rows)
        )

    def _goal_table(self) -> Table:
        columns = (
            Column('what', ''),
            Column('wanted', 'at least'),
            Column('found', 'found'),
            Column('lowest', 'lowest round'),
            Column('met', 'met'),
        )
        rows = [
            {
                'what': g.what,
                'wanted': g.wanted,
                'found': g.found.median,
                'lowest': g.found.lowest,
                'met': 'yes' if g.met else 'NO',
            }
            for g in self.goals()
        ]
        return Table('Goals', columns, tuple(rows))

    def to_dict(self) -> dict[str, object]:
        """All times as values for JSON."""
        return {
            'rounds': self.rounds,
            'run_s': self.run_s,
            'agreement_sigma': dict(self.agreement_sigma),
            'agreement_peer': dict(self.agreement_peer),
            'one_fix': {f'{age:g} s': _figures(t) for age, t in self.fix.items()},
            'runs': {
                f'{rate:g} Hz': {
                    **_figures(t),
                    'of_run_with_none': {
                        name: _plain(self.cost(rate, name)) for name in t if rate > 0.0
                    },
                }
                for rate, t in self.runs.items()
            },
            'stone_soup': _figures(self.peer),
            'goals': [g.to_dict() for g in self.goals()],
        }


def run(
    rounds: int = ROUNDS,
    run_s: float = late_fixes.RUN_S,
    ages_s: Sequence[float] = late_fixes.AGES_S,
    rates_hz: Sequence[float] = late_fixes.RATES_HZ,
    filled_s: float = late_fixes.FILLED_S,
    shortest_s: float = 0.005,
    report: Callable[[str], None] = lambda _: None,
) -> DelayBenchmark:
    """Times of all entries, after a comparison of their results.

    Parameters
    ----------
    rounds : int
    run_s : float
        Length of the whole runs [s]; longer than the oldest age.
    ages_s, rates_hz : sequences of float
        Ages of the one fix [s]; fixes per second in the runs, as old as the oldest of the ages.
    filled_s : float
        How long the engines run before the one fix [s]; longer than the oldest age.
    shortest_s : float
        Least time of one entry in a round, preparation left out [s].
    report : callable
        Called with a text on the present work.

    Raises
    ------
    Disagreement
        When `clone` and `rewind`, or the engine and Stone Soup, have different results.
    """
    report('the same work: comparing results')
    oldest = max(ages_s)
    world = late_fixes.simulated(filled_s)
    engines = late_fixes.prepared(world)
    agreement = {
        f'one fix {k} old': v for k, v in late_fixes.agreement(engines, world, ages_s).items()
    }
    period_s = 1.0 / max(rates_hz)
    runs = late_fixes.Runs(late_fixes.simulated(run_s, fix_period_s=period_s), oldest, rates_hz)
    agreement |= runs.agreement()
    peer_age_s = min(stepped.AGE_S, oldest - 0.05)
    work = stepped.work(filled_s, peer_age_s)
    peer = stepped.StoneSoup(work.stored)
    agreement_peer = stepped.agreement(work, peer)

    report(f'one late fix: {rounds} rounds')
    singles = late_fixes.entries(engines, world, ages_s)
    fix = _timed(singles, rounds, shortest_s)
    report(f'Stone Soup: {rounds} rounds')
    peers = interleave(stepped.entries(work, peer), rounds, shortest_s)
    report(f'whole runs: {rounds} rounds')
    whole = _timed({rate: runs.entries(rate) for rate in (0.0, *rates_hz)}, rounds, shortest_s)
    return DelayBenchmark(
        rounds, run_s, oldest, peer_age_s, fix, whole, peers, agreement, agreement_peer
    )


def _timed(
    groups: Mapping[float, Sequence[Entry]], rounds: int, shortest_s: float
) -> dict[float, dict[str, Timing]]:
    """Timings of all groups in the same rounds, by group and entry."""
    timings = interleave([e for group in groups.values() for e in group], rounds, shortest_s)
    return {key: {e.title: timings[e.key] for e in group} for key, group in groups.items()}


def _both(timings: Mapping[str, Timing], before: Mapping[str, Timing]) -> dict[str, Timing]:
    return {**timings, **{f'{name} before': t for name, t in before.items()}}


def _plain(r: Ratio) -> dict[str, object]:
    return {'median': r.median, 'lowest': r.lowest, 'highest': r.highest}


def _figures(timings: Mapping[str, Timing]) -> dict[str, object]:
    return {
        name: {
            'median_us': t.median_us,
            'rounds_us': [1e6 * s for s in t.seconds_per_item],
            'calls_per_round': t.repeat,
        }
        for name, t in timings.items()
    }
