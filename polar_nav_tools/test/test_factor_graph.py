"""The smoother against GTSAM: the same linear problem, means and sigmas."""

import numpy as np
import pytest

from polar_nav_tools.benchmarks import smooth
from polar_nav_tools.benchmarks.factor_graph import AS_STATED, FactorGraph, linear_run
from polar_nav_tools.benchmarks.navigation import Disagreement
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.world import make_world
from polar_nav_tools.experiments.world_spec import WorldSpec

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


@pytest.mark.slow
def test_the_benchmark_refuses_to_time_what_differs(monkeypatch):
    pytest.importorskip('gtsam', reason='GTSAM is not installed (pip install gtsam)')
    found = smooth.run(rounds=1, duration_s=40.0)
    assert found.agreement < smooth.BOUND
    assert found.peer is not None
    monkeypatch.setattr(smooth, 'BOUND', 1e-12)
    with pytest.raises(Disagreement, match='GTSAM differs'):
        smooth.run(rounds=1, duration_s=40.0)
