"""The model's seven states in block form against a plain filter on 31 states in NumPy."""

import numpy as np
import pytest
from reference.error_model import system_matrix

from polar_nav_core import attitude
from polar_nav_core.kernels.sins import block as fb
from polar_nav_core.kernels.sins import model as fm
from polar_nav_core.kernels.sins import update as kf
from polar_nav_core.kernels.sins.transition import INVERSE, fill_transition
from polar_nav_core.kernels.vehicle import model as vm
from polar_nav_core.vehicle_model import VehicleModel

N, E = kf.N, fm.E
ALL = N + E
R_E = np.array([5.0e5, -6.0e5, 6.29e6])
V_G = np.array([1.2, -0.7, 0.05])
C_B_G = attitude.matrix_from_euler(0.7, 0.15, -0.18)
F_B = np.array([0.3, -0.2, 9.83])
OMEGA_IB = np.array([0.02, -0.03, 0.04])
OMEGA_IE_G = np.array([3.0e-5, -2.0e-5, 6.3e-5])
INERTIA = np.array([112.8, 175.5, 195.5])
LINEAR, QUADRATIC = np.array([15.0, 90.0, 80.0]), np.array([90.0, 70.0, 90.0])
FORCE = np.array([60.0, 3.0, -6.0])
BUOYANCY, SPEED = 6.0, 1.1
V_R = np.array([0.9, -0.08, 0.06])
CURRENT = np.array([0.4, 0.25])
SCALES = np.concatenate(
    [
        np.repeat([1e-3, 2e-2, 2.0, 1e-6, 1e-4, 1e-3, 5e-3, 0.5], 3),
        [0.1, 0.05, 0.03, 0.3, 0.2, 0.5, 0.2],
    ]
)


def covariance(rng):
    A = rng.normal(size=(ALL, ALL))
    P = A @ A.T + ALL * np.eye(ALL)
    return P * np.outer(SCALES, SCALES)


def split(P):
    return P[:N, :N].copy(), P[:N, N:].copy(), P[N:, N:].copy()


def joined(P, P_xe, P_ee):
    return np.block([[P, P_xe], [P_xe.T, P_ee]])


def assert_near(got, expected, tolerance=1e-9):
    sigma = np.sqrt(np.diagonal(expected))
    assert np.abs((got - expected) / np.outer(sigma, sigma)).max() < tolerance
    assert np.array_equal(got[N:, N:], got[N:, N:].T)


def relative_acceleration(x, e):
    """v_r' with the errors x and e in the estimate; signs of error_model and filter_model."""
    C = attitude.exp(-x[:3]) @ C_B_G
    omega_eb = OMEGA_IB + x[9:12] - C.T @ OMEGA_IE_G
    log_total, share = log_drag() + e[5:7]
    d1, d2 = vm.surge_drag(float(log_total), float(share), SPEED)
    model = VehicleModel(
        INERTIA, np.array([d1, *LINEAR[1:]]), np.array([d2, *QUADRATIC[1:]]), BUOYANCY
    )
    return model.acceleration(V_R + e[:3], omega_eb, C, FORCE)


def log_drag():
    total = (LINEAR[0] + QUADRATIC[0] * SPEED) * SPEED
    return np.array([np.log(total), QUADRATIC[0] * SPEED**2 / total])


def slopes():
    F_ee, F_ex = np.ones((3, E)), np.ones((3, N))
    G, J = np.zeros((3, 3)), np.zeros((3, 3))
    omega_eb = OMEGA_IB - C_B_G.T @ OMEGA_IE_G
    fm.fill_model_slopes(
        F_ee, F_ex, G, J, V_R, omega_eb, C_B_G, OMEGA_IE_G, INERTIA, LINEAR, QUADRATIC,
        BUOYANCY, SPEED,
    )  # fmt: skip
    return F_ee, F_ex, G


def test_slopes_of_the_relative_acceleration_against_differences():
    F_ee, F_ex, _ = slopes()
    for F, size, pick in ((F_ee, E, 1), (F_ex, N, 0)):
        expected = np.zeros((3, size))
        for k in range(size):
            h = 1e-6
            step = [np.zeros(N), np.zeros(E)]
            step[pick][k] = h
            plus = relative_acceleration(*step)
            step[pick][k] = -h
            expected[:, k] = (plus - relative_acceleration(*step)) / (2.0 * h)
        np.testing.assert_allclose(F, expected, rtol=1e-7, atol=1e-9)
        assert np.abs(F).max() > 0.01


