"""Missions state the real floor: a DVL has bottom lock where its range reaches it, or by a key."""

import math

import numpy as np
import pytest

from polar_nav_sim.mission import load_mission
from polar_nav_sim.randomness import stream
from polar_nav_sim.resources import mission_names
from polar_nav_sim.sensors.dvl import DvlErrors, DvlSensor

LOCKED = {
    'demo': True,
    'racetrack': True,
    'lawnmower': True,
    'model_aided': True,
    'dive': True,
    'south_pole': True,
    'shelf': True,
    'near_pole': False,
    'over_pole': False,
    'antimeridian': False,
    'meridian_180': False,
    'station': False,
    'ahrs': True,
}


def valid_pings(mission, errors):
    vehicle = mission.followers[0]
    state = mission.with_duration(120.0).truth(vehicle).state
    sensor = DvlSensor(errors, 1.0, stream(1, 'dvl'))
    still = np.zeros(3)
    states = [state(mission.start_ns + second * 10**9) for second in range(0, 120, 10)]
    return [sensor.measure(k, still, still, float(s.altitude)).valid for k, s in enumerate(states)]


def test_every_mission_is_listed_and_states_a_floor():
    assert set(LOCKED) == set(mission_names())
    for name in LOCKED:
        assert load_mission(name).numbers.sea_floor_depth_m > 0.0


@pytest.mark.parametrize(('name', 'locked'), LOCKED.items())
def test_bottom_lock(name, locked):
    mission = load_mission(name)
    assert set(valid_pings(mission, DvlErrors())) == {locked}
    assumed = mission.with_overrides({'bottom_lock': 'assumed'})
    assert all(valid_pings(assumed, DvlErrors()))
    # What assumes it in water that is too deep loses it when taken at its word.
    if mission.numbers.bottom_lock == 'assumed':
        real = mission.with_overrides({'bottom_lock': 'range'})
        assert not any(valid_pings(real, DvlErrors()))


def test_the_instrument_of_the_shelf_has_lock_and_a_small_one_has_none():
    shelf = load_mission('shelf')
    own = shelf.instruments('follower')['dvl'].errors
    assert own.max_altitude_m == 200.0
    state = shelf.truth('follower').state(shelf.start_ns)
    assert float(state.altitude) == pytest.approx(70.0, abs=1e-5)
    still = np.zeros(3)
    sensor = DvlSensor(DvlErrors(max_altitude_m=50.0), 0.2, stream(1, 'dvl'))
    ping = sensor.measure(0, still, still, float(state.altitude))
    assert not ping.valid
    assert math.isnan(ping.altitude)
