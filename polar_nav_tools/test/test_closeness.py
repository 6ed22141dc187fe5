"""Differences of two runs in units of sigma: rounding passes, anything more is found and named."""

import dataclasses

import numpy as np
import pytest

from polar_nav_core.attitude import exp
from polar_nav_tools.report.example import example_input
from polar_nav_tools.series.closeness import LIMIT_SIGMA, closeness, model_closeness
from polar_nav_tools.series.model import ModelSeries

EXAMPLE = next(iter(example_input(minutes=0.5).runs.values()))[1]
ESTIMATE = dataclasses.replace(
    EXAMPLE,
    gyro_bias_b=np.full_like(EXAMPLE.gyro_bias_b, 1e-7),
    gyro_bias_sigma=np.full_like(EXAMPLE.gyro_bias_b, 1e-6),
)
K = 17


def changed(field, by):
    """Return the run with one field of sample K changed by a function of the old value."""
    values = getattr(ESTIMATE, field).copy()
    values[K] = by(values[K])
    return dataclasses.replace(ESTIMATE, **{field: values})


def sigma(P):
    return np.sqrt(np.diagonal(P[K]))


def test_the_same_run_is_at_distance_zero():
    found = closeness(ESTIMATE, ESTIMATE)
    assert (found.sigmas, found.close) == (0.0, True)
    assert set(found.fields) >= {'position', 'velocity', 'attitude', 'gyro bias', 'status'}


@pytest.mark.parametrize('size', [0.5e-6, 3e-6])
@pytest.mark.parametrize(
    ('field', 'what', 'change'),
    [
        ('r_e', 'position', lambda r, s: r + s * sigma(ESTIMATE.P_position_G).min()),
        ('v_G', 'velocity', lambda v, s: v + s * sigma(ESTIMATE.P_velocity_G)),
        (
            'C_b_G',
            'attitude',
            lambda C, s: exp(s * sigma(ESTIMATE.P_attitude_G) * [0, 0, 1.0]) @ C,
        ),
        ('gyro_bias_b', 'gyro bias', lambda b, s: b - s * ESTIMATE.gyro_bias_sigma[K]),
        ('P_velocity_G', 'covariance of velocity', lambda P, s: P * (1.0 + s)),
    ],
)
def test_differences_are_measured_in_sigma(field, what, change, size):
    if field == 'r_e':  # positions in metres on the earth hold 1e-9 m: take a larger share
        size *= 100.0
    other = changed(field, lambda value: change(value, size))
    found = closeness(ESTIMATE, other)
    assert found.what == what
    assert found.stamp_ns == ESTIMATE.stamp_ns[K]
    unit = np.sqrt(3.0) if field == 'r_e' else 1.0
    assert 0.3 * size < found.sigmas < 1.05 * unit * size * 1.01
    assert found.close is (found.sigmas <= LIMIT_SIGMA)


def test_a_number_against_none_is_no_rounding():
    for field in ('r_e', 'v_G', 'C_b_G', 'P_position_G', 'usbl_bias_a'):
        other = changed(field, lambda v: np.full_like(v, np.nan))
        assert closeness(ESTIMATE, other).sigmas == np.inf, field
        assert closeness(other, ESTIMATE).sigmas == np.inf, field
        assert closeness(other, other).sigmas == 0.0, field


def test_another_status_is_no_rounding():
    found = closeness(ESTIMATE, changed('status', lambda s: s + 1))
    assert (found.sigmas, found.what) == (np.inf, 'status')


def test_runs_that_cannot_be_paired():
    shorter = ESTIMATE.rows(slice(None, -3))
    assert 'estimates against' in closeness(ESTIMATE, shorter).what
    shifted = dataclasses.replace(ESTIMATE, stamp_ns=ESTIMATE.stamp_ns + 1)
    found = closeness(ESTIMATE, shifted)
    assert (found.close, found.stamp_ns) == (False, ESTIMATE.stamp_ns[0])
    nothing = ESTIMATE.rows(slice(0, 0))
    assert not closeness(nothing, nothing).close


# -- vehicle model


MODEL = ModelSeries(
    stamp_ns=np.arange(30) * 10**9,
    v_r_b=np.tile([1.0, 0.1, 0.0], (30, 1)),
    P_v_r_b=np.tile(np.eye(3) * 1e-4, (30, 1, 1)),
    current_G=np.tile([0.2, -0.1, 0.0], (30, 1)),
    P_current_G=np.tile(np.diag([1e-4, 1e-4, np.nan]), (30, 1, 1)),
    drag_linear=np.full(30, 15.0),
    drag_linear_sigma=np.full(30, 2.0),
    drag_quadratic=np.full(30, 90.0),
    drag_quadratic_sigma=np.full(30, np.nan),
    drag_correlation=np.zeros(30),
    heading_bias=np.full(30, 0.01),
    heading_bias_sigma=np.full(30, 0.02),
    current_walk=np.full(30, 1e-5),
)
"""With a vertical current and a quadratic drag that are not estimated."""


@pytest.mark.parametrize('size', [0.5e-6, 3e-6])
@pytest.mark.parametrize(
    ('field', 'what', 'sigma'),
    [
        ('v_r_b', 'velocity through the water', 1e-2),
        ('P_v_r_b', 'covariance of velocity through the water', 1e-4),
        ('current_G', 'current', np.array([1e-2, 0.0, 0.0])),
        ('drag_linear', 'drag linear', 2.0),
        ('heading_bias_sigma', 'heading bias sigma', 0.02),
    ],
)
def test_differences_of_vehicle_models(field, what, sigma, size):
    values = getattr(MODEL, field).copy()
    values[K] = values[K] + 0.9 * size * sigma
    found = model_closeness(MODEL, dataclasses.replace(MODEL, **{field: values}))
    assert (found.what, found.stamp_ns) == (what, MODEL.stamp_ns[K])
    assert found.sigmas == pytest.approx(0.9 * size, rel=1e-6)
    assert found.close is (size < LIMIT_SIGMA)


def test_a_model_without_a_sigma_must_be_the_same():
    assert model_closeness(MODEL, MODEL).sigmas == 0.0
    other = dataclasses.replace(MODEL, drag_quadratic=MODEL.drag_quadratic + 1e-9)
    assert model_closeness(MODEL, other).sigmas == np.inf
