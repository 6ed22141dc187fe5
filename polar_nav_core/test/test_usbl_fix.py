"""USBL: least squares in array axes, moving ends, to ECEF with covariance, innovation."""

import numpy as np
import pytest
from compiled import jit_only
from core_jacobian import LEVER, navigation_at, numeric_jacobian
from core_places import VECTORS, position
from hypothesis import given
from hypothesis import strategies as st
from reference import usbl as usbl_rows

from polar_nav_core import attitude, earth, grid, usbl
from polar_nav_core.error_model import X

SIGMA_C, SIGMA_R, SIGMA_H = 1e-3, 0.5, 0.1
COSINES = SIGMA_C**2 * np.eye(2)
UP_A = attitude.exp([0.1, -0.15, 0.0]).T[:, 2]


def solve(p, up_a=(0.0, 0.0, 1.0), noise=(0.0, 0.0, 0.0, 0.0)):
    """Measure a true vector with given noise in c_x, c_y, distance, height; solve."""
    r = np.linalg.norm(p)
    c = p[:2] / r + noise[:2]
    n = np.array([*c, np.copysign(np.sqrt(max(0.0, 1.0 - c @ c)), p[2])])
    return usbl.relative_in_array(
        n, COSINES, r + noise[2], SIGMA_R**2, up_a, np.dot(up_a, p) + noise[3], SIGMA_H**2
    )


@given(st.floats(-np.pi, np.pi), st.floats(-1.4, 1.4), st.floats(5.0, 8000.0), st.booleans())
def test_perfect_measurements_give_the_vector_back(azimuth, elevation, distance, tilted):
    p = distance * np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    found = solve(p, UP_A if tilted else (0.0, 0.0, 1.0))
    np.testing.assert_allclose(found.vector, p, rtol=0.0, atol=1e-9 * distance)
    assert np.all(np.linalg.eigvalsh(found.covariance) > 0.0)


@pytest.mark.parametrize('height', [0.0, 20.0, 100.0, 500.0])
@pytest.mark.parametrize('up_a', [(0.0, 0.0, 1.0), UP_A], ids=['level', 'tilted'])
def test_least_squares_is_regular_at_equal_depths(height, up_a):
    """Where X = h c_x / s has a standard deviation of 2.9 m, 71 m, 1768 m and infinity."""
    horizontal = np.sqrt(0.5 * (1000.0**2 - height**2))
    p = np.array([horizontal, horizontal, -height])
    sigma_x = np.sqrt(solve(p, up_a).covariance[0, 0])
    assert 0.6 < sigma_x < 0.85
    if up_a[2] == 1.0 and height <= 100.0:
        assert sigma_x == pytest.approx(0.79, abs=0.01)
    if height > 0.0:
        # the printed formula (21), by its derivatives (h c_x / s, s = h / R)
        c = horizontal / 1000.0
        s = height / 1000.0
        printed = np.sqrt(
            (c / s * SIGMA_H) ** 2
            + (height * (1 - c * c) / s**3 * SIGMA_C) ** 2
            + (height * c * c / s**3 * SIGMA_C) ** 2
        )
        assert printed > 3.0 * sigma_x


@pytest.mark.parametrize(
    'p', [(700.0, -700.0, -1.0), (300.0, 200.0, -900.0), (50.0, 900.0, 300.0)]
)
@pytest.mark.parametrize('up_a', [(0.0, 0.0, 1.0), UP_A], ids=['level', 'tilted'])
def test_covariance_is_what_noise_does(p, up_a):
    p = np.array(p)
    rng = np.random.default_rng(11)
    scale = np.array([SIGMA_C, SIGMA_C, SIGMA_R, SIGMA_H])
    errors = np.array([solve(p, up_a, scale * n).vector - p for n in rng.normal(size=(600, 4))])
    P = solve(p, up_a).covariance
    normalised = np.einsum('ni,ij,nj->n', errors, np.linalg.inv(P), errors)
    # mean of chi-square with 3 degrees of freedom over 600 draws: 3 +- 5 sigma of 0.1
    assert 2.5 < np.mean(normalised) < 3.5
    assert np.all(np.abs(np.mean(errors, axis=0)) < 6.0 * np.sqrt(np.diag(P) / 600) + 0.02)


