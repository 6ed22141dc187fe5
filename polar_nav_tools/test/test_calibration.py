"""Constants out of innovations: as injected, within their sigma; what is not shown is named."""

import math
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from polar_nav_core.engine import run as engine_run
from polar_nav_core.error_model import X
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid
from polar_nav_sim.sensors.compass import CompassErrors
from polar_nav_tools.calibration.constants import CONSTANTS, chosen
from polar_nav_tools.calibration.estimate import estimate
from polar_nav_tools.calibration.problem import Problem
from polar_nav_tools.calibration.solve import sums
from polar_nav_tools.calibration.verdicts import (
    Verdict,
    correlation,
    lines_of,
    notes,
    problems,
    sum_text,
    table,
)
from polar_nav_tools.experiments.calibrate.rows import ROWS, params_of
from polar_nav_tools.experiments.compass import stated, with_headings
from polar_nav_tools.experiments.errors import track_errors
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.world import make_world
from polar_nav_tools.experiments.world_spec import WorldSpec

BY_NAME = {row.name: row for row in ROWS}


def calibrated(row, scene='lawnmower', duration_s=300.0, seed=1, only=None, also=()):
    world = BY_NAME[row].world(scene, duration_s, seed)
    params = params_of(world)
    constants = chosen(params, world.inputs, only or tuple(BY_NAME[row].off), also)
    return estimate(params, world.inputs, constants)


@pytest.mark.parametrize('row', ['delay', 'dvl_yaw', 'dvl_scale', 'dvl_latency'])
@pytest.mark.parametrize('seed', [1, 2])
def test_a_constant_that_is_off_is_found(row, seed):
    found = calibrated(row, seed=seed)
    (line,) = lines_of(found)
    off = BY_NAME[row].off[line.constant.name]
    assert line.verdict is Verdict.ESTIMATED
    assert abs(line.value - off) < 4.0 * line.sigma
    assert off > 1.5 * line.sigma
    assert not problems(found)


@pytest.mark.slow
def test_all_at_once_are_found_and_the_innovations_are_white_again():
    found = calibrated('all')
    for line in lines_of(found):
        assert abs(line.value - BY_NAME['all'].off[line.constant.name]) < 4.0 * line.sigma
    misfits = found.misfits()
    assert misfits['dvl'][0] > 10.0
    for before, after in misfits.values():
        assert after == pytest.approx(1.0, abs=0.2)
        assert before > 0.8
    assert not notes(found)


def test_a_straight_run_shows_no_delay():
    found = calibrated('delay', 'straight')
    (line,) = lines_of(found)
    assert line.verdict is Verdict.NOT_EXCITED
    assert 'lawnmower' in line.why
    assert 'value' not in table('t', (line,)).rows[0]
    assert found.found.sigma[0] > 5.0


@pytest.mark.slow
def test_what_is_wrong_by_ten_sigmas_is_put_right():
    """A lever arm of a metre on a rolling vehicle, and a course that shows no delay."""
    found = calibrated('all', 'straight', 600.0, seed=3)
    assert found.misfits()['dvl'][0] > 100.0
    assert not problems(found)
    off = BY_NAME['all'].off
    for line in lines_of(found):
        if line.verdict is not Verdict.NOT_EXCITED:
            assert abs(line.value - off[line.constant.name]) < 4.0 * line.sigma
    assert found.refused() == 0
    assert not found.noise


@pytest.mark.slow
def test_noise_that_is_larger_than_stated_makes_sigmas_larger():
    world = BY_NAME['delay'].world('lawnmower', 300.0, 1)
    params, inputs = params_of(world), world.inputs
    rng = np.random.default_rng(4)
    worse = [replace(f, r_e=f.r_e + 4.0 * rng.normal(size=3)) for f in inputs.fixes]
    usual = estimate(params, inputs, chosen(params, inputs, ('delay',)))
    found = estimate(params, replace(inputs, fixes=tuple(worse)), usual.constants)
    assert found.found.sigma[0] > 2.5 * usual.found.sigma[0]
    assert found.misfits()['fix'][1] > 8.0
    assert any('fix' in note for note in notes(found))
    assert not problems(found)
    # A frame that is stated wrong: no noise is that large.
    swapped = [replace(f, r_e=f.r_e + 30.0 * rng.normal(size=3)) for f in inputs.fixes]
    found = estimate(params, replace(inputs, fixes=tuple(swapped)), usual.constants)
    assert any('no constant makes fix fit' in problem for problem in problems(found))


