"""Common errors of station mode: the filter is off by what its sensitivity says."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import station_twin as twin

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.kernels.station import common
from polar_nav_core.kernels.station import state as ss

pytestmark = pytest.mark.slow

SECONDS = 40.0
LINEAR = {
    'configuration': 'custom',
    'gate_probability': 1.0,
    'robust_fixes': 'none',
    'identify_method': 'none',
    'current_method': 'single',
}
STATED = {
    'station_range_scale_sigma': 0.005,
    'station_turn_sigma_deg': 0.5,
    'station_position_sigma': 10.0,
    'depth_offset_sigma': 0.5,
}
SMALL = np.array([1e-5, 1e-5, 1e-2, 1e-2, 1e-2])
"""Of each common error: small enough for the filter to be linear in it."""


@cache
def world():
    return twin.inputs(twin.truth(SECONDS), 4, depth_every=10)


def with_error(inputs, column):
    b = np.zeros(ss.COMMON)
    b[column] = SMALL[column]

    def off(fix):
        p = fix.polar
        polar = replace(
            p,
            range=p.range * (1.0 + b[ss.RANGE_SCALE]),
            bearing=p.bearing + b[ss.TURN],
            station=p.station + np.array([b[ss.OFFSET], b[ss.OFFSET + 1], 0.0]),
        )
        return replace(fix, polar=polar)

    return replace(
        inputs,
        fixes=tuple(off(fix) for fix in inputs.fixes),
        depth=inputs.depth + b[ss.DEPTH_ZERO],
    )


def final(inputs, **changes):
    engine = Engine(twin.params(**{**LINEAR, **STATED, **changes}))
    for event in inputs.events():
        list(engine.process(event))
    return engine.fusion.filter


@pytest.mark.parametrize('name', ['rewind', 'clone', 'back_propagate'])
def test_the_state_is_off_by_the_sensitivity_times_the_error(name):
    changes = {'delay_handling': name, 'station_heading_sigma_deg': 1.0}
    usual = final(world(), **changes)
    S = usual.bank.S[0]
    sigma = np.sqrt(np.diagonal(usual.bank.P[0]))
    for column in range(ss.COMMON):
        found = final(with_error(world(), column), **changes).bank.x[0] - usual.bank.x[0]
        expected = S[:, column] * SMALL[column]
        scale = np.abs(expected / sigma).max()
        assert scale > 1e-5
        # Gains depend on the state, too: that is the rest.
        np.testing.assert_allclose(found / sigma, expected / sigma, atol=0.05 * scale)


def test_stating_a_common_error_enlarges_what_is_published_and_changes_no_bit_of_it():
    silent = engine_run.run(twin.params(**LINEAR), world()).track
    stated = engine_run.run(twin.params(**LINEAR, **STATED), world()).track
    for name in ('r_e', 'v_G', 'C_b_G', 'x', 'weight'):
        assert np.array_equal(getattr(silent, name), getattr(stated, name)), name
    for name in ('P', 'P_x'):
        grown = getattr(stated, name) - getattr(silent, name)
        assert np.linalg.eigvalsh(grown).min() > -1e-9
    sigma = np.sqrt(stated.P_x[-1, 3, 3])
    assert 10.0 < sigma < 15.0
    assert np.sqrt(silent.P_x[-1, 3, 3]) < 8.0


def test_the_published_filter_publishes_what_the_paper_says():
    published = {**LINEAR, 'station_filter': 'published', 'delay_handling': 'tagged'}
    a, b = (engine_run.run(twin.params(**published, **c), world()).track for c in ({}, STATED))
    assert np.array_equal(a.P, b.P)
    assert np.array_equal(a.P_x[:, :6, :6], b.P_x[:, :6, :6])


def test_errors_of_constants_are_the_sensitivity_times_the_constants():
    """Any gain, any rows: e of a run with b less e of a run without is S b."""
    rng = np.random.default_rng(7)
    S, b = np.zeros((ss.N, ss.COMMON)), rng.standard_normal(ss.COMMON)
    e, e_0 = np.zeros(ss.N), np.zeros(ss.N)
    for _ in range(40):
        H, K = rng.standard_normal((2, 2, ss.N)) * 0.1
        J = rng.standard_normal((2, ss.COMMON))
        own, noise = J.copy(), rng.standard_normal(2)
        common.subtract_state(J, H, S, 2)
        S += K.T @ J
        e = e + K.T @ (own @ b + noise - H @ e)
        e_0 = e_0 + K.T @ (noise - H @ e_0)
    np.testing.assert_allclose(e - e_0, S @ b, rtol=1e-9, atol=1e-9)


def test_innovation_covariance_with_the_common_errors():
    rng = np.random.default_rng(8)
    J, sigma = rng.standard_normal((2, ss.COMMON)), rng.uniform(0.1, 2.0, ss.COMMON)
    wide = np.zeros(3)
    common.widen(wide, np.array([2.0, 0.3, 1.0]), J, sigma)
    expected = np.array([[2.0, 0.3], [0.3, 1.0]]) + J @ np.diag(sigma**2) @ J.T
    np.testing.assert_allclose(wide, expected[[0, 0, 1], [0, 1, 1]], rtol=1e-12)
