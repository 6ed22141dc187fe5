"""Missions: what files may say, and what is answered when they say something else."""

import math
from pathlib import Path

import numpy as np
import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_sim.mission import load_mission, mission_from
from polar_nav_sim.mission_overrides import overrides_from
from polar_nav_sim.resources import mission_names

STRAIGHT = {
    'path': {'kind': 'straight', 'latitude_deg': 80, 'longitude_deg': 120, 'speed_mps': 3},
    'vehicles': {'leader': {'role': 'leader'}, 'follower': {'depth_m': 50}},
}
FILE = Path('some.yaml')


def test_all_required_missions_are_there():
    required = {
        'antimeridian', 'demo', 'dive', 'lawnmower', 'near_pole', 'over_pole', 'racetrack',
        'south_pole',
    }  # fmt: skip
    assert required <= set(mission_names())


@pytest.mark.parametrize('name', [n for n in mission_names() if not load_mission(n).dynamic])
def test_missions_sail_at_their_speed_depth_and_distance(name):
    mission = load_mission(name)
    assert mission.description
    states = {}
    for vehicle in mission.vehicles:
        step_s = 0.5
        t_ns = mission.start_ns + (np.arange(0, mission.duration_s, step_s) * 1e9).astype(int)
        states[vehicle] = s = mission.truth(vehicle).state(t_ns)
        speed = np.linalg.norm(s.v_G, axis=1)
        assert np.abs(speed - mission.path.speed_mps).max() < 2e-5
        if name != 'dive':
            assert np.abs(s.depth - mission.formation[vehicle].depth_m).max() < 1e-6
    if not mission.led:
        return
    leader, follower = (states[v].r_e for v in mission.vehicles)
    distance = np.linalg.norm(leader - follower, axis=1)
    assert 400.0 < distance.min() <= distance.max() < 650.0
    assert np.ptp(distance) < 0.1


def test_demo_is_what_the_issue_says():
    mission = load_mission('demo')
    s = mission.truth('follower').state(mission.start_ns)
    assert mission.vehicles == ('leader', 'follower')
    assert mission.start_ns == 1772323200 * 10**9  # 2026-03-01T00:00:00Z
    assert mission.sample_count == 60001
    assert np.degrees([s.lat, s.lon]) == pytest.approx([80.0, 120.0], abs=1e-10)
    assert float(s.depth) == pytest.approx(100.0, abs=1e-6)
    # True north at 80 N 120 E: grid heading -120.4 deg.
    grid_heading = math.degrees(math.atan2(s.v_G[0], s.v_G[1]))
    assert grid_heading == pytest.approx(-120.4, abs=0.05)
    leader = mission.truth('leader').state(mission.start_ns)
    assert np.linalg.norm(leader.r_e - s.r_e) == pytest.approx(600.0, abs=2.0)


def test_near_pole_comes_within_a_kilometre_along_the_buoy_track():
    mission = load_mission('near_pole')
    t_ns = mission.start_ns + (np.arange(0, 600) * 10**9)
    s = mission.truth('follower').state(t_ns)
    from_axis = np.hypot(s.r_e[:, 0], s.r_e[:, 1])
    assert from_axis.min() < 1000.0
    assert np.degrees(s.lat).min() > 89.98
    assert np.abs(np.diff(np.degrees(s.lon))).max() > 300.0  # crosses the 180th meridian
    lateral = np.linalg.norm(np.cross(s.v_G, np.gradient(s.v_G, axis=0)), axis=1) / 3.0
    assert lateral.max() < 0.05
    # The shape does not depend on how long the mission is: this one ends at the same place.
    short = mission.with_duration(60.0)
    end = [m.truth('follower').state(m.end_ns).r_e for m in (mission, short)]
    assert np.linalg.norm(end[0] - end[1]) < 1e-3


def test_whole_numbers_and_defaults():
    mission = mission_from(STRAIGHT, FILE)
    assert mission.path.speed_mps == 3.0
    assert mission.formation['follower'].depth_m == 50.0
    assert mission.duration_s == 600.0
    assert mission.oscillation.yaw.period_s == 7.0


def test_overrides_and_duration():
    mission = load_mission('demo')
    changed = mission.with_overrides(
        overrides_from(['path.speed_mps=2.0', 'vehicles.follower.depth_m = 50'])
    ).with_duration(30.0)
    assert (changed.path.speed_mps, changed.formation['follower'].depth_m) == (2.0, 50.0)
    assert changed.sample_count == 3001
    assert changed.start_ns == mission.start_ns
    assert mission.path.speed_mps == 3.0


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'path.kind': 'zigzag'}, ('path', 'zigzag', 'racetrack')),
        ({'path.latitude_deg': 91.0}, ('latitude_deg', '91.0', '90')),
        ({'path.speed': 3.0}, ('path', 'speed')),
        ({'duration_s': -1.0}, ('duration_s', '-1.0')),
        ({'duration': 10.0}, ('unknown', 'duration')),
        ({'imu_rate_hz': 300.0}, ('imu_rate_hz', '300')),
        ({'start_time': 'tomorrow'}, ('start_time', 'tomorrow')),
        ({'vehicles.follower.role': 'leader'}, ('one vehicle', 'leader')),
        ({'vehicles.Follower 2': {}}, ('Follower 2', 'namespace')),
        ({'vehicles.follower.depth_m': 'deep'}, ('vehicles.follower', 'depth_m', 'deep')),
        ({'vehicles.follower.offset_m': [1.0]}, ('offset_m',)),
        ({'oscillation.surge': {}}, ('oscillation', 'surge')),
        ({'path.kind': 'track'}, ('path',)),
    ],
)
def test_mistakes_are_named(change, words):
    with pytest.raises(ConfigError) as error:
        mission_from(STRAIGHT, FILE).with_overrides(change)
    for word in ('some.yaml', *words):
        assert word in str(error.value)


