"""Whitened innovations of whole runs: white, and the smoother's information of common errors."""

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core.engine import innovations, smoothing
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


def test_they_hold_what_the_smoother_says_of_common_errors(run):
    params, inputs, found = run
    smoothed = smoothing.smooth(params, inputs)
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
