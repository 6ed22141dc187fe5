"""Tracks in their own time: stamps, places, and why a track can be refused."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from polar_nav_core import attitude, earth
from polar_nav_core.errors import ConfigError
from polar_nav_core.strapdown import Strapdown
from polar_nav_sim.mission import load_mission
from polar_nav_sim.paths.track import read_fixes
from polar_nav_sim.resources import find_data

NEAR_POLE = load_mission('near_pole')
RECORDED = NEAR_POLE.with_overrides({'path.as_recorded': True})
FIXES = read_fixes(find_data(NEAR_POLE.path.csv, NEAR_POLE.file))
FIRST = datetime(2026, 1, 1, tzinfo=UTC)


def seconds(mission):
    return mission.start_ns / 1e9


def write(path, lat, lon, minutes):
    rows = [
        f'{(FIRST + timedelta(minutes=float(m))).isoformat()},{a:.9f},{o:.9f}'
        for a, o, m in zip(lat, lon, minutes, strict=True)
    ]
    path.write_text('\n'.join(['datetime,latitude,longitude', *rows]) + '\n')
    return RECORDED.with_overrides(
        {'path.csv': str(path), 'path.nearest_pole': False, 'path.smoothing_m': 1.0}
    )


def line(path, south=False, lon=30.0, offset_m=0.0):
    """Straight at 0.5 m/s over a pole, or past it at a distance; its middle after three hours."""
    minutes = np.arange(0.0, 361.0, 10.0)
    x = 0.5 * 60.0 * (minutes - 180.0)
    lat = 90.0 - np.degrees(np.hypot(x, offset_m) / 6399593.6)
    lon = lon + np.degrees(np.arctan2(offset_m, -x))
    lon = (lon + 180.0) % 360.0 - 180.0
    return write(path, -lat if south else lat, lon, minutes)


def test_stamps_are_those_of_the_track():
    assert FIXES.utc_s[0] < seconds(RECORDED) < FIXES.utc_s[0] + 60.0
    day = RECORDED.with_overrides({'start_time': '2020-08-20T00:00:00Z', 'duration_s': 86400.0})
    assert seconds(day) == datetime(2020, 8, 20, tzinfo=UTC).timestamp()
    inside = (FIXES.utc_s > seconds(day)) & (FIXES.utc_s < seconds(day) + 86400.0)
    at = np.round(FIXES.utc_s[inside] * 1e9).astype(np.int64)
    s = day.truth('follower').state(at)
    fixes_e = earth.ecef_from_geodetic(
        FIXES.lat[inside], FIXES.lon[inside], np.full(at.shape, -100.0)
    )
    away = np.linalg.norm(s.r_e - fixes_e, axis=1)
    assert np.sqrt(np.mean(away**2)) < 80.0  # smoothing_m is 60 over the whole track
    assert away.max() < 250.0
    assert inside.sum() == 23
    speed = np.linalg.norm(s.v_G, axis=1)
    assert speed.max() < 0.3  # a drifting buoy, not 3 m/s
    assert np.abs(s.depth - 100.0).max() < 1e-6
    leader = day.truth('leader').state(at)
    assert np.ptp(np.linalg.norm(leader.r_e - s.r_e, axis=1)) < 0.1


def test_speed_and_direction_are_those_of_the_track():
    other = RECORDED.with_overrides({'path.speed_mps': 1.0, 'path.reverse': False})
    a, b = (m.truth('follower').state(m.end_ns).r_e for m in (RECORDED, other))
    assert np.array_equal(a, b)
    # Without the option nothing changes, stamps included.
    assert NEAR_POLE.start_ns == 1772323200 * 10**9


def test_nearest_pole_is_the_middle_of_the_mission(tmp_path):
    mission = line(tmp_path / 'track.csv', offset_m=300.0).with_overrides(
        {'path.nearest_pole': True, 'duration_s': 600.0}
    )
    assert seconds(mission) == (FIRST + timedelta(minutes=175)).timestamp()
    s = mission.truth('follower').state(mission.start_ns + 300 * 10**9)
    assert np.hypot(*s.r_e[:2]) == pytest.approx(300.0, abs=1.0)


@pytest.mark.parametrize(
    ('south', 'lon', 'offset_m'),
    [
        (False, 30.0, 0.0),
        (True, -60.0, 0.0),
        (False, 180.0, 0.0),
        (False, 90.0, 200.0),
        (True, 135.0, 1000.0),
    ],
)
def test_pole_and_180_degrees_are_ordinary_places(tmp_path, south, lon, offset_m):
    """A line at 0.5 m/s over or past a pole: constant velocity in grid axes, strapdown closes."""
    mission = line(tmp_path / 'track.csv', south, lon, offset_m).with_overrides(
        {'start_time': (FIRST + timedelta(minutes=175)).isoformat(), 'duration_s': 600.0}
    )
    block = mission.truth('follower').samples(0, mission.sample_count)
    s = block.state
    assert np.linalg.norm(s.v_G, axis=1) == pytest.approx(0.5, abs=1e-2)
    assert np.abs(s.v_G - s.v_G.mean(axis=0)).max() < 1e-2
    assert np.hypot(s.r_e[:, 0], s.r_e[:, 1]).min() == pytest.approx(offset_m, abs=1.0)
    ins = Strapdown(s.C_b_G[0], s.v_G[0], s.r_e[0])
    ins.run(block.delta_theta_b[1:], block.delta_v_b[1:], 0.01)
    assert np.linalg.norm(ins.r_e - s.r_e[-1]) < 1e-3
    assert np.abs(attitude.log(s.C_b_G[-1].T @ ins.C_b_G)).max() < 1e-9


def test_gaps_duplicates_and_the_wrong_time_are_named(tmp_path):
    track = tmp_path / 'track.csv'
    lat, lon = np.linspace(88.0, 88.3, 40), np.full(40, 179.9)
    minutes = np.arange(40.0) * 10.0
    gap = np.where(minutes >= 200.0, minutes + 240.0, minutes)
    mission = write(track, lat, lon, gap)
    assert mission.truth('follower')  # the gap is not in the ten minutes that are sailed
    late = mission.with_overrides({'start_time': '2026-01-01T03:05:00Z'})
    with pytest.raises(
        ConfigError, match=r'track.csv: no fix for 15000 s after 2026-01-01T03:10:00.*max_gap_s'
    ):
        late.truth('follower')
    assert late.with_overrides({'path.max_gap_s': 20000.0}).truth('follower')
    for start in ('2025-12-31T00:00:00Z', '2026-01-01T10:28:00Z'):
        with pytest.raises(ConfigError, match=r'needs the track from .* its fixes are from'):
            mission.with_overrides({'start_time': start}).truth('follower')
    with pytest.raises(ConfigError, match='needs the track from'):
        mission.with_duration(86400.0).truth('follower')
    minutes[7] = minutes[6]
    with pytest.raises(
        ConfigError, match=r'track.csv, line 9: time does not increase: 2026-01-01T01'
    ):
        write(track, lat, lon, minutes)
    with pytest.raises(ConfigError, match=r'5 fixes .* a curve needs 6'):
        write(track, lat[:5], lon[:5], np.arange(5.0) * 10.0).truth('follower')


def test_a_buoy_that_stops_and_returns_has_no_course_there(tmp_path):
    minutes = np.arange(0.0, 361.0, 10.0)
    lat = 88.0 + 0.01 * np.cos(np.radians(minutes))  # turns back after 3 h
    mission = write(tmp_path / 'track.csv', lat, np.full(len(lat), 10.0), minutes)
    with pytest.raises(ConfigError, match=r'as recorded it almost stops .* raise smoothing_m'):
        mission.with_overrides({'start_time': '2026-01-01T02:55:00Z'}).truth('follower')
    assert mission.with_overrides({'start_time': '2026-01-01T01:00:00Z'}).truth('follower')
