"""Common errors in the watchdog: within their stated sigmas no alarm, beyond them one by name."""

import numpy as np
import pytest
from compiled import jit_only

from polar_nav_core.engine.health import shared as beyond
from polar_nav_core.engine.health.conditions import Culprit, Level
from polar_nav_core.engine.health.statistics import statistics
from polar_nav_core.engine.health.view import Envelope, View
from polar_nav_core.engine.health.watchdog import DEPTH, DVL, FIX, Watchdog
from polar_nav_core.kernels import watch
from polar_nav_core.kernels.sins import consider, shared

SIGMA = np.zeros(consider.COLUMNS)
SIGMA[[consider.OFFSET, consider.OFFSET + 1, consider.OFFSET + 2]] = 0.3
SIGMA[consider.DEPTH_ZERO] = 0.5
R_FIX, R_DEPTH = np.diag([1.0, 1.0, 0.09]), np.diag([0.0025, 1.0, 1.0])


class Navigation:
    """Memories of a watchdog, and innovations with common errors b [sigma] from a given world."""

    def __init__(self, seed, b=None):
        self.rng = np.random.default_rng(seed)
        drawn = self.rng.standard_normal(consider.COLUMNS)
        self.b = SIGMA * (drawn if b is None else b)
        self.memories = np.zeros((watch.STREAMS, watch.MEMORIES, watch.WIDTH))
        self.shared = np.zeros((consider.COLUMNS + 1, consider.COLUMNS))
        self.dog = Watchdog(Envelope(max_speed=10.0, max_depth=6000.0))

    def attempt(self, stream, nu=None):
        """One measurement; nu is its white innovation per sigma."""
        m, S = (1, R_DEPTH) if stream == DEPTH else (3, R_FIX)
        J = np.zeros((3, consider.COLUMNS))
        if stream == DEPTH:
            consider.depth_common(J)
        else:
            J[:, consider.OFFSET : consider.OFFSET + 3] = -np.eye(3)
        nu = self.rng.standard_normal(3) if nu is None else nu
        z = np.sqrt(np.diagonal(S)) * nu + J @ self.b
        wide = np.zeros((3, 3))
        consider.widen(wide, S, J, SIGMA, m)
        e, V, L, w = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
        JE = np.zeros_like(J)
        shared.residual(e, V, self.shared, J, SIGMA, z, wide, JE, m)
        nis = shared.whitened(L, V, e, w, m)
        watch.observe(self.memories[stream], e, V, nis, m, True, 2.0, 0.0, z, wide)
        shared.learn(self.shared, J, L, w, JE, 1.0, m)
        return nis / m

    def look(self):
        none = np.zeros(3, dtype=np.int64)
        now = (10**12, self.memories, none, none, 2.0, 100.0, np.eye(2), 0)
        return self.dog.look(View(*now, shared=self.shared), [])


