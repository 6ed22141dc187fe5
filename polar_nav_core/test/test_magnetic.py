"""Magnetic field: published test values of WMM2025, and the field around a place."""

import math

import numpy as np
import pytest

from polar_nav_core import earth, magnetic

pytest.importorskip('pygeomag', reason='the field model is not installed')

PUBLISHED = (
    (2025.0, 0.0, 80.0, 0.0, 1.28),
    (2025.0, 0.0, 0.0, 120.0, -0.16),
    (2025.0, 0.0, -80.0, 240.0, 68.78),
    (2025.0, 100.0, 80.0, 0.0, 0.85),
    (2025.0, 100.0, -80.0, 240.0, 68.21),
    (2027.5, 0.0, 80.0, 0.0, 2.59),
    (2027.5, 0.0, 0.0, 120.0, -0.24),
    (2027.5, 0.0, -80.0, 240.0, 68.49),
    (2027.5, 100.0, 80.0, 0.0, 2.16),
    (2025.0, 28.0, 89.0, -121.0, -99.77),
    (2025.0, 48.0, 80.0, -96.0, -29.91),
)
"""Year, height [km], latitude, longitude, declination [deg]: test values of NOAA and BGS."""


def axes(lat, lon):
    s, c, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    return np.array([-sl, cl, 0.0]), np.array([-s * cl, -s * sl, c])


@pytest.mark.parametrize(('year', 'height_km', 'lat', 'lon', 'declination'), PUBLISHED)
def test_declinations_are_the_published_ones(year, height_km, lat, lon, declination):
    lat, lon = math.radians(lat), math.radians(lon)
    found = magnetic.field_near(lat, lon, height_km * 1e3, year)
    east, north = axes(lat, lon)
    angle = math.degrees(math.atan2(east @ found.field_e, north @ found.field_e))
    assert angle == pytest.approx(declination, abs=0.006)


@pytest.mark.parametrize(
    ('lat', 'lon', 'horizontal'),
    [(80.0, 120.0, 1788.0), (86.0, 120.0, 668.0), (75.0, -150.0, 6497.0)],
)
def test_the_horizontal_field_is_weak_where_the_magnetic_pole_is(lat, lon, horizontal):
    found = magnetic.field_near(math.radians(lat), math.radians(lon), 0.0, 2026.9)
    assert found.horizontal == pytest.approx(horizontal, abs=1.5)
    assert found.vertical > 50_000.0


@pytest.mark.parametrize('lon', [0.0, 90.0, -120.0])
def test_nothing_is_singular_at_a_pole(lon):
    here = magnetic.field_near(-math.pi / 2, math.radians(lon), 0.0, 2026.9)
    at_0 = magnetic.field_near(-math.pi / 2, 0.0, 0.0, 2026.9)
    assert np.linalg.norm(here.field_e - at_0.field_e) < 5.0
    assert here.horizontal == pytest.approx(16_822.0, abs=10.0)


@pytest.mark.parametrize('lat', [60.0, 89.9, -89.99])
def test_the_gradient_leads_to_the_field_100_km_away(lat):
    """What is left out there is less than the field's own disturbances of 300 nT."""
    lat, lon = math.radians(lat), 0.3
    near = magnetic.field_near(lat, lon, 0.0, 2026.9)
    r_e = near.r_e + 70e3 * np.sum(axes(lat, lon), axis=0)
    away = magnetic.field_near(*(float(x) for x in earth.geodetic_from_ecef(r_e)), 2026.9)
    by_gradient = near.field_e + near.gradient_e @ (r_e - near.r_e)
    assert np.linalg.norm(away.field_e - by_gradient) < 100.0
    assert np.linalg.norm(away.field_e - near.field_e) > 300.0


def test_years_of_stamps_and_of_no_model():
    assert magnetic.year_of(1_782_864_000_000_000_000) == pytest.approx(2026.496, abs=1e-3)
    assert magnetic.field_near(0.0, 0.0, 0.0, 1970.5) is None
    assert magnetic.field_near(0.0, 0.0, 0.0, 2030.5) is None
    assert magnetic.field_near(1.0, 0.0, 0.0, 2024.9) is not None
