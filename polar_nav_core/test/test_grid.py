"""Grid frame: axes, convergence, rates, true heading; the poles and +-180 degrees are ordinary."""

import csv
from pathlib import Path

import core_twin as twin
import numpy as np
import pyproj
import pytest
from core_places import PLACES, STATES, position
from hypothesis import given
from hypothesis import strategies as st

from polar_nav_core import earth, grid

V_G = np.array([2.0, -3.0, 0.1])


def true_axes(lat, lon):
    """C_e_g: rows true east, true north, up."""
    sL, cL, sl, cl = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    return np.array([[-sl, cl, 0.0], [-sL * cl, -sL * sl, cL], [cL * cl, cL * sl, sL]])


@pytest.mark.parametrize('name', PLACES)
def test_axes(name):
    r_e = position(name)
    C = grid.ecef_to_grid(r_e)
    np.testing.assert_allclose(C @ C.T, np.eye(3), rtol=0.0, atol=4e-16)
    assert np.linalg.det(C) == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_array_equal(C[2], earth.up(r_e))
    assert C[1, 1] == 0.0, 'grid north lies in a plane parallel to the Greenwich meridian'
    np.testing.assert_allclose(C, twin.axes(twin.geodetic(r_e)[0]), rtol=0.0, atol=1e-14)


def test_axes_at_the_poles():
    np.testing.assert_array_equal(
        grid.ecef_to_grid(position('exact north pole')), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    )
    np.testing.assert_array_equal(
        grid.ecef_to_grid(position('exact south pole')), [[0, 1, 0], [1, 0, 0], [0, 0, -1]]
    )


