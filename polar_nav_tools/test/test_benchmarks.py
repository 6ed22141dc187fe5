"""The benchmarks on tiny sizes: what is compared and how it is counted, never how fast it is."""

import dataclasses
import json
import os
import sys

import numpy as np
import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_tools.benchmarks import covariance, delay, late_fixes, machine, navigation, stepped
from polar_nav_tools.benchmarks.core import run
from polar_nav_tools.benchmarks.rounds import Entry, Timing, interleave, ratio
from polar_nav_tools.cli import main

SAMPLES = 40


@pytest.fixture(scope='module')
def record():
    return navigation.record(SAMPLES)


class Clock:
    """Each entry's work moves it by what the entry costs."""

    def __init__(self):
        self.now = 0.0
        self.order = []

    def entry(self, key, cost, items=1):
        def work():
            self.now += cost
            self.order.append(key)

        return Entry(key, key, items, work)

    def __call__(self):
        return self.now


def test_rounds_are_interleaved_and_reversed_every_second_time():
    clock = Clock()
    entries = [clock.entry('a', 1.0), clock.entry('b', 2.0)]
    timings = interleave(entries, 3, shortest_s=0.5, clock=clock)
    assert clock.order == [*'aabb', *'ab', *'ba', *'ab']
    assert timings['a'].seconds_per_item == (1.0, 1.0, 1.0)


def test_short_work_is_repeated_and_divided_by_its_items():
    clock = Clock()
    timings = interleave([clock.entry('a', 0.25, items=50)], 2, shortest_s=1.0, clock=clock)
    assert timings['a'].repeat == 4
    assert timings['a'].median_us == pytest.approx(5000.0)


def test_a_clock_that_stands_still_does_not_divide_by_zero():
    timings = interleave([Entry('a', 'a', 1, lambda: None)], 1, clock=lambda: 0.0)
    assert timings['a'].repeat == 1000


def test_what_is_prepared_is_not_timed():
    clock = Clock()
    entry = dataclasses.replace(clock.entry('a', 1.0), prepare=clock.entry('p', 100.0).run)
    timings = interleave([entry], 2, shortest_s=2.0, clock=clock)
    assert clock.order == [*'papa', *'papa', *'papa']
    assert timings['a'].seconds_per_item == (1.0, 1.0)


def test_no_rounds_are_refused():
    with pytest.raises(ValueError, match='at least 1'):
        interleave([], 0)


def test_ratios_are_taken_within_a_round():
    """The machine is four times as slow in the second round: the ratio does not see it."""
    timings = {
        'slow': Timing('slow', '', 1, 1, (10.0, 44.0, 12.0)),
        'fast': Timing('fast', '', 1, 1, (1.0, 4.0, 1.0)),
    }
    found = ratio(timings, 'slow', 'fast')
    assert (found.lowest, found.median, found.highest) == (10.0, 11.0, 12.0)


@pytest.mark.slow
def test_all_programs_reach_the_same_place(record):
    found = navigation.agreement(record)
    assert len(found) == 10
    assert max(found.values()) < 1e-3


@pytest.mark.slow
def test_a_wrong_result_is_not_timed(record):
    wrong = dataclasses.replace(record, truth_r_e=record.truth_r_e + 1.0)
    with pytest.raises(navigation.Disagreement, match='over the bound'):
        navigation.agreement(wrong)


@pytest.mark.parametrize('samples', [0, navigation.MOST_SAMPLES + 1])
def test_lengths_without_a_stated_bound_are_refused(samples):
    with pytest.raises(ValueError, match='samples must be'):
        navigation.record(samples)


@pytest.mark.slow
def test_covariances_equal_those_of_filterpy(record):
    found = covariance.agreement(covariance.matrices(record, cycles=20))
    assert max(found.values()) < covariance.BOUND


def test_a_wrong_covariance_is_noticed(record):
    matrices = covariance.matrices(record, cycles=3)
    P = covariance.Core(matrices).cycles()
    assert covariance.difference(P, P) == 0.0
    assert covariance.difference(P * (1.0 + 1e-6), P) == pytest.approx(1e-6)


@pytest.mark.slow
def test_every_run_of_an_entry_starts_anew(record):
    """An entry is called many times: it must do the same work each time."""
    batch, single = navigation.entries(record)
    for entry in (*batch, *single):
        first, second = entry.run(), entry.run()
        if isinstance(first, tuple):
            first, second = first[2], second[2]
        assert np.array_equal(first, second), entry.key
    for entries in covariance.entries(covariance.matrices(record, cycles=3)):
        for entry in entries:
            assert np.array_equal(entry.run(), entry.run()), entry.key


