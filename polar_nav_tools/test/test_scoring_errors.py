"""Errors in grid axes, against formulas written out here."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from polar_nav_tools.report.example import estimate_with_errors, example_truth
from polar_nav_tools.scoring import align, errors
from polar_nav_tools.scoring.errors import distance_travelled, wrapped

PLACES = [(80.0, 120.0), (89.99, 180.0), (90.0, 0.0), (-75.0, -60.0), (-90.0, 0.0), (45.0, 10.0)]


def grid_axes(r_e):
    """East, north, up of the grid from the ellipsoid's normal (WGS-84), one position."""
    x, y, z = r_e
    e2 = 1.0 - (1.0 - 1.0 / 298.257223563) ** 2
    p = np.hypot(x, y)
    beta = np.arctan2(z, (1.0 - e2) * p)  # start, then a fixed point
    for _ in range(20):
        s = np.sin(beta)
        radius = 6378137.0 / np.sqrt(1.0 - e2 * s * s)
        beta = np.arctan2(z + e2 * radius * s, p)
    c, s = np.cos(beta), np.sin(beta)
    u = np.array([c * x / p, c * y / p, s]) if p > 0 else np.array([0.0, 0.0, np.sign(z)])
    north = np.cross(u, [0.0, 1.0, 0.0])
    north /= np.linalg.norm(north)
    return np.stack([np.cross(north, u), north, u])


def made(truth, dr=(0.0, 0.0, 0.0), dv=(0.0, 0.0, 0.0), phi=(0.0, 0.0, 0.0)):
    n = len(truth)
    one = np.ones((n, 3))
    return estimate_with_errors(
        truth,
        'c',
        dr_G=dr * one,
        dv_G=dv * one,
        phi_G=phi * one,
        sigma_r=one,
        sigma_v=one,
        sigma_phi=0.01 * one,
    )


def of(truth, estimate):
    return errors(align(truth, estimate))


@pytest.mark.parametrize(('lat', 'lon'), PLACES)
def test_position_error_is_in_grid_axes(lat, lon):
    truth = example_truth('f', lat, lon, 0.05)
    step_e = np.array([0.3, -2.0, 1.1])
    estimate = dataclasses.replace(made(truth), r_e=truth.r_e + step_e)
    expected = [grid_axes(r) @ step_e for r in truth.r_e]
    assert_allclose(of(truth, estimate).dr_G, expected, atol=1e-8)


def test_attitude_error_has_the_sign_of_the_filter():
    """Chat = exp(-[phi x]) C, with scipy's rotations."""
    truth = example_truth('f', 80.0, 120.0, 0.1)
    rng = np.random.default_rng(1)
    phi = rng.normal(0.0, 0.3, (len(truth), 3))
    Chat = Rotation.from_rotvec(-phi).as_matrix() @ truth.C_b_G
    estimate = dataclasses.replace(made(truth), C_b_G=Chat)
    assert_allclose(of(truth, estimate).phi_G, phi, atol=1e-12)


def test_tiny_and_huge_attitude_errors_keep_their_digits():
    truth = example_truth('f', 80.0, 120.0, 0.05)
    for size in (1e-10, 1e-6, 3.1):
        estimate = made(truth, phi=(0.0, 0.0, size))
        assert_allclose(of(truth, estimate).phi_G[:, 2], size, atol=1e-15 + 1e-9 * size)


def test_along_and_cross_track():
    truth = example_truth('f', 80.0, 120.0, 0.5)
    speed = np.hypot(truth.v_G[:, 0], truth.v_G[:, 1])[:, None]
    ahead = truth.v_G / speed
    left = np.stack([-ahead[:, 1], ahead[:, 0], 0 * ahead[:, 0]], axis=1)
    dr = -3.0 * ahead + 0.7 * left
    error = of(truth, made(truth, dr=dr))
    assert_allclose(error.along, -3.0, atol=1e-8)
    assert_allclose(error.cross, 0.7, atol=1e-8)
    assert_allclose(error.horizontal, np.hypot(3.0, 0.7), atol=1e-8)


