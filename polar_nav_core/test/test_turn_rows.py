"""Velocity in a ping's rows of attitude: the noise of pings is no motion, and shows no heading."""

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core.engine import run as engine_run
from polar_nav_core.kernels.sins.turn import known_turn_rows, own_share

CONSUMER = {
    'gyro_noise_density': np.radians(0.005),
    'gyro_bias_sigma': np.radians(0.02),
    'accel_noise_density': 1.4e-3,
    'accel_bias_sigma': 0.02,
    'initial_sigma_heading_deg': 4.0,
}


def rows(rng):
    """Rows of a ping, its noise, and a covariance of the states."""
    H = rng.standard_normal((3, 24)) * (rng.uniform(size=(3, 24)) < 0.5)
    A, B = rng.standard_normal((24, 24)), rng.standard_normal((3, 3))
    return H, 0.1 * B @ B.T, 0.01 * A @ A.T


@pytest.mark.parametrize('seed', range(5))
def test_the_velocity_lies_between_both_by_the_share_of_the_estimate(seed):
    rng = np.random.default_rng(seed)
    H, R, P = rows(rng)
    z, v_G = rng.standard_normal(3), rng.standard_normal(3)
    own = np.trace((H @ P @ H.T)[:2, :2])
    share = own_share(H @ P @ H.T + R, R)
    assert share == pytest.approx(own / (own + np.trace(R[:2, :2])))
    before = H.copy()
    known_turn_rows(H, z, v_G, share)
    x, y, up = v_G - share * z
    expected = -np.array([[0.0, -up, y], [up, 0.0, -x], [-y, x, 0.0]])
    expected[np.diag_indices(3)] = np.diagonal(before[:, :3])  # zeros in the rows of a ping
    np.testing.assert_allclose(H[:, :3], expected, atol=1e-15)
    np.testing.assert_array_equal(H[:, 3:], before[:, 3:])


def test_its_error_says_nothing_to_the_innovation():
    """The measured velocity goes along with it by -R, the predicted one by H P H^T."""
    rng = np.random.default_rng(7)
    own, noise = 0.02**2, 0.005**2
    H, P, R = np.zeros((3, 24)), np.zeros((24, 24)), np.diag([noise] * 3)
    H[:, 3:6] = np.eye(3)
    P[3:6, 3:6] = own * np.eye(3)
    off = np.sqrt(own) * rng.standard_normal((200000, 3))
    z = off + np.sqrt(noise) * rng.standard_normal((200000, 3))
    share = own_share(H @ P @ H.T + R, R)
    for part, along in ((share, 0.0), (1.0, -noise), (0.0, own)):
        products = (off - part * z) * z
        five_sigmas = 5.0 * products.std() / np.sqrt(products.size)
        assert products.mean() == pytest.approx(along, abs=five_sigmas)
        assert five_sigmas < 0.2 * noise


def test_nothing_known_and_nothing_stated_are_no_division_by_zero():
    none = np.zeros((3, 3))
    assert own_share(none, none) == 0.0
    assert own_share(np.eye(3), np.eye(3)) == 0.0


def information(world, rng, **changes):
    """About the heading at the end of a run with pings of 5 mm/s, noisy or exact [1/rad^2]."""
    inputs = inputs_of(world, [])
    inputs.dvl_v_m[:] = [p.v_m for p in world.dvl(rng=rng)]
    P = engine_run.run(world.params(**changes, **CONSUMER), inputs).track.P[-1]
    return 1.0 / P[2, 2]


@pytest.mark.slow
def test_the_noise_of_pings_shows_little_heading_to_a_vehicle_at_rest():
    """Nothing moves: what noisy pings show beyond exact ones is of their noise.

    n^2/R and more of each with the measured velocity (1.7/rad^2 here), s (1 - s) with the known
    one (0.2), and next to nothing where a turn is carried with the corrections of the velocity.
    """
    world = World(60.0, v_G=(0.0, 0.0, 0.0))
    number = len(world.dvl())
    shown = {}
    for name in ('carried', 'known', 'measured'):
        changes = {'configuration': 'default', 'dvl_turn_velocity': name}
        exact = information(world, None, **changes)
        noisy = information(world, np.random.default_rng(3), **changes)
        shown[name] = (noisy - exact) / number
    assert shown['measured'] > 1.0
    assert 0.0 < shown['known'] < 0.2 * shown['measured']
    assert abs(shown['carried']) < 0.1 * shown['known']


@pytest.mark.parametrize('name', ['conventional_akf', 'modified_akf'])
def test_the_readings_of_the_paper_have_the_measured_velocity(name):
    world = World(5.0)
    inputs = inputs_of(world, world.fixes(1.0, 0.5))
    a, *others = (
        engine_run.run(world.params(configuration=name, dvl_turn_velocity=v), inputs).track
        for v in ('measured', 'known', 'carried')
    )
    for b in others:
        np.testing.assert_array_equal(a.r_e, b.r_e)
        np.testing.assert_array_equal(a.P, b.P)
