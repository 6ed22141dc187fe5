"""The DVL's scale: learnt from the velocity that a vehicle has, not from jitter about it."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core.engine import run as engine_run
from polar_nav_core.kernels.sins import state as fs
from polar_nav_core.kernels.sins.rows import SCALE
from polar_nav_core.kernels.sins.scale import NUMBER, PINGS, STEADY, steady_scale_rows

pytestmark = pytest.mark.slow

VIBRATION = 0.02
"""Noise of the accelerometers [m/s^2/sqrt(Hz)]."""


class Pings:
    """Rows of pings of one stated covariance, instrument axes turned by 30 deg."""

    def __init__(self, sigma, noise=1.0):
        c, s = np.cos(0.5), np.sin(0.5)
        self.C_m_G = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        self.P = np.diag(np.full(24, sigma**2))
        self.R = noise**2 * np.eye(3)
        self.memory = np.zeros(STEADY)

    def used(self, velocity_m, z_m=(0.0, 0.0, 0.0)):
        """Velocity in the rows of the scale, of a ping whose estimate and innovation are given."""
        H = np.zeros((3, 24))
        H[:, 3:6] = np.eye(3)
        H[:, SCALE : SCALE + 3] = -self.C_m_G * velocity_m
        PHt = H @ self.P
        z = self.C_m_G @ np.asarray(z_m)
        memory, S = self.memory, PHt @ H.T + self.R
        steady_scale_rows(H, self.R, z, self.C_m_G, self.P, memory, PHt, S)
        return -np.diagonal(self.C_m_G.T @ H[:, SCALE : SCALE + 3])


VELOCITY = np.array([2.0, 0.3, -0.1])


def test_a_velocity_that_jitters_by_its_own_error_is_the_mean_of_pings_before():
    rng = np.random.default_rng(1)
    pings = Pings(0.1)
    velocities = VELOCITY + 0.03 * rng.standard_normal((400, 3))
    for k, v in enumerate(velocities):
        used = pings.used(v)
        if 0 < k < PINGS:
            np.testing.assert_allclose(used, velocities[:k].mean(axis=0), atol=1e-12)
    assert pings.memory[NUMBER] == PINGS - 1
    np.testing.assert_allclose(used, VELOCITY, atol=0.02)


def test_a_change_of_speed_is_in_the_rows_at_once():
    pings = Pings(0.01)
    for _ in range(100):
        pings.used(VELOCITY)
    faster = VELOCITY + np.array([1.0, 0.0, 0.0])
    expected = VELOCITY + np.array([1.0 - 9.0 * 0.01**2, 0.0, 0.0])
    np.testing.assert_allclose(pings.used(faster), expected, atol=1e-12)


def test_a_vehicle_that_swings_is_in_the_rows_with_all_that_is_not_jitter():
    pings = Pings(0.01)
    swing = 0.1 * np.sin(0.4 * np.arange(400.0))
    used = np.array([pings.used(VELOCITY + np.array([0.0, v, 0.0]))[1] for v in swing])[200:]
    part = np.polyfit(swing[200:], used, 1)[0]
    assert part == pytest.approx(1.0 - 0.01**2 / (0.5 * 0.1**2), abs=0.01)


def test_a_ping_that_no_gate_lets_pass_leaves_the_mean_alone():
    pings = Pings(0.01, noise=0.005)
    for _ in range(100):
        pings.used(VELOCITY)
    before = pings.memory.copy()
    np.testing.assert_allclose(pings.used(VELOCITY, z_m=[5.0, -5.0, 5.0]), VELOCITY, atol=1e-12)
    np.testing.assert_array_equal(pings.memory[:NUMBER], before[:NUMBER])


def test_what_is_uncertain_with_the_scale_itself_is_no_jitter():
    pings = Pings(0.1)
    pings.P[3:6, SCALE : SCALE + 3] = pings.C_m_G * 0.999 * 0.1**2
    pings.P[SCALE : SCALE + 3, 3:6] = pings.P[3:6, SCALE : SCALE + 3].T
    pings.used(VELOCITY)
    moved = VELOCITY + np.array([0.1, 0.0, 0.0])
    np.testing.assert_allclose(pings.used(moved), moved, atol=0.002)


@pytest.mark.parametrize('steady', [True, False])
def test_neither_a_mean_nor_a_swing_pulls_a_scale(steady):
    """E[g z] about a velocity that stays, or one that swings by four times its own sigma."""
    rng = np.random.default_rng(2)
    r, q, count = 1.0, 0.05, 100_000
    P = 0.5 * q + np.sqrt(0.25 * q * q + q * r)
    G = P / (P + r)
    pings = Pings(np.sqrt(P))
    pings.P[SCALE:, SCALE:] = 0.0
    noise, walk = rng.standard_normal((count, 3)), np.sqrt(q) * rng.standard_normal((count, 3))
    a, slope, products = np.zeros(3), np.zeros(3), np.empty((count, 3))
    for k in range(count):
        a = a + walk[k]
        z = a - noise[k]
        true = np.zeros(3) if steady else 4.0 * np.sqrt(P) * np.sin(0.3 * k + np.arange(3.0))
        velocity = pings.used(true + a, z)
        products[k] = (slope - velocity) * z
        slope = slope + G * (velocity - slope)
        a = a - G * z
    error = products.std() / np.sqrt(products.size)
    assert abs(products.mean()) < 5.0 * error + 0.05 * P / (2.0 - G)


def test_predicted_and_corrected_velocities_pull_a_scale_as_derived():
    """E[g z] of a scalar filter about a velocity that stays (measurements.md, 1)."""
    rng = np.random.default_rng(1)
    r, q, pings = 1.0, 0.05, 400_000
    P = 0.5 * q + np.sqrt(0.25 * q * q + q * r)
    G = P / (P + r)
    noise, walk = np.sqrt(r) * rng.standard_normal(pings), np.sqrt(q) * rng.standard_normal(pings)
    a, slopes = 0.0, np.zeros(3)
    products = np.empty((pings, 3))
    for k in range(pings):
        a += walk[k]
        z = a - noise[k]
        velocities = np.array([a, a - G * z, a - G / (2.0 - G) * z])
        products[k] = (slopes - velocities) * z
        slopes += G * (velocities - slopes)
        a -= G * z
    expected = [-P / (2.0 - G), P * (1.0 - G) / (2.0 - G)]
    np.testing.assert_allclose(products.mean(axis=0)[:2], expected, rtol=0.03)
    assert abs(products.mean(axis=0)[2]) < 0.03 * abs(expected[0])


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


@pytest.mark.parametrize(('gap_s', 'anew'), [(8.0, False), (12.0, True)])
def test_the_mean_begins_anew_after_an_outage(monkeypatch, gap_s, anew):
    world, made = World(20.0), []
    make_state = fs.make_state
    monkeypatch.setattr(fs, 'make_state', lambda **k: made.append(make_state(**k)) or made[-1])
    inputs = inputs_of(world, [])
    since = inputs.dvl_stamps_ns - inputs.dvl_stamps_ns[0]
    kept = (since < 4e9) | (since >= (4.0 + gap_s) * 1e9)
    columns = ('dvl_stamps_ns', 'dvl_v_m', 'dvl_covariance_m', 'dvl_valid')
    fewer = {name: getattr(inputs, name)[kept] for name in columns}
    engine_run.run(world.params(configuration='default'), replace(inputs, **fewer))
    pings = max(state.steady[NUMBER] for state in made)
    after = np.count_nonzero(since >= (4.0 + gap_s) * 1e9)
    assert pings == (after if anew else np.count_nonzero(kept))


def test_vibration_pulls_no_scale(world):
    """With the newest velocity in the rows: NEES 5.3, and 3.2 sigma of three runs in one way."""
    nees, scale, sigma = np.array([run_of(world, seed) for seed in (1, 2, 3)]).T
    assert nees.mean() < 3.0
    assert abs(scale.mean()) < 2.0 * sigma.mean() / np.sqrt(3.0)