@pytest.mark.slow
def test_a_run_has_all_groups_and_is_json():
    reported = []
    result = run(samples=SAMPLES, rounds=1, cycles=3, shortest_s=0.0, report=reported.append)
    figures = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert list(figures['groups']) == ['batch', 'single', 'filter', 'prediction', 'update']
    assert set(figures['groups']['batch']['blocks']['times_as_fast_as']) == {
        'python_ins',
        'python_ins_loop',
        'numpy',
    }
    assert reported
    for group in result.groups:
        table = group.table()
        assert len(table.rows) == len(group.timings)
        assert set(group.peers) <= set(group.timings)


def test_a_foreign_core_is_refused():
    before = os.sched_getaffinity(0)
    with pytest.raises(ConfigError, match='core 99999'):
        machine.pin(99999)
    assert os.sched_getaffinity(0) == before


@pytest.fixture
def on_all_cores(monkeypatch):
    before = os.sched_getaffinity(0)
    monkeypatch.setenv('OPENBLAS_NUM_THREADS', '1')
    yield
    os.sched_setaffinity(0, before)


@pytest.mark.usefixtures('on_all_cores')
@pytest.mark.parametrize('options', [[], ['--json']])
def test_the_command(monkeypatch, capsys, options):
    arguments = ['polar', 'bench', 'core', '--rounds', '1', '--samples', str(SAMPLES), *options]
    monkeypatch.setattr(sys, 'argv', arguments)
    assert main() == 0
    out = capsys.readouterr().out
    if options:
        assert json.loads(out)['machine']['versions']['filterpy']
    else:
        assert 'python-ins' in out
        assert 'Same results' in out


