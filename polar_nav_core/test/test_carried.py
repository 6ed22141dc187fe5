"""Corrections of the velocity take the covariance along: they show no heading."""

import numpy as np
import pytest
from closed_loop import World

from polar_nav_core.attitude import matrix_from_euler
from polar_nav_core.engine.sins.filter import NavigationFilter
from polar_nav_core.engine.sins.turned import carry_now
from polar_nav_core.error_model import X
from polar_nav_core.kernels.sins import carried as kernels
from polar_nav_core.kernels.sins import consider
from polar_nav_core.kernels.sins.rows import turn_rows
from polar_nav_core.kernels.sins.transition import INVERSE

FROM, UP = np.array([1.9, -0.4, 0.1]), np.array([0.0, 0.0, 1.0])
"""A velocity before its corrections [m/s], and the axis of turning."""


def turn_with(v_G):
    """Error (24,) of heading and velocity turned together, which no ping shows."""
    x = np.zeros(24)
    x[X.phi_G], x[X.dv_G] = UP, np.cross(v_G, UP)
    return x


@pytest.fixture
def corrected():
    """Transition with its inverse, what two pings took off the velocity, and what is left."""
    rng = np.random.default_rng(11)
    Phi, inverse = np.eye(24), np.zeros(INVERSE)
    Phi[:9, :15] += 0.1 * rng.standard_normal((9, 15))
    whole = np.linalg.inv(Phi)
    inverse[:9, :15] = whole[:9, :15]
    v_G, taken = FROM.copy(), np.zeros(2)
    for x in rng.standard_normal((2, 24)):
        kernels.note_ping(taken, v_G, x)
        kernels.note_turn(taken, v_G, x)
        v_G -= x[X.dv_G]
    return Phi, inverse, taken, v_G


def test_what_no_ping_shows_stays_so_after_a_correction(corrected):
    Phi, inverse, taken, now = corrected
    H = np.zeros((3, 24))
    H[:, X.dv_G] = np.eye(3)
    turn_rows(H, *now)
    kernels.carried_heading_rows(H, now, taken)
    np.testing.assert_allclose(H @ turn_with(FROM), 0.0, atol=1e-14)
    expected = Phi @ turn_with(now)
    kernels.carry_heading(Phi, inverse, taken)
    np.testing.assert_allclose(Phi @ turn_with(FROM), expected, atol=1e-14)
    np.testing.assert_array_equal(taken, 0.0)


def test_a_turned_dvl_is_answered_by_the_velocity_after_a_correction_too(corrected):
    """A vehicle that is not level, whose heading is known: the velocity alone has answered."""
    _, _, taken, now = corrected
    C_b_G = matrix_from_euler(0.7, -0.3, 0.2)
    S, H = np.zeros((24, consider.COLUMNS)), np.zeros((3, 24))
    H[:, X.dv_G] = np.eye(3)

    def innovation(v_G, carried):
        turn_rows(H, *v_G)
        kernels.carried_heading_rows(H, v_G, carried)
        J = np.zeros((3, consider.COLUMNS))
        consider.dvl_common(J, C_b_G, H, np.zeros(3), np.zeros(3), np.zeros(3))
        return J[:, consider.DVL_YAW] + H @ S[:, consider.DVL_YAW]

    level = FROM * [1.0, 1.0, 0.0]  # the vertical velocity does not change here
    now[2] = 0.0
    S[X.dv_G, consider.DVL_YAW] = -innovation(level, np.zeros(2))
    np.testing.assert_allclose(innovation(now, taken), 0.0, atol=1e-14)
    assert np.abs(innovation(now, np.zeros(2))).max() > 0.1
    kernels.carry_yaw(S, C_b_G, taken)
    np.testing.assert_allclose(innovation(now, np.zeros(2)), 0.0, atol=1e-14)


def test_the_inverse_of_the_transition_goes_along(corrected):
    Phi, inverse, taken, _ = corrected
    before = Phi.copy()
    kernels.carry_heading(Phi, inverse, taken)
    assert np.abs(Phi - before).max() > 0.1
    np.testing.assert_allclose(inverse[:9, :15], np.linalg.inv(Phi)[:9, :15], atol=1e-12)


def test_a_fix_that_turns_the_vehicle_turns_its_velocity():
    """And leaves alone what it takes off the velocity besides."""
    taken, x = np.zeros(2), turn_with(FROM)
    x[X.dv_G] += 0.3
    kernels.note_turn(taken, FROM, x)
    np.testing.assert_allclose(taken, np.cross(FROM, UP)[:2], atol=1e-15)


def test_nothing_corrected_changes_no_bit(corrected):
    Phi, inverse, _, _ = corrected
    before = Phi.copy(), inverse.copy()
    kernels.carry_heading(Phi, inverse, np.zeros(2))
    np.testing.assert_array_equal(Phi, before[0])
    np.testing.assert_array_equal(inverse, before[1])


def test_carried_at_once_is_what_the_next_transition_does():
    world = World(2.0)
    params = world.params(configuration='default')
    f = NavigationFilter(params, params.initial_state(), int(world.stamps[0]))
    rng = np.random.default_rng(3)
    A, taken = rng.standard_normal((24, 24)), rng.standard_normal(2)
    f.state.P[:], f.state.carried[:] = A @ A.T, taken
    f.state.sensitivity[:] = rng.standard_normal(f.state.sensitivity.shape)
    P, sensitivity = f.state.P.copy(), f.state.sensitivity.copy()
    carry_now(f.state)
    T = np.eye(24)
    kernels.carry_yaw(sensitivity, f.state.C_b_G, taken)
    kernels.carry_heading(T, np.zeros(INVERSE), taken.copy())
    np.testing.assert_allclose(f.state.P, T @ P @ T.T, atol=1e-12)
    np.testing.assert_allclose(f.state.sensitivity, T @ sensitivity, atol=1e-12)
    np.testing.assert_array_equal(f.state.carried, 0.0)
