"""Exported trajectories: every digit, the right axes, one origin, errors in one sentence."""

import csv
import sys
from datetime import datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from polar_nav_core.attitude import matrix_from_quaternion
from polar_nav_core.earth import ecef_from_geodetic
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid
from polar_nav_tools.bags import BagError, open_bag
from polar_nav_tools.cli import main
from polar_nav_tools.export.at_stamps import at_stamps
from polar_nav_tools.export.formats import (
    Trajectory,
    axes,
    seconds_text,
    trajectory,
    write_trajectory,
)
from polar_nav_tools.export.source import exported, from_topic, origin_of
from polar_nav_tools.report.example import example_input

TRUTH, ESTIMATE, _ = next(iter(example_input(minutes=0.5).runs.values()))
REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'


def tum(path):
    rows = [line.split() for line in path.read_text().splitlines()]
    return [r[0] for r in rows], np.array([[float(x) for x in r[1:]] for r in rows])


def test_tum_keeps_every_digit(tmp_path):
    write_trajectory(tmp_path / 't', trajectory(TRUTH))
    times, values = tum(tmp_path / 't')
    seconds = [t.split('.') for t in times]
    assert [int(s) * 10**9 + int(n) for s, n in seconds] == TRUTH.stamp_ns.tolist()
    np.testing.assert_array_equal(values[:, :3], TRUTH.r_e)
    C_b_e = np.swapaxes(ecef_to_grid(TRUTH.r_e), 1, 2) @ TRUTH.C_b_G
    np.testing.assert_allclose(matrix_from_quaternion(values[:, 3:]), C_b_e, atol=1e-14)


def test_grid_frame_is_level_at_its_origin(tmp_path):
    write_trajectory(tmp_path / 't', trajectory(TRUTH), frame='grid')
    _, values = tum(tmp_path / 't')
    np.testing.assert_array_equal(values[0, :3], 0.0)
    np.testing.assert_allclose(matrix_from_quaternion(values[0, 3:]), TRUTH.C_b_G[0], atol=1e-13)
    step = (TRUTH.stamp_ns[1] - TRUTH.stamp_ns[0]) * 1e-9
    np.testing.assert_allclose(values[1, :3] / step, TRUTH.v_G[:2].mean(0), atol=1e-3)


def test_enu_points_north():
    r_e = ecef_from_geodetic(1.2, -2.0, 10.0)
    north = ecef_from_geodetic(1.2 + 1e-6, -2.0, 10.0) - r_e
    origin, C_e_g = axes('enu', r_e)
    np.testing.assert_array_equal(origin, r_e)
    np.testing.assert_allclose(C_e_g @ north / np.linalg.norm(north), [0, 1, 0], atol=1e-5)
    np.testing.assert_allclose(C_e_g @ C_e_g.T, np.eye(3), atol=1e-15)
    with pytest.raises(ConfigError, match='no east'):
        axes('enu', np.array([0.1, 0.1, 6.35e6]))


def test_csv_has_names_units_and_sigma(tmp_path):
    write_trajectory(tmp_path / 'e.csv', trajectory(ESTIMATE), kind='csv', frame='grid')
    with (tmp_path / 'e.csv').open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(ESTIMATE)
    assert int(rows[3]['stamp_ns']) == ESTIMATE.stamp_ns[3]
    sigma = np.sqrt(ESTIMATE.P_position_G[3, 0, 0])
    assert float(rows[3]['sigma_grid_east_m']) == sigma
    assert float(rows[3]['latitude_deg']) == np.rad2deg(ESTIMATE.latitude[3])
    write_trajectory(tmp_path / 't.csv', trajectory(TRUTH), kind='csv')
    assert 'sigma' not in (tmp_path / 't.csv').read_text()


def test_kml_has_a_time_and_a_place_for_each_pose(tmp_path):
    track = trajectory(ESTIMATE)
    path = tmp_path / 'a & b.kml'
    write_trajectory(path, track, kind='kml')
    root = ElementTree.parse(path).getroot()
    assert [e.text for e in root.iter('{http://www.opengis.net/kml/2.2}name')] == ['a & b']
    times = [e.text for e in root.iter('{http://www.opengis.net/kml/2.2}when')]
    places = [e.text for e in root.iter('{http://www.google.com/kml/ext/2.2}coord')]
    assert len(times) == len(places) == len(track)
    at = datetime.fromisoformat(times[2].replace('Z', '+00:00'))
    assert at.timestamp() == pytest.approx(track.stamp_ns[2] * 1e-9, abs=1e-3)
    expected = [np.rad2deg(track.longitude[2]), np.rad2deg(track.latitude[2]), track.height[2]]
    assert [float(x) for x in places[2].split()] == expected
    with pytest.raises(ConfigError, match='no frame enu'):
        write_trajectory(tmp_path / 'b.kml', track, kind='kml', frame='enu')