def test_without_heights_the_vertical_is_honestly_unknown_near_the_plane():
    p = np.array([1000.0, 0.0, -1.0])
    found = usbl.relative_in_array(p / np.linalg.norm(p), COSINES, np.linalg.norm(p), SIGMA_R**2)
    assert np.all(np.isfinite(found.covariance))
    assert 400.0 < np.sqrt(found.covariance[2, 2]) < 1100.0
    below = np.array([100.0, 50.0, -900.0])
    steep = usbl.relative_in_array(
        below / np.linalg.norm(below), COSINES, np.linalg.norm(below), SIGMA_R**2
    )
    np.testing.assert_allclose(steep.vector, below, atol=1e-6)
    assert np.sqrt(steep.covariance[2, 2]) < 0.6


def walk_of_one_fix(p_leader, p_follower, sound_speed, turn_around):
    """Solve t1..t4 by iteration for moving ends; returns t3, t4 (t1 = 0)."""
    t2 = 0.0
    for _ in range(50):
        t2 = np.linalg.norm(p_follower(t2) - p_leader(0.0)) / sound_speed
    t3 = t2 + turn_around
    t4 = t3
    for _ in range(50):
        t4 = t3 + np.linalg.norm(p_follower(t3) - p_leader(t4)) / sound_speed
    return t3, t4


@pytest.mark.parametrize('leader_speed', [0.0, 3.0, 15.0])
@pytest.mark.parametrize('turn_around', [0.0, 0.05])
@pytest.mark.parametrize(
    'offset', [(100.0, 0, 0), (600, -300, -80), (-3000, 500, -200), (0, 0, -50)]
)
def test_range_at_reply_with_moving_ends(leader_speed, turn_around, offset):
    v_leader = leader_speed * np.array([0.6, 0.8, 0.0])
    v_follower = np.array([-2.0, 2.0, 0.3])
    offset = np.array(offset, dtype=float)

    def p_leader(t):
        return v_leader * t

    def p_follower(t):
        return offset + v_follower * t

    t3, t4 = walk_of_one_fix(p_leader, p_follower, 1450.0, turn_around)
    truth = p_follower(t3) - p_leader(t4)
    half_path = 0.5 * 1450.0 * (t4 - turn_around)
    u = truth / np.linalg.norm(truth)
    found = usbl.range_at_reply(half_path, 0.25, u, p_leader(t4) - p_leader(0.0))
    # exact but for what the follower moves between hearing and replying, of which half is left
    moved = np.linalg.norm(v_follower) * turn_around
    assert abs(found.distance - np.linalg.norm(truth)) <= 0.5 * moved + 1e-9
    if leader_speed == 15.0 and abs(u @ v_leader) > 1.0:
        uncorrected = abs(half_path - np.linalg.norm(truth))
        assert abs(found.distance - np.linalg.norm(truth)) < 0.3 * uncorrected
    # the closed form solves |r u + D| + r = L
    D = p_leader(t4)
    assert np.linalg.norm(found.distance * u + D) + found.distance == pytest.approx(2 * half_path)
    # its variance is that of its own derivative
    step = 1e-3
    ahead = usbl.range_at_reply(half_path + step, 0.25, u, D).distance
    slope = (ahead - found.distance) / step
    assert found.variance == pytest.approx(slope**2 * 0.25, rel=1e-4)


def test_range_of_an_impossible_triangle_is_refused():
    with pytest.raises(ValueError, match='too short for a displacement'):
        usbl.range_at_reply(1.0, 0.1, [1, 0, 0], [3.0, 0, 0])


@pytest.mark.parametrize('case', VECTORS['usbl'])
def test_reference_vector(case):
    """Leader pose and array measurement -> follower position."""
    c = np.array([case['cos_theta_mx'], case['cos_theta_my']])
    n = np.array([*c, -np.sqrt(1.0 - c @ c)])
    C_b_G = np.array(case['leader_C_b_G'])
    in_array = usbl.relative_in_array(
        n, COSINES, case['range'], SIGMA_R**2, C_b_G[2], case['h_up_minus_rel'], SIGMA_H**2
    )
    np.testing.assert_allclose(in_array.vector, case['array_xyz'], rtol=0.0, atol=1e-8)
    relative = usbl.relative_in_grid(in_array, np.eye(3), np.zeros(3), C_b_G, np.zeros((3, 3)))
    np.testing.assert_allclose(relative.vector, case['rel_in_leader_grid_ENU'], atol=1e-8)
    follower = usbl.transponder_position(case['leader_R_e'], relative)
    np.testing.assert_allclose(follower.vector, case['follower_R_e'], rtol=0.0, atol=1e-7)


