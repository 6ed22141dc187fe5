"""Kernels of station mode against the reference vectors and against plain NumPy."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import station_oracle as oracle

from polar_nav_core import attitude
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.station import arrays
from polar_nav_core.kernels.station import (
    attitude as station_attitude,
)
from polar_nav_core.kernels.station import (
    depth as station_depth,
)
from polar_nav_core.kernels.station import (
    fix as station_fix,
)
from polar_nav_core.kernels.station import (
    forward as station_forward,
)
from polar_nav_core.kernels.station import state as ss
from polar_nav_core.kernels.station import (
    step as station,
)

VECTORS = json.loads((Path(__file__).parent / 'data' / 'has_station.json').read_text())
CASES = VECTORS['prediction']
RNG = np.random.default_rng


def settings(**changes):
    params = EngineParams(mode='station', configuration='default', current_method='single')
    return arrays.make_settings(params)._replace(**changes)


def known_model():
    """The navigation model of the vectors stands in the parameters' defaults."""
    m, c = VECTORS['nav_model'], settings()
    np.testing.assert_allclose(c.inertia, m['ma'] + np.array(m['added_mass']))
    np.testing.assert_allclose(c.drag_linear, m['d1'])
    np.testing.assert_allclose(c.drag_quadratic, m['d2'])
    assert c.net_buoyancy == m['Pz_up']
    return m


def level(current):
    """A rotation that makes a current horizontal: only gravity's direction is told apart."""
    angle = math.atan2(current[2], math.hypot(current[0], current[1]))
    psi = math.atan2(current[1], current[0])
    return attitude.matrix_from_euler(0.0, angle, 0.0) @ attitude.matrix_from_euler(-psi, 0.0, 0.0)


def published_case(case):
    """Bank, settings, scratch before the step of a case, turned so that the current is level."""
    m = known_model()
    Q = level(case['Vc'])
    c = settings(published=True, q_v=0.0, q_xy=0.0, q_z=0.0)
    b, w = arrays.make_bank(1), arrays.make_work(1)
    phi, theta, psi = case['ang']
    R = attitude.matrix_from_euler(psi, theta, phi)
    T = np.block([[np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), Q]])
    b.x[0, :6] = T @ case['X']
    b.P[0, :6, :6] = T @ case['P0'] @ T.T
    b.x[0, 6:8] = (Q @ case['Vc'])[:2]
    total = (m['d1'][0] + m['d2'][0] * c.speed) * c.speed
    b.x[0, ss.DRAG], b.x[0, ss.SHARE] = math.log(total), m['d2'][0] * c.speed**2 / total
    w.C_A[:] = Q @ R
    w.omega[:], w.up[:], w.g[:] = case['w'], R[2], case['tau']
    w.d1[:], w.d2[:] = c.drag_linear, c.drag_quadratic
    return b, c, w, T


@pytest.mark.parametrize('case', CASES)
def test_published_prediction(case):
    b, c, w, T = published_case(case)
    station.step_published(b.x[0], b.P[0], case['h'], c, w)
    np.testing.assert_allclose(T.T @ b.x[0, :6], case['X_pred'], rtol=1e-9, atol=1e-12)
    P = T.T @ b.P[0, :6, :6] @ T + case['Q']
    np.testing.assert_allclose(P, case['P_pred'], rtol=1e-9, atol=1e-12)


def predicted(case):
    """Bank right after the prediction of a case, level ground, nothing else known."""
    c = settings(published=True, fix_variance=case['has']['R'][0][0], surface=0.0)
    b, w = arrays.make_bank(1), arrays.make_work(1)
    b.x[0, :6], b.P[0, :6, :6] = case['X_pred'], case['P_pred']
    b.flat[ss.UP + 2] = 1.0
    b.counters[ss.IMU] = 1
    s = arrays.live_streams(1.0, 1)
    s.depth[0], s.depth_variance[0] = -case['depth']['z'], case['depth']['rz']
    return b, c, w, s


