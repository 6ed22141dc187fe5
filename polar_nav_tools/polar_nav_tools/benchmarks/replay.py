"""A long bag to scored estimates, beside the ways that others read bags.

What a part of the bag (ten minutes) gives is compared first: the scanner's arrays with those that
mcap-ros2-support and rclpy decode, and the estimates of the fast replay with those of a replay
message by message. Then that part is timed in interleaved rounds, and the whole bag once, in a
process of its own whose peak memory is told.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from polar_nav_core.engine import batch
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.errors import PolarNavError
from polar_nav_follower import session

from ..bags import Bag, open_bag
from ..bags.arrays import estimates_from_cdr
from ..estimates import EstimateRows
from ..fast_replay import FastResult, replay_arrays, wanted
from ..recorded_arrays import RecordedArrays, load_arrays
from ..recorded_inputs import load_inputs
from ..replay import parameters, replay
from ..scoring import compare, mission_phases
from ..scoring.tables import Column, Table
from .bag_readers import bare, exhausted, inputs_of, mcap_raw, mcap_rclpy, mcap_ros2
from .long_bag import CONFIGURATION, RATES_HZ, VEHICLE, long_bag
from .navigation import Disagreement
from .rounds import Entry, Ratio, Timing, interleave, ratio

DISTRIBUTIONS = ('numpy', 'numba', 'mcap', 'mcap-ros2-support', 'zstandard', 'isal', 'rclpy')
PART_MINUTES = 10.0
REAL_TIME = 10_000.0
AGAINST_PEER = 25.0
AGAINST_BARE = 3.0
MEMORY_MB = 1000.0

_MODULE = 'polar_nav_tools.benchmarks.replay'
_IMU_HZ = RATES_HZ['imu/data_raw']


def opened(path: Path) -> Bag:
    """Open a bag that is going to be read, as `./polar score` does."""
    return open_bag(path, ahead=lambda bag: wanted(bag, VEHICLE, truth=True))


def arrays_of(bag: Bag) -> RecordedArrays:
    """Decode what the follower took, and the truth."""
    arrays = load_arrays(bag, VEHICLE, truth=True)
    if arrays is None:
        raise PolarNavError(f'{bag.path} cannot be read as arrays')
    return arrays


def scored(arrays: RecordedArrays, result: FastResult) -> float:
    """Score as `./polar score` does; horizontal RMS of the second half [m]."""
    if arrays.truth is None:
        raise PolarNavError(f'{arrays.bag.path} has no truth')
    runs = {CONFIGURATION: (arrays.truth, result.estimates, result.receipts)}
    found = compare(runs, phases=mission_phases(arrays.truth))
    return float(found.scores[CONFIGURATION].second_half.rms('horizontal'))


def whole(path: Path) -> float:
    """From the bytes of a bag to scored estimates."""
    arrays = arrays_of(opened(path))
    return scored(arrays, replay_arrays(arrays))


def agree(bag: Bag, mcap_file: Path) -> dict[str, int]:
    """Compare what is going to be timed; number of values that were equal, by what was compared.

    Raises
    ------
    Disagreement
        When a single bit differs.
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
    slow = estimates_from_cdr(replay(load_inputs(bag, VEHICLE)).of(session.STATE), VEHICLE)
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
    stages : dict of str to float
        Processor seconds of the whole bag, by stage.
    peaks_mb : dict of str to float
        Peak memory of that process before, and after each stage.
    wall_s : float
        Of that process.
    file_mb : float
    agreement : dict of str to int
        Values that were equal.
    horizontal_m : float
        Score of the whole bag: horizontal RMS of the second half.
    """

    rounds: int
    hours: float
    part_minutes: float
    timings: dict[str, Timing]
    stages: dict[str, float]
    peaks_mb: dict[str, float]
    wall_s: float
    file_mb: float
    agreement: dict[str, int]
    horizontal_m: float

    @property
    def whole_s(self) -> float:
        """Processor time of the whole bag [s]."""
        return sum(self.stages.values())

    @property
    def peak_mb(self) -> float:
        """Peak memory of the process that took the whole bag."""
        return max(self.peaks_mb.values())

    @property
    def real_time(self) -> float:
        """Length of the bag over processor time."""
        return 3600.0 * self.hours / self.whole_s

    @property
    def peer_s(self) -> float:
        """mcap-ros2-support decoding of the whole bag, scaled from the part [s]."""
        return self.timings['mcap_ros2'].median_us * 1e-6 * 3600.0 * self.hours * _IMU_HZ

    def ratios(self) -> dict[str, Ratio]:
        """Ratios within the rounds of the part; our decoding has the opening in it."""
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
        """What was wanted: name, goal, found, met."""
        r = self.ratios()
        decode = r['our decoding / bare read and decompress'].median
        peer = self.peer_s / self.whole_s
        return [
            ('times real time, whole bag', REAL_TIME, self.real_time, self.real_time >= REAL_TIME),
            ('mcap-ros2-support decoding / whole', AGAINST_PEER, peer, peer >= AGAINST_PEER),
            ('decoding / bare, at most', AGAINST_BARE, decode, decode <= AGAINST_BARE),
            ('peak memory [MB], at most', MEMORY_MB, self.peak_mb, self.peak_mb <= MEMORY_MB),
        ]

    def tables(self) -> tuple[Table, ...]:
        """Times, ratios, the whole bag, goals."""
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
            (Column('what', ''), Column('s', 'processor', 's')),
            (
                *({'what': n, 's': s} for n, s in self.stages.items()),
                {'what': 'whole', 's': self.whole_s},
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

    def to_dict(self) -> dict[str, object]:
        """Plain data for JSON."""
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
                'processor_s': dict(self.stages),
                'processor_total_s': self.whole_s,
                'wall_s': self.wall_s,
                'times_real_time': self.real_time,
                'mcap_ros2_support_decoding_scaled_s': self.peer_s,
                'peak_mb': self.peak_mb,
                'peaks_mb': dict(self.peaks_mb),
                'file_mb': self.file_mb,
                'horizontal_rms_second_half_m': self.horizontal_m,
            },
            'goals': [{'what': n, 'goal': g, 'found': f, 'met': m} for n, g, f, m in self.goals()],
        }


def run(
    *, hours: float, rounds: int, tell: Callable[[str], None], folder: Path | None = None
) -> ReplayBenchmark:
    """Make the bags, compare, and time."""
    minutes = min(PART_MINUTES, 60.0 * hours)
    part_path, path = _made(minutes / 60.0, tell, folder), _made(hours, tell, folder)
    part = open_bag(part_path)
    mcap_file = part.files[0].path
    tell('comparing what is decoded, and the estimates')
    agreement = agree(part, mcap_file)
    tell(f'the part of {minutes:g} min: {rounds} rounds')
    timings = interleave(_entries(part, part_path, mcap_file), rounds, shortest_s=0.0)
    tell(f'the whole bag of {hours:g} h')
    found = _in_a_process(path, part_path)
    return ReplayBenchmark(
        rounds=rounds,
        hours=hours,
        part_minutes=minutes,
        timings=timings,
        stages=found['stages'],
        peaks_mb=found['peaks_mb'],
        wall_s=found['wall_s'],
        file_mb=sum(f.stat().st_size for f in path.glob('*.mcap')) / 1e6,
        agreement=agreement,
        horizontal_m=found['horizontal_m'],
    )


def _made(hours: float, tell: Callable[[str], None], folder: Path | None) -> Path:
    told = -1

    def progress(share: float) -> None:
        nonlocal told
        if int(10 * share) > told:
            told = int(10 * share)
            tell(f'making the bag of {hours:g} h: {100 * share:.0f} %')

    return long_bag(hours, folder=folder, progress=progress)


def _entries(bag: Bag, path: Path, mcap_file: Path) -> list[Entry]:
    arrays = arrays_of(bag)
    params = parameters(arrays.params, None, {})
    result = replay_arrays(arrays)
    n = bag.topics[f'/{VEHICLE}/{session.IMU}'].count

    def engine(inputs: Inputs) -> object:
        rows = EstimateRows(params)
        batch.run(params, inputs, sink=rows.take, told=True)
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


def _in_a_process(path: Path, warm: Path) -> dict[str, Any]:
    """Take the whole bag in a process that did nothing before, for its memory."""
    command = [sys.executable, '-m', _MODULE, str(path), str(warm)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise PolarNavError(f'the replay of {path} failed: {done.stderr.strip()[-2000:]}')
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def measured(path: Path) -> dict[str, Any]:
    """Processor time by stage, and peak memory of this process."""
    stages, peaks = {}, {'before': _peak_mb()}
    wall, last = time.perf_counter(), time.process_time()

    def done(stage: str) -> None:
        nonlocal last
        now = time.process_time()
        stages[stage], last = now - last, now
        peaks[stage] = _peak_mb()

    arrays = arrays_of(opened(path))
    done('open and decode')
    result = replay_arrays(arrays)
    done('engine')
    horizontal_m = scored(arrays, result)
    done('score')
    return {
        'stages': stages,
        'peaks_mb': peaks,
        'wall_s': time.perf_counter() - wall,
        'horizontal_m': horizontal_m,
    }


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def main() -> None:
    """Take one bag and print what was measured; another one before, to load the kernels."""
    path, warm = map(Path, sys.argv[1:3])
    whole(warm)
    sys.stdout.write(json.dumps(measured(path)))


if __name__ == '__main__':
    main()