@pytest.mark.parametrize(('m', 'enlargement'), [(1, 1.0), (2, 3.0), (3, 1.0), (3, 4.0)])
def test_residuals_are_those_of_a_filter_of_the_common_errors(m, enlargement):
    """By plain matrices, of fixes whose rows have other errors than one another."""
    n, rng = consider.COLUMNS, np.random.default_rng(7)
    sigma, b, Pi = rng.uniform(0.01, 2.0, n), np.zeros(n), np.eye(n)
    state = np.zeros((n + 1, n))
    for k in range(40):
        J = np.zeros((3, n))
        J[:m] = rng.standard_normal((m, n)) * (rng.random((m, n)) < 0.3)
        S, z = 0.05 * np.eye(3), rng.standard_normal(3)
        wide, e, V, JE = np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3)), np.zeros((3, n))
        consider.widen(wide, S, J, sigma, m)
        per_sigma = J[:m] * sigma
        exact = S[:m, :m] + per_sigma @ Pi @ per_sigma.T
        shared.residual(e, V, state, J, sigma, z, wide, JE, m)
        np.testing.assert_allclose(J[:m], per_sigma, rtol=1e-15)
        np.testing.assert_allclose(V[:m, :m], exact, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(e[:m], z[:m] - per_sigma @ b, rtol=1e-9, atol=1e-11)
        L, w = np.zeros((3, 3)), np.zeros(3)
        assert shared.whitened(L, V, e, w, m) == pytest.approx(
            e[:m] @ np.linalg.solve(exact, e[:m])
        )
        lam = enlargement if k % 3 == 0 else 1.0
        K = np.linalg.solve(lam * exact, per_sigma @ Pi).T
        b, Pi = b + K @ (z[:m] - per_sigma @ b), Pi - K @ (per_sigma @ Pi)
        shared.learn(state, J, L, w, JE, lam, m)
        np.testing.assert_allclose(state[0], b, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(state[1:], np.eye(n) - Pi, rtol=1e-8, atol=1e-10)
        np.testing.assert_array_equal(state[1:], state[1:].T)


def test_a_culprit_is_named_for_every_common_error():
    assert len(beyond._NAMES) == consider.COLUMNS


@jit_only
@pytest.mark.parametrize('seed', range(20))
def test_common_errors_drawn_from_their_sigmas_are_no_alarm(seed):
    navigation = Navigation(seed)
    for k in range(2000):
        navigation.attempt(FIX)
        navigation.attempt(DEPTH)
        if k % 20 == 0:
            assert not navigation.look().present


@jit_only
def test_residuals_are_independent_and_of_the_stated_size():
    """Means of them are chi-square (1) over worlds, as those of white innovations are."""
    means, sizes = [], []
    for seed in range(300):
        navigation = Navigation(seed)
        sizes += [navigation.attempt(FIX) for _ in range(100)]
        s = statistics(navigation.memories)
        means.append([*s.grid[FIX, watch.SHORT], *s.grid[FIX, watch.LONG]])
    assert np.mean(means) == pytest.approx(1.0, abs=0.1)
    assert np.mean(sizes) == pytest.approx(1.0, abs=0.01)


@jit_only
def test_what_is_known_has_the_covariance_that_it_states():
    values = []
    for seed in range(2000):
        navigation = Navigation(seed)
        for _ in range(3):
            navigation.attempt(FIX)
        values.append(navigation.shared[0, consider.OFFSET])
    known = navigation.shared[1 + consider.OFFSET, consider.OFFSET]
    assert known == pytest.approx(0.09 / (0.09 + 1.0 / 3.0))
    assert np.mean(np.square(values)) == pytest.approx(known, rel=0.15)


@pytest.mark.parametrize(
    ('column', 'stream', 'culprit', 'name'),
    [
        (consider.DEPTH_ZERO, DEPTH, Culprit.DEPTH, 'zero of depth'),
        (consider.OFFSET + 2, FIX, Culprit.FIXES, 'offset of fixes upwards'),
    ],
)
@pytest.mark.parametrize(('size', 'level'), [(6.0, Level.WARN), (12.0, Level.ERROR)])
def test_a_common_error_beyond_its_sigma_is_named(column, stream, culprit, name, size, level):
    b = np.zeros(consider.COLUMNS)
    b[column] = size
    navigation = Navigation(1, b)
    for _ in range(100):
        navigation.attempt(stream)
    found = {p.condition.key: p.condition for p in navigation.look().present}['common error']
    assert (found.level, found.culprit) == (level, culprit)
    assert found.sentence.startswith(name)


def test_a_step_within_the_stated_sigma_is_reported_once_the_error_is_known():
    navigation = Navigation(2)
    for k in range(600):
        if k == 300:
            navigation.b[consider.DEPTH_ZERO] += 0.3
        navigation.attempt(FIX)
        navigation.attempt(DEPTH)
        present = navigation.look().present
        assert k >= 300 or not present
        if present:
            assert k < 330
            assert present[0].condition.culprit & Culprit.DEPTH
            return
    raise AssertionError('never reported')


def test_what_is_known_is_forgotten_with_the_days():
    navigation = Navigation(3)
    for _ in range(50):
        navigation.attempt(FIX)
    before = navigation.shared.copy()
    shared.forget(navigation.shared, shared.TAU_S)
    np.testing.assert_allclose(navigation.shared[0], before[0] / np.e)
    np.testing.assert_allclose(navigation.shared[1:], before[1:] / np.e**2)


def until(navigation, innovation, key, most):
    """Attempts until a condition is present; the others must not be before."""
    before = np.zeros(3)
    for k in range(most):
        before = innovation(navigation.rng.standard_normal(3), before)
        navigation.attempt(FIX, before)
        keys = [p.condition.key for p in navigation.look().present]
        if key in keys:
            return k + 1
        assert not keys
    raise AssertionError('never reported')


def test_fixes_whose_neighbours_are_alike_are_filtered():
    def smooth(z, before):
        return 0.6 * before + 0.8 * z

    assert until(Navigation(4), smooth, 'position fixes alike', 400) < 200


def test_what_lasts_for_seconds_beneath_the_noise_of_pings_is_reported():
    """A velocity that wanders with a third of their sigma, for twenty pings on average."""
    navigation, wander, one = Navigation(4), np.zeros(3), np.eye(3)
    pings = navigation.memories[DVL]
    while not (present := navigation.look().present):
        for _ in range(10):
            drawn = navigation.rng.standard_normal((2, 3))
            wander = 0.95 * wander + 0.35 * np.sqrt(1.0 - 0.95**2) * drawn[0]
            z = wander + drawn[1]
            watch.observe(pings, z, one, z @ z, 3, True, 2.0, 0.0, z, one)
    (condition,) = (p.condition for p in present)
    assert condition.sentence.startswith('DVL have errors that last from one to the next')
    assert pings[:, watch.BLOCK_RISE].max() > 8.5
    assert pings[:, watch.ALIKE_RISE].max() < 15.0


def test_a_block_is_judged_once_it_is_full_and_then_forgotten():
    row = np.zeros(watch.WIDTH)
    row[watch.LAST : watch.LAST + 3] = 1.5, -1.0, 0.5
    for k in range(10):
        assert row[watch.BLOCK_NUMBER] == k
        assert row[watch.BLOCK_RISE] == 0.0
        watch.add_to_block(row, 3, 10.0)
    squares = 1.5**2 + 1.0**2 + 0.5**2  # a mean of 1.17 by axis, more than stated
    square = 10.0 * squares / (squares / 3.0)
    expected = 0.5 * (0.5 * square - 3.0 * np.log(2.0))
    assert row[watch.BLOCK_RISE] == pytest.approx(expected)
    assert not row[watch.BLOCK : watch.BLOCK_RISE].any()


def test_fixes_far_calmer_than_stated_are_reported():
    assert until(Navigation(5), lambda z, _: 0.55 * z, 'fixes calm', 400) < 300


@jit_only
def test_fixes_somewhat_calmer_than_stated_are_none():
    navigation = Navigation(6)
    for _ in range(3000):
        navigation.attempt(FIX, 0.8 * navigation.rng.standard_normal(3))
        assert not navigation.look().present


def test_the_ratios_of_calm_and_alike_have_the_mean_one_in_a_world_as_stated():
    x = np.random.default_rng(7).standard_normal((300_000, 3))
    limited = np.clip(x, -watch.RISE_LIMIT, watch.RISE_LIMIT)
    ratio = np.mean(x**2, axis=1)
    for calm, rho in zip(watch.CALMS, watch.ALIKE, strict=True):
        less = 1.5 * (ratio * (1.0 - 1.0 / calm) - np.log(calm))
        assert np.mean(np.exp(less)) == pytest.approx(1.0, abs=0.02)
        rest = 1.0 - rho**2
        off = limited[1:] - rho * limited[:-1]
        alike = 0.5 * np.sum(limited[1:] ** 2 - off**2 / rest - np.log(rest), axis=1)
        assert np.mean(np.exp(alike)) < 1.02