@pytest.mark.parametrize('case', CASES)
def test_depth_update(case):
    b, c, w, s = predicted(case)
    station_depth.depth_event(b, c, w, s, np.zeros((0, 1, ss.N)), arrays.make_tape(0))
    np.testing.assert_allclose(b.x[0, :6], case['depth']['X'], rtol=1e-9)
    P = np.diagonal(b.P[0])[:6]
    np.testing.assert_allclose(P, case['depth']['P_diag'], rtol=1e-9)
    gain = w.PHt[0, 0, :6] / w.S[0, 0]
    np.testing.assert_allclose(gain, case['depth']['K1'], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize('case', CASES)
def test_published_fix_after_depth_is_the_joint_update(case):
    """Eq. 13 has depth as its third row; R is diagonal, so one after the other is the same."""
    b, c, w, s = predicted(case)
    before = b.x[0].copy()
    station_depth.depth_event(b, c, w, s, np.zeros((0, 1, ss.N)), arrays.make_tape(0))
    dx, dy, _ = case['has']['innovation_xg_minus_buffered_x_y_and_depth']
    fix = np.zeros(ss.FIX_COLUMNS)
    fix[:6] = before[3] + dx - 100.0, before[4] + dy, b.x[0, 5], 0.0, 100.0, 0.0
    log = arrays.make_log(0.1, 1, snapshots=False, jumps=True)
    outcome = np.zeros(ss.OUTCOME)
    station_forward.forward_fix(b, c, w, s, log, fix, outcome, 1, 0.0, ss.TAGGED)
    np.testing.assert_allclose(b.x[0, :6], case['has']['X'], rtol=1e-9)
    np.testing.assert_allclose(np.diagonal(b.P[0])[:6], case['has']['P_diag'], rtol=1e-9)


def test_travel_time():
    for case in VECTORS['delay']:
        p = EngineParams(
            station_bit_rate=float(case['rate']),
            station_packet_bits=float(case['bits']),
            station_processing_s=float(case['T_proc']),
        )
        tau = p.travel_time(case['D'], case['c'])
        assert tau == pytest.approx(case['tau'], rel=1e-12)
        assert int(tau / 0.01 + 1e-9) == case['n_cells_h001']


@pytest.mark.parametrize('case', VECTORS['polar'])
def test_range_and_bearing_become_a_position_with_its_covariance(case):
    p, w = EngineParams(), arrays.make_work(1)
    dz = case['dz_auv_minus_has'] or 0.0
    azimuth = case['psi_has'] + case['bearing']
    at = np.zeros(ss.N)
    at[3:6] = case['x'], case['y'], case['has'][2] + dz
    fix = np.zeros(ss.FIX_COLUMNS)
    fix[:6] = *case['has'], case['psi_has'], case['D'], case['bearing']
    w.C_A[:] = np.eye(3)
    z, H = np.ones(2), np.zeros((2, ss.N))
    station_fix.fix_rows(z, H, fix, at, 0.0, w)
    np.testing.assert_allclose(z, 0.0, atol=1e-11 * case['D'])
    across = math.sqrt(case['D'] ** 2 - dz**2)
    J = np.linalg.inv(H[:, 3:5])
    c, s = math.cos(azimuth), math.sin(azimuth)
    stretch = case['D'] / across
    np.testing.assert_allclose(J, [[stretch * c, -across * s], [stretch * s, across * c]])
    if not dz:
        noise = np.diag([p.range_variance(case['D']), p.bearing_variance()])
        np.testing.assert_allclose(J @ noise @ J.T, case['cov'], rtol=1e-9)


def random_state(seed):
    rng = RNG(seed)
    x = np.concatenate(
        [rng.normal(size=3), rng.normal(size=3) * 300, rng.normal(size=2) * 0.4, [4.1, 0.6],
         rng.normal(size=2) * 0.1]
    )  # fmt: skip
    C = attitude.matrix_from_euler(*rng.normal(size=3) * [2.0, 0.3, 0.3])
    return x, C, rng.normal(size=3) * 0.3, rng.normal(size=3) * 40.0


@pytest.mark.parametrize('seed', range(4))
def test_step_and_its_slopes(seed):
    x, C, omega, force = random_state(seed)
    c, w, h, q_c = settings(), arrays.make_work(1), 0.01, 1e-5
    up = np.ascontiguousarray(C[2])
    w.C_A[:], w.omega[:], w.up[:], w.g[:] = C, omega, up, force
    w.d1[:], w.d2[:] = c.drag_linear, c.drag_quadratic

    def rates(y):
        return oracle.rates(y, C, omega, up, force, c)

    F = oracle.slopes(x, C, omega, c)
    steps = 1e-6 * np.maximum(1.0, np.abs(x))
    numeric = [(rates(x + e) - rates(x - e)) / (2 * e.sum()) for e in np.diag(steps)]
    np.testing.assert_allclose(F, np.column_stack(numeric), atol=1e-7)

    A = RNG(seed + 9).normal(size=(ss.N, ss.N))
    P, y = A @ A.T, x.copy()
    P[:, ss.STATION] = P[ss.STATION] = 0.0
    fd, fs, gx, gy = station.slopes(x, c, w)
    station.move(y, x, h, 1.0, fd, fs, gx, gy, w)
    np.testing.assert_allclose(y, x + h * rates(x), rtol=1e-13, atol=1e-12)
    Phi = np.eye(ss.N) + h * F
    expected = Phi @ P @ Phi.T + np.diag(oracle.added(c, h, q_c))
    station.spread(P, h, q_c, 1.0, 0.0, fd, fs, gx, gy, c, w)
    np.testing.assert_allclose(P, expected, rtol=1e-12, atol=1e-12)
    assert np.array_equal(P, P.T)
    # linearised elsewhere
    z = x + RNG(seed).normal(size=ss.N) * 0.1
    expected = x + h * rates(x) + Phi @ (z - x)
    station.move(z, x, h, 1.0, fd, fs, gx, gy, w)
    np.testing.assert_allclose(z, expected, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize('seed', range(4))
def test_rows_of_a_fix(seed):
    x, C, _, _ = random_state(seed)
    w, dt = arrays.make_work(1), 0.3
    w.C_A[:] = C
    fix = np.zeros(ss.FIX_COLUMNS)
    fix[:6] = 50.0, -900.0, -5.0, 0.4, 700.0, 6.0
    z, H = np.zeros(2), np.zeros((2, ss.N))
    station_fix.fix_rows(z, H, fix, x, dt, w)
    h = oracle.range_and_bearing(x, C, fix, dt)
    expected = np.array([700.0, 6.0]) - h
    expected[1] = math.remainder(expected[1], 2 * math.pi)
    np.testing.assert_allclose(z, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(H, oracle.fix_slopes(x, C, fix, dt), rtol=1e-12, atol=1e-15)


def test_bearing_does_not_wrap():
    w, x = arrays.make_work(1), np.zeros(ss.N)
    w.C_A[:] = np.eye(3)
    x[3:5] = -100.0, 0.1  # just short of pi
    fix = np.zeros(ss.FIX_COLUMNS)
    fix[ss.RANGE], fix[ss.BEARING] = 100.0, -math.pi + 0.002
    z, H = np.zeros(2), np.zeros((2, ss.N))
    station_fix.fix_rows(z, H, fix, x, 0.0, w)
    assert z[1] == pytest.approx(0.003, abs=1e-5)


def test_smoothing_takes_out_white_noise_and_follows_turns():
    rng, n, dt = RNG(3), 4000, 0.01
    t = np.arange(n) * dt
    psi, theta = 0.8 * np.sin(0.2 * t), 0.1 * np.sin(0.5 * t)
    true = attitude.matrix_from_euler(psi, theta, np.zeros(n))
    turn = np.einsum('nji,njk->nik', true[:-1], true[1:])
    omega = np.zeros((n, 3))
    omega[1:] = attitude.log(turn) / dt
    omega += rng.uniform(-0.01, 0.01, (n, 3))
    e = rng.uniform(-0.02, 0.02, (n, 3))
    C = attitude.matrix_from_euler(psi + e[:, 0], theta + e[:, 1], e[:, 2])
    raw = C.copy()
    stamps = (t * 1e9).astype(np.int64)
    station_attitude.smooth(stamps, omega, C, np.zeros(n), 1, n, 2.0, np.zeros(3))
    settled = slice(1000, None)

    def rms(A):
        off = attitude.log(np.einsum('nji,njk->nik', true[settled], A[settled]))
        return np.sqrt(np.mean(off**2, axis=0))

    assert (rms(raw) > 0.01).all()
    assert (rms(C) < 0.0015).all()
    np.testing.assert_allclose(np.einsum('nij,nkj->nik', C, C), np.tile(np.eye(3), (n, 1, 1)),
                               atol=1e-14)  # fmt: skip


def test_smoothing_begins_anew_after_a_jump():
    n = 50
    C = np.tile(np.eye(3), (n, 1, 1))
    C[20:] = attitude.matrix_from_euler(3.0, 0.0, 0.0)
    stamps = np.arange(n, dtype=np.int64) * 10_000_000
    station_attitude.smooth(stamps, np.zeros((n, 3)), C, np.zeros(n), 1, n, 2.0, np.zeros(3))
    np.testing.assert_allclose(C[30], attitude.matrix_from_euler(3.0, 0.0, 0.0), atol=1e-12)


def test_a_gyro_bias_shifts_the_attitude_by_bias_times_time_constant():
    n, tau, bias = 3000, 2.0, 1e-3
    C = np.tile(np.eye(3), (n, 1, 1))
    stamps = np.arange(n, dtype=np.int64) * 10_000_000
    station_attitude.smooth(
        stamps, np.full((n, 3), [0, 0, bias]), C, np.zeros(n), 1, n, tau, np.zeros(3)
    )
    assert attitude.log(C[-1])[2] == pytest.approx(bias * tau, rel=0.01)
