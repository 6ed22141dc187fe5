"""Attitude conversions: each against another, SciPy, and the signs of docs/frames.md."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from polar_nav_core import attitude

ANGLE = st.floats(-3.1, 3.1)
VECTOR = st.tuples(ANGLE, ANGLE, ANGLE).map(np.array)


@given(VECTOR)
def test_exp_log_and_scipy(a):
    C = attitude.exp(a)
    np.testing.assert_allclose(C, Rotation.from_rotvec(a).as_matrix(), rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(attitude.exp(attitude.log(C)), C, rtol=0.0, atol=1e-14)
    if np.linalg.norm(a) < 3.1:
        np.testing.assert_allclose(attitude.log(C), a, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize('size', [0.0, 1e-300, 1e-12, 1e-9, 1e-5])
def test_exp_and_log_of_small_angles(size):
    a = size * np.array([0.6, -0.8, 0.0])
    np.testing.assert_allclose(attitude.log(attitude.exp(a)), a, rtol=1e-9, atol=1e-30)


def test_log_of_half_turns():
    for axis in np.eye(3):
        found = attitude.log(attitude.exp(np.pi * axis))
        np.testing.assert_allclose(np.abs(found), np.pi * axis, rtol=0.0, atol=1e-12)


@given(ANGLE, st.floats(-1.57, 1.57), ANGLE)
def test_euler_there_and_back(psi, theta, phi):
    C = attitude.matrix_from_euler(psi, theta, phi)
    by_scipy = Rotation.from_euler('ZYX', [psi, theta, phi]).as_matrix()
    np.testing.assert_allclose(C, by_scipy, rtol=0.0, atol=1e-15)
    back = attitude.euler_from_matrix(C)
    np.testing.assert_allclose(attitude.matrix_from_euler(*back), C, rtol=0.0, atol=1e-12)
    assert -np.pi / 2 <= back[1] <= np.pi / 2


@pytest.mark.parametrize('theta', [np.pi / 2, -np.pi / 2])
def test_euler_straight_down_and_up(theta):
    C = attitude.matrix_from_euler(0.3, theta, 0.5)
    psi, found, phi = attitude.euler_from_matrix(C)
    assert phi == 0.0
    assert found == pytest.approx(theta)
    np.testing.assert_allclose(attitude.matrix_from_euler(psi, found, phi), C, atol=1e-12)


@given(VECTOR)
def test_quaternion_there_and_back(a):
    C = attitude.exp(a)
    q = attitude.quaternion_from_matrix(C)
    assert q[3] >= 0.0
    by_scipy = Rotation.from_matrix(C).as_quat()
    np.testing.assert_allclose(abs(q @ by_scipy), 1.0, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(attitude.matrix_from_quaternion(3.0 * q), C, rtol=0.0, atol=1e-14)


def test_signs():
    """psi counter-clockwise from grid east, theta > 0 nose down, phi > 0 right side down."""
    north = attitude.matrix_from_euler(np.pi / 2, 0.0, 0.0)
    np.testing.assert_allclose(north @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    assert attitude.grid_heading(north) == pytest.approx(0.0, abs=1e-15)
    assert attitude.grid_heading(np.eye(3)) == pytest.approx(np.pi / 2)
    assert (attitude.matrix_from_euler(0.0, 0.1, 0.0) @ [1, 0, 0])[2] < 0.0
    assert (attitude.matrix_from_euler(0.0, 0.0, 0.1) @ [0, -1, 0])[2] < 0.0
    # the papers' right-forward-up: their y axis is our x axis
    np.testing.assert_array_equal(attitude.C_RFU_TO_FLU @ [0, 1, 0], [1, 0, 0])
    np.testing.assert_array_equal(attitude.C_RFU_TO_FLU @ [1, 0, 0], [0, -1, 0])


def test_vectorised_over_leading_axes():
    rng = np.random.default_rng(3)
    a = rng.normal(size=(4, 5, 3))
    C = attitude.exp(a)
    assert C.shape == (4, 5, 3, 3)
    np.testing.assert_allclose(C[2, 3], attitude.exp(a[2, 3]), atol=1e-15)
    np.testing.assert_allclose(attitude.log(C)[1, 1], attitude.log(C[1, 1]), atol=1e-15)
    q = attitude.quaternion_from_matrix(C)
    np.testing.assert_allclose(attitude.matrix_from_quaternion(q), C, atol=1e-14)
    assert attitude.euler_from_matrix(C)[0].shape == (4, 5)
    b = rng.normal(size=3)
    np.testing.assert_allclose(attitude.skew(a)[0, 0] @ b, np.cross(a[0, 0], b), atol=1e-15)


def test_orthonormalised_is_the_nearest_rotation():
    C = attitude.exp([0.3, -1.0, 2.0])
    noisy = C + 1e-4 * np.random.default_rng(0).normal(size=(3, 3))
    found = attitude.orthonormalised(noisy)
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-15)
    assert np.linalg.norm(found - noisy) <= np.linalg.norm(C - noisy)
    assert np.linalg.det(attitude.orthonormalised(np.diag([1.0, 1.0, -1.0]))) > 0.0


def test_errors():
    with pytest.raises(ValueError, match='zero length'):
        attitude.matrix_from_quaternion([0.0, 0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match='q must have shape'):
        attitude.matrix_from_quaternion([1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match='C must have shape'):
        attitude.log(np.eye(2))


def test_one_matrix_gives_the_bits_of_many():
    rng = np.random.default_rng(7)
    vectors = rng.normal(0.0, 2.0, (400, 3)) * np.repeat([1.0, 1e-6, 1e-12, 0.0], 100)[:, None]
    halves = [np.diag(d) for d in ([1.0, -1, -1], [-1.0, 1, -1], [-1.0, -1, 1])]
    many = np.concatenate([attitude.exp(vectors), halves])
    for function in (attitude.quaternion_from_matrix, attitude.log):
        one_by_one = np.array([function(C) for C in many])
        np.testing.assert_array_equal(one_by_one, function(many))


def test_one_quaternion_gives_the_bits_of_many():
    rng = np.random.default_rng(8)
    many = rng.normal(0.0, 1.0, (400, 4)) * np.repeat([1.0, 1e-6, 1e200, 0.0], 100)[:, None]
    many[300:, 3] = np.arange(1.0, 101.0)
    with np.errstate(over='ignore'):
        found = attitude.matrix_from_quaternion(many)
    one_by_one = np.array([attitude.matrix_from_quaternion(q) for q in many])
    np.testing.assert_array_equal(one_by_one, found)
