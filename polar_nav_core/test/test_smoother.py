"""The smoother's backward pass against dense least squares."""

import numpy as np
import pytest
from compiled import jit_only
from scipy import linalg

from polar_nav_core.kernels.sins import smooth
from polar_nav_core.kernels.sins.consider import COLUMNS
from polar_nav_core.kernels.sins.left_out import normalize
from polar_nav_core.kernels.sins.model import MOVING, E
from polar_nav_core.kernels.sins.rings import KEPT, STEP, UPDATE
from polar_nav_core.kernels.sins.update import COUPLED, NAV, N

STEPS = 12


def _transition(rng, n):
    Phi = np.eye(n)
    Phi[:NAV, :COUPLED] += 0.2 * rng.standard_normal((NAV, COUPLED))
    Phi[range(18, N), range(18, N)] = rng.uniform(0.5, 1.0, 6)
    if n > N:  # a vehicle's model: driven by all, drives nothing of the others
        Phi[N : N + MOVING] += 0.2 * rng.standard_normal((MOVING, n))
    return Phi


def _phi(Phi):
    return np.concatenate([Phi[:NAV, :COUPLED].ravel(), np.diagonal(Phi)[NAV:N]])


@pytest.fixture(scope='module', params=[N, N + E], ids=['', 'with a model'])
def problem(request):
    """A linear filter in which nothing is simplified, and the same problem as one matrix."""
    return _problem(n=request.param)


def _problem(refused=-1, n=N, wide=0.0):
    """The problem; of the measurement ``refused`` only the gain is logged.

    A position known to ``wide`` has depths of a millimetre along no axis first, at last fixes.
    """
    rng = np.random.default_rng(1)
    P = np.diag(rng.uniform(0.5, 2.0, n) ** 2)
    if wide:
        P[range(6, 9), range(6, 9)] = wide**2
    P[20, 20] = 0.0  # known for sure
    b_sigma = np.zeros(COLUMNS)
    b_sigma[:4] = 0.7
    x, S_b = np.zeros(n), np.zeros((n, COLUMNS))
    entries, states = [], []
    # Unknowns: start, noise of each step, noise of each measurement, common errors.
    size = n + STEPS * n + 3 * STEPS + COLUMNS
    prior = np.zeros(size)
    prior[:n] = np.diagonal(P)
    prior[-COLUMNS:] = b_sigma**2
    G = np.zeros((n, size))  # error as a function of the unknowns
    G[:, :n] = np.eye(n)
    rows, values = [], []
    for k in range(STEPS):
        Phi, q = _transition(rng, n), rng.uniform(0.0, 0.3, n)
        if wide:  # a second of a vehicle, not of a matrix
            Phi, q = np.eye(n), 1e-6 * q
            Phi[6:9, 3:6] = 0.1 * np.eye(3)
            Phi[range(18, N), range(18, N)] = 0.99
        q[20] = 0.0
        G = Phi @ G
        G[:, n + k * n : n + (k + 1) * n] += np.eye(n)
        prior[n + k * n : n + (k + 1) * n] = q
        P, x, S_b = Phi @ P @ Phi.T + np.diag(q), Phi @ x, Phi @ S_b
        entries.append((STEP, (_phi(Phi), Phi[N : N + MOVING])))
        states.append((len(entries), x.copy(), P.copy(), S_b.copy(), G.copy()))
        m = 1 + 2 * (k % 2 if not wide else k > 8)
        H = np.zeros((3, n))
        H[:m] = rng.standard_normal((m, n)) * (rng.random((m, n)) < 0.4)
        R = np.diag(rng.uniform(0.5, 1.0, m))
        if wide:
            H[:] = 0.0
            H[:m, 6:9] = np.eye(3) if m == 3 else [[0.48, 0.6, 0.64]]
            R = np.diag(np.full(m, 0.5 if m == 3 else 1e-3) ** 2)
        J_b = np.zeros((3, COLUMNS))
        J_b[:m, :4] = rng.standard_normal((m, 4))
        at = n + STEPS * n + 3 * k
        prior[at : at + m] = np.diagonal(R)
        row = H[:m] @ G
        row[:, at : at + m] += np.eye(m)
        row[:, -COLUMNS:] += J_b[:m]
        y = rng.standard_normal(m) * 2.0
        if wide:  # as far off as was stated, where depths do not tell
            y = np.sqrt(np.diagonal(R)) * y + H[:m, 6:9] @ (
                0.1 * wide * np.array([5.0, -4.0, 0.0])
            )
        rows.append(row)
        values.append(y)
        z = np.zeros(3)
        z[:m] = y - H[:m] @ x
        S = H[:m] @ P @ H[:m].T + R
        K = np.zeros((3, n))
        K[:m] = np.linalg.solve(S, H[:m] @ P)
        L = np.zeros((3, 3))
        L[:m, :m] = np.linalg.cholesky(S)
        moved = J_b + H @ S_b
        entries.append((KEPT if k == refused else UPDATE, (H, K, L, z, moved, m)))
        if k == refused:
            continue
        x = x + K[:m].T @ z[:m]
        A = np.eye(n) - K[:m].T @ H[:m]
        P, S_b = A @ P @ A.T + K[:m].T @ R @ K[:m], S_b - K[:m].T @ moved[:m]
    return entries, states, prior, np.vstack(rows), np.concatenate(values), b_sigma


