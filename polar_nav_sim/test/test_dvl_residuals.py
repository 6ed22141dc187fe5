"""DVL: mounting drawn per run, sound speed, bad pings, latency: as stated, off by default."""

import dataclasses
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sim_chances import inside

from polar_nav_core.errors import ConfigError
from polar_nav_sim.params import DvlParams
from polar_nav_sim.randomness import stream
from polar_nav_sim.schedule import Late
from polar_nav_sim.sensors.dvl import DvlErrors, DvlSensor
from polar_nav_sim.sound_speed import SoundSpeed

EXACT = DvlErrors(scale=(0.0,) * 3, markov_sigma=0.0, noise_sigma=0.0, beam_noise_sigma=0.0)
V, OMEGA = np.array([2.0, 0.3, -0.1]), np.array([0.02, -0.05, 0.4])
WATER = SoundSpeed(np.array([0.0, 100.0]), np.array([1436.0, 1444.0]))
RUNS = 400


def first(seed=1, v=V, omega=OMEGA, depth=50.0, water=WATER, **changes):
    sensor = DvlSensor(dataclasses.replace(EXACT, **changes), 0.2, stream(seed, 'dvl'), water)
    return sensor.measure(0, v, omega, depth=depth).velocity_m


def test_misalignment_has_its_sigma_about_each_axis():
    v = np.array([3.0, 0.0, 0.0])
    x = np.array([first(k, v, misalignment_sigma_deg=0.3) for k in range(RUNS)])
    assert inside(x[:, 1:] / 3.0, math.radians(0.3))
    assert_allclose(np.linalg.norm(x, axis=1), 3.0, rtol=1e-14)
    about_x = np.array([first(k, V[[1, 0, 2]], misalignment_sigma_deg=0.3) for k in range(RUNS)])
    assert inside((about_x[:, 2:] - V[2]), math.radians(0.3) * np.hypot(2.0, 0.3))


def test_lever_error_has_its_sigma_and_shows_in_turns_only():
    x = np.array([first(k, lever_sigma_m=0.1) - V for k in range(RUNS)])
    assert inside(x[:, :1], 0.1 * np.hypot(OMEGA[1], OMEGA[2]))
    assert_array_equal(first(5, omega=np.zeros(3), lever_sigma_m=0.1), V)


@pytest.mark.parametrize('four_beams', [False, True])
def test_velocity_is_long_where_the_water_is_slower_than_assumed(four_beams):
    options = {'assumed_sound_speed': 1500.0, 'four_beams': four_beams}
    assert_allclose(first(**options), V * 1500.0 / 1440.0, rtol=1e-12)
    assert_allclose(first(depth=0.0, **options), V * 1500.0 / 1436.0, rtol=1e-12)
    phased = first(phased_array=True, **options)
    assert_allclose(phased, V * [1.0, 1.0, 1500.0 / 1440.0], rtol=1e-12)
    assert_allclose(first(four_beams=four_beams), V, rtol=1e-12)


def test_what_is_stated_of_the_sound_speed():
    def stated(water=WATER, **changes):
        sensor = DvlSensor(dataclasses.replace(EXACT, **changes), 0.2, stream(1, 'dvl'), water)
        return sensor.sound_speed(50.0)

    assert stated() == 1440.0
    assert stated(assumed_sound_speed=1500.0) == 1500.0
    assert math.isnan(stated(water=None))
    with pytest.raises(ValueError, match='sound speed'):
        stated(water=None, assumed_sound_speed=1500.0)
    # As before: the node states the constant of its parameter.
    assert SoundSpeed.from_spec(DvlParams(sound_speed=1463.0)).at(33.0) == 1463.0


def test_bad_pings_come_as_often_and_as_large_as_stated():
    errors = dataclasses.replace(EXACT, bad_ping_probability=0.05, bad_ping_sigma=0.7)
    sensor = DvlSensor(errors, 0.2, stream(4, 'dvl'))
    n = 6000
    off = np.array([sensor.measure(k, V, OMEGA).velocity_m for k in range(n)]) - V
    bad = np.any(off != 0.0, axis=1)
    assert abs(bad.sum() - 0.05 * n) < 4.0 * math.sqrt(0.05 * 0.95 * n)
    assert inside(off[bad], 0.7)


def test_an_option_changes_no_other_number():
    def pings(**changes):
        sensor = DvlSensor(DvlErrors(**changes), 0.2, stream(1, 'dvl'), WATER)
        return np.array([sensor.measure(k, V, OMEGA).velocity_m for k in range(300)])

    plain = pings()
    some = pings(bad_ping_probability=0.1)
    assert 0.8 < np.mean(np.all(plain == some, axis=1)) < 0.98
    with_lever = pings(lever_sigma_m=0.1) - plain
    assert_allclose(with_lever, np.tile(with_lever[0], (300, 1)), atol=1e-12)


def test_late_gives_out_in_order_once():
    late = Late(0.25)
    for k in range(3):
        late.put(100_000_000 * k, k)
    assert late.due(249_999_999) == []
    assert late.due(350_000_000) == [0, 1]
    assert late.due(10**9) == [2]
    assert late.due(10**9) == []


def test_out_of_range_is_named():
    with pytest.raises(ConfigError, match='misalignment_sigma_deg'):
        DvlErrors(misalignment_sigma_deg=-1.0)
