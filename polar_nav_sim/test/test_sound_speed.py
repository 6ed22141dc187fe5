"""Sound speed: the profile against TEOS-10, its harmonic mean against other integrations."""

import csv
import itertools

import gsw
import numpy as np
import pytest
from scipy.integrate import quad

from polar_nav_sim.mission import load_mission
from polar_nav_sim.poses import TrajectoryPoses
from polar_nav_sim.resources import DATA
from polar_nav_sim.sound_speed import SoundSpeed, WaterSpec
from polar_nav_sim.travel import arrival_ns

CAST = 'arctic_ssp/sizrs_2016_october6_drop6.csv'
WATER = SoundSpeed.from_spec(WaterSpec(sound_speed_profile=CAST))


def column(name):
    with (DATA / CAST).open(newline='') as f:
        return np.array([float(row[name]) for row in csv.DictReader(f)])


def test_the_cast_is_teos_10():
    """The stored speeds from temperature and salinity, by gsw, at 76 N 150 W in the Beaufort Sea.

    The file has three decimals and not the place; a degree of latitude is 0.6 mm/s: 2 mm/s.
    """
    depth = column('depth_m')
    pressure = gsw.p_from_z(-depth, 76.0)
    absolute = gsw.SA_from_SP(column('salinity_psu'), pressure, -150.0, 76.0)
    conservative = gsw.CT_from_t(absolute, column('temperature_c'), pressure)
    speed = gsw.sound_speed(absolute, conservative, pressure)
    assert np.abs(speed - column('sound_speed_mps')).max() < 2e-3
    assert [WATER.at(d) for d in depth] == column('sound_speed_mps').tolist()


@pytest.mark.parametrize(
    ('a', 'b'), [(1.0, 999.0), (60.0, 100.0), (20.3, 20.9), (150.5, 700.25), (0.0, 1200.0)]
)
def test_mean_is_the_slant_travel_time(a, b):
    """Time along a straight slant ray, integrated over its length piece by piece, by QUADPACK."""
    across = 600.0
    length = np.hypot(across, b - a)
    inner = [z for z in column('depth_m') if a < z < b]
    ends = [0.0, *((np.array(inner) - a) / (b - a) * length), length]
    travel_s = sum(
        quad(lambda s: 1.0 / WATER.at(a + (b - a) * s / length), p, q, epsabs=1e-16)[0]
        for p, q in itertools.pairwise(ends)
    )
    assert length / WATER.mean(a, b) == pytest.approx(travel_s, rel=1e-12)
    assert WATER.mean(b, a) == WATER.mean(a, b)


def test_mean_over_teos_10_itself():
    """From 60 to 100 m against gsw on a grid of 1 cm: interpolation costs under 3 mm/s."""
    depth = np.arange(60.005, 100.0, 0.01)
    t, s = (
        np.interp(depth, column('depth_m'), column(c)) for c in ('temperature_c', 'salinity_psu')
    )
    pressure = gsw.p_from_z(-depth, 76.0)
    absolute = gsw.SA_from_SP(s, pressure, -150.0, 76.0)
    speed = gsw.sound_speed(absolute, gsw.CT_from_t(absolute, t, pressure), pressure)
    assert WATER.mean(60.0, 100.0) == pytest.approx(1.0 / np.mean(1.0 / speed), abs=3e-3)


@pytest.mark.parametrize('water', [WATER, SoundSpeed.from_spec(WaterSpec(sound_speed=1463.0))])
def test_moving_ends_use_it(water):
    """Arrival at a moving vehicle: the travelled distance is the mean speed times the time."""
    mission = load_mission('over_pole')
    leader, follower = (TrajectoryPoses(mission.truth(v)) for v in mission.vehicles)
    arm = np.zeros(3)
    t0 = mission.start_ns + 100 * 10**9
    from_e, from_depth = leader.pose(t0).point(arm)
    t1 = arrival_ns(water, t0, from_e, from_depth, follower, arm)
    to_e, to_depth = follower.pose(t1).point(arm)
    speed = np.linalg.norm(to_e - from_e) / ((t1 - t0) * 1e-9)
    assert speed == pytest.approx(water.mean(from_depth, to_depth), abs=3e-6)
    if water is not WATER:
        assert speed == pytest.approx(1463.0, abs=3e-6)
