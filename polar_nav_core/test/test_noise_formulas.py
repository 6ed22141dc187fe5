"""Noise adaptation: each formula by hand."""

import numpy as np
import pytest

from polar_nav_core.engine.params import NO_CEILING, EngineParams
from polar_nav_core.engine.sins.sage_husa import (
    Q_BOUNDS,
    R_CEILING,
    GuardedNoise,
    GuardedProcess,
    Printed,
    clipped,
    lower_inverse,
)
from polar_nav_core.engine.sins.settings import make_settings
from polar_nav_core.kernels.sins import state as fs
from polar_nav_core.kernels.sins.judge import adapt_noise
from polar_nav_core.kernels.sins.work import make_work

B = 0.8


def test_guarded_R_by_hand():
    """One axis off: v = 3 at stated variance 2, of which S - R = 1 is the state's."""
    noise = GuardedNoise(B, 0.1)
    noise.learn(np.array([3.0, 0.0, 0.0]), 2.0 * np.eye(3), 3.0 * np.eye(3))
    d = (1 - B) / (1 - B ** (1 / (1 - B) + 1))
    other = (1 - d) * 1.0 + d * (0.0 - 0.5)
    assert np.allclose(noise.average, np.diag([(1 - d) + d * (4.5 - 0.5), other, other]))
    R = np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 0.0], [0.0, 0.0, 1.0]])
    L = np.linalg.cholesky(R)
    expected = L @ noise.average @ L.T
    noise.apply(R)
    assert np.allclose(R, expected)


def test_guarded_R_keeps_floor_and_ceiling_and_forgets_on_reset():
    noise = GuardedNoise(B, 0.3)
    for _ in range(100):
        noise.learn(np.zeros(3), np.eye(3), np.eye(3) * 1.3)
    assert np.allclose(np.linalg.eigvalsh(noise.ratio), 0.3)
    for _ in range(100):
        noise.learn(np.full(3, 1e4), np.eye(3), np.eye(3))
    assert np.linalg.eigvalsh(noise.ratio).max() == pytest.approx(R_CEILING)
    noise.reset()
    assert np.array_equal(noise.ratio, np.eye(3))


def test_guarded_R_weighs_a_sample_less_that_is_mostly_uncertainty_of_the_state():
    clear, blurred = GuardedNoise(B, 0.1), GuardedNoise(B, 0.1)
    clear.learn(np.sqrt([6.0, 6.0, 6.0]), np.eye(3), 2.0 * np.eye(3))
    blurred.learn(np.sqrt([105.0, 105.0, 105.0]), np.eye(3), 101.0 * np.eye(3))
    moved = [np.diagonal(n.average)[0] - 1.0 for n in (clear, blurred)]
    assert moved[1] == pytest.approx(moved[0] / 100.0)


def test_an_R_that_is_not_positive_definite_is_left_alone():
    noise = GuardedNoise(B, 0.1)
    R = np.diag([1.0, -1.0, 1.0])
    noise.apply(R)
    noise.learn(np.ones(3), R, np.eye(3))
    assert np.array_equal(R, np.diag([1.0, -1.0, 1.0]))
    assert np.array_equal(noise.average, np.eye(3))


def test_guarded_Q_by_hand():
    """State 6 alone has noise: K = 0.5, v = 3, S = 2, stated q = 0.25 over two steps."""
    process = GuardedProcess(B)
    P, q, K = np.zeros((24, 24)), np.zeros(24), np.zeros((1, 24))
    q[6], K[0, 6], K[0, 3] = 0.25, 0.5, 0.7
    process.add(P, np.eye(24), q, 0.1)
    process.add(P, np.eye(24), q, 0.1)
    assert not P.any()
    process.learn(K, np.array([3.0]), np.array([[2.0]]))
    process.add(P, np.eye(24), q, 0.1)
    d = (1 - B) / (1 - B ** (1 / (1 - B) + 1))
    # K S K^T = 0.5 does not exceed what was stated for the two steps: full weight.
    ratio = (1 - d) * 1.0 + d * (1.0 + 0.25 * (9.0 - 2.0) / 0.5)
    assert process.ratio == pytest.approx(ratio)
    assert P[6, 6] == pytest.approx(0.25 * (ratio - 1.0))
    assert np.count_nonzero(P) == 1


def test_guarded_Q_finds_the_noise_of_a_random_walk():
    """A scalar filter told a third of the true q: within a quarter of 3 after 20000 steps."""
    rng = np.random.default_rng(5)
    process = GuardedProcess(0.999)
    P, q = np.zeros((24, 24)), np.zeros(24)
    q[6] = 0.1
    truth, estimate, ratios = 0.0, 0.0, []
    for _ in range(20000):
        truth += rng.normal(0.0, np.sqrt(0.3))
        P[6, 6] += q[6]
        process.add(P, np.eye(24), q, 0.1)
        z = estimate - truth + rng.normal()
        S = P[6, 6] + 1.0
        K = np.zeros((1, 24))
        K[0, 6] = P[6, 6] / S
        process.learn(K, np.array([z]), np.array([[S]]))
        estimate -= K[0, 6] * z
        P[6, 6] *= 1.0 - K[0, 6]
        ratios.append(process.ratio[0, 0])
    assert np.mean(ratios[10000:]) == pytest.approx(3.0, rel=0.25)
    assert Q_BOUNDS[0] <= min(ratios)
    assert max(ratios) <= Q_BOUNDS[1]


