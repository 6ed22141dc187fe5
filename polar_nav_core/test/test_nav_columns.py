"""What nav/state tells of a state, beside NumPy forms of the same quantities."""

import numpy as np
import pytest

from polar_nav_core import attitude, earth, grid, nav_columns
from polar_nav_core.error_model import X

COUNT = 400
PLACE = ('latitude', 'longitude', 'height')


@pytest.fixture(scope='module')
def states():
    """Anywhere on earth, a nanometre from a pole too, in any attitude."""
    rng = np.random.default_rng(11)
    lat = np.pi / 2 - 10.0 ** rng.uniform(-9.0, 0.1, COUNT)
    lat[::2] *= -1.0
    r_e = earth.ecef_from_geodetic(lat, rng.uniform(-np.pi, np.pi, COUNT), rng.normal(size=COUNT))
    C_b_G = attitude.exp(rng.normal(size=(COUNT, 3)) * 2.0)
    root = rng.normal(size=(COUNT, 24, 24)) * 10.0 ** rng.uniform(-5.0, 2.0, (COUNT, 1, 24))
    return r_e, C_b_G, np.swapaxes(root, 1, 2) @ root


def test_place_and_attitude(states):
    r_e, C_b_G, _ = states
    told = nav_columns.describe(*states)
    psi, pitch, roll = attitude.euler_from_matrix(C_b_G)
    expected = {
        **dict(
            zip(('latitude', 'longitude', 'height'), earth.geodetic_from_ecef(r_e), strict=True)
        ),
        'roll': roll,
        'pitch': pitch,
        'grid_heading': np.mod(0.5 * np.pi - psi, 2.0 * np.pi),
    }
    for name, values in expected.items():
        found = told[:, nav_columns.COLUMNS[name]]
        np.testing.assert_allclose(found, values, rtol=4e-16, atol=1e-15, err_msg=name)
    q = attitude.quaternion_from_matrix(C_b_G)
    np.testing.assert_allclose(told[:, nav_columns.QUATERNION], q, rtol=0.0, atol=1e-15)


def test_a_variance_within_the_rounding_of_the_others_is_held(states):
    """Flat on the surface of the earth, 1e8 m and 5e7 m wide and 1 m thick."""
    r_e, C_b_G, _ = states
    C_e_G = grid.ecef_to_grid(r_e)
    root = np.random.default_rng(3).normal(size=(COUNT, 2, 2)) * 5e7
    flat_G = np.zeros((COUNT, 3, 3))
    flat_G[:, :2, :2] = root @ np.swapaxes(root, 1, 2)
    flat_G[:, 2, 2] = 1.0
    P = np.tile(np.eye(24), (COUNT, 1, 1))
    P[:, X.dr_e, X.dr_e] = np.swapaxes(C_e_G, 1, 2) @ flat_G @ C_e_G
    told = nav_columns.describe(r_e, C_b_G, P)[:, nav_columns.POSITION_COVARIANCE_G]
    found = told.reshape(-1, 3, 3)
    assert np.diagonal(found, axis1=1, axis2=2).min() >= 1.0
    assert np.linalg.eigvalsh(found).min() > 0.0
    size = np.trace(flat_G, axis1=1, axis2=2)[:, None, None]
    np.testing.assert_allclose(found / size, flat_G / size, rtol=0.0, atol=2e-14)


def test_covariances(states):
    r_e, _, P = states
    told = nav_columns.describe(*states)
    C_e_G = grid.ecef_to_grid(r_e)
    position_G = C_e_G @ P[:, X.dr_e, X.dr_e] @ np.swapaxes(C_e_G, 1, 2)
    scale = np.max(np.abs(position_G), axis=(1, 2), keepdims=True)
    found = told[:, nav_columns.POSITION_COVARIANCE_G].reshape(-1, 3, 3)
    np.testing.assert_allclose(found / scale, position_G / scale, rtol=0.0, atol=1e-14)
    for place, block in (
        (nav_columns.VELOCITY_COVARIANCE_G, X.dv_G),
        (nav_columns.ATTITUDE_COVARIANCE_G, X.phi_G),
    ):
        np.testing.assert_array_equal(told[:, place].reshape(-1, 3, 3), P[:, block, block])
    sigma = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    np.testing.assert_array_equal(told[:, nav_columns.SIGMA], sigma)


