"""Common errors: the sensitivity is what the error of a filter with fixed gains does."""

import numpy as np
import pytest

from polar_nav_core.kernels.sins import consider as co
from polar_nav_core.kernels.sins import rows
from polar_nav_core.kernels.sins.update import COUPLED, MARKOV, NAV, N

V, OMEGA = np.array([2.0, 0.3, -0.1]), np.array([0.02, -0.01, 0.1])
LEVER, NOWHERE = np.array([1.5, -0.4, 0.8]), np.zeros(3)


def attitude_rows(v_G):
    """Rows of a ping with that velocity [m/s] in its block of attitude: -[v x]."""
    H = np.zeros((3, N))
    H[:, :3] = np.cross(v_G, np.eye(3))
    return H


def transition(rng):
    Phi = np.eye(N)
    Phi[:NAV, :COUPLED] += 0.1 * rng.standard_normal((NAV, COUPLED))
    Phi[range(MARKOV, N), range(MARKOV, N)] = rng.uniform(0.5, 1.0, N - MARKOV)
    return Phi


def test_errors_of_constants_are_the_sensitivity_times_the_constants():
    """Any gain, any rows: e of a run with b less e of a run without is S b."""
    rng = np.random.default_rng(7)
    S, M, b = np.zeros((N, co.COLUMNS)), np.zeros((N, N)), rng.standard_normal(co.COLUMNS)
    e, e_0 = np.zeros(N), np.zeros(N)
    for step in range(40):
        Phi = transition(rng)
        co.predict_sensitivity(S, Phi, M)
        e, e_0 = Phi @ e, Phi @ e_0
        m = 1 if step % 3 else 3
        H, K = np.zeros((3, N)), np.zeros((3, N))
        H[:m], K[:m] = rng.standard_normal((2, m, N)) * 0.1
        J, noise = np.zeros((3, co.COLUMNS)), rng.standard_normal(m)
        J[:m] = rng.standard_normal((m, co.COLUMNS))
        own = J[:m].copy()
        co.innovation_sensitivity(J, H, S, m)
        co.update_sensitivity(S, K, J, m)
        e = e - K[:m].T @ (H[:m] @ e + own @ b + noise)
        e_0 = e_0 - K[:m].T @ (H[:m] @ e_0 + noise)
    assert np.linalg.norm(S @ b) > 1.0
    np.testing.assert_allclose(e - e_0, S @ b, rtol=1e-9, atol=1e-9)


