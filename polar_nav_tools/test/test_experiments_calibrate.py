"""The experiment `calibrate`: stated sigmas are the bound, and its table judges."""

import math

import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_tools.experiments.calibrate.experiment import (
    BOUND,
    CALIBRATE,
    CALIBRATED,
    CalibrateJob,
    plan,
    run_job,
    tables,
)
from polar_nav_tools.experiments.calibrate.rows import ROWS, SCENES
from polar_nav_tools.experiments.catalog import experiment_named
from polar_nav_tools.experiments.jobs import RunResult
from polar_nav_tools.experiments.request import Request, Size

SIZE = Size(300.0, 2)


def test_it_has_a_job_for_each_row_scene_and_seed():
    assert experiment_named('calibrate') is CALIBRATE
    jobs = plan(Request(), SIZE, (CALIBRATED,))
    calibrations = [j for j in jobs if j.column == CALIBRATED]
    assert len(calibrations) == 2 * len(ROWS) * len(SCENES)
    assert len(jobs) - len(calibrations) == (len(ROWS) - 1) * len(SCENES)
    few = plan(Request(rows='delay_*', first_seed=7), SIZE, (CALIBRATED,))
    assert {j.group for j in few} == {f'delay_{s}' for s in SCENES}
    assert {j.seed for j in few} == {7, 8}
    with pytest.raises(ConfigError, match='no such row'):
        plan(Request(rows='nothing'), SIZE, ())


@pytest.mark.slow
@pytest.mark.parametrize('row', [row.name for row in ROWS if len(row.off) == 1])
def test_sigmas_are_the_bound(row):
    """The bound knows neither the calibration's rows nor its moves, but innovations only."""
    calibrated, bound = (
        run_job(CalibrateJob(row, 'lawnmower', 300.0, column, 1)) for column in (CALIBRATED, BOUND)
    )
    ((name, least),) = bound.metrics.items()
    sigma = calibrated.metrics[name.replace('bound', 'sigma')]
    assert not calibrated.stopped
    # Differences of a latency are rougher: whole samples, and the turns of a rolling vehicle.
    assert sigma == pytest.approx(least, rel=0.15 if row == 'dvl_latency' else 0.03)


def result(seed, error, verdict=0, column=CALIBRATED):
    metrics = {'delay.error': error, 'delay.sigma': 0.1, 'delay.verdict': float(verdict)}
    if column == BOUND:
        metrics = {'delay.bound': 0.1}
    return RunResult('delay_circle', column, seed, metrics, math.nan, '', {}, 0.0)


@pytest.mark.parametrize(
    ('errors', 'verdict', 'well'),
    [
        ([0.1, -0.11, 0.08, 0.1], 0, 'yes'),
        ([0.3, -0.3, 0.3, 0.3], 0, 'no'),
        ([1e-4, 1e-4, 1e-4, 1e-4], 0, 'no'),
        ([5.0, -3.0, 4.0, 2.0], 1, 'yes'),
    ],
)
def test_its_table_judges(errors, verdict, well):
    runs = [result(1, 0.0, column=BOUND), *(result(k, e, verdict) for k, e in enumerate(errors))]
    (table,) = tables(runs, Size(600.0, len(errors)), Request())
    (row,) = table.rows
    assert row['well'] == well
    assert row['bound'] == 0.1
