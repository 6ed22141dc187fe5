"""Positions known to kilometres: corrections follow the bent surface, and depths place nobody."""

import math

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core import grid
from polar_nav_core.engine import run as engine_run
from polar_nav_core.error_model import X
from polar_nav_core.kernels.frames.earth import up_and_height
from polar_nav_core.kernels.sins.far import (
    FAR,
    begin_move,
    bend_of,
    end_move,
    is_far,
    turn_transition,
)

PLACES = np.array([[0.2e6, -0.3e6, 6.34e6], [1.1e6, -1.9e6, 5.95e6], [4.5e6, 4.5e6, 0.1e6]])


def moved(r_e, away_G, turn):
    """Position after a correction of grid axes [m], and that correction."""
    C_e_G = np.zeros((3, 3))
    x = np.zeros(24)
    x[X.dr_e] = grid.ecef_to_grid(r_e).T @ away_G
    height = begin_move(turn, r_e, C_e_G)
    after = r_e - x[X.dr_e]
    end_move(turn, after, C_e_G, x, height)
    return after, x


@pytest.mark.parametrize('r_e', PLACES)
@pytest.mark.parametrize('distance', [150.0, 3e3, 1e5])
def test_a_correction_moves_along_the_surface_to_the_height_that_it_means(r_e, distance):
    away_G = np.array([0.6 * distance, -0.8 * distance, 2.5])
    after, _ = moved(r_e, away_G, np.zeros((3, 3)))
    assert up_and_height(*after)[3] == pytest.approx(up_and_height(*r_e)[3] - 2.5, abs=1e-7)
    C_e_G = grid.ecef_to_grid(r_e)
    np.testing.assert_allclose((C_e_G @ (r_e - after))[:2], away_G[:2], atol=1e-7)


@pytest.mark.parametrize('r_e', PLACES)
def test_a_fix_far_off_is_where_its_innovation_moves_the_estimate(r_e):
    C_e_G = np.ascontiguousarray(grid.ecef_to_grid(r_e))
    fix, _ = moved(r_e, np.array([5e3, 7e3, -30.0]), np.zeros((3, 3)))
    z = C_e_G @ (r_e - fix)
    z[2] += bend_of(C_e_G, r_e, fix)
    assert z[2] == pytest.approx(-30.0, abs=1e-6)
    np.testing.assert_allclose(moved(r_e, z, np.zeros((3, 3)))[0], fix, atol=1e-6)
    assert bend_of(C_e_G, r_e, r_e + 0.5 * FAR * C_e_G[0]) == 0.0


def test_the_axes_turn_with_the_vertical_and_once():
    turn = np.zeros((3, 3))
    first, _ = moved(PLACES[1], np.array([4e3, 1e3, 0.0]), turn)
    second, _ = moved(first, np.array([-1e3, 9e3, 0.0]), turn)
    expected = grid.ecef_to_grid(second).T @ grid.ecef_to_grid(PLACES[1])
    np.testing.assert_allclose(turn, expected, atol=1e-14)
    Phi, inverse = np.eye(24), np.zeros((10, 16))
    inverse[:9, :9] = np.eye(9)
    turn_transition(Phi, inverse, turn)
    np.testing.assert_allclose(Phi[X.dr_e, X.dr_e], expected, atol=1e-14)
    np.testing.assert_allclose(inverse[:9, :9] @ Phi[:9, :9], np.eye(9), atol=1e-14)
    assert not turn.any()
    before = Phi.copy()
    turn_transition(Phi, inverse, turn)
    np.testing.assert_array_equal(Phi, before)


def test_positions_and_corrections_of_metres_are_not_far():
    P, x = np.eye(24), np.zeros(24)
    x[6] = 50.0
    assert not is_far(P, x)
    x[6] = 150.0
    assert is_far(P, x)
    P[7, 7], x[6] = 150.0**2, 0.0
    assert is_far(P, x)


@pytest.fixture(scope='module')
def world():
    return World(40.0)


@pytest.mark.slow
@pytest.mark.parametrize('sigma', [300.0, 1000.0, 5000.0])
def test_depths_alone_move_no_vehicle_and_make_it_no_surer(world, sigma):
    params = world.params(configuration='default', initial_sigma_position=sigma)
    track = engine_run.run(params, inputs_of(world, [])).track
    assert np.linalg.norm(track.r_e[-1] - world.r_e[-1]) < 0.3 * sigma
    assert math.sqrt(np.trace(track.P[-1, X.dr_e, X.dr_e])) > 0.9 * math.sqrt(2.0) * sigma
