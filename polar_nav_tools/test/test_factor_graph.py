"""The smoother against GTSAM: the same linear problem, means and sigmas."""

import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polar_nav_tools.benchmarks import smooth
from polar_nav_tools.benchmarks.factor_graph import AS_STATED, FactorGraph, linear_run
from polar_nav_tools.benchmarks.navigation import Disagreement
from polar_nav_tools.cli import main
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.world import make_world
from polar_nav_tools.experiments.world_spec import WorldSpec

BAGS = Path(__file__).parents[2] / 'bags'
CASES = {
    'paper_6_1': ({'imu': 'paper_6_1'}, {'delay_s': 0.0}),
    'paper_6_1, without DVL, late': (
        {'imu': 'paper_6_1', 'dvl_rate_hz': 0.0},
        {'delay_kind': 'uniform', 'delay_s': 60.0, 'loss': 0.3},
    ),
    'mems, without DVL': (
        {'imu': 'bmi088', 'dvl_rate_hz': 0.0, 'gyro_bias_dph': 20.0, 'accel_bias_g': 2e-3},
        {'delay_s': 20.0},
    ),
    'tactical, without DVL, over the pole': (
        {'imu': 'tactical', 'dvl_rate_hz': 0.0, 'latitude_deg': 89.9995, 'course_deg': 0.0},
        {'delay_kind': 'uniform', 'delay_s': 60.0, 'loss': 0.3},
    ),
    'tactical, late, lost, out of order': (
        {'imu': 'tactical', 'dvl_rate_hz': 5.0},
        {'delay_kind': 'uniform', 'delay_s': 60.0, 'loss': 0.3},
    ),
    'mems': (
        {'imu': 'bmi088', 'dvl_rate_hz': 5.0, 'gyro_bias_dph': 20.0, 'accel_bias_g': 2e-3},
        {'delay_s': 20.0},
    ),
}


def problem(world_changes, fix_changes, seed=1):
    """Linear problem of ten minutes; every measurement is fused as stated."""
    spec = WorldSpec(
        **{
            'duration_s': 600.0,
            'constants': 'prior',
            'speed_mps': 2.0,
            'depth_rate_hz': 2.0,
            **world_changes,
        }
    )
    fixes = FixSpec(**{'period_s': 4.0, 'first_s': 2.0, **fix_changes})
    world = make_world(spec, fixes, seed)
    return linear_run(world.params(**AS_STATED), world.inputs)


@pytest.mark.slow
@pytest.mark.parametrize('case', CASES)
def test_mean_and_sigma_are_those_of_gtsam(case):
    pytest.importorskip('gtsam', reason='GTSAM is not installed (pip install gtsam)')
    run = problem(*CASES[case])
    assert len(run.updates) > 900
    rows = np.linspace(0, len(run.steps) - 1, 12).astype(int)
    mean, sigma = FactorGraph(run).solve(run.steps[rows].tolist())
    active = run.active
    off = np.abs(run.mean[rows] - mean)[:, active] / sigma[:, active]
    assert off.max() < 0.004
    np.testing.assert_allclose(run.sigma[rows][:, active], sigma[:, active], rtol=0.004)


def test_the_benchmark_stands_alone_without_gtsam(monkeypatch):
    """What is timed and how it is counted, not how fast it is."""
    said = []
    monkeypatch.setattr(smooth, 'find_spec', lambda _: None)
    found = smooth.run(rounds=1, duration_s=40.0, report=said.append)
    assert set(found.timings) == {'filter', 'one', 'two'}
    assert found.peer is None
    assert any('not installed' in line for line in said)
    assert found.to_dict()['agreement_sigma'] is None
    titles = [table.title for table in found.tables()]
    assert titles == ['A run of 40 s', 'Ratios']


def bench_smooth(monkeypatch, *words):
    before = os.sched_getaffinity(0)
    monkeypatch.setenv('OPENBLAS_NUM_THREADS', '1')
    monkeypatch.setattr(
        sys, 'argv', ['polar', 'bench', 'smooth', '--rounds', '1', *map(str, words)]
    )
    try:
        return main()
    finally:
        os.sched_setaffinity(0, before)


def test_recordings_are_timed_one_by_one(monkeypatch, capsys):
    bags = [BAGS / 'reference_4', BAGS / 'reference_10']
    assert bench_smooth(monkeypatch, *bags, '--json') == 0
    found = json.loads(capsys.readouterr().out)['bags']
    assert [one['path'] for one in found] == [str(bag) for bag in bags]
    for one in found:
        assert set(one['ms']) == {'filter', 'one', 'two'}
        assert one['duration_s'] == pytest.approx(30.0, abs=0.1)
        assert one['first_pass'] > 0.0


def test_a_recording_that_is_smoothed_in_one_pass_has_no_further_one():
    world = make_world(WorldSpec(duration_s=30.0), FixSpec(period_s=4.0), 1)
    params, said = replace(world.params(), model_aiding=True, water_track_sigma=0.0), []
    found = smooth.run_recorded('dive', params, world.inputs, rounds=1, report=said.append)
    assert set(found.timings) == {'filter', 'one'}
    assert found.further is None
    assert [what for what, *_ in found.goals()] == ['first pass / filter']
    assert said[0].startswith('dive: there is no further pass to time (')


@pytest.mark.parametrize(
    ('words', 'sentence', 'status'),
    [
        ([__file__], 'is not an MCAP file', 1),
        ([BAGS.parent / 'docs'], 'has no bag in it', 1),
        (['nowhere'], 'nowhere does not exist', 2),
        ([BAGS / 'station'], 'only recordings of mode sins can be timed', 2),
        ([BAGS / 'reference_4', '--seconds', '60'], 'timed as long as it is', 2),
        (['--map', 'mapping.yaml'], 'goes with a bag', 2),
        (['--vehicle', 'auv'], 'goes with a bag', 2),
        ([BAGS / 'reference_4', '--accept', 'gap'], 'goes with --map', 2),
    ],
)
def test_what_cannot_be_timed_is_a_sentence(monkeypatch, capsys, words, sentence, status):
    assert bench_smooth(monkeypatch, *words) == status
    assert sentence in ' '.join(capsys.readouterr().err.split())


@pytest.mark.slow
def test_the_benchmark_refuses_to_time_what_differs(monkeypatch):
    pytest.importorskip('gtsam', reason='GTSAM is not installed (pip install gtsam)')
    found = smooth.run(rounds=1, duration_s=40.0)
    assert found.agreement < smooth.BOUND
    assert found.peer is not None
    monkeypatch.setattr(smooth, 'BOUND', 1e-12)
    with pytest.raises(Disagreement, match='GTSAM differs'):
        smooth.run(rounds=1, duration_s=40.0)
