"""`polar bench replay`: a long bag to scored estimates, beside other readers of bags.

The results of a part of the bag (ten minutes) are compared first: the scanner's arrays with those
decoded by mcap-ros2-support and rclpy, and the estimates of the fast replay with those of a replay
message by message. Then that part is timed in interleaved rounds, and the whole bag as often
(`whole_bag`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.inputs import Inputs
from polar_nav_ros import topics

from ..bags import Bag, open_bag
from ..bags.arrays import estimates_from_cdr
from ..experiments.received import VEHICLE
from ..replay.by_array import replay_arrays
from ..replay.by_message import parameters, replay
from ..replay.recorded import load_inputs
from ..scoring.tables import Column, Table
from ..series.estimates import EstimateRows
from .bag_readers import bare, exhausted, inputs_of, mcap_raw, mcap_rclpy, mcap_ros2
from .long_bag import RATES_HZ, long_bag
from .navigation import Disagreement
from .rounds import Entry, Ratio, Timing, interleave, ratio
from .whole_bag import WholeBag, arrays_of, opened, scored, take_whole_bag, whole

DISTRIBUTIONS = ('numpy', 'numba', 'mcap', 'mcap-ros2-support', 'zstandard', 'isal', 'rclpy')
PART_MINUTES = 10.0
REAL_TIME = 5_000.0
AGAINST_PEER = 25.0
AGAINST_BARE = 3.0
MEMORY_MB = 1000.0

_IMU_HZ = RATES_HZ[topics.IMU]


def agree(bag: Bag, mcap_file: Path) -> dict[str, int]:
    """Number of equal values of each comparison of the programs to be timed.

    Raises
    ------
    Disagreement
        If a single bit differs.
    """
    arrays = arrays_of(bag)
    params = parameters(arrays.params, None, {})
    ours = arrays.inputs(params).inputs
    counts = {}
    for name, way in (('mcap-ros2-support', mcap_ros2), ('rclpy', mcap_rclpy)):
        theirs = inputs_of(way(mcap_file), params)
        counts[name] = 0
        for field in fields(Inputs):
            mine, other = getattr(ours, field.name), getattr(theirs, field.name)
            if field.name == 'fixes':
                same = repr(mine) == repr(other)
            else:
                same = np.array_equal(mine, other, equal_nan=True)
                counts[name] += mine.size
            if not same:
                raise Disagreement(f'{field.name} as decoded by {name} differs')
    fast = replay_arrays(arrays).estimates
    slow = estimates_from_cdr(replay(load_inputs(bag, VEHICLE)).of(topics.STATE), VEHICLE)
    for name in ('stamp_ns', 'r_e', 'v_G', 'C_b_G', 'P_position_G'):
        if not np.array_equal(getattr(fast, name), getattr(slow, name)):
            raise Disagreement(f'{name} of the fast replay differs from that by message')
    counts['estimates'] = len(fast)
    return counts


@dataclass(frozen=True)
class ReplayBenchmark:
    """Times per IMU message of a part, and of the whole bag.

    Attributes
    ----------
    rounds : int
    hours, part_minutes : float
    timings : dict of str to Timing
        Of the part.
    bags : tuple of WholeBag
        The whole bag, a round each.
    file_mb : float
    agreement : dict of str to int
        Values that were equal.
    """

    rounds: int
    hours: float
    part_minutes: float
    timings: dict[str, Timing]
    bags: tuple[WholeBag, ...]
    file_mb: float
    agreement: dict[str, int]

    @property
    def whole_bag(self) -> WholeBag:
        """Round of median processor time (of an even number, the slower one of the middle)."""
        return sorted(self.bags, key=lambda bag: bag.total_s)[len(self.bags) // 2]

    @property
    def whole_s(self) -> float:
        """Processor time [s] of the whole bag."""
        return self.whole_bag.total_s

    @property
    def peak_mb(self) -> float:
        """Peak memory [MB] of a process with the whole bag: the highest of all rounds."""
        return max(bag.peak_mb for bag in self.bags)

    @property
    def real_time(self) -> float:
        """Length of the bag over processor time."""
        return 3600.0 * self.hours / self.whole_s

    @property
    def peer_s(self) -> float:
        """mcap-ros2-support decoding of the whole bag, scaled from the part [s]."""
        return self.timings['mcap_ros2'].median_us * 1e-6 * 3600.0 * self.hours * _IMU_HZ

    def ratios(self) -> dict[str, Ratio]:
        """Ratios within the rounds of the part; our decoding includes the opening."""
        t = self.timings
        return {
            'mcap-ros2-support decoding / whole replay': ratio(t, 'mcap_ros2', 'whole'),
            'mcap-ros2-support decoding / our decoding': ratio(t, 'mcap_ros2', 'decode'),
            'mcap + rclpy decoding / our decoding': ratio(t, 'rclpy', 'decode'),
            'our decoding / bare read and decompress': ratio(t, 'decode', 'bare'),
            'only to open / bare read and decompress': ratio(t, 'open', 'bare'),
            'mcap-ros2-support to the same engine / whole replay': ratio(
                t, 'mcap_ros2_engine', 'whole'
            ),
            'rclpy to the same engine / whole replay': ratio(t, 'rclpy_engine', 'whole'),
        }

    def goals(self) -> list[tuple[str, float, float, bool]]:
        """Goals: name, goal, measured value, whether it is met."""
        decode = float(np.median([bag.decoding for bag in self.bags]))
        peer = self.peer_s / self.whole_s
        return [
            ('times real time, whole bag', REAL_TIME, self.real_time, self.real_time >= REAL_TIME),
            ('mcap-ros2-support decoding / whole', AGAINST_PEER, peer, peer >= AGAINST_PEER),
            ('open and decode / bare, at most', AGAINST_BARE, decode, decode <= AGAINST_BARE),
            ('peak memory [MB], at most', MEMORY_MB, self.peak_mb, self.peak_mb <= MEMORY_MB),
        ]

    def tables(self) -> tuple[Table, ...]:
        """Tables of times, ratios, the whole bag and the goals."""
        bare_us = self.timings['bare'].median_us
        times = Table(
            f'A part of {self.part_minutes:g} min, per IMU message',
            (Column('what', ''), Column('us', '', 'us'), Column('times', 'x bare')),
            tuple(
                {'what': t.title, 'us': t.median_us, 'times': t.median_us / bare_us}
                for t in self.timings.values()
            ),
        )
        columns = (Column('what', ''), Column('median', 'median'), Column('span', 'rounds'))
        ratios = Table(
            'Ratios within rounds',
            columns,
            tuple(
                {'what': n, 'median': r.median, 'span': f'{r.lowest:.3g} to {r.highest:.3g}'}
                for n, r in self.ratios().items()
            ),
        )
        stages = Table(
            f'{self.hours:g} h, {self.file_mb:.0f} MB: bytes to scored estimates',
            (Column('what', ''), Column('s', 'processor', 's'), Column('span', 'rounds', 's')),
            tuple(
                {'what': name, 's': seconds, 'span': self._span(name)}
                for name, seconds in self.whole_bag.rows().items()
            ),
        )
        goals = Table(
            'Goals',
            (
                Column('what', ''),
                Column('goal', 'goal'),
                Column('found', 'found'),
                Column('met', 'met'),
            ),
            tuple({'what': n, 'goal': g, 'found': f, 'met': m} for n, g, f, m in self.goals()),
        )
        return times, ratios, stages, goals

    def _span(self, stage: str) -> str:
        values = [bag.rows()[stage] for bag in self.bags]
        return f'{min(values):.3g} to {max(values):.3g}'

    def to_dict(self) -> dict[str, object]:
        """All results as values for JSON."""
        return {
            'rounds': self.rounds,
            'hours': self.hours,
            'part_minutes': self.part_minutes,
            'agreement': self.agreement,
            'part_us_per_imu_message': {
                k: {'median': t.median_us, 'rounds': [1e6 * s for s in t.seconds_per_item]}
                for k, t in self.timings.items()
            },
            'ratios': {
                n: {'median': r.median, 'lowest': r.lowest, 'highest': r.highest}
                for n, r in self.ratios().items()
            },
            'whole_bag': {
                'processor_s': dict(self.whole_bag.stages),
                'processor_total_s': self.whole_s,
                'rounds_s': [bag.total_s for bag in self.bags],
                'system_s': self.whole_bag.system_s,
                'bare_s': self.whole_bag.bare_s,
                'wall_s': self.whole_bag.wall_s,
                'times_real_time': self.real_time,
                'mcap_ros2_support_decoding_scaled_s': self.peer_s,
                'peak_mb': self.peak_mb,
                'peaks_mb': dict(self.whole_bag.peaks_mb),
                'file_mb': self.file_mb,
                'horizontal_rms_second_half_m': self.whole_bag.horizontal_m,
            },
            'goals': [{'what': n, 'goal': g, 'found': f, 'met': m} for n, g, f, m in self.goals()],
        }


def run(
    *, hours: float, rounds: int, report: Callable[[str], None], folder: Path | None = None
) -> ReplayBenchmark:
    """Results of the benchmark: bags made, results compared, then timed."""
    minutes = min(PART_MINUTES, 60.0 * hours)
    part_path, path = _made(minutes / 60.0, report, folder), _made(hours, report, folder)
    part = open_bag(part_path)
    mcap_file = part.files[0].path
    report('comparing what is decoded, and the estimates')
    agreement = agree(part, mcap_file)
    report(f'the part of {minutes:g} min: {rounds} rounds')
    timings = interleave(_entries(part, part_path, mcap_file), rounds, shortest_s=0.0)
    report(f'the whole bag of {hours:g} h: {rounds} rounds')
    bags = tuple(take_whole_bag(path, part_path) for _ in range(rounds))
    return ReplayBenchmark(
        rounds=rounds,
        hours=hours,
        part_minutes=minutes,
        timings=timings,
        bags=bags,
        file_mb=sum(f.stat().st_size for f in path.glob('*.mcap')) / 1e6,
        agreement=agreement,
    )


def _made(hours: float, report: Callable[[str], None], folder: Path | None) -> Path:
    printed = -1

    def progress(share: float) -> None:
        nonlocal printed
        if int(10 * share) > printed:
            printed = int(10 * share)
            report(f'making the bag of {hours:g} h: {100 * share:.0f} %')

    return long_bag(hours, folder=folder, progress=progress)


def _entries(bag: Bag, path: Path, mcap_file: Path) -> list[Entry]:
    arrays = arrays_of(bag)
    params = parameters(arrays.params, None, {})
    result = replay_arrays(arrays)
    n = bag.topics[f'/{VEHICLE}/{topics.IMU}'].count

    def engine(inputs: Inputs) -> object:
        rows = EstimateRows(params)
        engine_run.run(params, inputs, sink=rows.append, derived=True)
        return rows.series(VEHICLE)

    def entry(key: str, title: str, call: Callable[[], object]) -> Entry:
        return Entry(key, title, n, call)

    return [
        entry('bare', 'read and decompress only', lambda: bare(bag)),
        entry('open', 'only to open: checksums, counts, every byte', lambda: open_bag(path)),
        entry('decode', 'open and decode to arrays', lambda: arrays_of(opened(path))),
        entry('engine', 'engine and estimates', lambda: replay_arrays(arrays)),
        entry('score', 'score', lambda: scored(arrays, result)),
        entry('whole', 'whole: bytes to scored estimates', lambda: whole(path)),
        entry('mcap_raw', 'mcap, messages as bytes', lambda: mcap_raw(mcap_file)),
        entry('mcap_ros2', 'mcap-ros2-support, decoding', lambda: exhausted(mcap_ros2(mcap_file))),
        entry('rclpy', 'mcap and rclpy, decoding', lambda: exhausted(mcap_rclpy(mcap_file))),
        entry(
            'mcap_ros2_engine',
            'mcap-ros2-support to the same engine',
            lambda: engine(inputs_of(mcap_ros2(mcap_file), params)),
        ),
        entry(
            'rclpy_engine',
            'rclpy to the same engine',
            lambda: engine(inputs_of(mcap_rclpy(mcap_file), params)),
        ),
    ]
