"""`polar bench core`: the core's kernels beside python-ins, filterpy and plain NumPy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..scoring import Column, Table
from . import covariance, navigation
from .rounds import Entry, Ratio, Timing, interleave, ratio

ROUNDS = 7
DISTRIBUTIONS = ('numpy', 'numba', 'pandas', 'python-ins', 'filterpy')


@dataclass(frozen=True)
class Group:
    """Timings of entries with the same work."""

    key: str
    title: str
    per: str
    timings: dict[str, Timing]
    peers: tuple[str, ...]
    """Keys of the reference entries."""

    def ratios(self, key: str) -> dict[str, Ratio]:
        """Times of the other entries over that of this one."""
        return {p: ratio(self.timings, p, key) for p in self.peers if p != key}

    def table(self) -> Table:
        """Table of the times."""
        columns = [Column('title', ''), Column('us', f'per {self.per}', 'us')]
        columns += [Column(p, f'times as fast as {self.timings[p].title}') for p in self.peers]
        rows = [
            {
                'title': t.title,
                'us': t.median_us,
                **{p: r.median for p, r in self.ratios(key).items()},
            }
            for key, t in self.timings.items()
        ]
        return Table(self.title, tuple(columns), tuple(rows))

    def to_dict(self) -> dict[str, object]:
        """All times as values for JSON."""
        return {
            key: {
                'title': t.title,
                'median_us': t.median_us,
                'rounds_us': [1e6 * s for s in t.seconds_per_item],
                'items': t.items,
                'calls_per_round': t.repeat,
                'times_as_fast_as': {
                    p: {'median': r.median, 'lowest': r.lowest, 'highest': r.highest}
                    for p, r in self.ratios(key).items()
                },
            }
            for key, t in self.timings.items()
        }


@dataclass(frozen=True)
class CoreBenchmark:
    """Times of one run."""

    samples: int
    compared_samples: int
    rounds: int
    agreement_m: dict[str, float]
    agreement_covariance: dict[str, float]
    groups: tuple[Group, ...]

    def to_dict(self) -> dict[str, object]:
        """All times as values for JSON."""
        return {
            'samples': self.samples,
            'compared_samples': self.compared_samples,
            'rounds': self.rounds,
            'agreement_m': self.agreement_m,
            'agreement_covariance': self.agreement_covariance,
            'groups': {g.key: g.to_dict() for g in self.groups},
        }


def run(
    samples: int = navigation.SAMPLES,
    rounds: int = ROUNDS,
    cycles: int = covariance.CYCLES,
    shortest_s: float = 0.03,
    report: Callable[[str], None] = lambda _: None,
) -> CoreBenchmark:
    """Times of all entries, after a comparison of their results.

    Parameters
    ----------
    samples : int
        Length of the IMU record, 1 to `navigation.MOST_SAMPLES`.
    rounds, cycles : int
        Rounds; filter cycles in one call.
    shortest_s : float
        Least time of one entry in a round [s].
    report : callable
        Called with a text on the present work.

    Raises
    ------
    Disagreement
        When the results of two programs differ: then there is nothing to time.
    """
    report('the same work: comparing results')
    record = navigation.record(samples)
    matrices = covariance.matrices(record, cycles)
    positions = navigation.agreement(record)
    covariances = covariance.agreement(matrices)

    def timed(entries: Sequence[Entry]) -> dict[str, Timing]:
        return interleave(entries, rounds, shortest_s)

    batch, single = navigation.entries(record)
    whole, predictions, updates = covariance.entries(matrices)
    report(f'strapdown: {rounds} rounds')
    peers = ('python_ins', 'python_ins_loop', 'numpy')
    one_by_one = 'Strapdown, sample by sample'
    groups = [
        Group('batch', 'Strapdown, a batch', 'sample', timed(batch), peers),
        Group('single', one_by_one, 'sample', timed(single), ('python_ins_called',)),
    ]
    report(f'filter: {rounds} rounds')
    groups += [
        Group(
            'filter', 'Prediction of 24 states and 3-dim update', 'cycle', timed(whole),
            ('filterpy', 'numpy'),
        ),
        Group('prediction', 'Prediction alone', 'call', timed(predictions), ('filterpy',)),
        Group('update', '3-dim update alone', 'call', timed(updates), ('filterpy',)),
    ]  # fmt: skip
    compared = min(record.samples, navigation.COMPARED_SAMPLES)
    return CoreBenchmark(samples, compared, rounds, positions, covariances, tuple(groups))
