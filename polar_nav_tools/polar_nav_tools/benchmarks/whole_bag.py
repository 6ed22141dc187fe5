"""Time by stage and memory of a long bag's replay and score, in a new process."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from polar_nav_core.errors import PolarNavError

from ..bags import Bag, open_bag
from ..experiments.received import VEHICLE
from ..replay.arrays import SinsArrays
from ..replay.arrays_from_bag import arrays_request, load_arrays
from ..replay.by_array import replay_arrays
from ..replay.result import ReplayedRun
from ..scoring import compare, mission_phases
from ..terminal.garbage_collection import collect_rarely
from .bag_readers import bare
from .long_bag import CONFIGURATION

DECODE = 'open and decode'
_MODULE = 'polar_nav_tools.benchmarks.whole_bag'


@dataclass(frozen=True)
class WholeBag:
    """Time and memory of one round.

    Attributes
    ----------
    stages : mapping of str to float
        Processor seconds, by stage.
    peaks_mb : mapping of str to float
        Peak memory of the process before, and after each stage.
    bare_s : float
        Processor seconds to read and decompress the bag, and nothing else.
    system_s : float
        Of the processor seconds, those of the system: nearly all for allocating memory.
    wall_s : float
    horizontal_m : float
        Score: horizontal RMS of the second half.
    """

    stages: Mapping[str, float]
    peaks_mb: Mapping[str, float]
    bare_s: float
    system_s: float
    wall_s: float
    horizontal_m: float

    @property
    def total_s(self) -> float:
        """Processor time of all stages [s]."""
        return sum(self.stages.values())

    @property
    def peak_mb(self) -> float:
        """Peak memory of the process."""
        return max(self.peaks_mb.values())

    @property
    def decoding(self) -> float:
        """Opening and decoding over bare reading and decompressing."""
        return self.stages[DECODE] / self.bare_s

    def rows(self) -> dict[str, float]:
        """Processor time of the bare reading, of each stage and of all [s]."""
        return {'read and decompress only': self.bare_s, **self.stages, 'whole': self.total_s}


def opened(path: Path) -> Bag:
    """Bag opened for reading, as by `./polar score`."""
    return open_bag(path, ahead=lambda bag: arrays_request(bag, VEHICLE, truth=True))


def arrays_of(bag: Bag) -> SinsArrays:
    """Arrays of the follower's input, and the truth."""
    arrays = load_arrays(bag, VEHICLE, truth=True)
    if not isinstance(arrays, SinsArrays):
        raise PolarNavError(f'{bag.path} cannot be read as arrays')
    return arrays


def scored(arrays: SinsArrays, result: ReplayedRun) -> float:
    """Horizontal RMS [m] of the second half, scored as by `./polar score`."""
    if arrays.truth is None:
        raise PolarNavError(f'{arrays.bag.path} has no truth')
    runs = {CONFIGURATION: (arrays.truth, result.estimates, result.receipts)}
    found = compare(runs, phases=mission_phases(arrays.truth))
    return float(found.scores[CONFIGURATION].second_half.rms('horizontal'))


def whole(path: Path) -> float:
    """Time and memory from the bytes of a bag to scored estimates."""
    arrays = arrays_of(opened(path))
    return scored(arrays, replay_arrays(arrays))


def take_whole_bag(path: Path, warm: Path) -> WholeBag:
    """Time and memory of a bag in a new process, after another one that loads the kernels."""
    command = [sys.executable, '-m', _MODULE, str(path), str(warm)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise PolarNavError(f'the replay of {path} failed: {done.stderr.strip()[-2000:]}')
    return WholeBag(**json.loads(done.stdout))


def measured(path: Path) -> WholeBag:
    """Time and memory of a bag in this process."""
    bag, begin = open_bag(path), time.process_time()
    bare(bag)
    bare_s = time.process_time() - begin
    stages, peaks = {}, {'before': _peak_mb()}
    wall, last, system = time.perf_counter(), time.process_time(), _system_s()

    def done(stage: str) -> None:
        nonlocal last
        now = time.process_time()
        stages[stage], last = now - last, now
        peaks[stage] = _peak_mb()

    arrays = arrays_of(opened(path))
    done(DECODE)
    result = replay_arrays(arrays)
    done('engine')
    horizontal_m = scored(arrays, result)
    done('score')
    return WholeBag(
        stages=stages,
        peaks_mb=peaks,
        bare_s=bare_s,
        system_s=_system_s() - system,
        wall_s=time.perf_counter() - wall,
        horizontal_m=horizontal_m,
    )


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _system_s() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_stime


def main() -> None:
    """Print time and memory of one bag, after another one that loads the kernels."""
    collect_rarely()
    path, warm = map(Path, sys.argv[1:3])
    whole(warm)
    sys.stdout.write(json.dumps(asdict(measured(path))))


if __name__ == '__main__':
    main()
