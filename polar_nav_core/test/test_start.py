"""The start: what it waits for, in which situations it aligns, and how good its state is."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from start_world import (
    FOG,
    MEMS,
    YEAR,
    Sensors,
    Vehicle,
    declination,
    errors,
    events,
    params_of,
    with_heading,
)

from polar_nav_core import magnetic
from polar_nav_core.engine.events import DepthSample, DvlPing, Fix, HeadingSample, ImuSample
from polar_nav_core.engine.start.gyrocompass import gyrocompass, sigma_of, too_weak
from polar_nav_core.engine.start.level import Tilt
from polar_nav_core.engine.start.machine import Start
from polar_nav_core.engine.start.model import MOST_HEADING, SAME_AGAIN, Phase, Stated

pytestmark = pytest.mark.slow

REST, WAY = Vehicle(), Vehicle(speed=1.2, waves=0.03)
GNSS = Sensors(fix_s=1.0)
AHRS = replace(GNSS, heading_sigma_deg=2.0)
DVL = Sensors(fix_s=2.0, dvl=True)
PLACE = Stated(latitude=math.radians(70.0), longitude=math.radians(20.0))


def run(vehicle, sensors, params, stated=None, *, seed=0, seconds=15.0, change=None):
    """State that a start finds, or None, and the start."""
    params = with_heading(params, sensors)
    start = Start(params, Stated() if stated is None else stated, sensors.inputs)
    for event in events(vehicle, sensors, params, seed, seconds):
        changed = event if change is None else change(event)
        found = None if changed is None else start.take(changed)
        if found is not None:
            return found, start
    return None, start


@pytest.mark.parametrize(
    ('vehicle', 'sensors', 'noise', 'stated', 'method'),
    [
        (REST, AHRS, MEMS, None, 'measured by ahrs (true north)'),
        (WAY, replace(AHRS, dvl=True), MEMS, None, 'measured by ahrs'),
        (REST, replace(AHRS, heading_reference='grid'), MEMS, None, '(grid north)'),
        (REST, GNSS, FOG, None, 'by gyrocompassing'),
        (REST, GNSS, MEMS, Stated(heading=math.radians(40.0)), 'as stated'),
        (REST, replace(AHRS, fix_s=0.0), MEMS, PLACE, 'measured by ahrs'),
        (REST, Sensors(), FOG, PLACE, 'by gyrocompassing'),
    ],
)
def test_situations_that_align(vehicle, sensors, noise, stated, method):
    found, start = run(vehicle, sensors, params_of(noise), stated)
    assert found is not None, start.progress
    assert start.progress.phase is Phase.DONE
    assert method in found.how['heading']
    again = SAME_AGAIN if 'measured' in found.how['heading'] else 1.0  # it is measured on
    assert found.state.sigma_heading <= again * MOST_HEADING
    for part, (error, sigma) in errors(vehicle, found).items():
        assert abs(error) < 4.0 * sigma, part


@pytest.mark.parametrize(
    ('vehicle', 'sensors', 'noise', 'stated', 'says'),
    [
        (REST, Sensors(heading_sigma_deg=2.0), MEMS, None, 'a place (no source of fixes'),
        (REST, GNSS, MEMS, None, 'a gyrocompass of these gyros (62 deg/h) is good to 1.8e+02 deg'),
        (REST, GNSS, MEMS, None, 'no source gives one'),
        (REST, GNSS, MEMS, None, 'state initial_grid_heading_deg or heading_deg'),
        (WAY, GNSS, FOG, None, 'without a DVL the course of two fixes is no heading'),
        (REST, DVL, MEMS, None, 'two fixes 33 m apart under way would give it'),
        (REST, replace(AHRS, heading_sigma_deg=6.0), MEMS, None, 'good to 6 deg, the limit is 5'),
        (REST, replace(AHRS, fix_s=9.0), MEMS, None, 'a second fix that agrees with the first'),
        (replace(REST, latitude_deg=88.5), GNSS, FOG, None, 'gyros of 0.034 deg/h would do here'),
    ],
)
def test_situations_that_wait_name_what_for(vehicle, sensors, noise, stated, says):
    found, start = run(vehicle, sensors, params_of(noise), stated)
    assert found is None
    assert start.progress.phase is Phase.WAITING
    assert says in start.progress.sentence


def test_it_waits_for_a_depth_that_there_is_a_source_of():
    no_depth = lambda e: None if isinstance(e, DepthSample) else e  # noqa: E731
    found, start = run(REST, replace(AHRS, depth=True), params_of(MEMS), change=no_depth)
    assert found is None
    assert start.progress.sentence == 'waiting for: depth'
    found, _ = run(replace(REST, depth=30.0), replace(AHRS, depth=True), params_of(MEMS))
    assert found.state.height == pytest.approx(-30.0, abs=0.5)
    assert found.how['height'] == 'by depth'


def test_a_magnetic_heading_is_without_its_declination_once_a_place_is_known():
    pytest.importorskip('pygeomag', reason='the field model is not installed')
    compass = replace(AHRS, heading_reference='magnetic')
    found, _ = run(REST, compass, params_of(MEMS, heading_declination_deg=0.0))
    assert 'measured by ahrs (magnetic north)' in found.how['heading']
    error, sigma = errors(REST, found)['heading']
    assert abs(error) < sigma / SAME_AGAIN
    lat, lon = math.radians(REST.latitude_deg), math.radians(REST.longitude_deg)
    horizontal = magnetic.field_near(lat, lon, 0.0, YEAR).horizontal
    known = math.hypot(0.26, 5417.0 / horizontal, math.degrees(300.0 / horizontal))
    assert sigma == pytest.approx(SAME_AGAIN * math.radians(math.hypot(2.0, known)), rel=0.01)
    assert abs(declination(lat, lon)) > sigma / SAME_AGAIN
    added = params_of(MEMS, heading_declination_deg=4.0)
    other, _ = run(REST, compass, added)
    turned = other.state.grid_heading - found.state.grid_heading
    assert turned == pytest.approx(math.radians(-4.0), abs=1e-9)


@pytest.mark.parametrize(
    ('place', 'changes', 'says'),
    [
        ((80.0, 120.0), {}, 'the horizontal magnetic field is 1788 nT here: too weak'),
        ((70.0, 20.0), {'magnetic_year': 1970.5}, 'no model is of the date, see magnetic_year'),
    ],
)
def test_a_magnetic_heading_that_means_nothing_starts_nothing(place, changes, says):
    pytest.importorskip('pygeomag', reason='the field model is not installed')
    vehicle = replace(REST, latitude_deg=place[0], longitude_deg=place[1])
    sensors = replace(AHRS, heading_reference='magnetic')
    start = Start(
        replace(with_heading(params_of(MEMS), sensors), **changes), Stated(), sensors.inputs
    )
    plain = replace(sensors, heading_reference='grid')
    assert all(start.take(e) is None for e in events(vehicle, plain, start._p, 0, 13.0))
    assert says in start.progress.sentence


def test_a_heading_from_a_direction_of_its_own_or_a_silent_one_is_named():
    for reference, says in (
        ('arbitrary', 'heading/data counts from a direction of its own'),
        ('true', 'its source heading/data (true north) is silent'),
    ):
        sensors = replace(AHRS, heading_reference=reference)
        none = lambda e: None if isinstance(e, HeadingSample) else e  # noqa: E731
        _, start = run(REST, sensors, params_of(MEMS), change=none)
        assert says in start.progress.sentence


def test_fixes_of_an_antenna_under_water_and_pings_through_the_water_do_not_start_it():
    deep = replace(REST, depth=30.0)
    sensors = replace(AHRS, depth=True)
    antenna = lambda e: replace(e, surface_depth=1.0) if isinstance(e, Fix) else e  # noqa: E731
    found, start = run(deep, sensors, params_of(MEMS), change=antenna)
    assert found is None
    assert 'waiting for: a fix' in start.progress.sentence
    water = lambda e: replace(e, water=True) if isinstance(e, DvlPing) else e  # noqa: E731
    found, _ = run(WAY, replace(AHRS, dvl=True), params_of(MEMS), change=water)
    assert 'by the DVL' not in found.how['velocity']


def test_before_the_window_is_full_it_aligns():
    _, start = run(REST, AHRS, params_of(MEMS), seconds=6.0)
    assert start.progress.phase is Phase.ALIGNING
    assert start.progress.sentence == 'aligning: levelling, 5 of 10 s'


def test_an_imu_upside_down_or_in_other_units_does_not_level():
    def in_g(event):
        return replace(event, f_b=event.f_b / 9.8) if isinstance(event, ImuSample) else event

    found, start = run(REST, AHRS, params_of(MEMS), change=in_g)
    assert found is None
    assert 'gravity (the mean specific force is 1 m/s^2)' in start.progress.sentence


def test_the_course_needs_way_and_withstands_a_wrong_fix():
    params = params_of(MEMS)
    found, start = run(WAY, DVL, params, seconds=16.0)
    assert found is None
    assert start.progress.phase is Phase.ALIGNING
    assert 'heading by the course' in start.progress.sentence
    found, _ = run(WAY, replace(DVL, outliers=(3,)), params, seconds=60.0)
    error, sigma = errors(WAY, found)['heading']
    assert abs(error) < 3.0 * sigma <= 3.0 * MOST_HEADING
    assert 'by the course over' in found.how['heading']


def test_a_heading_found_at_rest_is_carried_until_there_are_fixes():
    """No fixes at first; the vehicle then turns away, and its heading has aged."""
    params = params_of(FOG, align_heading='gyrocompass')
    late = replace(PLACE, latitude=None)
    start = Start(params, late, GNSS.inputs)
    fixes_from = 12.0
    states = []
    for event in events(REST, GNSS, params, 1, 30.0):
        if getattr(event, 'receive_ns', 10**18) < fixes_from * 1e9:
            continue
        found = start.take(event)
        if found is not None:
            states.append(found)
            break
    assert states
    assert states[0].stamp_ns > fixes_from * 1e9
    candidate = start._headings._best['gyrocompass']
    older = replace(candidate, stamp_ns=candidate.stamp_ns - 3600 * 10**9)
    aged = start._headings._aged(older, candidate.stamp_ns)
    expected = math.hypot(
        candidate.sigma, 3600 * params.gyro_bias_sigma, 60 * params.gyro_noise_density
    )
    assert aged == pytest.approx(expected)


def test_a_gap_of_the_imu_forgets_the_heading():
    params = params_of(FOG)
    start = Start(params, PLACE, frozenset())
    for event in events(REST, Sensors(), params, 0, 8.0):
        start.take(event)
    for event in events(REST, Sensors(), params, 0, 8.0):
        moved = replace(event, stamp_ns=event.stamp_ns + 20 * 10**9)
        assert start.take(moved) is None  # 8 s since the gap are no window
    assert start._frame.restarts == 1


def test_sigma_of_a_gyrocompass_is_that_of_the_issue():
    latitude, bias, speed = math.radians(60.0), 1e-6, 0.5
    omega, radius = 7.292115e-5, 6378137.0
    expected = math.hypot(bias / (omega * 0.5), speed / (omega * radius * 0.5))
    assert sigma_of(latitude, bias, speed) == pytest.approx(expected)
    assert sigma_of(math.radians(90.0), bias) > 1e6


def test_a_gyrocompass_that_turns_is_refused():
    latitude = math.radians(45.0)
    omega = 7.292115e-5 * np.array([math.cos(latitude), 0.0, math.sin(latitude)])
    kinds = {'bias': 2e-7, 'noise': 1e-8, 'tilt_sigma': 1e-5}
    good = gyrocompass(omega, Tilt(0.0, 0.0), latitude, **kinds)
    assert not good.refusal
    assert good.heading == pytest.approx(0.0, abs=1e-12)
    turning = gyrocompass(omega + 1e-4, Tilt(0.0, 0.0), latitude, **kinds)
    assert 'not at rest' in turning.refusal


def test_the_refusal_names_the_latitude_that_would_do():
    bias = 1e-6
    latitude = math.radians(85.0)
    said = too_weak(latitude, bias, sigma_of(latitude, bias))
    lower = math.degrees(math.acos(bias / (MOST_HEADING * 7.292115e-5)))
    assert f'below {lower:.1f} deg these would do' in said
    assert sigma_of(math.radians(lower), bias) == pytest.approx(MOST_HEADING, rel=1e-3)


@pytest.mark.parametrize(
    ('vehicle', 'sensors', 'noise', 'seconds'),
    [
        (replace(WAY, turn=0.02), replace(AHRS, dvl=True, fix_delay_s=1.0), MEMS, 15.0),
        (REST, GNSS, FOG, 15.0),
        (replace(REST, latitude_deg=80.0, longitude_deg=120.0), GNSS, FOG, 15.0),
        (WAY, replace(DVL, fix_delay_s=1.0), MEMS, 90.0),
    ],
)
def test_errors_are_as_stated_over_seeds(vehicle, sensors, noise, seconds):
    """RMS of error over sigma of 20 seeds: its own scatter is 0.16."""
    params = params_of(noise)
    ratios = {}
    for seed in range(20):
        found, start = run(vehicle, sensors, params, seed=seed, seconds=seconds)
        assert found is not None, start.progress
        for part, (error, sigma) in errors(vehicle, found).items():
            again = SAME_AGAIN if part == 'heading' and 'measured' in found.how[part] else 1.0
            ratios.setdefault(part, []).append(again * error / sigma)
    rms = {part: float(np.sqrt(np.mean(np.square(r)))) for part, r in ratios.items()}
    assert all(value < 1.5 for value in rms.values()), rms
    assert rms['heading'] > 0.4, rms
