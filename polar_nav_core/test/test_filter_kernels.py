"""Filter kernels against NumPy twins, rows against central differences of their own innovation."""

import numpy as np
import pytest
from reference.error_model import system_matrix
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from polar_nav_core import attitude, earth, grid
from polar_nav_core.kernels.sins import imu as filter_imu
from polar_nav_core.kernels.sins import rows as filter_rows
from polar_nav_core.kernels.sins import update as kf
from polar_nav_core.kernels.sins import walk as filter_walk
from polar_nav_core.kernels.sins.transition import INVERSE, fill_transition

N = kf.N
R_E = earth.ecef_from_geodetic(np.deg2rad(84.0), np.deg2rad(-130.0), -80.0)
V_G = np.array([2.0, -1.5, 0.2])
C_B_G = attitude.matrix_from_euler(0.7, 0.05, -0.08)
OMEGA = np.array([0.02, -0.03, 0.04])
F_B = np.array([0.3, -0.2, 9.83])


def transition(dt=0.1, tau_usbl=0.0):
    return both_ways(dt, tau_usbl)[0]


def both_ways(dt, tau_usbl):
    Phi, inverse = np.zeros((N, N)), np.zeros(INVERSE)
    fill_transition(
        Phi,
        inverse,
        np.zeros((15, 15)),
        R_E.copy(),
        V_G.copy(),
        C_B_G.copy(),
        F_B.copy(),
        dt,
        300.0,
        tau_usbl,
    )
    return Phi, inverse


def inverse_of(Phi):
    """As `fill_transition` leaves it, of any transition that has its structure."""
    inverse, dense = np.zeros(INVERSE), np.linalg.inv(Phi)
    inverse[:9, :15] = dense[:9, :15]
    inverse[9, :6] = 1.0 / np.diagonal(Phi)[18:]
    return inverse


def covariance(rng, scale=None):
    A = rng.normal(size=(N, N))
    P = A @ A.T + N * np.eye(N)
    s = np.ones(N) if scale is None else scale
    return P * np.outer(s, s)


SCALES = np.repeat([1e-4, 1e-2, 1.0, 1e-7, 1e-5, 1e-4, 5e-3, 0.5], 3)


