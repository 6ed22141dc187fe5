"""Samples missing from a regular IMU are interpolated, with the variance of that."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of
from test_batch import both
from test_imu_gap import view

from polar_nav_core import attitude
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.events import ImuSample
from polar_nav_core.engine.health.conditions import Level
from polar_nav_core.engine.health.view import Envelope, Gaps
from polar_nav_core.engine.health.watchdog import Watchdog
from polar_nav_core.engine.methods import DELAY_HANDLING
from polar_nav_core.engine.sins.filter import NavigationFilter
from polar_nav_core.error_model import X
from polar_nav_core.kernels.sins import events, fill
from polar_nav_core.kernels.sins import state as fs


@pytest.fixture(scope='module')
def world():
    return World(12.0)


def only(inputs, kept):
    """Inputs with some of the IMU samples."""
    return replace(
        inputs,
        imu_stamps_ns=inputs.imu_stamps_ns[kept],
        omega_ib_b=inputs.omega_ib_b[kept],
        f_b=inputs.f_b[kept],
    )


def lossy(inputs, share=0.5, longest=6):
    """Inputs whose IMU samples of 7 s are lost at random, a few in a row at most."""
    rng = np.random.default_rng(4)
    kept = np.ones(len(inputs.imu_stamps_ns), dtype=bool)
    in_row = 0
    for k in range(300, 1000):
        in_row = in_row + 1 if rng.random() < share and in_row < longest else 0
        kept[k] = in_row == 0
    return only(inputs, kept)


def without_aid(inputs):
    """Inputs with a DVL and depths that say nothing."""
    return replace(
        inputs,
        dvl_covariance_m=inputs.dvl_covariance_m * 1e10,
        depth_variance=inputs.depth_variance * 1e10,
    )


def turned(a, b):
    """Angle between the last attitudes of two tracks [rad]."""
    return np.linalg.norm(attitude.log(a.C_b_G[-1] @ b.C_b_G[-1].T))


@pytest.mark.parametrize('instant', ['mean', 'instant'])
def test_missing_samples_hardly_turn_the_vehicle(world, instant):
    inputs = without_aid(inputs_of(world, []))
    if instant == 'instant':  # values at the stamps of what the means are of
        inputs = replace(
            inputs,
            omega_ib_b=0.5 * (inputs.omega_ib_b + np.roll(inputs.omega_ib_b, -1, 0)),
            f_b=0.5 * (inputs.f_b + np.roll(inputs.f_b, -1, 0)),
        )
    sound, filled, held = (
        engine_run.run(world.params(imu_sample=instant, imu_missing=how), x).track
        for how, x in (
            ('interpolated', inputs),
            ('interpolated', lossy(inputs)),
            ('held', lossy(inputs)),
        )
    )
    assert turned(filled, sound) < 2e-5
    assert np.linalg.norm(filled.v_G[-1] - sound.v_G[-1]) < 1e-3
    if instant == 'mean':
        assert turned(held, sound) > 100.0 * turned(filled, sound)


def test_the_variance_is_that_of_the_noise_of_rates(world):
    """White noise of 1e-3 rad/s: the attitude is off by about what is stated for it."""
    inputs, off, stated = without_aid(inputs_of(world, [])), [], []
    params = world.params()
    clean = engine_run.run(params, inputs).track
    for seed in range(6):
        noise = 1e-3 * np.random.default_rng(seed).standard_normal(inputs.omega_ib_b.shape)
        noisy = replace(inputs, omega_ib_b=inputs.omega_ib_b + noise)
        whole, filled = (engine_run.run(params, x).track for x in (noisy, lossy(noisy)))
        off.append(attitude.log(filled.C_b_G[-1] @ whole.C_b_G[-1].T))
        P, P_0 = filled.P[-1][X.phi_G, X.phi_G], clean.P[-1][X.phi_G, X.phi_G]
        stated.append(np.diag(P) - np.diag(P_0))
    ratio = np.mean(np.square(off)) / np.mean(stated)
    assert 0.02 < ratio < 1.5  # a bend is allowed for besides


def test_nothing_changes_where_nothing_is_missing(world):
    inputs = inputs_of(world, world.fixes(2.0, 1.0))
    filled, held = (
        engine_run.run(world.params(imu_missing=how), inputs).track
        for how in ('interpolated', 'held')
    )
    assert np.array_equal(filled.r_e, held.r_e)
    assert np.array_equal(filled.P, held.P)


@pytest.mark.parametrize('shift_ms', [0, 4])
@pytest.mark.parametrize('instant', ['mean', 'instant'])
def test_a_ping_within_is_made_up_for(world, instant, shift_ms):
    """Pings that say nothing leave no trace of what was held up to them."""
    inputs = without_aid(inputs_of(world, []))
    shifted = inputs.dvl_stamps_ns + shift_ms * 1_000_000
    often = replace(inputs, dvl_stamps_ns=shifted)
    never = replace(
        inputs,
        dvl_stamps_ns=inputs.dvl_stamps_ns[:0],
        dvl_valid=inputs.dvl_valid[:0],
        dvl_v_m=inputs.dvl_v_m[:0],
        dvl_covariance_m=inputs.dvl_covariance_m[:0],
    )
    params = world.params(imu_sample=instant)
    a, b = (engine_run.run(params, lossy(x, longest=8)).track for x in (often, never))
    assert turned(a, b) < 1e-7
    assert np.linalg.norm(a.v_G[-1] - b.v_G[-1]) < 1e-4


@pytest.mark.parametrize('name', DELAY_HANDLING)
def test_same_bits_where_samples_are_missing(world, name):
    rng = np.random.default_rng(5)
    fixes = world.fixes(0.37, lambda _: rng.uniform(0.0, 4.0), rng=rng)
    last_ns = int(world.stamps[-1])
    fixes = [f for f in fixes if f.receive_ns < last_ns]
    both(
        world.params(configuration='custom', delay_handling=name, gate_probability=0.999),
        lossy(inputs_of(world, fixes), longest=12),
    )


def test_rewind_gives_the_bits_of_fixes_in_order(world):
    rng = np.random.default_rng(7)
    fixes = world.fixes(0.37, lambda _: rng.uniform(0.0, 4.0), rng=rng)
    last_ns = int(world.stamps[-1])
    fixes = [f for f in fixes if f.receive_ns < last_ns]
    prompt = [replace(f, receive_ns=f.validity_ns) for f in fixes]
    params = world.params(configuration='custom', delay_handling='rewind')
    late, at_once = (
        engine_run.run(params, lossy(inputs_of(world, x))).track for x in (fixes, prompt)
    )
    assert np.array_equal(late.r_e[-1], at_once.r_e[-1])
    assert np.array_equal(late.P[-1], at_once.P[-1])


def test_an_imu_that_becomes_slower_is_followed(world):
    """After minutes its interval is the usual one, and nothing is missing; samples may be lost."""
    params = world.params(imu_gap_s=0.5)
    now_ns = int(world.stamps[1])
    f = NavigationFilter(params, params.initial_state(), now_ns)
    for k in range(12_000):
        now_ns += 10_000_000 if k < 200 else 30_000_000
        f.imu(ImuSample(now_ns, k, np.zeros(3), np.array([0.0, 0.0, 9.8])))
        if k in (300, 900):  # two of three lost
            assert f.state.counters[fs.MISSING_NS] > 1_000_000_000
    assert f.state.counters[fs.USUAL_NS] == 30_000_000
    assert f.state.counters[fs.MISSING_NS] < 0.05 * fill.FADE_NS


@pytest.mark.parametrize('apart_ns', [1, 1_000, 200_000, 3_000_000])
@pytest.mark.parametrize('at', [1, 300])
def test_two_stamps_close_by_chance_are_no_interval(world, at, apart_ns):
    """A nanosecond would make a thousand million missing samples of all that come later."""
    f = NavigationFilter(world.params(), world.params().initial_state(), int(world.stamps[1]))
    for k in range(1, 600):
        stamp_ns = int(world.stamps[1]) + 10_000_000 * k
        if k == at + 1:
            early_ns = stamp_ns - 10_000_000 + apart_ns
            f.imu(ImuSample(early_ns, 1000, np.zeros(3), np.array([0.0, 0.0, 9.8])))
        f.imu(ImuSample(stamp_ns, k, np.zeros(3), np.array([0.0, 0.0, 9.8])))
    assert f.state.counters[fs.USUAL_NS] == 10_000_000
    assert f.state.counters[fs.MISSING_NS] == 0


def test_irregular_stamps_are_not_taken_for_missing_samples(world):
    inputs = inputs_of(world, world.fixes(2.0, 1.0))
    shift_ns = np.random.default_rng(2).integers(-4_500_000, 4_500_000, len(inputs.imu_stamps_ns))
    odd = replace(inputs, imu_stamps_ns=np.sort(inputs.imu_stamps_ns + shift_ns))
    found = engine_run.run(world.params(), odd, look_every_s=1.0).health[-1]
    assert not any('missing' in p.condition.key for p in found.present)


@pytest.mark.parametrize(('share', 'said'), [(0.04, False), (0.06, True)])
def test_missing_samples_are_a_condition(share, said):
    health = Watchdog(Envelope(20.0, 1000.0)).look(view(gaps=Gaps(0, 0.0, 0, share)), [])
    assert bool(health.present) is said
    if said:
        (found,) = health.present
        assert found.condition.level is Level.WARN
        assert '6 % of the IMU samples' in found.condition.sentence


def test_missing_samples_are_counted(world):
    inputs = lossy(inputs_of(world, []), longest=2)
    found = engine_run.run(world.params(), inputs, look_every_s=1.0).health
    names = [{p.condition.key for p in h.present} for h in found]
    assert 'IMU samples missing' not in names[2]
    assert 'IMU samples missing' in names[9]


def test_the_noise_of_a_step_is_of_its_own_length(world):
    """Steps are nearly always as long as the one before."""
    params = world.params(dvl_markov_sigma=0.005, dvl_markov_tau=2.0, usbl_bias_sigma=0.01)
    f = NavigationFilter(params, params.initial_state(), int(world.stamps[1]))
    variances, taus = (f.settings.markov[0], f.settings.usbl[0]), (2.0, params.usbl_bias_tau)
    q, decays = np.zeros(24), np.zeros(3)
    assert min(variances) > 0.0
    for dt in (0.1, 0.1, 0.03, 0.1, 0.5):
        events._process_noise(q, f.state, f.settings, dt, decays)
        for part, variance, tau in zip(
            (X.dvl_markov_m, X.usbl_bias_a), variances, taus, strict=True
        ):
            expected = variance * -np.expm1(-2.0 * dt / tau)
            np.testing.assert_allclose(q[part], expected, rtol=1e-12)