@pytest.mark.slow
def test_noise_of_the_pings_is_no_motion_that_shows_a_scale():
    """Few fixes, a slow error of the DVL as large as a scale, and an IMU as noisy as a STIM300."""
    found = []
    for seed in (1, 2, 3):
        world = BY_NAME['delay'].world('lawnmower', 300.0, seed)
        params = replace(
            params_of(world),
            gyro_noise_density=1.5e-4,
            accel_noise_density=1e-3,
            accel_bias_walk=2.7e-4,
            dvl_markov_sigma=0.02,
        )
        inputs = replace(world.inputs, fixes=world.inputs.fixes[::4])
        (line,) = lines_of(estimate(params, inputs, chosen(params, inputs, ('dvl_scale',))))
        found.append(line.value)
    assert abs(np.mean(found)) < 0.2


def test_an_array_and_the_heading_of_its_vehicle_are_one_sum():
    (line,) = lines_of(calibrated('array_yaw'))
    assert line.verdict is Verdict.INSEPARABLE
    assert 'heading bias' in line.why
    assert abs(line.value - 0.5) < 4.0 * line.sigma


def test_dvl_yaw_and_heading_bias_of_one_course_are_a_sum():
    """A level vehicle on one course, whose heading is known by its compass only."""
    spec = WorldSpec(
        duration_s=300.0,
        speed_mps=2.0,
        oscillating=False,
        constants='prior',
        gyro_bias_dph=10.0,
        accel_bias_g=1e-3,
        initial_sigma_heading_deg=20.0,
        initial_sigma_tilt_deg=0.5,
        dvl_rate_hz=5.0,
        depth_rate_hz=2.0,
    )
    world = make_world(spec, FixSpec(period_s=2.0, first_s=2.0, delay_s=3.0), 1)
    world = with_headings(world, 'true', CompassErrors(bias_deg=2.0), 0.0)
    noise = {'gyro_noise_density': 4e-5, 'accel_noise_density': 1e-3}
    params = world.params(configuration='default', **stated('true', 4.5, **noise))
    params = replace(params, dvl_rpy_deg=(0.0, 0.0, -1.0))
    found = estimate(
        params, world.inputs, chosen(params, world.inputs, ('dvl_yaw', 'heading_bias'))
    )
    (tied,) = sums(found.found, found.prior)
    assert math.degrees(tied.value) == pytest.approx(3.0, abs=4.0 * math.degrees(tied.sigma))
    assert tied.sigma < 0.3 * found.found.sigma.min()
    assert correlation(found)[0, 1] < -0.95
    for line in lines_of(found):
        assert line.verdict is Verdict.INSEPARABLE
        assert line.why.startswith('dvl_yaw + heading_bias = ')
    assert sum_text(found.constants, tied) in line.why


@pytest.mark.slow
def test_rows_of_common_errors_are_differences_of_runs():
    """Sign and unit of each column, and of what it does to the states of the filter."""
    world = BY_NAME['dvl_yaw'].world('lawnmower', 300.0, 1)
    params = params_of(world)
    columns = [c for c in CONSTANTS if c.column >= 0 and not c.rough]
    problem = Problem(params, world.inputs, columns, lambda _: None)
    at = np.zeros(len(columns))
    run = problem.run(at)
    M, _ = problem._rows(run, at)
    for k, c in enumerate(columns):
        by, _ = problem._differences(run, at, k)
        slope = by @ M[:, k] / (M[:, k] @ M[:, k])
        assert slope == pytest.approx(1.0, abs=0.05), c.name
        assert np.linalg.norm(by - M[:, k]) < 0.2 * np.linalg.norm(by), c.name


def test_moves_add_up():
    world = BY_NAME['all'].world('lawnmower', 300.0, 1)
    params, inputs = params_of(world), world.inputs
    for c in CONSTANTS:
        if c.move is None or c.needs == 'headings':
            continue
        size = 0.01 * c.prior
        there = c.move(*c.move(params, inputs, size), -size)
        for a, b in zip(inputs.fixes, there[1].fixes, strict=True):
            np.testing.assert_allclose(b.r_e, a.r_e, rtol=0, atol=1e-3, err_msg=c.name)
            assert abs(b.validity_ns - a.validity_ns) < 100_000
        np.testing.assert_allclose(there[0].dvl_rpy_deg, params.dvl_rpy_deg, atol=1e-9)
        np.testing.assert_allclose(there[0].dvl_lever_b, params.dvl_lever_b, atol=1e-12)


