"""The simulated heading of an AHRS: exact without errors, worse in turns and in a weak field."""

import math

import numpy as np
import pytest

from polar_nav_core.attitude import matrix_from_euler
from polar_nav_core.earth import ecef_from_geodetic
from polar_nav_core.grid import convergence, ecef_to_grid
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors.compass import CompassErrors, CompassSensor, measured_headings

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


def sensor(errors, reference='grid', seed=3, period_s=0.1):
    return CompassSensor(errors, reference, period_s, stream(seed, 'auv/compass'))


def sailed(errors, reference='grid', lat_deg=-80.0, samples=range(600), turn_s=200.0, speed=2.0):
    """Errors of the heading [deg] and readings of one that is asked sample by sample at 10 Hz."""
    lat, lon = math.radians(lat_deg), math.radians(240.0)
    r_e = np.asarray(ecef_from_geodetic(lat, lon, -20.0))
    found, off = [], []
    one = sensor(errors, reference)
    sigma = 0.0 if reference == 'grid' else float(convergence(lat, lon))
    for k in samples:
        h = 2.0 * math.pi * 0.1 * k / turn_s
        C = np.asarray(matrix_from_euler(0.5 * math.pi - h, 0.02, -0.05))
        v_G = speed * np.array([math.sin(h), math.cos(h), 0.0])
        found.append(one.measure(k, int(STAMPS[0]) + k * 100_000_000, r_e, C, v_G))
        off.append(found[-1].heading - h - sigma)
    return np.degrees(np.angle(np.exp(1j * np.array(off)))), found


def test_sample_by_sample_without_errors_it_is_the_attitude():
    off, found = sailed(EXACT)
    assert np.abs(off).max() < 1e-6
    C = np.asarray(matrix_from_euler(0.5 * math.pi, 0.02, -0.05))
    np.testing.assert_allclose(found[0].attitude(), C, atol=1e-12)


def test_sample_by_sample_its_errors_are_as_stated():
    """Coloured ones of 60 s, of 20 instruments; the vertical leans by v x rate / g in a turn."""
    errors = CompassErrors(coloured_deg=1.5, white_deg=0.3, tilt_deg=0.0, drift_deg=2.0)
    rng = [CompassSensor(errors, 'grid', 0.1, stream(k, 'auv/compass')) for k in range(200)]
    r_e = np.asarray(ecef_from_geodetic(1.4, 0.1, 0.0))
    zero = np.zeros(3)
    first, last = ([] for _ in range(2))
    for one in rng:
        first.append(one.measure(0, int(STAMPS[0]), r_e, np.eye(3), zero).heading)
        last.append(
            one.measure(250, int(STAMPS[0]) + 25_000_000_000, r_e, np.eye(3), zero).heading
        )
    off = np.degrees(np.array([first, last])) - 90.0
    assert off.std() == pytest.approx(errors.heading_sigma_deg, rel=0.15)
    assert np.corrcoef(off)[0, 1] > 0.6  # what lasts is most of it
    turning = CompassErrors(**{**vars(EXACT), 'turn_factor': 1.0})
    _, found = sailed(turning, speed=2.0)
    lean = np.degrees(np.arccos([r.attitude()[2, 2] for r in found[1:]]))
    level = np.degrees(np.arccos(sailed(EXACT)[1][0].attitude()[2, 2]))
    expected = math.degrees(2.0 * 2.0 * math.pi / 200.0 / 9.83)
    assert np.abs(lean - level).max() == pytest.approx(expected, rel=0.35)


def test_a_sample_is_the_same_at_any_pace():
    errors = CompassErrors(drift_deg=1.0)
    every, some = sailed(errors)[0], sailed(errors, samples=range(0, 600, 7))[0]
    np.testing.assert_array_equal(every[0], some[0])
    level = CompassErrors(drift_deg=1.0, turn_factor=0.0)
    every, some = sailed(level)[0], sailed(level, samples=range(0, 600, 7))[0]
    np.testing.assert_array_equal(every[::7], some)


def test_something_magnetic_nearby_turns_it_for_as_long():
    pytest.importorskip('pygeomag')
    errors = CompassErrors(
        **{**vars(EXACT), 'disturbance_nt': 3000.0, 'disturbance_first_s': 20.0,
           'disturbance_s': 10.0}
    )  # fmt: skip
    off, found = sailed(errors, 'magnetic')
    calm, _ = sailed(EXACT, 'magnetic')
    size = np.abs(off - calm)
    assert size[:200].max() < 1e-9
    assert size[200:300].max() > 2.0
    assert size[300:].max() < 1e-9
    strength = np.linalg.norm(found[0].field_b)
    assert 40_000.0 < strength < 60_000.0  # WMM at 80 S 120 W: 55 uT
