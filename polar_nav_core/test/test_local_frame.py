"""Local map frames: axes, refusals, files; and the frame `odom` that corrections do not move."""

import numpy as np
import pytest

from polar_nav_core import attitude, earth
from polar_nav_core.error_model import X
from polar_nav_core.errors import ConfigError
from polar_nav_core.kernels.sins import odometry, present
from polar_nav_core.kernels.sins.present_covariance import STATES
from polar_nav_core.local_frame import DeadReckoning, LocalFrame, frame_of_file


def at(lat_deg, lon_deg, height=0.0):
    return earth.ecef_from_geodetic(np.deg2rad(lat_deg), np.deg2rad(lon_deg), height)


def test_enu_points_to_true_north_and_grid_does_not():
    origin = at(80.0, 120.0)
    north = at(80.001, 120.0) - origin
    enu, grid = LocalFrame(origin, 'enu'), LocalFrame(origin, 'grid')
    np.testing.assert_allclose((enu.C_e_m @ north)[:2] / np.linalg.norm(north), [0, 1], atol=1e-5)
    assert abs((grid.C_e_m @ north)[0]) > 0.8 * np.linalg.norm(north)
    for frame in (enu, grid):
        np.testing.assert_allclose(frame.C_e_m @ frame.C_e_m.T, np.eye(3), atol=1e-15)
        np.testing.assert_allclose(frame.C_e_m @ earth.up(origin), [0, 0, 1], atol=1e-15)


@pytest.mark.parametrize('lat_deg', [90.0, 89.995, -89.995])
def test_enu_is_refused_at_a_pole_where_grid_is_not(lat_deg):
    LocalFrame(at(lat_deg, 20.0), 'grid')
    with pytest.raises(ConfigError, match='from a pole'):
        LocalFrame(at(lat_deg, 20.0), 'enu')
    LocalFrame(at(89.98, 20.0), 'enu')


def test_the_plane_leaves_the_surface():
    frame = LocalFrame(at(80.0, 120.0), 'grid')
    away = frame.position(at(80.0 + np.rad2deg(5000.0 / 6.4e6), 120.0))
    assert away[2] == pytest.approx(-1.96, abs=0.02)


def test_a_file_gives_the_frame_that_wrote_it(tmp_path):
    frame = LocalFrame(at(-75.0, 30.0, 12.5), 'enu')
    path = tmp_path / 'origin.yaml'
    path.write_text(frame.as_yaml())
    read = frame_of_file(path)
    np.testing.assert_allclose(read.r_e, frame.r_e, atol=1e-8)
    np.testing.assert_allclose(read.C_e_m, frame.C_e_m, atol=1e-14)


@pytest.mark.parametrize(
    ('text', 'why'),
    [
        ('latitude_deg: 80.0', 'all of them'),
        ('[1, 2]', 'all of them'),
        ('{latitude_deg: 91, longitude_deg: 0, height_m: 0, axes: grid}', 'latitude_deg is 91'),
        ('{latitude_deg: yes, longitude_deg: 0, height_m: 0, axes: grid}', 'latitude_deg is True'),
        ('{latitude_deg: 80, longitude_deg: 0, height_m: 0, axes: ned}', "axes is 'ned'"),
        ('{latitude_deg: 90, longitude_deg: 0, height_m: 0, axes: enu}', 'from a pole'),
    ],
)
def test_what_is_wrong_with_a_file_is_said(tmp_path, text, why):
    path = tmp_path / 'origin.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError, match=why) as error:
        frame_of_file(path)
    assert 'origin.yaml' in str(error.value)