def circle(t):
    """Pose of a vehicle on a circle of 15 m at 2 m/s, its bow ahead, near a pole."""
    a, w = 2.0 / 15.0 * t, 2.0 / 15.0
    n = len(t)
    flat = np.column_stack([np.cos(a), np.sin(a)])
    r_e = np.column_stack([100.0 + 15.0 * flat, np.full(n, 6.3567e6)])
    v_e = 15.0 * w * np.column_stack([-flat[:, 1], flat[:, 0], np.zeros(n)])
    C = Rotation.from_euler('z', (a + 0.5 * np.pi)[:, None]).as_matrix()
    return r_e, v_e, C


def test_poses_between_those_that_are_known_are_on_the_way():
    own = np.arange(0, 20_000_000_000, 100_000_000)
    r_e, v_e, C = circle(own * 1e-9)
    nothing = np.zeros(len(own))
    sigma = np.column_stack([own * 1e-9] * 3)
    track = Trajectory(own, r_e, C, v_e, sigma, nothing, nothing, nothing, 0)
    wanted = np.array([30_000_000_000, 7_350_000_000, 1_234_567_890, -5])
    found = at_stamps(track, wanted)
    assert found.stamp_ns.tolist() == [1_234_567_890, 7_350_000_000]
    assert found.left_out == 2
    there, speed, turned = circle(found.stamp_ns * 1e-9)
    np.testing.assert_allclose(found.r_e, there, atol=1e-6)
    np.testing.assert_allclose(found.v_e, speed, atol=1e-4)
    np.testing.assert_allclose(found.C_b_e, turned, atol=1e-9)
    np.testing.assert_allclose(found.sigma_G[:, 1], found.stamp_ns * 1e-9)
    with pytest.raises(ConfigError, match='none of the times'):
        at_stamps(track, wanted[:1])


def test_samples_without_a_pose_are_left_out_and_counted(tmp_path):
    r_e = ESTIMATE.r_e.copy()
    r_e[5:8] = np.nan
    shuffled = type(ESTIMATE)(**{**vars(ESTIMATE), 'r_e': r_e}).rows(slice(None, None, -1))
    track = trajectory(shuffled)
    assert (len(track), track.left_out) == (len(ESTIMATE) - 3, 3)
    assert (np.diff(track.stamp_ns) > 0).all()
    with pytest.raises(ConfigError, match='no pose'):
        write_trajectory(tmp_path / 'x', trajectory(shuffled.rows(slice(0, 0))))


def test_seconds_are_exact():
    assert seconds_text(1_772_323_200_000_000_001) == '1772323200.000000001'
    assert seconds_text(-1_500_000_000) == '-1.500000000'


@pytest.mark.parametrize('frame', ['ecef', 'grid'])
def test_odometry_of_a_bag_is_its_estimate(frame, tmp_path):
    bag = open_bag(REFERENCE)
    origin = origin_of(bag, None)
    for name, track in (
        ('a', exported(bag, 'estimate', None)),
        ('b', from_topic(bag, '/follower/odometry')),
    ):
        write_trajectory(tmp_path / name, track, frame=frame, origin_r_e=origin)
    a, b = (tum(tmp_path / name) for name in 'ab')
    assert a[0] == b[0]
    np.testing.assert_allclose(a[1][:, :3], b[1][:, :3], atol=1e-8)
    C = [matrix_from_quaternion(values[:, 3:]) for _, values in (a, b)]
    np.testing.assert_allclose(C[0], C[1], atol=1e-12)


def test_leader_is_the_other_vehicle():
    bag = open_bag(REFERENCE)
    leader = exported(bag, 'leader', None)
    np.testing.assert_array_equal(leader.r_e, from_topic(bag, '/leader/truth').r_e)
    assert np.linalg.norm(leader.r_e[0] - origin_of(bag, None)) > 10.0


@pytest.mark.parametrize(
    ('what', 'words'), [('sonar', 'none of truth'), ('truth:default', 'none of truth')]
)
def test_what_does_not_exist(what, words):
    with pytest.raises(ConfigError, match=words):
        exported(open_bag(REFERENCE), what, None)


def test_topics_that_are_no_trajectory():
    bag = open_bag(REFERENCE)
    with pytest.raises(BagError, match='sensor_msgs/msg/Imu'):
        from_topic(bag, '/follower/imu/data_raw')
    with pytest.raises(BagError, match='/whale'):
        from_topic(bag, '/whale')


def test_the_command(tmp_path, monkeypatch, capsys):
    def polar(*arguments):
        monkeypatch.setattr(sys, 'argv', ['polar', 'export', *map(str, arguments)])
        status = main()
        said = capsys.readouterr()
        return status, said.out, said.err

    status, out, _ = polar(REFERENCE, tmp_path / 'a.csv', '--frame', 'enu')
    assert status == 0
    assert 'poses, csv, enu' in out
    status, _, err = polar(REFERENCE, tmp_path / 'a.csv')
    assert (status, 'already' in err) == (2, True)
    status, _, err = polar(REFERENCE, tmp_path / 'b', '--frame', 'moon')
    assert (status, 'moon' in err, (tmp_path / 'b').exists()) == (2, True, False)
    status, _, err = polar(REFERENCE, tmp_path / 'b', '--what', 'truth', '--topic', '/x')
    assert status == 2