def test_covariances_with_the_common_errors():
    rng = np.random.default_rng(8)
    S, sigma = rng.standard_normal((N, co.COLUMNS)), rng.uniform(0.1, 2.0, co.COLUMNS)
    sigma[2] = 0.0
    P = np.cov(rng.standard_normal((N, 100)))
    B = np.diag(sigma**2)
    total = P.copy()
    co.add_common(total, S, sigma, np.empty((co.COLUMNS, N)))
    np.testing.assert_allclose(total, P + S @ B @ S.T, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(total, total.T)
    blocks, own = P.copy(), np.kron(np.eye(N // 3), np.ones((3, 3))) > 0.0
    co.add_common_blocks(blocks, S, sigma)
    np.testing.assert_array_equal(blocks, np.where(own, total, P))
    J, wide = rng.standard_normal((3, co.COLUMNS)), np.zeros((3, 3))
    co.widen(wide, P[:3, :3], J, sigma, 3)
    np.testing.assert_allclose(wide, P[:3, :3] + J @ B @ J.T, rtol=1e-12)
    leading = P[:9, :9].copy()
    co.add_common(leading, S, sigma, np.empty((co.COLUMNS, N)))
    np.testing.assert_array_equal(leading, total[:9, :9])


@pytest.mark.parametrize(
    ('column', 'change'),
    [
        (co.DVL_YAW, np.cross([0.0, 0.0, 1.0], V)),
        (co.DVL_PITCH, np.cross([0.0, 1.0, 0.0], V)),
        (co.DVL_LEVER_X, np.cross(OMEGA, [1.0, 0.0, 0.0])),
        (co.DVL_LEVER_Y, np.cross(OMEGA, [0.0, 1.0, 0.0])),
    ],
)
def test_common_errors_of_the_dvl_are_changes_of_its_rows(column, change):
    """J against the difference of two innovations of the filter's own rows."""
    rng = np.random.default_rng(9)
    C_b_G, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    C_m_b, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    J = np.full((3, co.COLUMNS), 7.0)
    H = attitude_rows(C_b_G @ (V - np.cross(OMEGA, LEVER)))
    co.dvl_common(J, C_b_G, H, OMEGA, NOWHERE, LEVER)

    def innovation(v_b):
        H, R, z, C = np.zeros((3, N)), np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3))
        nothing = np.zeros(3)
        rows.dvl_rows(
            H, R, z, C, C_b_G, V, nothing, nothing, nothing, nothing, nothing, C_m_b.T @ v_b,
            np.eye(3), C_m_b, nothing,
        )  # fmt: skip
        return z

    found = (innovation(V + 1e-3 * change) - innovation(V)) / 1e-3
    np.testing.assert_allclose(found, J[:, column], rtol=1e-9, atol=1e-9)


def test_a_dvl_has_no_other_common_errors():
    J = np.full((3, co.COLUMNS), 7.0)
    co.dvl_common(J, np.eye(3), attitude_rows(V), OMEGA, NOWHERE, NOWHERE)
    assert not J[:, :6].any()
    assert not J[:, 11:].any()


def test_latency_of_the_dvl_is_the_acceleration_in_the_axes_of_the_body():
    rng = np.random.default_rng(11)
    C_b_G, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    a_b, J = rng.standard_normal(3), np.full((3, co.COLUMNS), 7.0)
    co.dvl_common(J, C_b_G, attitude_rows(V), OMEGA, a_b, LEVER)
    np.testing.assert_allclose(J[:, co.DVL_LATENCY], C_b_G @ a_b, rtol=1e-12)


def test_the_zero_of_depth_is_in_its_one_row():
    J = np.full((3, co.COLUMNS), 7.0)
    co.depth_common(J)
    expected = np.zeros((3, co.COLUMNS))
    expected[0, 11] = 1.0
    np.testing.assert_array_equal(J, expected)


def test_a_conflict_widens_velocity_and_position_only():
    rng = np.random.default_rng(12)
    P, u = np.cov(rng.standard_normal((N, 100))), rng.standard_normal(6)
    u[1] = 0.0
    expected = P.copy()
    expected[3:9, 3:9] += np.outer(u, u)
    co.add_conflict(P, u)
    np.testing.assert_allclose(P, expected, rtol=1e-14, atol=0.0)


def test_rows_beyond_those_measured_are_left_alone():
    rng = np.random.default_rng(13)
    S, H = rng.standard_normal((N, co.COLUMNS)), rng.standard_normal((3, N))
    for m in (1, 2):
        J, wide, K = np.full((3, co.COLUMNS), 7.0), np.full((3, 3), 7.0), np.full((3, N), 7.0)
        co.innovation_sensitivity(J, H, S, m)
        assert (J[m:] == 7.0).all()
        sigma = rng.uniform(0.1, 1.0, co.COLUMNS)
        co.widen(wide, np.eye(3), J, sigma, m)
        np.testing.assert_allclose(
            wide[:m, :m], np.eye(m) + J[:m] @ np.diag(sigma**2) @ J[:m].T, rtol=1e-12
        )
        assert (wide[m:] == 7.0).all()
        after = S.copy()
        co.update_sensitivity(after, K, J, m)
        np.testing.assert_allclose(after, S - K[:m].T @ J[:m], rtol=1e-12, atol=1e-12)


def test_common_errors_of_fixes():
    rng = np.random.default_rng(10)
    C_e_G, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    r_G, v_G = np.array([300.0, -400.0, 50.0]), np.array([1.0, 2.0, 0.1])
    J = np.full((3, co.COLUMNS), 7.0)
    co.fix_common(J, C_e_G, C_e_G.T @ r_G, v_G, np.zeros((3, 7)))
    np.testing.assert_allclose(J[:, co.RANGE_SCALE], -r_G, atol=1e-9)
    np.testing.assert_allclose(J[:, co.ARRAY_TURN], -np.cross([0.0, 0.0, 1.0], r_G), atol=1e-9)
    np.testing.assert_allclose(J[:, co.CLOCK], -v_G)
    np.testing.assert_array_equal(J[:, co.OFFSET : co.OFFSET + 3], -np.eye(3))
    assert not J[:, 6:].any()
    common_e = rng.standard_normal((3, 7))
    co.fix_common(J, C_e_G, C_e_G.T @ r_G, v_G, common_e)
    np.testing.assert_allclose(J[:, co.LEADER :], -C_e_G @ common_e[:, 3:], atol=1e-12)


def test_a_late_fix_takes_off_what_the_velocity_moved_since():
    S, J = np.zeros((N, co.COLUMNS)), np.zeros((3, co.COLUMNS))
    S[3:6, co.DVL_YAW], S[6:9, co.DVL_YAW] = [0.02, -0.01, 0.03], [1.0, 2.0, 3.0]
    H = np.zeros((3, N))
    H[:, 6:9] = np.eye(3)
    co.late_sensitivity(J, S, 10.0)
    co.innovation_sensitivity(J, H, S, 3)
    np.testing.assert_allclose(J[:, co.DVL_YAW], [0.8, 2.1, 2.7])
    assert not np.delete(J, co.DVL_YAW, axis=1).any()