def test_help_has_an_example(monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', ['polar', 'bench', 'core', '--help'])
    assert main() == 0
    out = capsys.readouterr().out
    assert 'Example: ./polar bench core' in out
    assert '--json' in out


# -- late fixes -----------------------------------------------------------------------------------

AGES_S = (0.5, 2.0)


@pytest.fixture(scope='module')
def late():
    world = late_fixes.simulated(6.0, fix_period_s=0.5)
    return world, late_fixes.prepared(world)


@pytest.fixture(scope='module')
def late_work():
    return stepped.work(6.0, 1.95)


def test_every_strategy_takes_the_same_fix_again_and_again(late):
    world, engines = late
    fix = late_fixes.aged(world, 2.0)
    for one in engines.values():
        first = one.take(fix)
        moved = late_fixes.taken_over(one.engine).filter.state.r_e.copy()
        assert not one.restored
        one.restore()
        assert one.restored
        assert repr(one.take(fix)) == repr(first)
        np.testing.assert_array_equal(late_fixes.taken_over(one.engine).filter.state.r_e, moved)
        one.restore()


def test_clone_agrees_with_rewind_and_a_wrong_one_is_not_timed(late, monkeypatch):
    world, engines = late
    found = late_fixes.agreement(engines, world, AGES_S)
    assert set(found) == {'0.5 s', '2 s'}
    assert max(found.values()) < late_fixes.BOUND
    wrong = {**engines, 'clone': engines['tagged']}
    monkeypatch.setattr(late_fixes, 'BOUND', 1e-5)
    with pytest.raises(navigation.Disagreement, match='clone and rewind differ'):
        late_fixes.agreement(wrong, world, AGES_S)


def test_a_world_without_the_fix_is_refused(late):
    with pytest.raises(ValueError, match=r'no fix that is 0\.7 s old'):
        late_fixes.aged(late[0], 0.7)


def test_runs_have_the_fixes_that_arrive_in_time(late):
    runs = late_fixes.Runs(late[0], 2.0, (1.0, 2.0))
    assert runs.inputs(0.0).fixes == ()
    for rate_hz, count in ((1.0, 4), (2.0, 8)):
        fixes = runs.inputs(rate_hz).fixes
        assert len(fixes) == count
        assert {fix.receive_ns - fix.validity_ns for fix in fixes} == {2_000_000_000}
    assert max(runs.agreement().values()) < late_fixes.BOUND


def test_stone_soup_does_the_same_work(late_work):
    s = late_work.stored
    assert len(s.steps) == 20
    assert [sum(len(u.y) == m for step in s.steps for u in step.updates) for m in (1, 3)] == [
        20,
        10,
    ]
    found = stepped.agreement(late_work, stepped.StoneSoup(s))
    assert max(found.values()) < stepped.BOUND


def test_other_work_than_stone_soups_is_not_timed(late_work):
    s = late_work.stored
    more = dataclasses.replace(s, steps=(*s.steps, s.steps[-1]))
    with pytest.raises(navigation.Disagreement, match='differs from Stone Soup'):
        stepped.agreement(late_work, stepped.StoneSoup(more))


@pytest.fixture(scope='module')
def delayed():
    return delay.run(
        1, run_s=8.0, ages_s=AGES_S, rates_hz=(1.0, 2.0), filled_s=6.0, shortest_s=0.0
    )


def test_delay_figures_are_plain_and_complete(delayed):
    figures = json.loads(json.dumps(delayed.to_dict(), allow_nan=False))
    assert list(figures['one_fix']) == ['0.5 s', '2 s']
    assert list(figures['runs']) == ['0 Hz', '1 Hz', '2 Hz']
    assert set(figures['runs']['2 Hz']['of_run_with_none']) == set(late_fixes.RUN_STRATEGIES)
    assert set(figures['stone_soup']) == {'clone', 'rewind', 'stone_soup'}
    assert len(figures['goals']) == 4
    assert [len(t.rows) for t in delayed.tables()] == [2, 3, 3, 4]


def test_a_goal_is_met_by_its_median():
    assert delay.Goal('', 2.0, ratio_of(2.0)).met
    assert not delay.Goal('', 2.0, ratio_of(1.9)).met


def ratio_of(value):
    timings = {'a': Timing('a', '', 1, 1, (value,)), 'b': Timing('b', '', 1, 1, (1.0,))}
    return ratio(timings, 'a', 'b')


@pytest.mark.slow
def test_delay_picture(delayed, tmp_path):
    from polar_nav_tools.benchmarks.delay_figure import write_figure

    for name in ('a/delay.svg', 'b.svg', 'c.png'):
        write_figure(delayed, tmp_path / name)
    assert (tmp_path / 'a/delay.svg').read_text() == (tmp_path / 'b.svg').read_text()
    assert 'back_propagate' in (tmp_path / 'b.svg').read_text()


def test_a_picture_of_unknown_kind_is_refused_before_anything_runs(monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', ['polar', 'bench', 'delay', '--figure', 'x.gif'])
    assert main() != 0
    assert '--figure x.gif' in capsys.readouterr().err


@pytest.mark.slow
def test_replay_compares_and_times_a_short_bag(tmp_path, capsys, monkeypatch):
    pytest.importorskip('rclpy')
    monkeypatch.setattr(machine, 'pin', lambda core: core)
    options = ['--hours', '0.05', '--rounds', '1', '--folder', str(tmp_path), '--json']
    monkeypatch.setattr(sys, 'argv', ['polar', 'bench', 'replay', *options])
    assert main() == 0
    found = json.loads(capsys.readouterr().out)
    samples = 3 * 60 * 100
    assert found['agreement']['rclpy'] == found['agreement']['mcap-ros2-support'] > 7 * samples
    assert found['agreement']['estimates'] > 1790
    assert set(found['whole_bag']['processor_s']) == {'open and decode', 'engine', 'score'}
    assert found['whole_bag']['horizontal_rms_second_half_m'] < 5.0
    assert [goal['what'] for goal in found['goals']][-1].startswith('peak memory')
    assert len(list(tmp_path.iterdir())) == 1  # shorter than the part that peers are timed on


@pytest.mark.slow
@pytest.mark.slow
def test_a_run_of_arrays_is_timed_with_looks_and_without(capsys, monkeypatch):
    monkeypatch.setattr(machine, 'pin', lambda core: core)
    options = ['--hours', '0.05', '--rounds', '1', '--json']
    monkeypatch.setattr(sys, 'argv', ['polar', 'bench', 'monte-carlo', *options])
    assert main() == 0
    found = json.loads(capsys.readouterr().out)
    assert found['fused'] > 60  # of 90, but for those that are still on their way
    assert [len(times) for times in found['seconds'].values()] == [1, 1, 1]


def test_replay_does_not_time_what_differs(tmp_path, monkeypatch):
    pytest.importorskip('rclpy')
    from polar_nav_tools.bags import open_bag
    from polar_nav_tools.benchmarks import replay
    from polar_nav_tools.benchmarks.long_bag import long_bag

    bag = open_bag(long_bag(0.02, folder=tmp_path))
    file = bag.files[0].path
    assert replay.agree(bag, file)['estimates'] == 721
    good = replay.inputs_of

    def off_by_a_bit(messages, params):
        inputs = good(messages, params)
        inputs.f_b[500, 1] = np.nextafter(inputs.f_b[500, 1], np.inf)
        return inputs

    monkeypatch.setattr(replay, 'inputs_of', off_by_a_bit)
    with pytest.raises(navigation.Disagreement, match='f_b as decoded by mcap-ros2-support'):
        replay.agree(bag, file)