@given(st.floats(-90.0, 90.0), st.floats(-180.0, 180.0))
def test_convergence_turns_true_axes_into_grid_axes(lat_deg, lon_deg):
    lat, lon = np.radians(lat_deg), np.radians(lon_deg)
    if np.hypot(np.cos(lon), np.sin(lat) * np.sin(lon)) < 1e-3:
        return
    s = grid.convergence(lat, lon)
    C_g_G = np.array([[np.cos(s), -np.sin(s), 0], [np.sin(s), np.cos(s), 0], [0, 0, 1]])
    C_e_G = grid.ecef_to_grid(earth.ecef_from_geodetic(lat, lon, 50.0))
    np.testing.assert_allclose(C_g_G @ true_axes(lat, lon), C_e_G, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize('lon_deg', [0.3, 90.0, 179.9, 180.0, -180.0, -45.0])
@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_axes_are_continuous_across_the_poles(lon_deg, sign):
    lon = np.radians(lon_deg)
    near = earth.ecef_from_geodetic(sign * np.radians(90.0 - 1e-7), lon, 0.0)
    far = earth.ecef_from_geodetic(sign * np.radians(90.0 - 1e-7), lon + np.pi, 0.0)
    np.testing.assert_allclose(grid.ecef_to_grid(near), grid.ecef_to_grid(far), atol=4e-9)
    np.testing.assert_allclose(grid.earth_rate(near), grid.earth_rate(far), atol=4e-13)
    np.testing.assert_allclose(
        grid.transport_rate(near, V_G), grid.transport_rate(far, V_G), rtol=0.0, atol=1e-14
    )


@pytest.mark.parametrize('lat_deg', [60.0, 89.99, -75.0])
def test_nothing_happens_at_180_degrees(lat_deg):
    lat = np.radians(lat_deg)
    east = earth.ecef_from_geodetic(lat, np.radians(180.0 - 1e-9), 0.0)
    west = earth.ecef_from_geodetic(lat, np.radians(-180.0 + 1e-9), 0.0)
    np.testing.assert_allclose(grid.ecef_to_grid(east), grid.ecef_to_grid(west), atol=1e-10)
    np.testing.assert_allclose(
        grid.transport_rate(east, V_G), grid.transport_rate(west, V_G), rtol=0.0, atol=1e-15
    )


@pytest.mark.parametrize('lat_deg', [60.0, 75.0, 89.0, 89.9])
def test_convergence_is_that_of_a_spherical_transverse_mercator(lat_deg):
    projection = pyproj.Proj('+proj=tmerc +lon_0=0 +R=6371000')
    lon_deg = np.arange(-179.0, 180.0, 7.0)
    factors = projection.get_factors(lon_deg, np.full_like(lon_deg, lat_deg))
    found = np.degrees(grid.convergence(np.radians(lat_deg), np.radians(lon_deg)))
    np.testing.assert_allclose(found, factors.meridian_convergence, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize('lon', [0.0, 1.0, np.pi / 2, np.pi, -2.5])
def test_convergence_at_a_pole_is_the_limit_along_the_meridian(lon):
    assert grid.convergence(np.pi / 2, lon) == pytest.approx(lon, abs=1e-15)
    assert grid.convergence(-np.pi / 2, lon) == pytest.approx(-lon, abs=1e-15)


@pytest.mark.parametrize('name', STATES)
def test_reference_vectors(name):
    state, expected = STATES[name]['input'], STATES[name]['expected']
    r_e, v_G = np.array(state['R_e']), np.array(state['V_G'])
    np.testing.assert_allclose(grid.ecef_to_grid(r_e), expected['C_e_G'], rtol=0.0, atol=1e-12)
    for found, key in (
        (grid.earth_rate(r_e), 'w_ie_G'),
        (grid.transport_rate(r_e, v_G), 'w_eG_G'),
    ):
        error = np.linalg.norm(found - expected[key])
        assert error < 1e-9 * np.linalg.norm(expected[key]), key
    if expected['sigma_rad'] is not None:
        lat, lon, _ = earth.geodetic_from_ecef(r_e)
        assert grid.convergence(lat, lon) == pytest.approx(expected['sigma_rad'], abs=1e-12)


@pytest.mark.parametrize('name', PLACES)
def test_rates_equal_the_plain_twin(name):
    r_e = position(name)
    omega_ie_G, omega_eG_G = twin.rates(r_e, V_G)
    np.testing.assert_allclose(grid.earth_rate(r_e), omega_ie_G, rtol=0.0, atol=1e-18)
    scale = np.linalg.norm(omega_eG_G)
    np.testing.assert_allclose(
        grid.transport_rate(r_e, V_G), omega_eG_G, rtol=0.0, atol=1e-11 * scale
    )


@pytest.mark.parametrize('name', PLACES)
def test_transport_rate_is_the_turn_of_the_axes(name):
    r_e = position(name)
    C = grid.ecef_to_grid(r_e)
    v_e = C.T @ V_G
    dt = 3.0
    # C(t+dt) C(t-dt)^T = I - 2 dt [w x]: central difference of the axes themselves
    turn = grid.ecef_to_grid(r_e + v_e * dt) @ grid.ecef_to_grid(r_e - v_e * dt).T
    w = -np.array([turn[2, 1], turn[0, 2], turn[1, 0]]) / (2.0 * dt)
    found = grid.transport_rate(r_e, V_G)
    np.testing.assert_allclose(found, w, rtol=0.0, atol=1e-5 * np.linalg.norm(found))


@pytest.mark.parametrize('lon_deg', [90.0, -90.0])
@pytest.mark.parametrize(
    'function',
    [
        grid.ecef_to_grid,
        grid.earth_rate,
        lambda r_e: grid.transport_rate(r_e, V_G),
        lambda r_e: grid.true_heading(r_e, 0.0, 0.01, 1.0),
        lambda r_e: grid.convergence(*earth.geodetic_from_ecef(r_e)[:2]),
    ],
)
def test_the_only_singular_places_say_so(lon_deg, function):
    r_e = earth.ecef_from_geodetic(0.0, np.radians(lon_deg), 0.0)
    with pytest.raises(ValueError, match=r'equator at longitude \+-90'):
        function(r_e)
    function(earth.ecef_from_geodetic(np.radians(1e-4), np.radians(lon_deg), 0.0))


def test_true_heading():
    r_e = position('80N 120E')
    found = grid.true_heading(r_e, np.radians(30.0), 0.001, 10.0)
    distance = np.hypot(r_e[0], r_e[1])
    lat, lon, _ = earth.geodetic_from_ecef(r_e)
    assert found.convergence == pytest.approx(float(grid.convergence(lat, lon)), abs=1e-14)
    assert found.heading == pytest.approx(np.radians(30.0) + found.convergence, abs=1e-14)
    assert found.sigma == pytest.approx(np.hypot(0.001, 10.0 / distance), rel=1e-14)


@pytest.mark.parametrize('sign', [1.0, -1.0])
@pytest.mark.parametrize(('distance', 'known'), [(0.0, False), (5.0, False), (6.0, True)])
def test_true_heading_ends_where_nothing_is_known(sign, distance, known):
    # sigma_east = 10 m reaches pi/sqrt(3) at 5.51 m from the axis
    r_e = np.array([distance, 0.0, sign * 6356752.0])
    found = grid.true_heading(r_e, 1.0, 0.0, 10.0)
    assert np.isfinite(found.heading) == np.isfinite(found.convergence) == known
    assert found.sigma == pytest.approx(10.0 / 6.0 if known else np.pi / np.sqrt(3.0))


def test_true_heading_of_an_unknown_sigma_is_unknown():
    found = grid.true_heading(position('80N 120E'), 1.0, np.nan, 10.0)
    assert np.isnan(found.heading)
    assert np.isnan(found.sigma)


def test_along_a_real_buoy_track_grid_is_smooth_while_true_course_swings():
    """MOSAiC buoy 2020P237, hourly, from 89.9927 N across +-180 degrees (test/data/README.md)."""
    text = (Path(__file__).parent / 'data' / 'mosaic_2020P237_near_pole.csv').read_text()
    rows = list(csv.DictReader(text.splitlines()))
    lat, lon = (np.radians([float(row[key]) for row in rows]) for key in ('latitude', 'longitude'))
    assert np.degrees(lat.max()) > 89.99
    assert np.any(np.abs(np.diff(lon)) > np.pi), 'the track wraps'
    r_e = earth.ecef_from_geodetic(lat, lon, 0.0)
    C = grid.ecef_to_grid(r_e)
    d_e = np.diff(r_e, axis=0)
    moved = np.linalg.norm(d_e, axis=1)
    turned = np.linalg.norm(C[1:] - C[:-1], axis=(1, 2))
    assert np.all(turned <= 1.5 * moved / 6.35e6), 'grid axes turn no faster than up does'
    # A vehicle that follows the ice on a constant grid heading: its true heading turns with true
    # north.
    true_heading = np.unwrap(1.0 + grid.convergence(lat, lon)[:24])
    assert np.degrees(np.ptp(true_heading)) > 75.0
