"""Earth: ECEF and geodetic, up, radii, gravity, at ordinary places and at the poles."""

import core_twin as twin
import numpy as np
import pytest
from core_places import PLACES, STATES, position
from hypothesis import given
from hypothesis import strategies as st

from polar_nav_core import earth
from polar_nav_core.kernels.frames import earth as kernels

LAT = st.floats(-90.0, 90.0)
LON = st.floats(-180.0, 180.0)


@given(LAT, LON, st.floats(-11_000.0, 400_000.0))
def test_geodetic_there_and_back(lat_deg, lon_deg, h):
    lat, lon = np.radians(lat_deg), np.radians(lon_deg)
    back = earth.geodetic_from_ecef(earth.ecef_from_geodetic(lat, lon, h))
    assert abs(back[0] - lat) < 1e-15 * 4
    assert abs(back[2] - h) < 1e-8
    # longitude is worth cos(lat) of an angle; at +-180 both signs are the same place
    turn = (back[1] - lon + np.pi) % (2.0 * np.pi) - np.pi
    assert abs(turn) * np.cos(lat) < 1e-15 * 4


@pytest.mark.parametrize('name', PLACES)
def test_up_and_height_equal_an_iteration_on_latitude(name):
    r_e = position(name)
    u_e, h = twin.geodetic(r_e)
    np.testing.assert_allclose(earth.up(r_e), u_e, rtol=0.0, atol=2e-15)
    assert float(earth.geodetic_from_ecef(r_e)[2]) == pytest.approx(PLACES[name][2], abs=5e-9)
    assert h == pytest.approx(PLACES[name][2], abs=5e-9)


@pytest.mark.parametrize('height', [-100e3, -11e3, 0.0, 10e3, 1000e3])
def test_up_is_exact_from_deep_below_to_high_above(height):
    lat = np.linspace(-np.pi / 2, np.pi / 2, 181)
    expected = np.stack([np.cos(lat) * np.cos(2.0), np.cos(lat) * np.sin(2.0), np.sin(lat)], -1)
    found = earth.up(earth.ecef_from_geodetic(lat, 2.0, height))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize(('z', 'lat'), [(6356652.314245179, 90.0), (-6356652.314245179, -90.0)])
def test_exact_pole(z, lat):
    found = earth.geodetic_from_ecef([0.0, 0.0, z])
    assert np.degrees(found[0]) == lat
    assert found[2] == pytest.approx(-100.0, abs=2e-9)
    np.testing.assert_array_equal(earth.up([0.0, 0.0, z]), [0.0, 0.0, np.sign(z)])


def test_longitude_survives_next_to_the_pole():
    r_e = earth.ecef_from_geodetic(np.radians(90.0 - 1e-9), np.radians(-137.0), 0.0)
    assert np.degrees(earth.geodetic_from_ecef(r_e)[1]) == pytest.approx(-137.0, abs=1e-6)


@pytest.mark.parametrize('name', STATES)
def test_reference_vectors(name):
    state = STATES[name]
    r_e = np.array(state['input']['R_e'])
    np.testing.assert_allclose(earth.up(r_e), state['expected']['u_e'], rtol=0.0, atol=1e-12)
    assert earth.geodetic_from_ecef(r_e)[2] == pytest.approx(state['expected']['h'], abs=1e-8)
    assert earth.gravity(r_e) == pytest.approx(state['expected']['gravity'], rel=1e-12)


def test_gravity_at_known_places():
    # WGS-84: 9.7803253359 on the equator, 9.8321849379 at the pole
    assert earth.gravity([earth.SEMI_MAJOR, 0.0, 0.0]) == pytest.approx(9.7803253359, abs=1e-10)
    assert earth.gravity([0.0, 0.0, earth.SEMI_MINOR]) == pytest.approx(9.8321849379, abs=1e-9)


@pytest.mark.parametrize('name', PLACES)
def test_gravity_slopes_are_its_derivatives(name):
    lat, _, h = PLACES[name]
    s = np.sin(np.radians(lat))
    by_h, by_s = kernels.gravity_slopes(s, float(h))
    d = 100.0
    numeric = (kernels.gravity(s, h + d) - kernels.gravity(s, h - d)) / (2 * d)
    assert by_h == pytest.approx(numeric, rel=1e-9)
    d = 1e-4
    numeric = (kernels.gravity(s + d, float(h)) - kernels.gravity(s - d, float(h))) / (2 * d)
    assert by_s == pytest.approx(numeric, abs=1e-9)


def test_radii_at_the_pole_are_equal():
    r_m, r_n = kernels.radii(1.0)
    assert r_m == pytest.approx(6399593.6258, abs=1e-3)
    assert r_n == pytest.approx(r_m, rel=1e-15)


def test_shapes_and_errors():
    many = np.stack([position(name) for name in PLACES])
    assert earth.up(many[None]).shape == (1, len(many), 3)
    assert earth.gravity(many).shape == (len(many),)
    assert np.ndim(earth.gravity(many[0])) == 0
    read_only = many[0].copy()
    read_only.flags.writeable = False
    assert earth.gravity(read_only) == earth.gravity(many)[0]
    with pytest.raises(ValueError, match=r'r_e must have shape'):
        earth.up([1.0, 2.0])
    with pytest.raises(ValueError, match='centre of the earth'):
        earth.up([0.0, 0.0, 0.5])
    with pytest.raises(ValueError, match='lat must be within'):
        earth.ecef_from_geodetic(1.6, 0.0, 0.0)


def test_a_filter_that_has_gone_astray_can_still_be_told():
    """Its position can be so large that a square is not finite; no warning, no error."""
    lat, lon, height = earth.geodetic_from_ecef([1e200, 1.0, 1.0])
    assert not abs(height) < 1e9
    assert not abs(lat) > np.pi
    assert not abs(lon) > np.pi


@pytest.mark.parametrize('lat', [-90.0, -80.0, 0.0, 47.0, 89.999, 90.0])
@pytest.mark.parametrize('lon', [-170.0, 0.0, 25.0])
def test_east_north_up_is_a_rotation_towards_growing_longitude_and_latitude(lat, lon):
    phi, lam = np.radians(lat), np.radians(lon)
    C_e_n = earth.ecef_to_enu(phi, lam)
    np.testing.assert_allclose(C_e_n @ C_e_n.T, np.eye(3), rtol=0.0, atol=1e-15)
    r_e = earth.ecef_from_geodetic(phi, lam, 0.0)
    np.testing.assert_allclose(C_e_n[2], earth.up(r_e), rtol=0.0, atol=2e-15)
    step = 1e-6 if lat < 90.0 else -1e-6  # there is no latitude beyond a pole
    northward = (earth.ecef_from_geodetic(phi + step, lam, 0.0) - r_e) * np.sign(step)
    np.testing.assert_allclose(
        C_e_n @ northward / np.linalg.norm(northward), [0.0, 1.0, 0.0], rtol=0.0, atol=1e-6
    )
    np.testing.assert_allclose(C_e_n[0], np.cross(C_e_n[1], C_e_n[2]), rtol=0.0, atol=1e-15)


def test_east_north_up_of_many_places_is_each_one_by_one():
    lat, lon = np.array([0.1, -1.2]), np.array([2.0, -0.5])
    together = earth.ecef_to_enu(lat, lon)
    assert together.shape == (2, 3, 3)
    for k in range(2):
        np.testing.assert_array_equal(together[k], earth.ecef_to_enu(lat[k], lon[k]))