def test_transition_is_the_matrix_exponential_to_third_order():
    F = np.zeros((N, N))
    F[:15, :15] = system_matrix(R_E, V_G, C_B_G, F_B)
    F[18:21, 18:21] = -np.eye(3) / 300.0
    F[21:24, 21:24] = -np.eye(3) / 50.0
    # The remainder is F^3 dt^3/6, most of it gravity turning a gyro bias into position.
    errors = [np.abs(transition(dt, 50.0) - expm(F * dt)).max() for dt in (0.4, 0.2, 0.1)]
    assert errors[2] < 1.05 * 9.84 * 0.1**3 / 6.0
    assert errors[0] / errors[1] == pytest.approx(8.0, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(8.0, rel=0.05)


def test_predict_is_phi_p_phi_transposed():
    rng = np.random.default_rng(0)
    P, Phi, q = covariance(rng, SCALES), transition(), rng.uniform(0, 1e-9, N)
    expected = Phi @ P @ Phi.T + np.diag(q)
    kf.predict(P, Phi, q, np.zeros((N, N)))
    np.testing.assert_allclose(P, expected, rtol=1e-12, atol=1e-16)
    assert np.array_equal(P, P.T)


@pytest.mark.parametrize('m', [1, 2, 3])
def test_update_is_the_textbook_update(m):
    rng = np.random.default_rng(m)
    P = covariance(rng, SCALES)
    H = np.zeros((3, N))
    H[:m] = rng.normal(size=(m, N))
    A = rng.normal(size=(3, 3))
    R = A @ A.T + np.eye(3)
    z = rng.normal(size=3)
    S = H[:m] @ P @ H[:m].T + R[:m, :m]
    K = P @ H[:m].T @ np.linalg.inv(S)
    IKH = np.eye(N) - K @ H[:m]
    expected = IKH @ P @ IKH.T + K @ R[:m, :m] @ K.T
    w, x, got = kf.scratch(), np.zeros(N), P.copy()
    kf.innovation_covariance(w['S'], w['PHt'], got, H, R, m)
    assert kf.cholesky(w['L'], w['S'], m)
    nis = kf.nis_of(w['L'], z, w['w'], m)
    kf.update(got, x, w['S'], z, m, w['K'], w['PHt'], w['L'], w['M'])
    assert nis == pytest.approx(z[:m] @ np.linalg.solve(S, z[:m]), rel=1e-9)
    np.testing.assert_allclose(x, K @ z[:m], rtol=1e-8, atol=1e-14)
    np.testing.assert_allclose(got, expected, rtol=1e-7, atol=1e-15)
    assert np.array_equal(got, got.T)


def test_update_stays_definite_where_the_short_form_does_not():
    """A measurement 1e-8 times the prior, repeatedly: Joseph's form survives the cancellation."""
    P = np.diag(SCALES**2) * 1e6
    w, x = kf.scratch(), np.zeros(N)
    H = np.zeros((3, N))
    H[:, 6:9] = np.eye(3)
    H[:, 0:3] = 100.0 * attitude.skew([1.0, 2.0, 3.0])
    R = 1e-8 * np.eye(3)
    for _ in range(200):
        kf.innovation_covariance(w['S'], w['PHt'], P, H, R, 3)
        assert kf.cholesky(w['L'], w['S'], 3)
        kf.update(P, x, w['S'], np.zeros(3), 3, w['K'], w['PHt'], w['L'], w['M'])
        assert kf.cholesky(w['LP'], P, N)


def test_cholesky_tells_what_is_not_definite():
    L = np.zeros((N, N))
    P = np.eye(N)
    assert kf.cholesky(L, P, N)
    assert kf.is_positive_definite(P, N, L)
    for bad in (-1.0, 0.0, np.nan, np.inf):
        P[5, 5] = bad
        assert not kf.cholesky(L, P, N)
        assert not kf.is_positive_definite(P, N, L)
        assert kf.is_positive_definite(P, 5, L)


def test_both_tests_of_definiteness_agree_with_the_least_eigenvalue():
    rng = np.random.default_rng(11)
    verdicts = []
    for k in range(40):
        A = rng.normal(size=(N, N))
        least = (-1.0) ** k * 10.0 ** rng.uniform(-6.0, 0.0)
        values, vectors = np.linalg.eigh(A @ A.T)
        values[0] = least
        P = (vectors * values) @ vectors.T
        P = 0.5 * (P + P.T)
        assert kf.cholesky(np.zeros((N, N)), P, N) == (least > 0.0)
        verdicts.append(kf.is_positive_definite(P, N, np.zeros((N, N))) == (least > 0.0))
        L = np.zeros((N, N))
        if kf.cholesky(L, P, N):
            np.testing.assert_allclose(L @ L.T, P, rtol=1e-9, atol=1e-9)
    assert all(verdicts)


def test_surroundings_held_over_a_filter_step_move_nothing():
    """A minute of turns at 3 m/s while diving: held for ten samples, and evaluated at each."""
    ends = []
    for every in (10, 1):
        C, v, r = C_B_G.copy(), np.array([2.5, -1.5, -0.5]), R_E.copy()
        increments, sums, held, zero = np.zeros((4, 3)), np.zeros((6, 3)), np.zeros(8), np.zeros(3)
        for k in range(6000):
            if k % every == 0:
                filter_imu.hold_surroundings(held, v, r, 0.01 * every)
            omega = np.array([0.02 * np.sin(0.1 * k), 0.01, 0.1 * np.cos(0.003 * k)])
            f = C.T @ np.array([0.1 * np.sin(0.01 * k), 0.1 * np.cos(0.02 * k), 9.83])
            filter_imu.imu_step(
                C, v, r, zero, zero, omega, f, increments, 0.01, 0.01 if k else 0.0, sums, held
            )
        ends.append((C, v, r))
    (C, v, r), (exact_C, exact_v, exact_r) = ends
    np.testing.assert_allclose(C, exact_C, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(v, exact_v, rtol=0.0, atol=5e-9)
    np.testing.assert_allclose(r, exact_r, rtol=0.0, atol=1e-6)
    assert not np.array_equal(r, exact_r)


def test_rows_times_inverse():
    rng = np.random.default_rng(3)
    X, Phi = rng.normal(size=(3, N)), transition(1.0, 40.0)
    Phi[:9, :9] += 0.3 * rng.normal(size=(9, 9))
    expected = X @ np.linalg.inv(Phi)
    filter_walk.rows_times(X, inverse_of(Phi), 3)
    np.testing.assert_allclose(X, expected, rtol=1e-9, atol=1e-9)


def test_inverse_of_a_transition_to_the_fourth_order():
    """Against the dense inverse, in units of the sigmas that the states have."""
    off = []
    for dt in (1.0, 0.5, 0.1):
        Phi, found = both_ways(dt, 50.0)
        difference = (found - inverse_of(Phi))[:, :15]
        off.append(np.abs(difference[:9] * SCALES[:15] / SCALES[:9, None]).max())
        np.testing.assert_allclose(found[9], inverse_of(Phi)[9], rtol=1e-15)
    assert off[0] / off[1] == pytest.approx(16.0, rel=0.05)
    assert off[2] < 1e-12


def test_walk_forward_refers_rows_and_innovation_to_now():
    """Rings that wrap, several corrections at one step, some before the first transition."""
    rng = np.random.default_rng(4)
    steps, ring = 12, 7
    Phis = {j: np.eye(N) + 0.05 * np.triu(rng.normal(size=(N, N)), 1) for j in range(1, steps + 1)}
    for Phi in Phis.values():  # the structure the kernel relies on
        Phi[9:, :] = np.diag(np.diag(Phi))[9:, :]
        Phi[:9, 15:] = 0.0
    stored = np.zeros((ring, *INVERSE))
    for j, Phi in Phis.items():
        stored[j % ring] = inverse_of(Phi)
    first, begin = 6, 9
    applied = [
        (6, rng.normal(size=N)),
        (6, rng.normal(size=N)),
        (8, rng.normal(size=N)),
        (12, rng.normal(size=N)),
    ]
    corrections, at = np.zeros((5, N)), np.zeros(5, dtype=np.int64)
    for i, (step, c) in enumerate(applied):
        corrections[(begin + i) % 5] = c
        at[(begin + i) % 5] = step
    H, z = rng.normal(size=(3, N)), rng.normal(size=3)
    G, expected_z = H.copy(), z.copy()
    for step in range(first, steps + 1):
        if step > first:
            G = G @ np.linalg.inv(Phis[step])
        for s, c in applied:
            if s == step:
                expected_z = expected_z - G @ c
    filter_walk.walk_forward(
        H,
        z,
        3,
        stored,
        first,
        steps,
        corrections,
        at,
        begin,
        begin + 4,
    )
    np.testing.assert_allclose(H, G, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(z, expected_z, rtol=1e-9, atol=1e-9)


class State:
    """Estimate whose error is x: hat = truth disturbed by the error the filter's signs define."""

    def __init__(self, x=None):
        x = np.zeros(N) if x is None else x
        self.C_b_G = attitude.exp(-x[0:3]) @ C_B_G
        self.v_G = V_G + x[3:6]
        self.r_e = R_E + x[6:9]
        self.bg = -x[9:12]
        self.scale = np.array([0.01, -0.02, 0.005]) - x[15:18]
        self.markov = np.array([0.02, 0.01, -0.03]) - x[18:21]
        self.usbl = -x[21:24]


def central(z_of, columns, step):
    H = np.zeros((len(z_of(np.zeros(N))), N))
    for k in range(N):
        e = np.zeros(N)
        e[k] = step[k]
        H[:, k] = (z_of(e) - z_of(-e)) / (2 * step[k])
    return H[:, columns]


STEP = np.repeat([1e-3, 1e-4, 1e-1, 1e-6, 1e-5, 1e-5, 1e-4, 1e-2], 3)
LEVER = np.array([1.5, -0.4, 0.8])
MOUNT = attitude.matrix_from_euler(0.8, 0.02, np.pi)
OMEGA_IE_G = grid.earth_rate(R_E)
TRUE_MEASURED_DVL = np.array([2.1, -0.3, 0.4])


def dvl_z(x, H=None, R=None):
    s, z = State(x), np.zeros(3)
    H = np.zeros((3, N)) if H is None else H
    R = np.zeros((3, 3)) if R is None else R
    filter_rows.dvl_rows(
        H, R, z, np.zeros((3, 3)), s.C_b_G, s.v_G, OMEGA.copy(), OMEGA_IE_G, s.bg, s.scale,
        s.markov, TRUE_MEASURED_DVL, np.diag([1e-4, 4e-4, 9e-4]), MOUNT, LEVER,
    )  # fmt: skip
    return z


def test_dvl_rows_are_the_derivative_of_the_innovation():
    # An innovation near zero: the block [V x] is taken at the DVL's velocity, which is v_G then.
    global V_G
    keep = V_G
    try:
        V_G = V_G - dvl_z(np.zeros(N))
        H, R = np.zeros((3, N)), np.zeros((3, 3))
        dvl_z(np.zeros(N), H, R)
        blocks = [*range(6), *range(9, 12), *range(15, 21)]
        expected = central(dvl_z, blocks, STEP)
        # Left out: the Earth rate under the lever turns with the attitude error.
        np.testing.assert_allclose(
            H[:, :3], expected[:, :3], atol=5e-6 + 7.3e-5 * np.linalg.norm(LEVER)
        )
        np.testing.assert_allclose(H[:, blocks[3:]], expected[:, 3:], atol=5e-6)
        C_m_G = C_B_G @ MOUNT
        np.testing.assert_allclose(R, C_m_G @ np.diag([1e-4, 4e-4, 9e-4]) @ C_m_G.T, atol=1e-15)
    finally:
        V_G = keep


def place(s, lever=LEVER):
    C_e_G, ie, lever_G, point, velocity = np.zeros((3, 3)), *(np.zeros(3) for _ in range(4))
    height = filter_imu.place(
        s.r_e, s.v_G, np.ascontiguousarray(s.C_b_G), lever, C_e_G, ie, lever_G, point, velocity
    )
    return height, C_e_G, lever_G, point, velocity


def test_depth_rows_are_the_derivative_of_the_innovation():
    def z_of(x, H=None):
        s, z = State(x), np.zeros(3)
        height, C_e_G, *_ = place(s)
        H = np.zeros((3, N)) if H is None else H
        filter_rows.depth_rows(
            H,
            np.zeros((3, 3)),
            z,
            C_e_G,
            np.ascontiguousarray(s.C_b_G),
            height,
            -79.0,
            0.01,
            LEVER,
        )
        return z[:1]

    H = np.zeros((3, N))
    z_of(np.zeros(N), H)
    np.testing.assert_allclose(H[:1], central(z_of, list(range(N)), STEP), atol=1e-6)


def test_fix_rows_are_the_derivative_of_the_innovation():
    measured = place(State())[3] + np.array([0.4, -0.3, 0.2])
    C_a_G = attitude.matrix_from_euler(0.4, 0.0, 0.0)
    R_e = 4.0 * np.eye(3)
    C_e_G = grid.ecef_to_grid(R_E)

    def z_of(x, H=None):
        s, z = State(x), np.zeros(3)
        _, _, lever_G, point, _ = place(s)
        H = np.zeros((3, N)) if H is None else H
        filter_rows.fix_rows(
            H, np.zeros((3, 3)), z, C_e_G, lever_G, point, measured, R_e, C_a_G, s.usbl
        )
        return z

    H = np.zeros((3, N))
    z_of(np.zeros(N), H)
    # Grid axes turn by 1e-7 rad over a metre; with a lever that is all that is left out.
    np.testing.assert_allclose(H, central(z_of, list(range(N)), STEP), atol=5e-6)


def test_feed_back_undoes_an_error():
    rng = np.random.default_rng(5)
    x = rng.normal(size=N) * np.repeat([1e-2, 1.0, 10.0, 1e-3, 1e-2, 1e-2, 1e-2, 1.0], 3)
    s = State(x)
    C, v, r = np.ascontiguousarray(s.C_b_G), s.v_G, s.r_e
    biases = [np.zeros(3) for _ in range(5)]
    kf.feed_back(x, C, v, r, *biases)
    np.testing.assert_allclose(C, C_B_G, atol=1e-14)
    np.testing.assert_allclose(v, V_G, atol=1e-14)
    np.testing.assert_allclose(r, R_E, atol=1e-8)
    np.testing.assert_allclose(np.concatenate(biases), x[9:], atol=1e-15)


@pytest.mark.parametrize('angle', [0.0, 1e-9, 1e-4, 9.9e-4, 1.01e-3, 1e-2, 1.0, 3.0])
def test_feed_back_turns_by_the_rotation_of_any_size(angle):
    """Small angles by a series, which goes over into sines without a step."""
    phi = angle * np.array([2.0, -1.0, 2.0]) / 3.0
    x = np.zeros(N)
    x[:3] = phi
    C, others = C_B_G.copy(), [np.zeros(3) for _ in range(7)]
    kf.feed_back(x, C, *others)
    np.testing.assert_allclose(C, Rotation.from_rotvec(phi).as_matrix() @ C_B_G, atol=1e-15)
    assert not np.any(others)


def test_place_gives_frames_and_the_point():
    s = State()
    height, C_e_G, lever_G, point, velocity = place(s)
    np.testing.assert_allclose(C_e_G, grid.ecef_to_grid(R_E), atol=1e-12)
    np.testing.assert_allclose(lever_G, C_B_G @ LEVER, atol=1e-12)
    np.testing.assert_allclose(point, R_E + C_e_G.T @ C_B_G @ LEVER, atol=1e-8)
    np.testing.assert_allclose(velocity, C_e_G.T @ V_G, atol=1e-12)
    assert height == pytest.approx(-80.0, abs=1e-6)
