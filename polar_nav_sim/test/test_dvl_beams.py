"""DVL with four beams: geometry, drop-outs, least squares, bottom lock beam by beam."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from polar_nav_core.attitude import matrix_from_euler
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors.dvl import DvlErrors, DvlSensor
from polar_nav_sim.sensors.janus import directions, slant_ranges, solve

EXACT = DvlErrors(
    scale=(0.0,) * 3,
    markov_sigma=0.0,
    noise_sigma=0.0,
    four_beams=True,
    beam_noise_sigma=0.0,
    beam_range_sigma_m=0.0,
)
V, OMEGA = np.array([3.0, 0.2, -0.1]), np.array([0.01, 0.02, 0.3])


def sensor_of(**changes):
    return DvlSensor(dataclasses.replace(EXACT, **changes), 0.2, stream(1, 'dvl'))


def pings(n, altitude=math.nan, C_b_G=None, **changes):
    sensor = sensor_of(**changes)
    return [sensor.measure(k, V, OMEGA, altitude, C_b_G) for k in range(n)]


@pytest.mark.parametrize('angle', [10.0, 22.5, 30.0, 45.0])
@pytest.mark.parametrize('azimuth', [0.0, 45.0, -100.0])
def test_beams_are_a_janus(angle, azimuth):
    b = directions(math.radians(angle), math.radians(azimuth))
    assert_allclose(np.linalg.norm(b, axis=1), 1.0, rtol=1e-15)
    assert_allclose(b[:, 2], -math.cos(math.radians(angle)), rtol=1e-14)
    assert_allclose(b[0] + b[2], b[1] + b[3], atol=1e-15)  # opposite beams
    assert_allclose(
        b[:2, :2] @ b[:2, :2].T, math.sin(math.radians(angle)) ** 2 * np.eye(2), atol=1e-15
    )
    assert math.degrees(math.atan2(b[0, 1], b[0, 0])) == pytest.approx(azimuth)
    # Four beams: sigma / (sqrt(2) sin) across, sigma / (2 cos) along the axis.
    _, cofactor = solve(b, b @ V, np.ones(4, dtype=bool))
    s, c = math.sin(math.radians(angle)), math.cos(math.radians(angle))
    assert_allclose(cofactor, np.diag([0.5 / s**2, 0.5 / s**2, 0.25 / c**2]), atol=1e-13)


@pytest.mark.parametrize('lost', [None, 0, 1, 2, 3])
def test_three_beams_give_the_same_velocity(lost):
    b = directions(math.radians(30.0), math.radians(45.0))
    good = np.arange(4) != lost
    along = np.where(good, b @ V, math.nan)
    v, cofactor = solve(b, along, good)
    assert_allclose(v, V, rtol=1e-13)
    assert (np.diag(cofactor) >= np.diag(solve(b, b @ V, np.ones(4, dtype=bool))[1]) - 1e-12).all()
    for two in itertools.combinations(range(4), 2):
        with pytest.raises(ValueError, match='2 beams give no velocity'):
            solve(b, b @ V, np.isin(np.arange(4), two))


def test_velocity_is_that_of_the_instrument_and_beams_agree():
    mounting = {'lever_b': (1.0, -0.5, 0.2), 'rpy_deg': (10.0, -20.0, 135.0)}
    (ping,) = pings(1, **mounting)
    C_m_b = matrix_from_euler(*np.radians([135.0, -20.0, 10.0]))
    assert_allclose(C_m_b @ ping.velocity_m, V + np.cross(OMEGA, [1.0, -0.5, 0.2]), rtol=1e-13)
    data = ping.beam_data
    assert_allclose(data.velocity, data.directions_m @ ping.velocity_m, rtol=1e-13)
    assert np.isnan(data.range_m).all()  # the floor is unknown here
    assert data.good.all()


def test_scale_bias_and_markov_act_as_without_beams():
    changes = {'scale': (1e-3, 2e-3, 0.0), 'bias': (0.0, 0.0, 0.1), 'markov_sigma': 0.01}
    beams = [p.velocity_m for p in pings(300, **changes)]
    plain = [p.velocity_m for p in pings(300, four_beams=False, **changes)]
    assert_allclose(beams, plain, atol=1e-13)


def test_noise_of_the_solution_is_its_covariance():
    """Chi-square of the error over 3000 pings, beams lost or not; false alarms 1e-3."""
    all_pings = pings(3000, beam_noise_sigma=0.01, beam_loss_probability=0.1)
    valid = [p for p in all_pings if p.valid]
    errors = [p.velocity_m - V for p in valid]
    total = sum(e @ np.linalg.solve(p.covariance_m, e) for e, p in zip(errors, valid, strict=True))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * len(valid))
    assert low < total < high
    assert {p.beams for p in valid} == {3, 4}


@pytest.mark.parametrize('rpy_deg', [(0.0, 0.0, 0.0), (15.0, -10.0, 70.0)])
def test_ranges_meet_a_flat_floor(rpy_deg):
    C_b_G = matrix_from_euler(*np.radians(rpy_deg[::-1]))
    (ping,) = pings(1, altitude=50.0, C_b_G=C_b_G, lever_b=(1.0, 0.0, -0.5))
    data = ping.beam_data
    ends = (
        C_b_G @ np.array([1.0, 0.0, -0.5]) + (data.range_m[:, None] * data.directions_m) @ C_b_G.T
    )
    assert_allclose(ends[:, 2], -50.0, rtol=1e-13)
    assert ping.altitude == pytest.approx(50.0 + (C_b_G @ [1.0, 0.0, -0.5])[2])
    noisy = pings(2000, altitude=50.0, C_b_G=C_b_G, beam_range_sigma_m=0.2)
    ranges = np.array([p.beam_data.range_m for p in noisy])
    # 8000 numbers: the sigma is known to 0.8 %; four of these.
    assert ranges.std(axis=0).mean() == pytest.approx(0.2, rel=0.032)


def test_beams_are_lost_one_by_one_and_the_ping_is_marked():
    """Binomial: 4000 pings with 30 % loss; shares within four sigma (false alarms 1e-4 each)."""
    loss, n = 0.3, 4000
    all_pings = pings(n, altitude=50.0, beam_loss_probability=loss)
    good = np.array([p.beam_data.good for p in all_pings])
    sigma = math.sqrt(loss * (1.0 - loss) / n)
    assert_allclose(good.mean(axis=0), 1.0 - loss, atol=4.0 * sigma)
    valid = 0.7**4 + 4 * 0.3 * 0.7**3
    share = np.mean([p.valid for p in all_pings])
    assert share == pytest.approx(valid, abs=4.0 * math.sqrt(valid * (1.0 - valid) / n))
    for p, g in zip(all_pings, good, strict=True):
        assert p.beams == g.sum()
        assert p.valid == (g.sum() >= 3) == bool(np.isfinite(p.velocity_m).all())
        assert_array_equal(np.isfinite(p.beam_data.velocity), g)
        assert_array_equal(np.isfinite(p.beam_data.range_m), g)
        assert np.isfinite(p.altitude) == g.any()


@pytest.mark.parametrize(
    ('altitude', 'beams'), [(math.nan, 4), (100.0, 4), (199.9, 4), (200.1, 0), (0.29, 0)]
)
def test_level_bottom_lock_is_that_of_the_altitude(altitude, beams):
    (ping,) = pings(1, altitude=altitude)
    assert ping.beams == beams
    assert ping.valid == (beams == 4)
    assert math.isnan(ping.altitude) == (beams == 0 or math.isnan(altitude))


def test_a_heeling_vehicle_loses_the_beams_that_look_away():
    heel = matrix_from_euler(0.0, 0.0, math.radians(15.0))  # starboard down
    (ping,) = pings(1, altitude=195.0, C_b_G=heel)
    # Beams at 45, 135 degrees look to port: they are lifted, their range is out of reach.
    assert_array_equal(ping.beam_data.good, [False, False, True, True])
    assert (ping.beams, ping.valid) == (2, False)
    (ping,) = pings(1, altitude=50.0, C_b_G=matrix_from_euler(0.0, 0.0, math.radians(80.0)))
    assert_array_equal(ping.beam_data.good, [False, False, True, True])
    flat = slant_ranges(directions(0.5, 0.0), matrix_from_euler(0.0, 0.0, np.pi), 10.0)
    assert np.isinf(flat).all()


def test_beams_change_no_other_draw_and_do_not_depend_on_pace():
    errors = DvlErrors(beam_loss_probability=0.2, four_beams=True)
    sensor = DvlSensor(errors, 0.2, stream(1, 'dvl'))
    whole = [sensor.measure(k, V, OMEGA, 30.0) for k in range(600)]
    sensor = DvlSensor(errors, 0.2, stream(1, 'dvl'))
    for k in (3, 299, 599):
        ping = sensor.measure(k, V, OMEGA, 30.0)
        assert_array_equal(ping.beam_data.velocity, whole[k].beam_data.velocity)
        assert_array_equal(ping.beam_data.range_m, whole[k].beam_data.range_m)
    plain = DvlSensor(dataclasses.replace(errors, four_beams=False), 0.2, stream(1, 'dvl'))
    beams = [plain.measure(k, V, OMEGA, 30.0).beams for k in range(600)]
    assert beams == [p.beams for p in whole]


def test_message_has_the_beams_and_marks_what_is_lost():
    pytest.importorskip('rclpy')
    from polar_nav_sim.convert import dvl_to_msg, twist_to_msg

    all_pings = pings(60, altitude=50.0, beam_loss_probability=0.3, beam_noise_sigma=0.01)
    assert {p.beams for p in all_pings} >= {2, 3, 4}
    for ping in all_pings:
        msg = dvl_to_msg(ping, 10**9, 'follower/dvl', 1440.0)
        good = ping.beam_data.good
        assert msg.num_good_beams == ping.beams
        assert msg.beam_velocities_valid == msg.beam_ranges_valid == good.any()
        for i, b in enumerate(msg.beam_unit_vec):
            assert [b.x, b.y, b.z] == ping.beam_data.directions_m[i].tolist()
        assert_array_equal(np.isfinite(msg.beam_velocity), good)
        assert_array_equal(np.isfinite(msg.range), good)
        assert_array_equal(msg.beam_velocity_covar, np.where(good, 1e-4, -1.0))
        assert_array_equal(msg.range_covar, np.where(good, 0.0, -1.0))
        assert_array_equal(msg.beam_quality, good.astype(float))
        if ping.valid:
            assert_array_equal(msg.velocity_covar, ping.covariance_m.ravel())
            twist = twist_to_msg(ping, 10**9, 'follower/dvl')
            assert twist.twist.covariance[1] == ping.covariance_m[0, 1]
        else:
            assert msg.velocity_covar[0] == -1.0
            assert math.isnan(msg.velocity.x)
