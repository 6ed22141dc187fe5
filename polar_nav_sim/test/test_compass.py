"""The simulated heading of an AHRS: exact without errors, worse in turns and in a weak field."""

import math

import numpy as np
import pytest

from polar_nav_core.earth import ecef_from_geodetic
from polar_nav_core.grid import convergence, ecef_to_grid
from polar_nav_sim.sensors.compass import CompassErrors, measured_headings

EXACT = CompassErrors(coloured_deg=0.0, white_deg=0.0, tilt_deg=0.0, noise_nt=0.0, turn_factor=0.0)
N = 400
STAMPS = 1_790_000_000_000_000_000 + 500_000_000 * np.arange(N)


def circle(errors, reference, lat_deg, lon_deg=120.0, speed=1.0, seed=1):
    """Errors of the heading [deg] and true headings on a circle of 100 s, level."""
    lat, lon = math.radians(lat_deg), math.radians(lon_deg)
    r_e = np.tile(np.asarray(ecef_from_geodetic(lat, lon, 0.0)), (N, 1))
    C_e_G = np.asarray(ecef_to_grid(r_e))
    h = 2.0 * np.pi * np.arange(N) / 200.0
    x, y = np.sin(h), np.cos(h)
    C_b_G = np.zeros((N, 3, 3))
    C_b_G[:, 0, 0], C_b_G[:, 1, 0] = x, y
    C_b_G[:, 0, 1], C_b_G[:, 1, 1] = -y, x
    C_b_G[:, 2, 2] = 1.0
    v_G = speed * C_b_G[:, :, 0]
    rng = np.random.default_rng(seed)
    found, up_b = measured_headings(errors, reference, STAMPS, r_e, C_e_G, C_b_G, v_G, rng)
    true = h + float(convergence(lat, lon)) if reference != 'grid' else h
    return np.degrees(np.angle(np.exp(1j * (found - true)))), up_b


@pytest.mark.parametrize('reference', ['true', 'grid'])
def test_without_errors_it_is_the_heading(reference):
    error, up_b = circle(EXACT, reference, 80.0)
    assert np.abs(error).max() < 1e-6
    assert np.abs(up_b - [0.0, 0.0, 1.0]).max() < 1e-12


def test_a_magnetic_one_is_off_by_the_published_declination():
    """WMM2025 at 80 S 120 W and 2027.5: 68.49 deg; here three quarters of a year before."""
    pytest.importorskip('pygeomag', reason='the field model is not installed')
    error, _ = circle(EXACT, 'magnetic', -80.0, 240.0)
    assert error.mean() == pytest.approx(-68.5, abs=0.3)
    assert np.ptp(error) < 1e-6


def test_iron_does_more_where_the_field_is_weak():
    """Hard iron has the period of the course; 300 nT are 1 deg at the South Pole, 14 at 80 N."""
    pytest.importorskip('pygeomag', reason='the field model is not installed')
    iron = CompassErrors(**{**vars(EXACT), 'hard_iron_nt': 300.0})
    sizes = [np.ptp(circle(iron, 'magnetic', lat)[0]) / 2.0 for lat in (-89.9, 80.0)]
    assert sizes[0] == pytest.approx(math.degrees(300.0 * 2**0.5 / 16_820.0), rel=0.05)
    assert sizes[1] > 10.0


def test_a_turn_tilts_the_vertical_and_by_the_dip_the_heading():
    """v x rate / g at 2 m/s in a circle of 100 s: 0.73 deg of tilt."""
    pytest.importorskip('pygeomag', reason='the field model is not installed')
    turning = CompassErrors(**{**vars(EXACT), 'turn_factor': 1.0})
    off, up_b = circle(turning, 'magnetic', -89.9, speed=2.0)
    level, _ = circle(EXACT, 'magnetic', -89.9, speed=2.0)
    tilt = math.degrees(2.0 * 2.0 * math.pi / 100.0 / 9.83)
    leaning = np.degrees(np.arccos(up_b[5:-5, 2]))
    np.testing.assert_allclose(leaning, tilt, rtol=0.01)
    dip = 51_590.0 / 16_820.0
    assert np.abs(off - level)[5:-5].max() == pytest.approx(dip * tilt, rel=0.1)
