"""The experiment `smooth`: its jobs, its table, and what it counts of correlated samples."""

import numpy as np
import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_tools.experiments import smooth_mismatch
from polar_nav_tools.experiments.catalog import experiment_named
from polar_nav_tools.experiments.request import Request, Size
from polar_nav_tools.experiments.smooth import (
    SMOOTH,
    SMOOTHER,
    SmoothJob,
    correlation_time,
    plan,
    run_job,
    tables,
)

SIZE = Size(120.0, 2)


def test_it_has_a_job_for_each_world_and_seed():
    assert experiment_named('smooth') is SMOOTH
    jobs = plan(Request(rows='6_*', first_seed=5), SIZE, ())
    assert {(j.row, j.seed) for j in jobs} == {('6_1', 5), ('6_1', 6), ('6_2', 5), ('6_2', 6)}
    assert {j.row for j in plan(Request(rows='station*'), SIZE, ())} == {
        'station',
        'station_changing',
    }
    with pytest.raises(ConfigError, match='no such row'):
        plan(Request(rows='nothing'), SIZE, ())


@pytest.mark.parametrize(('keep', 'expected'), [(0.0, 1.0), (0.9, 19.0)])
def test_samples_count_once_per_correlation_time(keep, expected):
    """An autoregression x <- a x + noise has 1 + 2 sum a^k = (1 + a)/(1 - a)."""
    rng = np.random.default_rng(1)
    x = np.zeros((20_000, 3))
    noise = rng.standard_normal(x.shape) * np.sqrt(1.0 - keep**2)
    for k in range(1, len(x)):
        x[k] = keep * x[k - 1] + noise[k]
    assert correlation_time(x) == pytest.approx(expected, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize('world', ['6_2', 'exact_no_dvl', 'station_changing'])
def test_the_smoother_is_nearer_and_its_table_judges_it(world):
    results = [run_job(SmoothJob(world, 120.0, SMOOTHER, seed)) for seed in (1, 2)]
    (table,) = tables(results, SIZE, Request())
    rows = {row['track']: row for row in table.rows}
    assert rows['smoother']['rms'] < rows['filter']['rms']
    assert rows['smoother']['sigma'] < rows['filter']['sigma']
    assert 2.0 <= rows['smoother']['samples'] < 180.0
    assert {row['well'] for row in table.rows} <= {'yes', 'no'}


@pytest.mark.slow
def test_a_world_that_differs_is_judged_for_filter_and_smoother():
    """With a dead thruster the filter is late; the smoother knows better from when it died."""
    jobs = smooth_mismatch.plan(
        Request(rows='station_thruster_dead', first_seed=3001), Size(1200.0, 1), ()
    )
    (table,) = smooth_mismatch.tables(
        [smooth_mismatch.run_job(job) for job in jobs], SIZE, Request()
    )
    (row,) = table.rows
    assert row['smoother_wrong'] == '0 of 1'
    assert row['smoother_rms'] < 0.5 * row['filter_rms']
