"""DVL and depth: Jacobians by central differences, forward models, heading observability."""

import gsw
import numpy as np
import pytest
from core_jacobian import LEVER, navigation_at, numeric_jacobian
from core_places import position
from reference import depth as depth_rows
from reference import dvl
from reference import usbl as usbl_rows
from reference.error_model import Navigation

from polar_nav_core import attitude, depth, earth, grid
from polar_nav_core.error_model import X
from polar_nav_core.kernels.sins import rows as filter_rows

PLACES = ['exact north pole', 'exact south pole', '89.99N at 180E', '80N 120E', '75S 60W']
OMEGA = np.array([0.05, -0.08, 0.1])
OFFSET = np.array([0.03, -0.02, 0.01])
MOUNTING = dvl.Mounting(attitude.exp([0.02, -0.3, 0.7]), np.array([0.4, -0.2, -0.5]))


@pytest.mark.parametrize('name', PLACES)
def test_dvl_jacobian(name):
    navigation = navigation_at(name)
    omega_ie_G = grid.earth_rate(navigation.r_e)
    v_m = dvl.measured(navigation, OMEGA, omega_ie_G, MOUNTING) + OFFSET
    H = dvl.jacobian(navigation, v_m, OMEGA, omega_ie_G, MOUNTING)
    numeric = numeric_jacobian(
        lambda n: dvl.innovation(n, v_m, OMEGA, omega_ie_G, MOUNTING), navigation
    )
    # The scale error multiplies what the instrument should show, not what it showed.
    numeric[:, X.dvl_scale_m] = numeric_jacobian(
        lambda n: dvl.innovation(n, v_m - OFFSET, OMEGA, omega_ie_G, MOUNTING), navigation
    )[:, X.dvl_scale_m]
    np.testing.assert_allclose(H, numeric, rtol=0.0, atol=2e-7)


def test_noise_of_a_ping_does_not_stand_in_the_scale_block():
    """E[H' z] of the scale must vanish, or its estimate creeps ping by ping."""
    navigation = navigation_at('80N 120E')
    omega_ie_G = grid.earth_rate(navigation.r_e)
    v_m = dvl.measured(navigation, OMEGA, omega_ie_G, MOUNTING)
    noise = np.random.default_rng(5).normal(size=(4000, 3))
    pull = np.zeros(3)
    for n in noise:
        H = dvl.jacobian(navigation, v_m + n, OMEGA, omega_ie_G, MOUNTING)[:, X.dvl_scale_m]
        pull += H.T @ dvl.innovation(navigation, v_m + n, OMEGA, omega_ie_G, MOUNTING)
    # At the measured velocity every axis would have 1; five sigma of the mean are allowed.
    limit = 5.0 * np.abs(v_m) / np.sqrt(len(noise))
    assert (limit < 0.5).all()
    assert (np.abs(pull / len(noise)) < limit).all()


def test_dvl_innovation_of_a_perfect_measurement_is_zero():
    navigation = navigation_at('80N 120E')
    omega_ie_G = grid.earth_rate(navigation.r_e)
    v_m = dvl.measured(navigation, OMEGA, omega_ie_G, MOUNTING)
    z = dvl.innovation(navigation, v_m, OMEGA, omega_ie_G, MOUNTING)
    np.testing.assert_allclose(z, 0.0, atol=1e-15)
    x = 1e-3 * np.sin(np.arange(24))
    H = dvl.jacobian(navigation, v_m, OMEGA, omega_ie_G, MOUNTING)
    wrong = navigation.corrected(-x)
    found = dvl.innovation(wrong, v_m, OMEGA, omega_ie_G, MOUNTING)
    np.testing.assert_allclose(found, H @ x, rtol=0.0, atol=2e-5)


def test_dvl_sees_the_lever_arm_and_not_the_turn_of_the_earth():
    """At rest on the turning earth a DVL shows zero, turning on the spot omega x lever."""
    C = attitude.matrix_from_euler(0.3, 0.0, 0.0)
    navigation = Navigation(C, np.zeros(3), position('80N 120E'))
    omega_ie_G = grid.earth_rate(navigation.r_e)
    mounting = dvl.Mounting(lever_b=np.array([2.0, 0.0, 0.0]))
    at_rest = dvl.measured(navigation, C.T @ omega_ie_G, omega_ie_G, mounting)
    np.testing.assert_allclose(at_rest, 0.0, atol=1e-18)
    turning = dvl.measured(
        navigation, C.T @ omega_ie_G + np.array([0, 0, 0.1]), omega_ie_G, mounting
    )
    np.testing.assert_allclose(turning, [0.0, 0.2, 0.0], atol=1e-15)


def test_dvl_makes_heading_observable():
    """The block -[V x] on phi: a heading error shows across the track, times the speed."""
    navigation = Navigation(np.eye(3), np.array([3.0, 0.0, 0.0]), position('80N 120E'))
    H = dvl.jacobian(navigation, [3.0, 0.0, 0.0], np.zeros(3), np.zeros(3), dvl.Mounting())
    np.testing.assert_array_equal(H[:, X.phi_G], -attitude.skew([3.0, 0.0, 0.0]))
    heading = np.zeros(24)
    heading[X.phi_G.start + 2] = 1e-3
    np.testing.assert_allclose(H @ heading, [0.0, 3e-3, 0.0], atol=1e-18)


