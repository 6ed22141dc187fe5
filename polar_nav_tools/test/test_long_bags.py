"""Long recordings: the same numbers as in one piece, and memory that does not follow the length."""

import json
import tracemalloc

import pytest

from foreign_samples import REFERENCE
from polar_nav_core import spilled
from polar_nav_tools.benchmarks.long_bag import long_bag
from polar_nav_tools.benchmarks.whole_bag import arrays_of, opened
from polar_nav_tools.experiments.received import VEHICLE
from polar_nav_tools.replay.by_array import replay_arrays
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.replay.recorded import load_inputs
from polar_nav_tools.scoring import compare, mission_phases
from polar_nav_tools.smoothing.bag import How, smooth_bag

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


@pytest.mark.usefixtures('in_pieces')
@pytest.mark.parametrize(('call', 'most_kb'), [(scores, 90.0), (outputs, 40.0)])
def test_memory_does_not_follow_the_length(bags, call, most_kb):
    """Of a minute remain 30 fixes and receipts; 6,000 samples and 600 estimates are 800 kB."""
    call(bags[0])
    short, long = (peak_mb(call, path) for path in bags)
    print(short, long, 1e3 * (long - short) / (MINUTES[1] - MINUTES[0]))
    assert 1e3 * (long - short) / (MINUTES[1] - MINUTES[0]) < most_kb
