"""The DVL's scale beside a noisy IMU: learnt from fixes, not from the jitter of the velocity."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core.engine import run as engine_run
from polar_nav_core.kernels.sins.rows import SCALE
from polar_nav_core.kernels.sins.scale import PINGS, SWING, steady_scale_rows

pytestmark = pytest.mark.slow

VIBRATION = 0.02
"""Noise of the accelerometers [m/s^2/sqrt(Hz)]."""


def rows(velocity_m):
    """Rows of a ping with a velocity, instrument axes turned by 30 deg."""
    c, s = np.cos(0.5), np.sin(0.5)
    C_m_G = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    H = np.zeros((3, 24))
    H[:, SCALE : SCALE + 3] = -C_m_G * velocity_m
    return H, C_m_G


def used(H, C_m_G):
    return -np.diagonal(C_m_G.T @ H[:, SCALE : SCALE + 3])


SIGMA = 0.02


def judged(velocities_m, steady):
    """Velocities that stand in the rows of the scale, and what a ping's variances grow by."""
    P = np.zeros((24, 24))
    P[SCALE : SCALE + 3, SCALE : SCALE + 3] = SIGMA**2 * np.eye(3)
    found, more = [], []
    for velocity in velocities_m:
        H, C_m_G = rows(np.asarray(velocity))
        R = np.zeros((3, 3))
        steady_scale_rows(H, R, C_m_G, P, steady)
        found.append(used(H, C_m_G))
        more.append(C_m_G.T @ R @ C_m_G)
    return np.array(found), np.array(more)


def settled(*speed_m):
    """The speed that stays, after its first pings."""
    return np.array([*speed_m, PINGS])


def test_the_speed_that_stays_is_the_mean_of_the_first_pings():
    rng = np.random.default_rng(1)
    velocities = np.array([2.0, 0.0, -0.1]) + 0.05 * rng.standard_normal((int(PINGS), 3))
    steady = np.zeros(4)
    found, _ = judged(velocities, steady)
    np.testing.assert_allclose(steady, [*velocities.mean(axis=0), PINGS], atol=1e-12)
    means = np.cumsum(velocities, axis=0) / np.arange(1, len(velocities) + 1)[:, None]
    np.testing.assert_allclose(found, means, atol=1e-12)


def test_a_jittering_velocity_hardly_moves_the_rows():
    rng = np.random.default_rng(2)
    jitter = 0.009 * rng.standard_normal((4000, 3))
    found, _ = judged(np.array([2.0, 0.3, -0.1]) + jitter, settled(2.0, 0.3, -0.1))
    assert found.std(axis=0).max() < 0.02 * jitter.std()


def test_a_change_of_speed_stands_in_the_rows_at_once_but_for_a_swing():
    found, more = judged(
        [[0.5, 0.0, 0.0], [1.0, 0.0, 0.0], [1.9, 0.0, 0.0]], settled(2.0, 0.0, 0.0)
    )
    np.testing.assert_allclose(found[:2, 0], [0.5 + SWING, 1.0 + SWING], atol=1e-12)
    assert found[2, 0] == pytest.approx(1.985, abs=0.005)
    expected = SIGMA**2 * np.array([SWING, SWING, found[2, 0] - 1.9]) ** 2
    np.testing.assert_allclose(more[:, 0, 0], expected, atol=1e-15)


def test_the_rows_go_to_a_new_speed_slowly():
    steady = settled(2.0, 0.0, 0.0)
    found, more = judged(np.tile([0.5, 0.0, 0.0], (20000, 1)), steady)
    assert found[int(4 * PINGS), 0] == pytest.approx(0.5 + 0.9 * SWING, abs=0.1 * SWING)
    assert found[-1, 0] == pytest.approx(0.5, abs=1e-4)
    assert more[-1].max() < 1e-12


def test_rows_do_not_lag_behind_a_swing_that_is_wider_than_the_limit():
    """What lags goes along with accelerations: by half of the velocity, were the rows a play."""
    phase = np.arange(6000) * 2.0 * np.pi / 40.0
    velocities = np.zeros((len(phase), 3))
    velocities[:, 0] = 2.0 * SWING * np.sin(phase)
    found = judged(velocities, settled(0.0, 0.0, 0.0))[0][:, 0]
    along, across = found @ np.sin(phase), found @ np.cos(phase)
    assert along > 0.1 * velocities[:, 0] @ np.sin(phase)
    assert abs(across) < 0.05 * along


def test_a_scale_without_sigma_has_the_velocity_itself():
    H, C_m_G = rows(np.array([2.0, 0.1, 0.0]))
    before, R = H.copy(), np.zeros((3, 3))
    steady_scale_rows(H, R, C_m_G, np.zeros((24, 24)), settled(1.0, 0.0, 0.0))
    np.testing.assert_array_equal(H, before)
    np.testing.assert_array_equal(R, 0.0)


@pytest.fixture(scope='module')
def world():
    return World(300.0)


def run_of(world, seed):
    """NEES of velocity in the second half, the scale along track at the end, and its sigma."""
    rng = np.random.default_rng(seed)
    fixes = world.fixes(2.0, 1.0, sigma=2.0, rng=rng)
    inputs = inputs_of(world, fixes, seed)
    f_b = inputs.f_b + VIBRATION * 10.0 * rng.standard_normal(inputs.f_b.shape)
    params = world.params(
        configuration='default',
        accel_noise_density=VIBRATION,
        dvl_scale_sigma=0.03,
        initial_sigma_position=5.0,
    )
    track = engine_run.run(params, replace(inputs, f_b=f_b)).track
    late = slice(len(track.stamps_ns) // 2, None, 100)
    at = (track.stamps_ns[late] - world.stamps[0]) // 10_000_000
    error = track.v_G[late] - np.array(world.v_G)[at]
    P = track.P[late, 3:6, 3:6]
    nees = np.einsum('ni,nij,nj->n', error, np.linalg.inv(P), error) / 3.0
    return nees.mean(), track.sensor_errors[-1, 6], np.sqrt(track.P[-1, SCALE, SCALE])


def test_vibration_pulls_no_scale(world):
    """With the newest velocity in the rows: NEES 5.3, and 3.2 sigma of three runs in one way."""
    nees, scale, sigma = np.array([run_of(world, seed) for seed in (1, 2, 3)]).T
    assert nees.mean() < 1.6
    assert abs(scale.mean()) < 2.0 * sigma.mean() / np.sqrt(3.0)
