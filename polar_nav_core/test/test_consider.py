"""Common errors: the sensitivity is what the error of a filter with fixed gains does."""

import numpy as np
import pytest

from polar_nav_core.kernels.sins import consider as co
from polar_nav_core.kernels.sins import rows
from polar_nav_core.kernels.sins.update import COUPLED, MARKOV, NAV, N

V, OMEGA = np.array([2.0, 0.3, -0.1]), np.array([0.02, -0.01, 0.1])


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
    co.add_common(total, S, sigma)
    np.testing.assert_allclose(total, P + S @ B @ S.T, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(total, total.T)
    J, wide = rng.standard_normal((3, co.COLUMNS)), np.zeros((3, 3))
    co.widen(wide, np.eye(3), J, sigma, 3)
    np.testing.assert_allclose(wide, np.eye(3) + J @ B @ J.T, rtol=1e-12)


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
    J = np.zeros((3, co.COLUMNS))
    co.dvl_common(J, C_b_G, np.eye(3), V, OMEGA, np.array([0.0, 0.0, 9.8]), 9.8)

    def innovation(v_m):
        H, R, z, C = np.zeros((3, N)), np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3))
        nothing = np.zeros(3)
        rows.dvl_rows(
            H, R, z, C, C_b_G, V, nothing, nothing, nothing, nothing, nothing, v_m, np.eye(3),
            np.eye(3), nothing,
        )  # fmt: skip
        return z

    found = (innovation(V + 1e-3 * change) - innovation(V)) / 1e-3
    np.testing.assert_allclose(found, J[:, column], rtol=1e-9, atol=1e-9)


def test_latency_of_the_dvl_is_the_change_of_body_velocity():
    """Steady turn: body velocity is constant, nothing is late; speeding up: the acceleration."""
    speed, rate, C_b_G, J = 2.0, 0.2, np.eye(3), np.zeros((3, co.COLUMNS))
    v, omega = np.array([speed, 0.0, 0.0]), np.array([0.0, 0.0, rate])
    centripetal = np.array([0.0, speed * rate, 9.8])
    co.dvl_common(J, C_b_G, np.eye(3), v, omega, centripetal, 9.8)
    np.testing.assert_allclose(J[:, co.DVL_LATENCY], 0.0, atol=1e-12)
    co.dvl_common(J, C_b_G, np.eye(3), v, omega, centripetal + np.array([0.5, 0.0, 0.0]), 9.8)
    np.testing.assert_allclose(J[:, co.DVL_LATENCY], [0.5, 0.0, 0.0], atol=1e-12)


def test_common_errors_of_fixes():
    rng = np.random.default_rng(10)
    C_e_G, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    r_G, v_G, J = np.array([300.0, -400.0, 50.0]), np.array([1.0, 2.0, 0.1]), np.zeros((3, 12))
    co.fix_common(J, C_e_G, C_e_G.T @ r_G, v_G)
    np.testing.assert_allclose(J[:, co.RANGE_SCALE], -r_G, atol=1e-9)
    np.testing.assert_allclose(J[:, co.ARRAY_TURN], -np.cross([0.0, 0.0, 1.0], r_G), atol=1e-9)
    np.testing.assert_allclose(J[:, co.CLOCK], -v_G)
    np.testing.assert_array_equal(J[:, co.OFFSET : co.OFFSET + 3], -np.eye(3))


def test_a_late_fix_takes_off_what_the_velocity_moved_since():
    S, J = np.zeros((N, co.COLUMNS)), np.zeros((3, co.COLUMNS))
    S[co.DV, co.DVL_YAW], S[co.DR, co.DVL_YAW] = 0.02, 1.0
    H = np.zeros((3, N))
    H[:, co.DR : co.DR + 3] = np.eye(3)
    co.late_sensitivity(J, S, 10.0)
    co.innovation_sensitivity(J, H, S, 3)
    assert J[0, co.DVL_YAW] == pytest.approx(0.8)
