"""A MEMS vehicle: its vices are what they state; two seeds of the experiment for mechanism."""

import numpy as np
import pytest

from polar_nav_core.engine import run as engine_run
from polar_nav_tools.experiments.catalog import experiment_named
from polar_nav_tools.experiments.evidence import mems
from polar_nav_tools.experiments.experiment import Request, run


@pytest.fixture(scope='module')
def mems_world():
    case = next(c for c in mems.cases(450.0) if c.name == 'imu')
    return case.scene.make(5)


def test_a_housing_is_undone_by_its_stated_mounting(mems_world):
    plain, housed = mems.Vices()(mems_world), mems.Vices(housing=True)(mems_world)
    assert np.abs(housed.inputs.dvl_v_m - plain.inputs.dvl_v_m).max() > 0.5
    a, b = (
        engine_run.run(world.params(**mems.stated(vices), output_period_s=1.0), world.inputs).track
        for world, vices in ((plain, mems.Vices()), (housed, mems.Vices(housing=True)))
    )
    # Scale errors are of other axes then, which differs by little at 2 m/s.
    assert np.abs(a.v_G - b.v_G).max() < 0.05


def test_pings_are_bad_and_the_barometer_sticks_as_stated(mems_world):
    plain = mems.Vices()(mems_world).inputs
    bad = mems.Vices(bad_pings=0.05)(mems_world).inputs
    share = np.mean(np.abs(bad.dvl_v_m - plain.dvl_v_m).max(axis=1) > 0.0)
    assert share == pytest.approx(0.05, abs=0.02)
    stuck = mems.Vices(stuck_s=30.0)(mems_world).inputs
    repeats = np.mean(np.diff(stuck.depth) == 0.0)
    assert repeats == pytest.approx(90.0 / 450.0, abs=0.01)  # from 0, 200 and 400 s on


def test_a_rest_takes_the_gyro_bias_away():
    rested, cold = (
        next(c for c in mems.cases(60.0) if c.name == name).scene.world.imu_errors()
        for name in ('imu', 'not_rested')
    )
    assert (rested.gyro_turn_on_sigma_dph, rested.gyro_g_sigma_dph) == (0.0, 0.0)
    assert cold.gyro_turn_on_sigma_dph == 3600.0
    assert rested.accel_turn_on_sigma_ug == cold.accel_turn_on_sigma_ug > 0.0


@pytest.mark.slow
def test_mems_at_two_seeds(tmp_path):
    request = Request(rows='noise, imu, not_rested', seeds=2, first_seed=9001, duration_s=300.0)
    outcome = run(experiment_named('mems'), request, tmp_path, lambda *_: None)
    rows = {row['case']: row for row in outcome.tables[0].rows}
    assert rows['noise']['met']
    assert rows['imu']['rms'] < 5.0
    assert not rows['not_rested']['within']