def test_a_resting_vehicle_has_no_track():
    truth = example_truth('f', 80.0, 120.0, 0.05)
    still = dataclasses.replace(truth, v_G=0.01 * truth.v_G)
    error = of(still, made(still))
    assert np.isnan(error.along).all()
    assert np.isnan(error.cross).all()
    assert np.isfinite(error.dr_G).all()


def test_heading_error_is_clockwise_and_wraps():
    truth = example_truth('f', 80.0, 120.0, 0.05)
    level = np.broadcast_to(np.eye(3), truth.C_b_G.shape)

    # psi is counter-clockwise from grid east; grid north is psi = 90 degrees, heading 0.
    def turned(psi_deg):
        return Rotation.from_euler('Z', psi_deg, degrees=True).as_matrix() @ level

    truth = dataclasses.replace(truth, C_b_G=turned(90.2))  # heading 359.8
    estimate = dataclasses.replace(made(truth), C_b_G=turned(89.9))  # heading 0.1
    error = of(truth, estimate)
    assert_allclose(np.rad2deg(error.grid_heading), 0.3, atol=1e-9)
    # Chat = exp(-[phi x]) C turns by -phi, counter-clockwise positive: phi_z is clockwise.
    assert_allclose(error.phi_G[:, 2], error.grid_heading, atol=1e-12)


@pytest.mark.parametrize(('lat', 'lon'), [(80.0, 120.0), (89.9, -170.0), (-75.0, 30.0)])
def test_true_heading_error(lat, lon):
    """True heading from east, north and the body axis in the earth frame, without grid angles."""
    truth = example_truth('f', lat, lon, 0.05)
    expected = []
    for r_e, C_b_G in zip(truth.r_e, truth.C_b_G, strict=True):
        G = grid_axes(r_e)
        x_e = G.T @ C_b_G[:, 0]
        east = np.cross([0.0, 0.0, 1.0], G[2])
        east /= np.linalg.norm(east)
        north = np.cross(G[2], east)
        expected.append(np.arctan2(x_e @ east, x_e @ north))
    claimed = np.array(expected) + 0.004
    estimate = dataclasses.replace(made(truth), true_heading=np.mod(claimed, 2 * np.pi))
    assert_allclose(of(truth, estimate).true_heading, 0.004, atol=1e-9)


def test_sigmas_come_from_the_covariance_and_a_negative_variance_gives_none():
    truth = example_truth('f', 80.0, 120.0, 0.05)
    estimate = made(truth)
    P = estimate.P_position_G.copy()
    P[:, 0, 0], P[:, 1, 1], P[:, 2, 2] = 4.0, -1.0, np.nan
    sigma = of(truth, dataclasses.replace(estimate, P_position_G=P)).sigma_position_G
    assert_allclose(sigma[:, 0], 2.0)
    assert np.isnan(sigma[:, 1:]).all()


def test_diverged_estimates_stay_in_place_as_nan():
    truth = example_truth('f', 80.0, 120.0, 0.05)
    estimate = made(truth)
    r_e, C = estimate.r_e.copy(), estimate.C_b_G.copy()
    r_e[5:], C[5:] = np.nan, np.nan
    error = of(truth, dataclasses.replace(estimate, r_e=r_e, C_b_G=C))
    assert np.isfinite(error.dr_G[:5]).all()
    assert np.isnan(error.dr_G[5:]).all()
    assert np.isnan(error.phi_G[5:]).all()
    assert np.isnan(error.grid_heading[5:]).all()


def test_wrapped():
    assert_allclose(
        wrapped(np.deg2rad([0.0, 190.0, -190.0, 720.0])), np.deg2rad([0, -170, 170, 0])
    )
    assert wrapped(np.array([np.pi])) == np.pi
    assert wrapped(np.array([-np.pi])) == np.pi


def test_distance_travelled():
    r_e = np.array([[0.0, 0, 0], [3, 4, 0], [3, 4, 12]])
    assert distance_travelled(r_e) == 17.0
    assert distance_travelled(r_e[:1]) == 0.0
