"""Mathematics of calibration: least squares, sums of constants, mountings that are turned."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from polar_nav_core.attitude import matrix_from_euler
from polar_nav_core.engine.events import Rank
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_tools.calibration import move
from polar_nav_tools.calibration.problem import in_common
from polar_nav_tools.calibration.solve import (
    Normal,
    excited,
    least_squares,
    sums,
    with_states,
)


def test_least_squares_is_that_of_all_equations():
    rng = np.random.default_rng(2)
    M, white, prior = rng.normal(size=(40, 3)), rng.normal(size=40), np.array([1.0, 5.0, 0.2])
    at = np.array([0.3, -1.0, 0.1])
    A = np.vstack([M, np.diag(1.0 / prior)])
    whole, *_ = np.linalg.lstsq(A, np.concatenate([white, -at / prior]), rcond=None)
    found = least_squares(M, white, at, prior)
    np.testing.assert_allclose(found.mean, whole, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(A.T @ A), rtol=1e-9)


def test_rows_that_are_alike_but_for_rounding_show_a_sum_only():
    rng = np.random.default_rng(3)
    row = rng.normal(size=500)
    M = np.column_stack([row, row + 0.01 * rng.normal(size=500)])
    prior = np.array([10.0, 10.0])
    found = least_squares(M, M @ np.array([1.0, 2.0]), np.zeros(2), prior)
    assert found.sigma.min() > 6.0
    (tied,) = sums(found, prior)
    assert tied.weight == pytest.approx(1.0, abs=0.05)
    assert tied.value == pytest.approx(3.0, abs=0.1)
    assert tied.sigma < 0.1
    np.testing.assert_allclose(excited(found, prior), [1.5, 1.5], atol=0.1)


def test_a_scale_is_of_the_speed_about_a_ping_without_its_noise():
    """Along axes of hardly any motion, of pings without bottom lock and of none, there is none."""
    stamps = np.arange(0, 60 * 10**9, 200 * 10**6)
    v = np.tile([2.0, 0.0, 0.0], (len(stamps), 1))
    v[150:, 0] = 1.0
    v[:, 1] = 0.1 * (-1.0) ** np.arange(len(v))
    v[20] = [9.0, 0.0, 0.0]
    v[30] = np.nan
    valid = np.arange(len(v)) != 31
    inputs = Inputs(stamps[:0], v[:0], v[:0], dvl_stamps_ns=stamps, dvl_v_m=v, dvl_valid=valid)
    calm = move.calm_velocity(EngineParams(), inputs)
    assert calm[20, 0] == 2.0
    assert calm[150, 0] == pytest.approx(1.5, abs=0.1)
    assert calm[-1, 0] == 1.0
    assert not calm[:, 1:].any()
    assert not calm[[30, 31]].any()
    _, moved = move.dvl_scale(EngineParams(), inputs, 0.25)
    np.testing.assert_allclose(moved.dvl_v_m[20], [9.0 - 0.4, 0.0, 0.0])
    assert inputs.dvl_v_m[20, 0] == 9.0


def test_a_scale_is_also_of_what_swinging_adds():
    """By yaw about a course kept, of a DVL whose axes are forward, right, down."""
    stamps = np.arange(0, 40 * 10**9, 50 * 10**6)
    s = 1e-9 * stamps
    yaw = 0.02 * np.sin(2 * np.pi * s / 4.0)
    rates = np.zeros((len(s), 3))
    rates[1:, 2] = np.diff(yaw) / 0.05
    v = np.column_stack([2.0 * np.cos(yaw), 2.0 * np.sin(yaw), 0.0 * yaw])
    pings = slice(80, -80, 4)
    inputs = Inputs(
        stamps, rates, rates, dvl_stamps_ns=stamps[pings], dvl_v_m=v[pings],
        dvl_valid=np.ones(len(v[pings]), bool),
    )  # fmt: skip
    calm = move.calm_velocity(EngineParams(dvl_rpy_deg=(180.0, 0.0, 0.0)), inputs)
    np.testing.assert_allclose(calm[5:-5], v[pings][5:-5], atol=2e-3)


def test_a_scale_is_also_of_what_the_lever_arm_adds():
    """A turn to port of a DVL whose axes are forward, right, down, a metre ahead of the IMU."""
    stamps = np.arange(0, 20 * 10**9, 200 * 10**6)
    rates = np.tile([0.0, 0.0, 0.5], (len(stamps), 1))
    v = np.tile([2.0, -0.5, 0.0], (len(stamps), 1))
    inputs = Inputs(
        stamps, rates, rates, dvl_stamps_ns=stamps, dvl_v_m=v, dvl_valid=np.ones(len(v), bool)
    )
    params = EngineParams(dvl_rpy_deg=(180.0, 0.0, 0.0), dvl_lever_b=(1.0, 0.0, 0.0))
    np.testing.assert_allclose(move.calm_velocity(params, inputs), v, atol=1e-12)


def test_a_mounting_is_turned_about_the_axes_of_the_body():
    rpy = move.turned((180.0, 0.0, 45.0), 2, math.radians(2.0))
    np.testing.assert_allclose(np.abs(rpy), [180.0, 0.0, 47.0], atol=1e-9)
    roll, pitch, yaw = np.radians(move.turned((10.0, 20.0, 30.0), 0, math.radians(5.0)))
    before = matrix_from_euler(*np.radians([30.0, 20.0, 10.0]))
    by = matrix_from_euler(yaw, pitch, roll) @ before.T
    np.testing.assert_allclose(by, matrix_from_euler(0.0, 0.0, np.radians(5.0)), atol=1e-12)


def test_states_move_with_the_constants():
    """A state and a constant of one linear problem, solved at once."""
    rng = np.random.default_rng(5)
    root = rng.normal(size=(2, 2))
    b = Normal(np.array([0.5, -2.0]), root @ root.T)
    S, P = np.array([[0.3, 0.1]]), np.array([[0.04]])
    found = with_states(b, np.array([1.0]), P, S)
    A = np.vstack([np.eye(2), S])
    np.testing.assert_allclose(found.mean, A @ b.mean + np.array([0.0, 0.0, 1.0]))
    whole = A @ b.covariance @ A.T + np.diag([0.0, 0.0, 0.04])
    np.testing.assert_allclose(found.covariance, whole)


def test_measurements_are_found_again_where_one_run_refused_some_and_stamps_moved():
    depths, pings = np.arange(0, 1000, 100), np.arange(7, 1000, 50)

    def run(pings_ns):
        stamps = np.concatenate([depths, pings_ns])
        ranks = np.repeat([Rank.DEPTH, Rank.DVL], [len(depths), len(pings_ns)])
        return SimpleNamespace(stamps_ns=stamps, ranks=ranks)

    less, more = run(np.delete(pings, 4) - 20), run(np.delete(pings, [0, 9]) + 20)
    own, in_less, in_more = in_common(run(pings), less, more)
    n = len(depths)
    kept = [k for k in range(len(pings)) if k not in (0, 4, 9)]
    np.testing.assert_array_equal(own, [*range(n), *(n + k for k in kept)])
    np.testing.assert_array_equal(less.stamps_ns[in_less[n:]], pings[kept] - 20)
    np.testing.assert_array_equal(more.stamps_ns[in_more[n:]], pings[kept] + 20)