def innovation(x, e):
    C = attitude.exp(-x[:3]) @ C_B_G
    current = np.append(CURRENT + e[3:5], 0.0)
    return V_G + x[3:6] - C @ (V_R + e[:3]) - current


def rows():
    H, H_e, z = np.ones((3, N)), np.ones((3, E)), np.zeros(3)
    fm.model_rows(H, H_e, z, C_B_G, V_G, V_R, CURRENT)
    return H, H_e, z


def test_rows_of_the_pseudo_measurement_against_differences():
    H, H_e, z = rows()
    np.testing.assert_allclose(z, innovation(np.zeros(N), np.zeros(E)), atol=1e-15)
    for got, size, pick in ((H, N, 0), (H_e, E, 1)):
        expected = np.zeros((3, size))
        for k in range(size):
            step = [np.zeros(N), np.zeros(E)]
            step[pick][k] = 1e-6
            plus = innovation(*step)
            step[pick][k] = -1e-6
            expected[:, k] = (plus - innovation(*step)) / 2e-6
        np.testing.assert_allclose(got, expected, atol=1e-9)


def transition(dt):
    """Blocks from the kernels, and I + F dt + (F dt)^2/2 of the 31 states."""
    F_ee, F_ex, G = slopes()
    F15 = system_matrix(R_E, V_G, C_B_G, F_B)
    Phi = np.zeros((N, N))
    work = np.zeros(INVERSE), np.zeros((15, 15))
    fill_transition(Phi, *work, R_E, V_G, C_B_G, F_B, dt, 300.0, 0.0)
    Phi_ee, Phi_ex = np.ones((3, E)), np.ones((3, N))
    fm.fill_model_transition(Phi_ee, Phi_ex, F_ee, F_ex, F15, dt)
    F = np.zeros((ALL, ALL))
    F[:15, :15] = F15
    F[N : N + 3, :N], F[N : N + 3, N:] = F_ex, F_ee
    dense = np.eye(ALL) + F * dt + 0.5 * (F * dt) @ (F * dt)
    dense[18:21, 18:21] = Phi[18:21, 18:21]
    return Phi, Phi_ee, Phi_ex, dense, G