@pytest.mark.parametrize('name', ['exact north pole', '80N 120E', '75S 60W', '89.99N at 180W'])
@jit_only
def test_covariance_to_ecef_is_what_errors_do(name):
    """Array noise, leader attitude and position together, mounting and lever arm included."""
    rng = np.random.default_rng(7)
    C_b_G = attitude.matrix_from_euler(0.5, 0.05, -0.1)
    C_a_b, lever_b = attitude.exp([np.pi, 0.0, 0.2]), np.array([2.0, -0.5, -1.0])
    P_phi = np.diag([1e-4, 1e-4, 9e-4]) ** 2 * 100.0
    P_r = np.diag([0.3, 0.4, 0.5]) ** 2
    leader = position(name)
    p_a = np.array([500.0, -300.0, 400.0])
    exact = solve(p_a)
    relative = usbl.relative_in_grid(exact, C_a_b, lever_b, C_b_G, P_phi)
    np.testing.assert_allclose(relative.vector, C_b_G @ (C_a_b @ p_a + lever_b), atol=1e-6)
    fix = usbl.transponder_position(leader, relative, P_r)
    samples = []
    for _ in range(1500):
        noisy = usbl.Relative(rng.multivariate_normal(p_a, exact.covariance), exact.covariance)
        turned = attitude.exp(rng.multivariate_normal(np.zeros(3), P_phi)) @ C_b_G
        one = usbl.relative_in_grid(noisy, C_a_b, lever_b, turned, P_phi)
        moved = leader + rng.multivariate_normal(np.zeros(3), P_r)
        samples.append(usbl.transponder_position(moved, one).vector - fix.vector)
    normalised = np.einsum('ni,ij,nj->n', samples, np.linalg.inv(fix.covariance), samples)
    assert 2.75 < np.mean(normalised) < 3.25


def test_leader_and_follower_grids_differ():
    """A vector added in the follower's grid axes instead of the leader's is metres wrong."""
    leader = earth.ecef_from_geodetic(np.radians(80.0), np.radians(120.0), -100.0)
    relative = usbl.Relative(np.array([3000.0, 1000.0, 0.0]), np.eye(3))
    fix = usbl.transponder_position(leader, relative)
    other = leader + grid.ecef_to_grid(fix.vector).T @ relative.vector
    assert 0.5 < np.linalg.norm(fix.vector - other) < 5.0


@pytest.mark.parametrize('name', ['exact north pole', 'exact south pole', '80N 120E', '75S 60W'])
@pytest.mark.parametrize('with_bias', [True, False])
def test_innovation_and_jacobian(name, with_bias):
    navigation = navigation_at(name)
    C_a_e = attitude.exp([0.3, -1.0, 2.0]) if with_bias else None
    fix = navigation.r_e + np.array([3.0, -2.0, 1.0])
    H = usbl_rows.jacobian(navigation, LEVER, C_a_e)
    numeric = numeric_jacobian(lambda n: usbl_rows.innovation(n, fix, LEVER, C_a_e), navigation)
    np.testing.assert_allclose(H, numeric, rtol=0.0, atol=1e-5)
    assert np.any(H[:, X.usbl_bias_a]) == with_bias


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'distance': 0.0}, 'must be positive'),
        ({'distance_variance': -1.0}, 'must be positive'),
        ({'distance': np.nan}, 'must be positive'),
        ({'up_a': [0.0, 0.0, 1.0], 'up_variance': 0.0}, 'up_variance'),
    ],
)
def test_bad_measurements_are_refused(change, words):
    arguments = {
        'direction_a': [0.6, 0.0, -0.8],
        'cosine_covariance': COSINES,
        'distance': 100.0,
        'distance_variance': 1.0,
    }
    with pytest.raises(ValueError, match=words):
        usbl.relative_in_array(**{**arguments, **change})
