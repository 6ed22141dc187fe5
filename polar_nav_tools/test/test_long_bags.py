"""Long recordings: the same numbers as in one piece, in memory that does not follow them."""

import json
import mmap
import tracemalloc

import numpy as np
import pytest
from foreign_samples import REFERENCE

from polar_nav_core import spilled
from polar_nav_core.errors import PolarNavError
from polar_nav_tools.benchmarks import memory
from polar_nav_tools.benchmarks.long_bag import long_bag
from polar_nav_tools.benchmarks.whole_bag import arrays_of, opened
from polar_nav_tools.experiments.received import VEHICLE
from polar_nav_tools.replay import life
from polar_nav_tools.replay.by_array import replay_arrays
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.replay.outputs import Outputs
from polar_nav_tools.replay.recorded import load_inputs
from polar_nav_tools.scoring import compare, mission_phases
from polar_nav_tools.smoothing.bag import How, smooth_bag

pytestmark = pytest.mark.slow

MINUTES = (2.0, 8.0)
MB = 1e6


@pytest.fixture
def in_pieces(monkeypatch):
    """Short recordings are treated as long ones."""
    monkeypatch.setattr(spilled, 'LEAST_BYTES', 1 << 12)
    monkeypatch.setattr(spilled, 'ROWS', 100)


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp('long')
    return [long_bag(minutes / 60.0, folder=folder) for minutes in MINUTES]


def scores(path):
    arrays = arrays_of(opened(path))
    run = replay_arrays(arrays)
    return compare(
        {'run': (arrays.truth, run.estimates, run.receipts)}, phases=mission_phases(arrays.truth)
    ).to_dict()


def outputs(path):
    result = replay(load_inputs(path))
    return result.sha256, result.verdicts, result.taken, len(result.outputs)


def smoothed(path):
    run = smooth_bag(
        opened(path),
        VEHICLE,
        configuration='default',
        changes={},
        how=How(),
        progress=lambda _: None,
    )
    return run.smoothed.r_e.tolist(), run.comparison.to_dict()


def whole_and_in_pieces(monkeypatch, result):
    whole = result()
    monkeypatch.setattr(spilled, 'LEAST_BYTES', 1 << 12)
    monkeypatch.setattr(spilled, 'ROWS', 100)
    return whole, result()


@pytest.mark.parametrize('result', [scores, outputs, smoothed])
def test_pieces_give_the_same_bits(bags, monkeypatch, result):
    whole, again = whole_and_in_pieces(monkeypatch, lambda: result(bags[0]))
    assert json.dumps(again) == json.dumps(whole)


def test_a_recorded_bag_in_pieces(monkeypatch):
    whole, again = whole_and_in_pieces(monkeypatch, lambda: scores(REFERENCE))
    assert json.dumps(again) == json.dumps(whole)


def peak_mb(call, path):
    tracemalloc.start()
    try:
        call(path)
        return tracemalloc.get_traced_memory()[1] / MB
    finally:
        tracemalloc.stop()


def is_in_a_file(array):
    while isinstance(array, np.ndarray):
        array = array.base
    return isinstance(array, mmap.mmap)


def columns_of(series):
    return {n: c for n, c in vars(series).items() if isinstance(c, np.ndarray)}


@pytest.mark.usefixtures('in_pieces')
def test_no_long_column_is_held(bags):
    arrays = arrays_of(opened(bags[1]))
    run = replay_arrays(arrays)
    found = compare({'run': (arrays.truth, run.estimates, run.receipts)}).scores['run']
    series = (run.estimates, arrays.truth, found.pairs.truth, found.pairs.estimate, found.errors)
    for columns in (*map(columns_of, series), *arrays.columns.values()):
        held = [n for n, c in columns.items() if c.nbytes > 8192 and not is_in_a_file(c)]
        assert set(held) <= {'stamp_ns'}  # of what is compared, a number for each second


def test_memory_does_not_follow_the_length(bags, monkeypatch):
    """Of a minute remain fixes and receipts; 6,000 samples and 600 estimates are 800 kB."""
    monkeypatch.setattr(spilled, 'LEAST_BYTES', 1 << 14)
    monkeypatch.setattr(spilled, 'ROWS', 2000)
    short, long = (peak_mb(scores, path) for path in bags)
    assert long - short < 0.12 * (MINUTES[1] - MINUTES[0])


def test_few_messages_wait_for_their_turn(bags, monkeypatch):
    most, push = 0, life.heapq.heappush

    def counted(heap, item):
        nonlocal most
        push(heap, item)
        most = max(most, len(heap))

    monkeypatch.setattr(life.heapq, 'heappush', counted)
    result = replay(load_inputs(bags[0]))
    assert isinstance(result.outputs, Outputs)
    assert len(result.outputs) > 1000
    assert most < 20


def test_the_peak_of_a_command_is_measured(bags):
    found = memory.Peaks('replay', memory.peak_mb(('info',), bags[0]), 1e4)
    assert 20.0 < found.short < 1000.0
    assert not found.met
    assert memory.table(1.0, (found,)).records()[0]['above_mb'] == found.above
    with pytest.raises(PolarNavError, match='failed'):
        memory.peak_mb(('info',), bags[0] / 'nothing')