def test_transition_has_the_second_order_of_all_states():
    Phi, Phi_ee, Phi_ex, dense, _ = transition(0.1)
    np.testing.assert_allclose(Phi, dense[:N, :N], rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(Phi_ex, dense[N : N + 3, :N], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(Phi_ee, dense[N : N + 3, N:], rtol=1e-12, atol=1e-15)


def test_the_transition_is_the_derivative_of_the_step():
    """v_r over 0.1 s by the kernel: its slope with v_r, to the third order left out."""
    Phi_ee = transition(0.1)[1]
    omega_eb, up = OMEGA_IB - C_B_G.T @ OMEGA_IE_G, np.ascontiguousarray(C_B_G[2])

    def moved(v):
        v = v.copy()
        fm.move_relative_velocity(
            v, np.zeros(3), np.zeros(3), omega_eb, up, FORCE, INERTIA, LINEAR, QUADRATIC,
            BUOYANCY, 0.1, 0.05,
        )  # fmt: skip
        return v

    expected = np.array([(moved(V_R + s) - moved(V_R - s)) / 2e-5 for s in 1e-5 * np.eye(3)]).T
    # The slope is taken at the start here, at the middle of the step in the filter.
    np.testing.assert_allclose(Phi_ee[:, :3], expected, atol=2e-3)


def test_many_steps_of_prediction_and_update_are_those_of_31_states():
    rng = np.random.default_rng(0)
    dense = covariance(rng)
    P, P_xe, P_ee = split(dense)
    Phi, Phi_ee, Phi_ex, Phi_all, G = transition(0.1)
    q, q_e, gyro = 1e-6 * SCALES[:N] ** 2, np.array([2e-6, 1e-5, 1e-9]), 1e-8
    q[:3] = gyro * 0.1
    B = np.zeros((ALL, 3))
    B[:3], B[N : N + 3] = -C_B_G, G
    Q = np.diag(np.concatenate([q, 0.1 * q_e[[0, 0, 0, 1, 1, 2, 2]]]))
    Q[:3, :3] = 0.0
    Q += 0.1 * gyro * B @ B.T
    H, H_e, _ = rows()
    variances = np.array([0.06, 0.06, 1.5])
    w = kf.scratch()
    G_e, K_e, D_e, D_x = (np.zeros((3, n)) for n in (E, E, E, N))
    for step in range(300):
        fm.predict_block(P_xe, P_ee, P, Phi, Phi_ee, Phi_ex, np.zeros((N, E)), np.zeros((E, E)))
        fm.add_model_noise(P_xe, P_ee, q_e, C_B_G, G, gyro, 0.1)
        kf.predict(P, Phi, q, w['M'])
        dense = Phi_all @ dense @ Phi_all.T + Q
        assert_near(joined(P, P_xe, P_ee), dense)
        z = rng.normal(size=3)
        fb.joint_innovation(w['S'], w['PHt'], G_e, P, P_xe, P_ee, H, H_e, np.diag(variances))
        assert kf.cholesky(w['L'], w['S'], 3)
        kf.gain_of(w['K'], D_x, w['PHt'], w['L'], w['S'], 3)
        kf.gain_of(K_e, D_e, G_e, w['L'], w['S'], 3)
        dense, x = updated(dense, np.hstack([H, H_e]), np.diag(variances), z)
        kf.subtract(P, w['K'], D_x, w['K'], D_x)
        kf.subtract(P_xe, w['K'], D_x, K_e, D_e)
        kf.subtract(P_ee, K_e, D_e, K_e, D_e)
        assert_near(joined(P, P_xe, P_ee), dense)
        got = np.concatenate([w['K'].T @ z, K_e.T @ z])
        assert (np.abs(got - x) < 1e-9 * SCALES * np.abs(z).max()).all()
        if step % 2:
            dense = without_e(rng, P, P_xe, P_ee, dense, w, 1 + step % 3)


def without_e(rng, P, P_xe, P_ee, dense, w, m):
    """Update by m rows that do not know e: the 24 states first, the block after."""
    H = np.zeros((3, N))
    H[:m, rng.integers(0, N, 5)] = rng.normal(size=(m, 5)) / SCALES[4]
    R, z = np.eye(3) * 0.5, rng.normal(size=3)
    G_e, K_e, D_e, D_x = (np.zeros((3, n)) for n in (E, E, E, N))
    fb.rows_of_block(G_e, H, P_xe, m)
    kf.innovation_covariance(w['S'], w['PHt'], P, H, R, m)
    assert kf.cholesky(w['L'], w['S'], m)
    kf.gain_of(w['K'], D_x, w['PHt'], w['L'], w['S'], m)
    kf.subtract(P, w['K'], D_x, w['K'], D_x)
    kf.gain_of(K_e, D_e, G_e, w['L'], w['S'], m)
    kf.subtract(P_xe, w['K'], D_x, K_e, D_e)
    kf.subtract(P_ee, K_e, D_e, K_e, D_e)
    expected, correction = updated(dense, np.hstack([H[:m], np.zeros((m, E))]), R[:m, :m], z[:m])
    assert_near(joined(P, P_xe, P_ee), expected)
    got = np.concatenate([w['K'].T @ z, K_e.T @ z])
    assert (np.abs(got - correction) < 1e-8 * SCALES).all()
    return expected


def updated(P, H, R, z):
    """Joseph's form and K z."""
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    A = np.eye(ALL) - K @ H
    P = A @ P @ A.T + K @ R @ K.T
    return 0.5 * (P + P.T), K @ z


@pytest.mark.parametrize('active', [N, kf.USBL])
def test_definiteness_of_the_whole(active):
    rng = np.random.default_rng(3)
    P, P_xe, P_ee = split(covariance(rng))
    P_xe[active:] = 0.0
    L = np.zeros((N, N))

    def definite():
        return kf.cholesky(L, P, active) and fb.is_jointly_definite(
            P_xe, P_ee, L, np.zeros((N, E)), np.zeros((E, E)), active
        )

    assert definite()
    x = slice(0, active)
    left = P_ee - P_xe[x].T @ np.linalg.solve(P[x, x], P_xe[x])
    values = np.linalg.eigvalsh(left)
    P_ee -= 1.01 * values[0] * np.eye(E)
    assert not definite()
