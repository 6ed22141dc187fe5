"""The smoother's backward pass against dense least squares."""

import numpy as np
import pytest

from polar_nav_core.kernels.sins import smooth
from polar_nav_core.kernels.sins.consider import COLUMNS
from polar_nav_core.kernels.sins.state import STEP, UPDATE
from polar_nav_core.kernels.sins.update import COUPLED, NAV, N

STEPS = 12


def _transition(rng):
    Phi = np.eye(N)
    Phi[:NAV, :COUPLED] += 0.2 * rng.standard_normal((NAV, COUPLED))
    Phi[range(18, N), range(18, N)] = rng.uniform(0.5, 1.0, 6)
    return Phi


def _phi(Phi):
    return np.concatenate([Phi[:NAV, :COUPLED].ravel(), np.diagonal(Phi)[NAV:]])


@pytest.fixture(scope='module')
def problem():
    """A linear filter in which nothing is simplified, and the same problem as one matrix."""
    rng = np.random.default_rng(1)
    P = np.diag(rng.uniform(0.5, 2.0, N) ** 2)
    P[20, 20] = 0.0  # known for sure
    b_sigma = np.zeros(COLUMNS)
    b_sigma[:4] = 0.7
    x, S_b = np.zeros(N), np.zeros((N, COLUMNS))
    entries, states = [], []
    # Unknowns: start, noise of each step, noise of each measurement, common errors.
    size = N + STEPS * N + 3 * STEPS + COLUMNS
    prior = np.zeros(size)
    prior[:N] = np.diagonal(P)
    prior[-COLUMNS:] = b_sigma**2
    E = np.zeros((N, size))  # error as a function of the unknowns
    E[:, :N] = np.eye(N)
    rows, values = [], []
    for k in range(STEPS):
        Phi, q = _transition(rng), rng.uniform(0.0, 0.3, N)
        q[20] = 0.0
        E = Phi @ E
        E[:, N + k * N : N + (k + 1) * N] += np.eye(N)
        prior[N + k * N : N + (k + 1) * N] = q
        P, x, S_b = Phi @ P @ Phi.T + np.diag(q), Phi @ x, Phi @ S_b
        entries.append((STEP, _phi(Phi)))
        states.append((len(entries), x.copy(), P.copy(), S_b.copy(), E.copy()))
        m = 1 + 2 * (k % 2)
        H = np.zeros((3, N))
        H[:m] = rng.standard_normal((m, N)) * (rng.random((m, N)) < 0.4)
        R = np.diag(rng.uniform(0.5, 1.0, m))
        J_b = np.zeros((3, COLUMNS))
        J_b[:m, :4] = rng.standard_normal((m, 4))
        at = N + STEPS * N + 3 * k
        prior[at : at + m] = np.diagonal(R)
        row = H[:m] @ E
        row[:, at : at + m] += np.eye(m)
        row[:, -COLUMNS:] += J_b[:m]
        y = rng.standard_normal(m) * 2.0
        rows.append(row)
        values.append(y)
        z = np.zeros(3)
        z[:m] = y - H[:m] @ x
        S = H[:m] @ P @ H[:m].T + R
        K = np.zeros((3, N))
        K[:m] = np.linalg.solve(S, H[:m] @ P)
        L = np.zeros((3, 3))
        L[:m, :m] = np.linalg.cholesky(S)
        moved = J_b + H @ S_b
        entries.append((UPDATE, (H, K, L, z, moved, m)))
        x = x + K[:m].T @ z[:m]
        A = np.eye(N) - K[:m].T @ H[:m]
        P, S_b = A @ P @ A.T + K[:m].T @ R @ K[:m], S_b - K[:m].T @ moved[:m]
    return entries, states, prior, np.vstack(rows), np.concatenate(values), b_sigma


def _smoothed(problem):
    entries, states, *_ = problem
    kinds = np.array([kind for kind, _ in entries])
    steps = [v for kind, v in entries if kind == STEP]
    updates = [v for kind, v in entries if kind == UPDATE]
    indices = np.array([int(np.sum(kinds[:k] == kind)) for k, kind in enumerate(kinds)])
    H, K, L, z, moved = (np.array([u[i] for u in updates]) for i in range(5))
    n = len(states)
    x, P = np.empty((n, N)), np.array([s[2] for s in states])
    sensitivity = np.array([s[3] for s in states])
    navigation = np.zeros((n, 30))
    navigation[:, [0, 4, 8]] = 1.0
    common = np.zeros((COLUMNS, COLUMNS + 1))
    smooth.smooth_back(
        kinds,
        indices,
        np.array(steps),
        H,
        K,
        L,
        z,
        moved,
        np.array([u[5] for u in updates]),
        np.array([s[0] for s in states]),
        navigation,
        x,
        P,
        sensitivity,
        np.zeros((1 + COLUMNS, N)),
        np.zeros((N, N)),
        common,
        np.zeros((2, N, N)),
    )
    x += np.array([s[1] for s in states])
    return x, P, sensitivity, common


def _conditioned(prior, A, y, row):
    """Mean and covariance of ``row`` of the unknowns, given A unknowns = y."""
    D = A * prior
    gain = np.linalg.solve(D @ A.T, D @ row.T).T
    return gain @ y, (row * prior) @ row.T - gain @ (D @ row.T)


def test_it_is_least_squares_over_everything(problem):
    _, states, prior, A, y, _ = problem
    x, P, sensitivity, _ = _smoothed(problem)
    known = prior.copy()
    known[-COLUMNS:] = 0.0
    for k, (_, _, _, _, E) in enumerate(states):
        mean, covariance = _conditioned(known, A, y, E)
        np.testing.assert_allclose(x[k], mean, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(P[k], covariance, rtol=0.0, atol=1e-9)
        for c in range(4):  # one unit of a common error moves the innovations, and so the mean
            moved, _ = _conditioned(known, A, A[:, len(prior) - COLUMNS + c], E)
            np.testing.assert_allclose(sensitivity[k][:, c], -moved, rtol=0.0, atol=1e-9)


def test_what_innovations_say_of_common_errors_is_least_squares(problem):
    _, _, prior, A, y, b_sigma = problem
    common = _smoothed(problem)[3]
    row = np.zeros((4, len(prior)))
    row[range(4), range(len(prior) - COLUMNS, len(prior) - COLUMNS + 4)] = 1.0
    mean, covariance = _conditioned(prior, A, y, row)
    posterior = np.linalg.inv(common[:4, :4] + np.diag(b_sigma[:4] ** -2.0))
    np.testing.assert_allclose(posterior, covariance, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(posterior @ common[:4, COLUMNS], mean, rtol=0.0, atol=1e-9)