def test_constants_are_those_that_the_data_are_about():
    world = BY_NAME['delay'].world('straight', 60.0, 1)
    params, inputs = params_of(world), world.inputs
    names = [c.name for c in chosen(params, inputs)]
    assert {'delay', 'dvl_yaw', 'range_scale', 'sea_surface'} <= set(names)
    assert 'heading_bias' not in names
    assert 'dvl_roll' not in names
    assert [c.name for c in chosen(params, inputs, ('delay',), ('dvl_roll',))] == [
        'delay',
        'dvl_roll',
    ]
    with pytest.raises(ConfigError, match='no constant'):
        chosen(params, inputs, ('yaw',))
    with pytest.raises(ConfigError, match='measured headings'):
        chosen(params, inputs, ('heading_bias',))
    alone = [c.name for c in chosen(params, replace(inputs, fixes=()))]
    assert 'delay' not in alone
    for first, second in pairwise(sorted(c.name for c in CONSTANTS)):
        assert first != second


def nees_of_position(world, params, inputs):
    """Mean horizontal NEES per axis after two minutes."""
    track = engine_run.run(replace(params, output_period_s=1.0), inputs).track
    e = track_errors(world, track)
    late = e.time_s > 120.0
    C_e_G = ecef_to_grid(world.truth.state(track.stamps_ns).r_e)
    P = np.einsum('nij,njk,nlk->nil', C_e_G, e.P[:, X.dr_e, X.dr_e], C_e_G)[late, :2, :2]
    d = e.dr_G[late, :2]
    return float(np.mean(np.einsum('ni,nij,nj->n', d, np.linalg.inv(P), d)) / 2.0)


@pytest.mark.slow
@pytest.mark.parametrize('seed', [1, 3])
def test_after_calibration_a_run_is_honest(seed):
    row = BY_NAME['all']
    world = row.world('lawnmower', 600.0, seed)
    params, inputs = params_of(world), world.inputs
    found = estimate(params, inputs, chosen(params, inputs, tuple(row.off)))
    assert nees_of_position(world, params, inputs) > 50.0
    values = {c.name: v for c, v in zip(found.constants, found.found.mean, strict=True)}
    left = {c.name: s for c, s in zip(found.constants, found.found.sigma, strict=True)}
    for c in found.constants:
        if c.move is not None:
            params, inputs = c.move(params, inputs, float(values[c.name]))
    inputs = replace(inputs, dvl_v_m=inputs.dvl_v_m / (1.0 + values['dvl_scale']))
    params = replace(
        params,
        dvl_scale_sigma=left['dvl_scale'],
        dvl_lever_sigma=left['dvl_lever_x'],
        dvl_misalignment_sigma_deg=math.degrees(left['dvl_yaw']),
        fix_clock_sigma=left['delay'],
        fix_range_scale_sigma=left['range_scale'],
        fix_heading_sigma_deg=math.degrees(left['array_yaw']),
    )
    assert nees_of_position(world, params, inputs) < 3.0


@pytest.mark.parametrize(
    ('misfits', 'words'),
    [
        ({'fix': (1.0, 1.0), 'dvl': (190.0, 24.0), 'depth': (6.4, 57.0)}, ''),
        ({'fix': (600.0, 300.0)}, ''),  # the noise is stated much too small
        ({'fix': (3.6, 270.0)}, 'with these constants fix fits worse than as stated'),
        ({'fix': (3.6, 500.0)}, 'no constant makes fix fit'),
    ],
)
def test_constants_that_a_sensor_contradicts_are_a_problem(misfits, words):
    """As after a gap of the IMU, where the gate had refused what did not fit as stated."""
    after = SimpleNamespace(divergence='', filters=1)
    found = SimpleNamespace(after=after, settled=True, rounds=4, misfits=lambda: misfits)
    assert [p[: len(words)] for p in problems(found)] == [words] * bool(words)