def test_dvl_covariance_turns_with_the_vehicle():
    navigation = navigation_at('80N 120E')
    R_m = np.diag([1e-4, 4e-4, 9e-4])
    R_G = dvl.covariance(navigation, R_m, MOUNTING)
    rng = np.random.default_rng(5)
    omega_ie_G = grid.earth_rate(navigation.r_e)
    v_m = dvl.measured(navigation, OMEGA, omega_ie_G, MOUNTING)
    noise = rng.multivariate_normal(np.zeros(3), R_m, size=4000)
    z = [dvl.innovation(navigation, v_m + n, OMEGA, omega_ie_G, MOUNTING) for n in noise]
    np.testing.assert_allclose(np.cov(np.transpose(z)), R_G, rtol=0.0, atol=6e-5)


@pytest.mark.parametrize('name', PLACES)
def test_depth_jacobian(name):
    navigation = navigation_at(name)
    H = depth_rows.jacobian(navigation, LEVER)
    numeric = numeric_jacobian(lambda n: depth_rows.innovation(n, 99.0, 0.5, LEVER), navigation)
    np.testing.assert_allclose(H, numeric, rtol=0.0, atol=1e-6)


def test_depth_innovation():
    navigation = Navigation(np.eye(3), np.zeros(3), position('80N 120E'))
    # base_link at -100 m, the sensor 0.6 m above it: 99.9 m below a surface at +0.5 m
    for shown, expected in ((99.9, 0.0), (100.9, 1.0)):
        z = depth_rows.innovation(navigation, shown, 0.5, LEVER)
        np.testing.assert_allclose(z, expected, atol=1e-8)


@pytest.mark.parametrize('lat_deg', [90.0, -90.0, 80.0, 0.0])
def test_pressure_to_depth_and_back(lat_deg):
    lat = np.radians(lat_deg)
    depths = np.array([0.0, 1.0, 100.0, 4000.0])
    pressure = depth.pressure_from_depth(depths, lat, 100_000.0)
    np.testing.assert_allclose(
        depth.depth_from_pressure(pressure, lat, 100_000.0), depths, atol=1e-6
    )
    assert pressure[0] == pytest.approx(100_000.0, abs=1e-6)
    assert pressure[2] == pytest.approx(float(gsw.p_from_z(-100.0, lat_deg)) * 1e4 + 1e5)
    # 1 kPa more air is 10 cm of water
    shift = depth.depth_from_pressure(pressure[2], lat, 101_000.0) - 100.0
    assert shift == pytest.approx(-0.099, abs=2e-3)


@pytest.mark.parametrize('name', PLACES)
def test_compiled_rows_equal_these_forms(name):
    """kernels.sins.rows is what the engine runs."""
    navigation = navigation_at(name)
    C_e_G = grid.ecef_to_grid(navigation.r_e)
    omega_ie_G = grid.earth_rate(navigation.r_e)
    H, R, z = np.zeros((3, 24)), np.zeros((3, 3)), np.zeros(3)
    v_m = dvl.measured(navigation, OMEGA, omega_ie_G, MOUNTING) + OFFSET
    R_m = np.diag([1e-4, 4e-4, 9e-4])
    filter_rows.dvl_rows(
        H, R, z, np.zeros((3, 3)),
        navigation.C_b_G, navigation.v_G, OMEGA, omega_ie_G,
        navigation.b_gyro_b, navigation.dvl_scale_m, navigation.dvl_markov_m,
        v_m, R_m, MOUNTING.C_m_b, MOUNTING.lever_b,
    )  # fmt: skip
    expected = dvl.jacobian(navigation, v_m, OMEGA, omega_ie_G, MOUNTING)
    # the kernel leaves the earth's turn of the lever arm out of H: 7e-5 rad/s times metres
    np.testing.assert_allclose(H, expected, rtol=0.0, atol=1e-4)
    np.testing.assert_allclose(
        z, dvl.innovation(navigation, v_m, OMEGA, omega_ie_G, MOUNTING), rtol=0.0, atol=1e-14
    )
    # R without the factor 1 / (1 + scale): a few per cent
    np.testing.assert_allclose(R, dvl.covariance(navigation, R_m, MOUNTING), rtol=0.0, atol=5e-5)

    lever_G = navigation.C_b_G @ LEVER
    height = float(earth.geodetic_from_ecef(navigation.r_e)[2])
    filter_rows.depth_rows(H, R, z, C_e_G, navigation.C_b_G, height, 0.5 - 99.0, 0.01, LEVER)
    np.testing.assert_allclose(H[:1], depth_rows.jacobian(navigation, LEVER), rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(
        z[:1], depth_rows.innovation(navigation, 99.0, 0.5, LEVER), atol=1e-9
    )

    fix = navigation.r_e + np.array([3.0, -2.0, 1.0])
    C_a_e = attitude.exp([0.3, -1.0, 2.0])
    filter_rows.fix_rows(
        H, R, z, C_e_G, lever_G, navigation.r_e + C_e_G.T @ lever_G, fix, np.eye(3),
        C_e_G @ C_a_e, navigation.usbl_bias_a,
    )  # fmt: skip
    expected = usbl_rows.jacobian(navigation, LEVER, C_a_e)
    np.testing.assert_allclose(C_e_G.T @ H, expected, rtol=0.0, atol=1e-14)
    found = C_e_G.T @ z
    np.testing.assert_allclose(
        found, usbl_rows.innovation(navigation, fix, LEVER, C_a_e), rtol=0.0, atol=1e-8
    )