def test_a_vehicle_with_sources_needs_no_leader():
    mission = load_mission('ahrs')
    assert not mission.led
    assert mission.vehicles == mission.followers == ('auv',)
    assert mission.sources('auv').name == 'ahrs.yaml'
    assert load_mission('demo').led
    assert load_mission('demo').sources('follower') is None
    with pytest.raises(ConfigError, match='mission ahrs has no leader'):
        mission.leader  # noqa: B018 - it raises
    with pytest.raises(ConfigError, match=r'role leader, found .*only vehicles with sources'):
        mission.with_overrides({'vehicles.auv.sources': ''})
    with pytest.raises(ConfigError, match=r"file 'nowhere\.yaml' is neither beside it nor in"):
        mission.with_overrides({'vehicles.auv.sources': 'nowhere.yaml'})


def test_turns_and_dives_that_do_not_fit_are_named():
    lawnmower = load_mission('lawnmower').with_overrides({'path.spacing_m': 50.0})
    with pytest.raises(ConfigError, match=r'spacing_m: 50.0 is less than the 110'):
        lawnmower.truth('follower')
    dive = load_mission('dive').with_overrides({'path.dive_m': 1.0})
    with pytest.raises(ConfigError, match='dive_m'):
        dive.truth('follower')


def test_unknown_names(tmp_path):
    with pytest.raises(ConfigError, match='neither a file nor one of ahrs, antimeridian, demo'):
        load_mission('nowhere')
    with pytest.raises(ConfigError, match="no vehicle 'third'"):
        load_mission('demo').truth('third')
    broken = tmp_path / 'broken.yaml'
    broken.write_text('path: [')
    with pytest.raises(ConfigError, match=r'broken\.yaml: not YAML'):
        load_mission(broken)
    with pytest.raises(ConfigError, match='key=value'):
        overrides_from(['speed'])


def test_a_mapping_file_is_told_from_a_mission(tmp_path):
    path = tmp_path / 'mapping.yaml'
    path.write_text('version: 2\nimu: {topic: /imu}\n', encoding='utf-8')
    with pytest.raises(ConfigError, match=r"no section 'path'; it looks like a mapping file"):
        load_mission(path)


def test_track_too_short_too_wild_or_unreadable(tmp_path):
    mission = load_mission('near_pole')
    with pytest.raises(ConfigError, match='m long, the mission needs'):
        mission.with_duration(30000.0).truth('follower')
    with pytest.raises(ConfigError, match='max_lateral_acceleration'):
        mission.with_overrides({'path.smoothing_m': 1.0}).truth('follower')
    track = tmp_path / 'track.csv'
    track.write_text('datetime,latitude,longitude\n2020-01-01,89.9,1.0\n2020-01-02,99,1.0\n')
    with pytest.raises(ConfigError, match=r'track.csv, line 3: no place at 99'):
        mission.with_overrides({'path.csv': str(track)}).truth('follower')
    track.write_text('time,latitude,longitude\n')
    with pytest.raises(ConfigError, match='no column datetime'):
        mission.with_overrides({'path.csv': str(track)}).truth('follower')
    with pytest.raises(ConfigError, match='first_utc'):
        mission.with_overrides({'path.first_utc': 'soon'}).truth('follower')
    with pytest.raises(ConfigError, match='neither beside it'):
        mission.with_overrides({'path.csv': 'nothing.csv'}).truth('follower')


def test_track_part_can_be_chosen():
    mission = load_mission('near_pole').with_overrides(
        {
            'path.nearest_pole': False,
            'path.reverse': False,
            'path.first_utc': '2020-08-20T06:00:00',
        }
    )
    s = mission.truth('follower').state(mission.start_ns)
    # The fix of that hour: 89.9899 N, 168.3185 E, at the start but for the margin and smoothing.
    assert float(np.degrees(s.lat)) == pytest.approx(89.9899, abs=1e-3)
    assert float(np.degrees(s.lon)) == pytest.approx(168.3, abs=6.0)


def test_a_start_that_no_stamp_can_hold() -> None:
    with pytest.raises(ConfigError, match=r'start_time 9999.* the last second'):
        load_mission('demo').with_overrides({'start_time': '9999-12-31T23:59:59Z'})