def _smoothed(problem, b_sigma=np.zeros(COLUMNS), before=0.0, wide=0):  # noqa: B008 - not changed
    entries, states, *_ = problem
    kinds = np.array([kind for kind, _ in entries])
    steps = [v for kind, v in entries if kind == STEP]
    updates = [v for kind, v in entries if kind != STEP]
    indices = np.array(
        [int(np.sum((kinds[:k] == STEP) == (kind == STEP))) for k, kind in enumerate(kinds)]
    )
    H, K, L, z, moved = (np.array([u[i] for u in updates]) for i in range(5))
    sizes = np.array([u[5] for u in updates])
    P = np.array([s[2] for s in states])
    count, n = P.shape[:2]
    x = np.empty((count, n))
    sensitivity = np.array([s[3] for s in states])
    navigation = np.zeros((count, 30))
    navigation[:, [0, 4, 8]] = 1.0
    common = np.zeros((COLUMNS, COLUMNS + 1))
    residuals, V = np.empty((len(updates), 3)), np.empty((len(updates), 3, 3))
    smooth.smooth_back(
        kinds,
        indices,
        np.array([phi for phi, _ in steps]),
        np.array([model for _, model in steps]) if n > N else np.zeros((0, 3, 31)),
        np.vstack([rows[:m] for rows, m in zip(H, sizes, strict=True)]),
        np.vstack([rows[:m] for rows, m in zip(K, sizes, strict=True)]),
        L,
        z,
        moved,
        sizes,
        np.array([s[0] for s in states]),
        navigation,
        np.zeros((count, n)),
        x,
        P,
        sensitivity,
        np.zeros((n, 1 + COLUMNS)),
        np.zeros((n, n)),
        common,
        b_sigma,
        residuals,
        V,
        before,
        np.zeros((n, n)),
        np.array([wide]),
        np.zeros((6, n, n)),
    )
    x += np.array([s[1] for s in states])
    return x, P, sensitivity, common, residuals, V


def _conditioned(prior, A, y, row):
    """Mean and covariance of ``row`` of the unknowns, given A unknowns = y."""
    D = A * prior
    gain = np.linalg.solve(D @ A.T, D @ row.T).T
    return gain @ y, (row * prior) @ row.T - gain @ (D @ row.T)


