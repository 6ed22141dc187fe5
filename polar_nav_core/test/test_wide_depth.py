"""Depths beside a position known to kilometres: they must not place the vehicle.

The surface of equal depth is bent and a Jacobian's row is not: depths of 5 cm placed a vehicle
whose start was known to 1 km within 300 m of where it was not, and one known to 20 km 18 km off
with 0.1 km claimed.
"""

import math

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core import grid
from polar_nav_core.engine import run as engine_run
from polar_nav_core.error_model import X
from polar_nav_core.kernels.sins.wide_depth import level_row


@pytest.fixture(scope='module')
def world():
    return World(40.0)


@pytest.mark.parametrize('sigma', [300.0, 1000.0, 5000.0])
def test_depths_alone_move_no_vehicle_and_make_it_no_surer(world, sigma):
    params = world.params(configuration='default', initial_sigma_position=sigma)
    track = engine_run.run(params, inputs_of(world, [])).track
    moved = np.linalg.norm(track.r_e[-1] - world.r_e[-1])
    assert moved < 0.3 * sigma
    P = track.P[-1, X.dr_e, X.dr_e]
    assert math.sqrt(np.trace(P)) > 0.9 * math.sqrt(2.0) * sigma


def covariance(C_e_G, sigma):
    """Of a position known to ``sigma`` [m] on a slope of a hundredth, and to 1 m across it."""
    slope = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.01, 0.0, 1.0]])
    P = np.eye(24)
    P_G = slope @ np.diag([sigma**2, sigma**2, 1.0]) @ slope.T
    P[X.dr_e, X.dr_e] = C_e_G.T @ P_G @ C_e_G
    return P


@pytest.mark.parametrize(('sigma', 'turned'), [(100.0, False), (1000.0, True)])
def test_the_row_has_no_gain_for_the_horizontal_and_states_the_whole_variance(
    world, sigma, turned
):
    C_e_G = np.ascontiguousarray(grid.ecef_to_grid(world.r_e[0]))
    P, H, R = covariance(C_e_G, sigma), np.zeros((3, 24)), np.zeros((3, 3))
    H[0, X.dr_e], R[0, 0] = C_e_G[2], 0.05**2
    whole = H[0] @ P @ H[0] + R[0, 0]
    level_row(P, H, R, C_e_G)
    assert (R[0, 0] > 0.05**2) == turned
    gain_G = C_e_G @ (P @ H[0])[X.dr_e]
    assert (np.abs(gain_G[:2]).max() < 1e-6) == turned
    assert H[0] @ P @ H[0] + R[0, 0] == pytest.approx(whole, rel=1e-9)
