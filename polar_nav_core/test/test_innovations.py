"""Whitened innovations of whole runs: white, and the smoother's information of common errors."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of
from scipy.stats import multivariate_normal

from polar_nav_core.engine import innovations, smoothing
from polar_nav_core.engine.events import Rank
from polar_nav_core.engine.sins.innovation_tape import whitened
from polar_nav_core.errors import ConfigError


@pytest.fixture(scope='module')
def run():
    world = World(90.0, leg_s=20.0)
    params = world.params(
        configuration='default', fix_clock_sigma=1.0, dvl_misalignment_sigma_deg=1.0
    )
    inputs = inputs_of(world, world.fixes(2.0, 4.0, rng=np.random.default_rng(3)))
    return params, inputs, innovations.innovations(params, inputs)


def test_whitening_is_the_solution_of_a_triangle():
    rng = np.random.default_rng(1)
    L = np.tril(rng.normal(size=(4, 3, 3))) + 3.0 * np.eye(3)
    x, sizes = rng.normal(size=(4, 3, 2)), np.array([1, 3, 2, 3])
    found = whitened(L, x, sizes)
    for k, m in enumerate(sizes):
        np.testing.assert_allclose(L[k, :m, :m] @ found[k, :m], x[k, :m], rtol=1e-12)
        assert not found[k, m:].any()


def test_they_are_white_with_unit_variance(run):
    found = run[2]
    rows = found.sizes.sum()
    assert rows > 2000
    assert np.sum(found.white**2) / rows == pytest.approx(1.0, abs=0.15)


def test_their_density_is_that_of_all_rows_at_once():
    """White rows with common errors b: the dense normal distribution of cov I + W B W^T."""
    rng = np.random.default_rng(7)
    n, c = 7, 4
    sizes = np.array([1, 3, 3, 1, 2, 3, 1])
    beyond = np.arange(3) >= sizes[:, None]
    white = np.where(beyond, 0.0, 2.0 * rng.normal(size=(n, 3)))
    moved = np.where(beyond[:, :, None], 0.0, rng.normal(size=(n, 3, c)))
    log_sigma = np.where(beyond, 0.0, rng.normal(size=(n, 3)))
    sigmas = np.array([0.5, 0.0, 2.0, 30.0])
    nothing = np.zeros(0)
    found = innovations.Innovations(
        sizes, sizes, sizes, sizes, white, moved, log_sigma, nothing, nothing, nothing, 1, (), ''
    )
    u, logs = innovations.independent(found, sigmas)
    rows = int(sizes.sum())
    got = -logs.sum() - 0.5 * np.sum(u**2) - 0.5 * rows * np.log(2.0 * np.pi)
    W = moved[~beyond]
    dense = multivariate_normal(np.zeros(rows), np.eye(rows) + W * sigmas**2 @ W.T)
    assert got == pytest.approx(dense.logpdf(white[~beyond]) - log_sigma.sum(), rel=1e-10)
    assert not u[beyond].any()
    assert not logs[beyond].any()


def test_density_of_a_run_is_that_of_its_measurements(run):
    """Of a run without common errors: rows z ~ N(0, S) with S = L L^T, as the filter has them."""
    params, inputs, found = run
    u, logs = innovations.independent(found, np.zeros(found.moved.shape[2]))
    np.testing.assert_array_equal(u, found.white)
    np.testing.assert_array_equal(logs, found.log_sigma)
    louder = replace(inputs, depth_variance=4.0 * inputs.depth_variance)
    other = innovations.innovations(params, louder)
    depth = found.ranks == Rank.DEPTH
    assert found.log_sigma[depth, 0].mean() < other.log_sigma[depth, 0].mean()
    # z of a depth is the same in the first measurement: the product of both.
    first = int(np.flatnonzero(depth)[0])
    z = [r.white[first, 0] * np.exp(r.log_sigma[first, 0]) for r in (found, other)]
    assert z[0] == pytest.approx(z[1], rel=1e-9)


def test_they_hold_what_the_smoother_says_of_common_errors(run):
    params, inputs, found = run
    smoothed = smoothing.smooth(params, inputs, passes=1)
    M = found.moved.reshape(-1, found.moved.shape[2])
    np.testing.assert_allclose(
        M.T @ M, smoothed.information, rtol=1e-9, atol=1e-9 * smoothed.information.max()
    )
    np.testing.assert_allclose(
        M.T @ found.white.ravel(), smoothed.vector, rtol=1e-6, atol=1e-9 * np.abs(M).sum()
    )


def test_the_end_is_the_end_of_the_run(run):
    _, inputs, found = run
    assert found.filters == 1
    assert not found.divergence
    assert found.stamps_ns[-1] == inputs.imu_stamps_ns[-1]
    np.testing.assert_allclose(found.P, found.P.T, atol=1e-12)
    assert found.sensitivity.any()


def test_a_run_in_which_nothing_is_measured_is_refused(run):
    params, inputs, _ = run
    empty = type(inputs)(inputs.imu_stamps_ns[:1], inputs.omega_ib_b[:1], inputs.f_b[:1])
    with pytest.raises(ConfigError, match='nothing was measured'):
        innovations.innovations(params, empty)
