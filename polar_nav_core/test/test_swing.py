"""Acceleration that late pings have missed: of any motion, and to the second order in the age."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from polar_nav_core.kernels.sins import swing


def test_acceleration_in_body_axes_is_that_less_what_turning_the_axes_makes():
    """Of any motion: d/dt (C^T v) by differences of a track with that rate and acceleration."""
    rng = np.random.default_rng(11)
    C_b_G, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    v_G, omega, f_b = (rng.standard_normal(3) for _ in range(3))
    a_G = C_b_G @ f_b - np.array([0.0, 0.0, 9.8])
    a_b = np.zeros(3)
    swing.body_acceleration(a_b, C_b_G, v_G, omega, f_b, 9.8)

    def velocity_b(t):
        angle = np.linalg.norm(omega) * t
        axis = omega / np.linalg.norm(omega)
        return Rotation.from_rotvec(-angle * axis).apply(C_b_G.T @ (v_G + a_G * t))

    np.testing.assert_allclose(
        a_b, (velocity_b(1e-4) - velocity_b(-1e-4)) / 2e-4, rtol=1e-6, atol=1e-6
    )


def test_a_steady_turn_has_none_and_speeding_up_its_own():
    speed, rate, a_b = 2.0, 0.2, np.zeros(3)
    v, omega = np.array([speed, 0.0, 0.0]), np.array([0.0, 0.0, rate])
    centripetal = np.array([0.0, speed * rate, 9.8])
    swing.body_acceleration(a_b, np.eye(3), v, omega, centripetal, 9.8)
    np.testing.assert_allclose(a_b, 0.0, atol=1e-12)
    faster = centripetal + np.array([0.5, 0.0, 0.0])
    swing.body_acceleration(a_b, np.eye(3), v, omega, faster, 9.8)
    np.testing.assert_allclose(a_b, [0.5, 0.0, 0.0], atol=1e-12)


def left_over(sigma, ages, period_s, *, late):
    """RMS of v(t - age) - v(t) + age a over a swing and ages, a by the filter or of now."""
    dt, rate = 0.01, 2.0 * np.pi / period_s
    t = np.arange(0.0, 10.0 * period_s, dt)
    a, mean, found = rate * np.cos(rate * (t - 0.5 * dt)), np.zeros(3), []
    share = np.zeros(2)
    for k, x in enumerate(a):
        swing.follow(mean, np.array([x, 0.0, 0.0]), sigma, dt, k == 0, share)
        found.append(mean[0] if late else x)
    settled = t > period_s
    off = [
        np.sin(rate * (t - age)) - np.sin(rate * t) + age * np.array(found) for age in np.abs(ages)
    ]
    return np.sqrt(np.mean(np.array(off)[:, settled] ** 2))


@pytest.mark.parametrize('period_s', [3.0, 6.0])
def test_less_is_left_over_of_a_swing_than_with_the_acceleration_of_now(period_s):
    """Over half-normal ages; the difference is b^2/2 or b (b/2 - tau) times that of v's jerk."""
    sigma, ages = 0.05, 0.05 * np.random.default_rng(5).standard_normal(300)
    now, then = (left_over(sigma, ages, period_s, late=late) for late in (False, True))
    jerk = np.sqrt(0.5) * (2.0 * np.pi / period_s) ** 2
    b = np.abs(ages)
    assert now == pytest.approx(jerk * np.sqrt(np.mean(b**4)) / 2, rel=0.15)
    least = jerk * np.sqrt(np.mean((b * (b / 2 - swing.USUAL_AGE * sigma)) ** 2))
    assert then == pytest.approx(least, rel=0.15)
    assert then < 0.7 * now


def test_the_age_is_that_which_leaves_least():
    b = np.abs(np.random.default_rng(6).standard_normal(200000))
    best = np.sum(b**2 * b / 2) / np.sum(b**2)
    assert best == pytest.approx(swing.USUAL_AGE, rel=0.01)


def test_each_interval_counts_by_its_own_length():
    mean, share, sigma = np.zeros(3), np.zeros(2), 0.05
    swing.follow(mean, np.zeros(3), sigma, 0.01, True, share)
    expected = 0.0
    for dt in (0.01, 0.01, 0.03, 0.01, 0.2):
        swing.follow(mean, np.array([1.0, 2.0, -1.0]), sigma, dt, False, share)
        expected += (1.0 - np.exp(-dt / (swing.USUAL_AGE * sigma))) * (1.0 - expected)
        np.testing.assert_allclose(mean, [expected, 2.0 * expected, -expected], rtol=1e-12)


def test_the_first_sample_is_taken_whole():
    mean = np.zeros(3)
    swing.follow(mean, np.array([1.0, -2.0, 3.0]), 0.05, 0.01, True, np.zeros(2))
    np.testing.assert_array_equal(mean, [1.0, -2.0, 3.0])
