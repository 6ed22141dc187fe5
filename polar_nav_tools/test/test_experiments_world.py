"""The offline world: truth and sensors close, noise has its stated size, runs are paired."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from polar_nav_core.attitude import exp
from polar_nav_core.engine import run as engine_run
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid
from polar_nav_sim.sensors.imu import DPH, G0
from polar_nav_tools.experiments.errors import track_errors
from polar_nav_tools.experiments.recorded import RecordedImu
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.world import make_world
from polar_nav_tools.experiments.world_spec import WorldSpec

SHORT = WorldSpec(duration_s=60.0)
EXACT = WorldSpec(duration_s=60.0, noisy=False, constants='none', initial_errors='none')
REWIND = {'configuration': 'custom', 'delay_handling': 'rewind', 'gate_probability': 1.0}


def test_without_noise_the_engine_stays_on_the_truth():
    world = make_world(EXACT, FixSpec(period_s=1.0, delay_s=2.0), 1)
    result = engine_run.run(world.params(**REWIND), world.inputs)
    errors = track_errors(world, result.track)
    assert len(errors.time_s) > 590
    assert len(result.receipts) == 58
    assert np.abs(errors.dr_G).max() < 1e-3
    assert np.abs(errors.dv_G).max() < 1e-5
    assert np.abs(errors.phi_G).max() < 1e-6


def test_a_mission_gives_the_truth_where_it_is_named():
    spec = dataclasses.replace(EXACT, duration_s=20.0, mission='over_pole')
    world = make_world(spec, FixSpec(period_s=1.0), 1)
    result = engine_run.run(world.params(**REWIND), world.inputs)
    assert np.degrees(world.truth.state(world.truth.start_ns).lat) > 89.9
    assert np.abs(track_errors(world, result.track).dr_G).max() < 1e-3


def test_errors_have_the_signs_of_the_frames():
    world = make_world(EXACT, FixSpec(), 1)
    stamps = world.inputs.imu_stamps_ns[[500, 1500]]
    truth = world.truth.state(stamps)
    phi_G, dv_G, dr_G = np.array([[1e-4, -2e-4, 3e-4], [0.1, 0.2, 0.3], [1.0, -2.0, 3.0]])
    C_G_e = np.swapaxes(ecef_to_grid(truth.r_e), 1, 2)
    track = SimpleNamespace(
        stamps_ns=stamps,
        r_e=truth.r_e + C_G_e @ dr_G,
        v_G=truth.v_G + dv_G,
        C_b_G=exp(-phi_G) @ truth.C_b_G,
        P=np.broadcast_to(np.eye(24), (2, 24, 24)),
        sensor_errors=np.zeros((2, 15)),
    )
    errors = track_errors(world, track)
    np.testing.assert_allclose(errors.phi_G, [phi_G] * 2, atol=1e-9)
    np.testing.assert_allclose(errors.dv_G, [dv_G] * 2, atol=1e-12)
    np.testing.assert_allclose(errors.dr_G, [dr_G] * 2, atol=1e-8)
    way = truth.v_G[0, :2] / np.linalg.norm(truth.v_G[0, :2])
    assert errors.along[0] == pytest.approx(dr_G[:2] @ way)
    assert np.hypot(errors.along[0], errors.cross[0]) == pytest.approx(np.hypot(1.0, 2.0))
    np.testing.assert_allclose(errors.nees_position(), [14.0] * 2, rtol=1e-6)


def test_sensor_noise_has_the_stated_size():
    world = make_world(dataclasses.replace(SHORT, imu='paper_6_2', duration_s=120.0), FixSpec(), 3)
    ideal = make_world(dataclasses.replace(EXACT, duration_s=120.0), FixSpec(), 3)
    noise = world.inputs.omega_ib_b - ideal.inputs.omega_ib_b
    np.testing.assert_allclose(noise.mean(axis=0), 0.03 * DPH, atol=4e-7)
    # 4.308e-6 rad/s per filter period of 0.1 s, 5 samples of 50 Hz.
    assert noise[:, 0].std() == pytest.approx(4.308e-6 * np.sqrt(5.0), rel=0.05)
    force = world.inputs.f_b - ideal.inputs.f_b
    assert force[:, 1].std() == pytest.approx(0.00156 * np.sqrt(5.0), rel=0.05)
    v_m = world.inputs.dvl_v_m - ideal.inputs.dvl_v_m - world.dvl_markov_m
    assert v_m.std() == pytest.approx(0.005, rel=0.05)
    scaled = make_world(dataclasses.replace(world.spec, noisy=False), FixSpec(), 3)
    np.testing.assert_allclose(scaled.inputs.dvl_v_m, 1.0001 * ideal.inputs.dvl_v_m, rtol=1e-12)
    depth = world.inputs.depth - ideal.inputs.depth
    assert depth.std() == pytest.approx(0.05, rel=0.08)


def test_constants_are_stated_drawn_or_zero():
    stated = make_world(SHORT, FixSpec(), 1).constants
    np.testing.assert_allclose(stated.gyro_bias_b, 0.03 * DPH)
    np.testing.assert_allclose(stated.accel_bias_b, 1e-6 * G0)
    drawn = [
        make_world(dataclasses.replace(SHORT, duration_s=10.0, constants='prior'), FixSpec(), seed)
        for seed in range(1, 41)
    ]
    scaled = np.array([w.constants.gyro_bias_b for w in drawn]) / (0.03 * DPH)
    assert 0.8 < scaled.std() < 1.2
    assert abs(scaled.mean()) < 0.3


def test_fixes_have_the_stated_noise_and_covariance():
    spec = FixSpec(sigma=2.0, sigma_vertical=0.3, delay_s=1.0)
    world = make_world(dataclasses.replace(SHORT, duration_s=300.0), spec, 2)
    fixes = world.inputs.fixes
    truth = world.truth.state(np.array([f.validity_ns for f in fixes]))
    C_e_G = ecef_to_grid(truth.r_e)
    error_G = np.einsum('nij,nj->ni', C_e_G, np.array([f.r_e for f in fixes]) - truth.r_e)
    np.testing.assert_allclose(error_G.std(axis=0), [2.0, 2.0, 0.3], rtol=0.06)
    np.testing.assert_allclose(error_G.mean(axis=0), 0.0, atol=0.15)
    covariance_G = C_e_G[7] @ fixes[7].covariance_e @ C_e_G[7].T
    np.testing.assert_allclose(covariance_G, np.diag([4.0, 4.0, 0.09]), atol=1e-9)


def test_a_leader_error_is_constant_per_run_and_stated():
    specs = [FixSpec(), FixSpec(leader_sigma=3.0)]
    without, with_error = (make_world(SHORT, s, 5).inputs.fixes for s in specs)
    shift = np.array([b.r_e - a.r_e for a, b in zip(without, with_error, strict=True)])
    assert np.linalg.norm(shift[0]) > 0.1
    np.testing.assert_allclose(shift, shift[:1].repeat(len(shift), 0), atol=1e-3)
    trace = np.trace(with_error[0].covariance_e) - np.trace(without[0].covariance_e)
    assert trace == pytest.approx(18.0)


def test_one_seed_is_one_world_whatever_the_delay():
    near, far = (make_world(SHORT, FixSpec(period_s=1.0, delay_s=d), 4) for d in (0.0, 9.0))
    np.testing.assert_array_equal(near.inputs.omega_ib_b, far.inputs.omega_ib_b)
    np.testing.assert_array_equal(near.inputs.dvl_v_m, far.inputs.dvl_v_m)
    assert near.initial == far.initial
    late = {f.sequence: f.r_e for f in far.inputs.fixes}
    for fix in near.inputs.fixes:
        if fix.sequence in late:
            np.testing.assert_array_equal(fix.r_e, late[fix.sequence])
    other = make_world(SHORT, FixSpec(period_s=1.0), 5)
    assert not np.array_equal(near.inputs.omega_ib_b, other.inputs.omega_ib_b)


def test_the_clairvoyant_run_is_the_run_without_delay():
    delayed = make_world(SHORT, FixSpec(period_s=1.0, delay_s=4.0), 6)
    assert len(delayed.inputs.fixes) == 56
    assert len(delayed.under_way) == 4
    delayed = delayed.clairvoyant()
    prompt = make_world(SHORT, FixSpec(period_s=1.0), 6)
    a, b = (engine_run.run(w.params(**REWIND), w.inputs) for w in (delayed, prompt))
    assert len(a.receipts) == 60
    np.testing.assert_array_equal(a.track.r_e, b.track.r_e)
    np.testing.assert_array_equal(a.track.P, b.track.P)


def test_recorded_errors_are_added_and_start_again_at_their_end():
    rng = np.random.default_rng(1)
    recorded = RecordedImu(50.0, rng.normal(size=(70, 3)), rng.normal(size=(70, 3)))
    ideal = make_world(dataclasses.replace(EXACT, duration_s=10.0), FixSpec(), 1)
    spec = dataclasses.replace(EXACT, duration_s=10.0, imu='recorded')
    world = make_world(spec, FixSpec(), 1, recorded)
    added = world.inputs.omega_ib_b - ideal.inputs.omega_ib_b
    np.testing.assert_allclose(added[:70], recorded.omega_b, atol=1e-12)
    np.testing.assert_allclose(added[70:140], recorded.omega_b, atol=1e-12)
    assert world.params().gyro_noise_density == pytest.approx(np.sqrt(1.0 / 50.0), rel=0.3)
    with pytest.raises(ConfigError, match=r'imu_rate_hz: 100\.0 Hz, the recording has 50'):
        make_world(dataclasses.replace(spec, imu_rate_hz=100.0), FixSpec(), 1, recorded)


def test_rates_that_do_not_divide_are_refused():
    with pytest.raises(ConfigError, match=r'dvl_rate_hz: 7\.0 Hz does not divide 50\.0 Hz'):
        make_world(dataclasses.replace(SHORT, dvl_rate_hz=7.0), FixSpec(), 1)