def test_it_is_least_squares_over_everything(problem):
    _, states, prior, A, y, _ = problem
    x, P, sensitivity, *_ = _smoothed(problem)
    known = prior.copy()
    known[-COLUMNS:] = 0.0
    for k, (_, _, _, _, G) in enumerate(states):
        mean, covariance = _conditioned(known, A, y, G)
        np.testing.assert_allclose(x[k], mean, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(P[k], covariance, rtol=0.0, atol=1e-9)
        for c in range(4):  # one unit of a common error moves the innovations, and so the mean
            moved, _ = _conditioned(known, A, A[:, len(prior) - COLUMNS + c], G)
            np.testing.assert_allclose(sensitivity[k][:, c], -moved, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize('n', [N, N + E], ids=['', 'with a model'])
@pytest.mark.parametrize('wide', [10.0, 1e2, 1e3, 1e4, 1e5])
@jit_only
def test_a_position_that_was_known_to_kilometres_is_as_by_least_squares(n, wide):
    """P - P Lambda P was 1e6 m^2 less 1e6 m^2 and some rounding: variances below zero."""
    problem = _problem(n=n, wide=wide)
    _, states, prior, A, y, _ = problem
    x, P, *_ = _smoothed(problem)
    known = prior.copy()
    known[-COLUMNS:] = 0.0
    # In units of the sigmas, by QR: normal equations would lose as many digits.
    sigma = np.sqrt(known)
    noise = np.arange(n + STEPS * n, n + STEPS * n + 3 * STEPS)
    noise = noise[known[noise] > 0.0]
    others = np.setdiff1d(np.arange(len(known)), noise)
    weights = 1.0 / sigma[noise][np.argmax(A[:, noise] != 0.0, axis=1)]
    rows = weights[:, None] * (A * sigma)[:, others]
    Q, U = np.linalg.qr(np.vstack([np.eye(len(others)), rows]))
    u = linalg.solve_triangular(U, Q.T @ np.append(np.zeros(len(others)), weights * y))
    rounding = 1e-14 * wide**2
    for k, (*_, G) in enumerate(states):
        of_unknowns = (G * sigma)[:, others]
        factor = linalg.solve_triangular(U, of_unknowns.T, trans='T')
        covariance = factor.T @ factor
        np.testing.assert_allclose(P[k], covariance, rtol=1e-5, atol=rounding + 1e-6)
        assert (np.diagonal(P[k]) >= 0.0).all()
        off = np.abs(x[k] - of_unknowns @ u) / np.sqrt(np.diagonal(covariance) + rounding)
        # The adjoint itself has the usual digits: tenths of a sigma from 100 km.
        assert off[np.isfinite(off)].max() < 1e-3 + 0.5 * (wide / 1e5) ** 2


def test_what_innovations_say_of_common_errors_is_least_squares(problem):
    _, _, prior, A, y, b_sigma = problem
    common = _smoothed(problem)[3]
    row = np.zeros((4, len(prior)))
    row[range(4), range(len(prior) - COLUMNS, len(prior) - COLUMNS + 4)] = 1.0
    mean, covariance = _conditioned(prior, A, y, row)
    posterior = np.linalg.inv(common[:4, :4] + np.diag(b_sigma[:4] ** -2.0))
    np.testing.assert_allclose(posterior, covariance, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(posterior @ common[:4, COLUMNS], mean, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize('refused', [-1, 5])
def test_what_all_others_say_of_a_measurement_is_least_squares_without_it(refused):
    problem = _problem(refused)
    *_, prior, A, y, b_sigma = problem
    residuals, V = _smoothed(problem, b_sigma)[4:]
    known = prior.copy()
    known[-COLUMNS:] = 0.0
    sizes = [1 + 2 * (k % 2) for k in range(STEPS)]
    ends = np.cumsum(sizes)
    of_refused = slice(ends[refused] - sizes[refused], ends[refused]) if refused >= 0 else []
    for k, m in enumerate(sizes):
        own = np.arange(ends[k] - m, ends[k])
        others = np.delete(np.arange(len(y)), np.concatenate([own, np.r_[of_refused]]).astype(int))
        mean, covariance = _conditioned(known, A[others], y[others], A[own])
        np.testing.assert_allclose(residuals[k, :m], y[own] - mean, rtol=0.0, atol=1e-9)
        for c in range(4):  # common errors are stated, not estimated
            column = A[:, len(prior) - COLUMNS + c]
            moved, _ = _conditioned(known, A[others], column[others], A[own])
            d = b_sigma[c] * (column[own] - moved)
            covariance = covariance + np.outer(d, d)
        np.testing.assert_allclose(V[k, :m, :m], covariance, rtol=0.0, atol=1e-9)


def test_normalized_squares_are_those_of_the_first_rows_where_there_is_a_covariance():
    rng = np.random.default_rng(4)
    A = rng.standard_normal((5, 3, 3))
    V, e = A @ A.transpose(0, 2, 1), rng.standard_normal((5, 3))
    V[3] = np.diag([1.0, -1.0, 1.0])
    V[4] = 0.0
    nis = np.empty(5)
    normalize(e, V, np.array([3, 2, 1, 2, 3]), nis, np.empty((4, 3)))
    for k, m in enumerate((3, 2, 1)):
        assert nis[k] == pytest.approx(e[k, :m] @ np.linalg.solve(V[k, :m, :m], e[k, :m]), 1e-9)
    assert np.isnan(nis[3:]).all()