@pytest.mark.parametrize('simplified', [False, True])
def test_printed_forms_by_hand(simplified):
    """(35)-(38) and (62)-(65) with one state and one row, two measurements 0.5 s apart."""
    a = Printed(simplified=simplified, forgetting=B, start=0.0, size=1)
    rows = np.array([0])
    q_hat, Q_hat, r_hat, R_hat, P = 0.0, 0.2, 0.0, 4.0, 1.0
    for k, z in ((1, 3.0), (2, -1.0)):
        d = (1 - B) / (1 - B**k)
        given_P = np.array([[4.0 * P + 0.1]])
        a.add(given_P, np.array([[2.0]]), np.array([0.1]), 0.5)
        prior = 4.0 * P + Q_hat * 0.5
        assert given_P[0, 0] == pytest.approx(prior)
        R = a.noise(rows, np.array([[4.0]]))[0, 0]
        assert pytest.approx(R_hat) == R
        v = z - r_hat
        K = prior / (prior + R)
        after = (1 - K) ** 2 * prior + K**2 * R
        x = K * v
        a.learn_printed(
            np.array([x]),
            np.array([z]),
            np.array([v]),
            np.array([[prior]]),
            np.array([[after]]),
            np.array([[prior]]),
            rows,
        )
        if simplified:
            q_hat = (1 - d) * q_hat + d * x / 0.5
            Q_hat = (1 - d) * Q_hat + d * (x * x + after) / 0.5
            R_hat = (1 - d) * R_hat + d * v * v
        else:
            q_hat = q_hat + d * x / 0.5
            Q_hat = (1 - d) * Q_hat + d * (x * x + after - 4.0 * P) / 0.5
            R_hat = (1 - d) * R_hat + d * (v * v - prior)
        r_hat = (1 - d) * r_hat + d * z
        P = after
        assert (a.q[0], a.Q[0, 0], a.r[0], a.R[0, 0]) == pytest.approx(
            (q_hat, Q_hat, r_hat, R_hat)
        )
        if k == 1:  # d_1 = 1: what was stated is gone
            assert a.R[0, 0] == pytest.approx(9.0 if simplified else 9.0 - prior)


def test_Q_of_63_grows_in_a_direction_that_is_not_measured():
    """P' = P + Q, Q' = (1 - d) Q + d P': a factor of 1 + sqrt(d) a step."""
    a = Printed(simplified=True, forgetting=0.99, start=1e4, size=1)
    P, sizes = np.array([[1.0]]), []
    for _ in range(200):
        P = P + 1e-3
        a.add(P, np.eye(1), np.array([1e-3]), 1.0)
        a.learn_printed(np.zeros(1), np.zeros(1), np.zeros(1), P, P, P, np.array([0]))
        sizes.append(P[0, 0])
    assert sizes[-1] / sizes[-2] == pytest.approx(1.0 + np.sqrt(0.01), rel=1e-3)


def test_clipping_and_triangular_inverse():
    rng = np.random.default_rng(6)
    A = rng.normal(size=(5, 5))
    A = A + A.T
    values, vectors = np.linalg.eigh(A)
    expected = vectors @ np.diag(np.clip(values, -0.5, 1.5)) @ vectors.T
    assert np.allclose(clipped(A, -0.5, 1.5), expected)
    L = np.tril(rng.normal(size=(5, 5))) + 3.0 * np.eye(5)
    assert np.allclose(lower_inverse(L) @ L, np.eye(5))


def test_Q_keeps_its_bounds():
    process = GuardedProcess(B)
    q, K = np.zeros(24), np.zeros((1, 24))
    q[6], K[0, 6] = 1.0, 0.1
    for z, bound in ((1e6, Q_BOUNDS[1]), (0.0, Q_BOUNDS[0])):
        for _ in range(400):
            P = np.zeros((24, 24))
            process.add(P, np.eye(24), q, 0.1)
            process.learn(K, np.array([z]), np.array([[100.0]]))
        assert process.ratio[0, 0] == pytest.approx(bound)
        assert P[6, 6] == pytest.approx(bound - 1.0)


@pytest.mark.parametrize(('ceiling', 'scaled'), [(25.0, 25.0), (NO_CEILING, 400.0)])
def test_adapted_noise_ends_at_the_ceiling(ceiling, scaled):
    """Without one, the noise grows along with any innovation, and nothing is refused any more."""
    settings = make_settings(EngineParams(configuration='modified_akf', adaptive_ceiling=ceiling))
    state, work = fs.make_state(), make_work()
    state.noise[:] = [0.5, 400.0, 1.0, 0.1]
    work.R[:] = np.eye(3)
    adapt_noise(state, settings, work, fs.FIX_ROW, fs.VECTOR)
    assert np.diagonal(work.R) == pytest.approx([scaled, 1.0, 0.5])
    noise = GuardedNoise(B, 0.1, ceiling)
    for _ in range(100):
        noise.learn(np.full(3, 100.0), np.eye(3), np.eye(3))
    assert np.linalg.eigvalsh(noise.ratio).max() == pytest.approx(min(ceiling, R_CEILING))