def walk(corrections):
    """Odom poses, and map poses, of a vehicle on a circle; each step may have a correction."""
    odom = DeadReckoning()
    r_m, C_b_m = np.array([3.0, -2.0, -40.0]), attitude.matrix_from_euler(0.3, 0.02, -0.01)
    odom.move(r_m, C_b_m, np.zeros(3), np.eye(3))
    rows = []
    for shift, turn in corrections:
        moved, C_turn_b = C_b_m @ [0.02, 0.0, 0.0], attitude.exp([0.0, 0.001, 0.01])
        C_b_m = attitude.exp(turn) @ C_b_m @ C_turn_b
        r_m = r_m + moved + shift
        odom.move(r_m, C_b_m, moved, C_turn_b)
        composed = odom.origin + odom.C_o_m @ odom.position, odom.C_o_m @ odom.C_b_o
        np.testing.assert_allclose(composed[0], r_m, atol=1e-9)
        np.testing.assert_allclose(composed[1], C_b_m, atol=1e-12)
        pose = odom.position, odom.C_b_o, odom.origin, odom.C_o_m
        rows.append([part.copy() for part in pose])
    return rows


def test_corrections_of_place_and_heading_move_odom_only():
    none = [(np.zeros(3), np.zeros(3))] * 40
    some = list(none)
    some[20] = np.array([7.0, -3.0, 1.0]), np.zeros(3)
    some[30] = np.zeros(3), np.array([0.0, 0.0, 0.4])
    for k, (a, b) in enumerate(zip(walk(none), walk(some), strict=True)):
        np.testing.assert_allclose(a[0], b[0], atol=1e-9)
        np.testing.assert_allclose(a[1], b[1], atol=1e-9)
        np.testing.assert_allclose(a[3], np.eye(3), atol=1e-12)
        moved = np.linalg.norm(b[2] - a[2])
        assert (moved > 1.0) == (k >= 20)


def test_the_way_in_odom_has_no_step_but_that_of_the_vehicle():
    rng = np.random.default_rng(2)
    rows = walk([(rng.normal(0, 1.0, 3), rng.normal(0, 0.1, 3)) for _ in range(200)])
    steps = np.linalg.norm(np.diff([r[0] for r in rows], axis=0), axis=1)
    np.testing.assert_allclose(steps, 0.02, atol=1e-9)


def test_the_numbers_of_an_odometry_are_those_of_matrices():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(STATES, STATES))
    P = A @ A.T
    C_b_G, C_e_G, C_e_m = (attitude.matrix_from_euler(*rng.normal(size=3)) for _ in range(3))
    r_e, v_G, omega = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3)
    values = np.zeros(present.VALUES)
    for k, part in (
        (present.R_E, r_e),
        (present.V_G, v_G),
        (present.C_B_G, C_b_G),
        (present.C_E_G, C_e_G),
        (present.RATE, omega),
        (present.MOVED, [1.0, 2.0, 3.0]),
    ):
        values[k : k + np.size(part)] = np.ravel(part)
    frame = LocalFrame(at(80.0, 120.0), 'grid')
    frame.r_e, frame.C_e_m = np.array([1.0, 0.0, 2.0]), C_e_m
    r_m, C_b_m, moved_m = frame.pose(values)
    np.testing.assert_allclose(r_m, C_e_m @ (r_e - frame.r_e), atol=1e-12)
    np.testing.assert_allclose(C_b_m, C_e_m @ C_e_G.T @ C_b_G, atol=1e-12)
    np.testing.assert_allclose(moved_m, C_e_m @ [1.0, 2.0, 3.0], atol=1e-12)
    numbers = np.empty(odometry.NUMBERS)
    odometry.pose_and_twist(r_m, C_b_m, C_e_m, values, P, 0.25, numbers, present.make_scratch())
    to_pose, to_twist = np.zeros((6, 15)), np.zeros((6, 15))
    to_pose[:3, X.dr_e], to_pose[3:, X.phi_G] = C_e_m, -C_b_m @ C_b_G.T
    to_twist[:3, X.dv_G], to_twist[3:, X.b_gyro_b] = C_b_G.T, np.eye(3)
    twist = to_twist @ P @ to_twist.T
    twist[:3, 3:] = twist[3:, :3] = 0.0
    twist[3:, 3:] += 0.25 * np.eye(3)
    expected = [
        r_m,
        attitude.quaternion_from_matrix(C_b_m),
        to_pose @ P @ to_pose.T,
        C_b_G.T @ v_G,
        omega,
        twist,
    ]
    np.testing.assert_allclose(
        numbers, np.concatenate([np.ravel(e) for e in expected]), atol=1e-12
    )