def test_true_heading_as_far_as_it_is_known(states):
    r_e, _, P = states
    told = nav_columns.describe(*states)
    column = {name: told[:, k] for name, k in nav_columns.COLUMNS.items()}
    unknown = 0
    for n in range(COUNT):
        x, y, _ = r_e[n]
        east = np.array([-y, x, 0.0]) / np.hypot(x, y)
        sigma_east = np.sqrt(east @ P[n, X.dr_e, X.dr_e] @ east)
        wanted = grid.true_heading(
            r_e[n], column['grid_heading'][n], np.sqrt(P[n, 2, 2]), float(sigma_east)
        )
        found = [column[k][n] for k in ('true_heading', 'true_heading_sigma', 'convergence')]
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-15)
        unknown += np.isnan(wanted.heading)
    assert 0.1 * COUNT < unknown < 0.9 * COUNT


def test_at_the_pole_nothing_is_told_of_longitude_and_true_heading():
    told = nav_columns.describe(
        np.array([[0.0, 0.0, 6356752.0]]), np.eye(3)[None], 1e-12 * np.eye(24)[None]
    )[0]
    column = {name: told[k] for name, k in nav_columns.COLUMNS.items()}
    assert column['latitude'] == np.pi / 2
    assert np.isnan([column[k] for k in ('longitude', 'true_heading', 'convergence')]).all()
    assert column['true_heading_sigma'] == grid.TRUE_HEADING_SIGMA_CAP


def test_straight_up_and_half_turns():
    """Where Euler angles and quaternions change their branch."""
    C_b_G = np.array(
        [
            [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]],  # pitch 90 degrees
            np.diag([1.0, -1.0, -1.0]),
            np.diag([-1.0, 1.0, -1.0]),
            np.diag([-1.0, -1.0, 1.0]),
        ]
    )
    r_e = np.tile(earth.ecef_from_geodetic(1.5, 0.3, 0.0), (4, 1))
    told = nav_columns.describe(r_e, C_b_G, np.tile(np.eye(24), (4, 1, 1)))
    q = told[:, nav_columns.QUATERNION]
    np.testing.assert_allclose(attitude.matrix_from_quaternion(q), C_b_G, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(nav_columns.rotations(q), C_b_G, rtol=0.0, atol=1e-15)
    _, pitch, roll = attitude.euler_from_matrix(C_b_G)
    np.testing.assert_allclose(told[:, nav_columns.COLUMNS['pitch']], pitch, rtol=0, atol=1e-15)
    np.testing.assert_allclose(told[:, nav_columns.COLUMNS['roll']], roll, rtol=0, atol=1e-15)


def test_rotations_of_quaternions_of_about_unit_length():
    rng = np.random.default_rng(12)
    q = rng.normal(size=(200, 4))
    expected = attitude.matrix_from_quaternion(q)
    np.testing.assert_allclose(nav_columns.rotations(q), expected, rtol=0.0, atol=1e-14)
    assert np.isnan(nav_columns.rotations(np.zeros((1, 4)))).all()


def test_no_grid_north_on_the_equator_at_ninety_degrees():
    r_e = np.array([[1e6, 0.0, 6.2e6], [0.0, earth.SEMI_MAJOR, 0.0]])
    with pytest.raises(ValueError, match='grid north is undefined'):
        nav_columns.describe(r_e, np.tile(np.eye(3), (2, 1, 1)), np.tile(np.eye(24), (2, 1, 1)))
