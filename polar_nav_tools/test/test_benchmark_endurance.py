"""Memory over a long run: what is read when, and what counts as flat. The run is a live test."""

import json

import pytest

pytest.importorskip('rclpy')

from polar_nav_core.errors import PolarNavError
from polar_nav_tools.benchmarks import processes
from polar_nav_tools.benchmarks.endurance import SAMPLES, Endurance, Memory, Watch


@pytest.fixture
def grows(monkeypatch):
    """Watch over 960 s of two processes; one grows by 1 MB in 10 s."""
    watch, now = Watch(960.0), [0.0]
    memory_mb = {1: lambda: 100.0 + 0.1 * now[0], 2: lambda: 50.0}
    monkeypatch.setattr(processes, 'own_mb', lambda pid: memory_mb[pid]())

    def until(end_s):
        while now[0] < end_s:
            watch.look(now[0], {'leaks': 1, 'holds': 2})
            now[0] += 1.0

    return watch, until


def test_memory_is_read_at_even_distances_and_compared_by_quarters(grows):
    watch, until = grows
    until(960.0)
    assert len(watch.read['holds']) == SAMPLES
    leaks, holds = watch.memory()
    assert (leaks.name, leaks.second_quarter_mb, leaks.last_quarter_mb) == ('leaks', 135.5, 183.5)
    assert leaks.most_mb == 195.0
    assert leaks.growth == pytest.approx(48.0 / 135.5)
    assert (holds.growth, leaks.flat, holds.flat) == (0.0, False, True)


def test_a_process_that_has_ended_ends_the_readings(grows, monkeypatch):
    def gone(_pid):
        raise FileNotFoundError

    watch, until = grows
    until(500.0)
    monkeypatch.setattr(processes, 'own_mb', gone)
    until(960.0)
    assert watch.read['holds'][-1][0] == 490.0
    with pytest.raises(PolarNavError, match='leaks: the run was over before'):
        watch.memory()


def test_a_run_is_well_where_memory_is_flat_and_the_bag_whole():
    flat, leaks = Memory('follower', 100.0, 104.0, 106.0), Memory('recorder', 100.0, 106.0, 106.0)
    found = Endurance(3600.0, 300.0, [flat], 3, 80.0, [])
    assert found.ok
    assert found.sentence().startswith('12.0 times real time; the bag, 3 files and 80 MB: whole')
    assert not Endurance(3600.0, 300.0, [flat, leaks], 3, 80.0, []).ok
    cut = Endurance(3600.0, 300.0, [flat], 3, 80.0, ['bag_1.mcap: cut off'])
    assert (cut.ok, cut.sentence().endswith('80 MB: bag_1.mcap: cut off.')) == (False, True)
    assert json.loads(json.dumps(cut.to_dict()))['memory'][0]['flat']
    assert [row['growth'] for row in found.table().rows] == [pytest.approx(4.0)]
