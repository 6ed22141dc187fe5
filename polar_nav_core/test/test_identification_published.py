"""Published Levenberg-Marquardt: the reference numbers, and its traps, each beside the way out."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification_world import TRUE_MODEL, Sensors, identifier_of
from numpy.testing import assert_allclose

from polar_nav_core.identification.identifier import identify
from polar_nav_core.identification.params import IdentificationParams
from polar_nav_core.identification.published import (
    Samples,
    levenberg_marquardt,
    steady_speed_and_slopes,
    track_and_slopes,
)
from polar_nav_core.identification.result import IdentificationVerdict as Verdict
from polar_nav_core.vehicle_model import steady_speed

VECTORS = json.loads((Path(__file__).parent / 'data' / 'has_identification.json').read_text())
TRUTH = np.array([25.0, 19.0, 0.4, 0.25])
PUBLISHED_START = np.array([15.0, 90.0, 0.0, 0.0])


def samples_of(case):
    return Samples(
        np.array(case['t']),
        np.array(case['tau']),
        np.array(case['psi']),
        np.column_stack([case['xg'], case['yg']]),
        np.array(case['X1']),
    )


CASES = [pytest.param(c, id=c['name']) for c in VECTORS['lm']]
NOISY = samples_of(VECTORS['lm'][1])


@pytest.mark.parametrize('case', VECTORS['steady_speed'])
def test_steady_speed_and_its_slopes(case):
    found = steady_speed_and_slopes(np.array([case['tau']]), case['d1'], case['d2'])
    assert_allclose(np.ravel(found), [case['u'], case['du_dd1'], case['du_dd2']], rtol=1e-9)
    assert steady_speed(case['tau'], case['d1'], case['d2']) == pytest.approx(case['u'], rel=1e-9)


@pytest.mark.parametrize('case', CASES)
def test_reference_minimum(case):
    samples = samples_of(case)
    error = track_and_slopes(samples, np.array(case['P0']))[0] - samples.position
    assert np.sum(error**2) == pytest.approx(case['cost_at_P0'], rel=1e-9)
    found = levenberg_marquardt(samples, np.array(case['P0']))
    assert found.converged
    assert_allclose(found.values, case['P'], rtol=1e-4)
    assert found.cost == pytest.approx(case['cost_sum_sq'], rel=1e-9, abs=1e-12)
    assert_allclose(np.diag(np.linalg.inv(found.normal)), case['cov_diag'], rtol=1e-4)


@pytest.mark.parametrize('drag', [(15.0, 90.0), (25.0, 19.0), (-3.0, 40.0)])
def test_sensitivities_against_differences(drag):
    values = np.array([*drag, 0.3, -0.2])
    _, slopes = track_and_slopes(NOISY, values)
    for k, step in enumerate([1e-4, 1e-4, 1e-6, 1e-6]):
        e = step * np.eye(4)[k]
        numerical = track_and_slopes(NOISY, values + e)[0] - track_and_slopes(NOISY, values - e)[0]
        assert_allclose(slopes[:, :, k], numerical / (2 * step), rtol=1e-6, atol=1e-6)


def test_trap_stall_at_a_drag_that_must_stay_positive():
    # Scenario of the paper, whose full noise makes the minimum; eight times its cost is left.
    samples = Samples.of(identifier_of(sensors=Sensors(seed=1)).window())
    stalled = levenberg_marquardt(samples, PUBLISHED_START, keep_linear_positive=True)
    free = levenberg_marquardt(samples, PUBLISHED_START)
    assert free.converged
    assert free.values[0] > 0.0
    assert not stalled.converged
    assert abs(stalled.values[0]) < 0.01
    assert 70.0 < stalled.values[1] < 90.0
    assert stalled.cost > 5.0 * free.cost
    robust = identifier_of(sensors=Sensors(seed=1)).identify(0, 'offline', 'robust')
    assert robust.verdict is Verdict.ACCEPTED  # bounded, from the same start
    assert 10.0 < robust.values[0] < 40.0


def test_trap_poor_damping():
    few = [
        levenberg_marquardt(NOISY, PUBLISHED_START, mu=10.0**k).iterations for k in range(-4, 5)
    ]
    assert max(few) <= 33
    for mu in (1e-4, 1.0):
        fixed = levenberg_marquardt(NOISY, PUBLISHED_START, adaptive=False, mu=mu)
        assert fixed.converged
        assert_allclose(fixed.values, VECTORS['lm'][1]['P'], rtol=1e-4)
    for mu in (1e2, 1e4):
        fixed = levenberg_marquardt(NOISY, PUBLISHED_START, adaptive=False, mu=mu)
        assert not fixed.converged
        assert fixed.iterations == 200
        adaptive = levenberg_marquardt(NOISY, PUBLISHED_START, mu=mu)
        assert adaptive.converged
        assert_allclose(adaptive.values, VECTORS['lm'][1]['P'], rtol=1e-4)


def test_trap_anchor_at_the_first_fix():
    window = identifier_of().window()
    e0 = np.array([8.0, 0.0])
    expected = -1.5 * e0[0] / window.duration
    # With the drag known it is the slope of a line through a point that is off: -3/2 e0 / T.
    _, slopes = track_and_slopes(Samples.of(window), TRUTH)
    offset = np.tile(e0, window.fixes)
    alone = np.linalg.lstsq(slopes.reshape(-1, 4)[:, 2:], -offset, rcond=None)[0]
    assert_allclose(alone, [expected, 0.0], rtol=0.01, atol=1e-12)
    position = window.position.copy()
    position[0] += e0
    off = replace(window, position=position)
    clean, anchored = (
        levenberg_marquardt(Samples.of(w), PUBLISHED_START).values for w in (window, off)
    )
    bias = (anchored - clean)[2]
    assert bias == pytest.approx(expected, rel=0.2)
    # A start that is estimated keeps the error of one fix out of the current.
    free, moved = (
        identify(w, IdentificationParams(), stamp_ns=0, trigger='offline', method='robust')
        for w in (window, off)
    )
    assert np.abs(moved.values - free.values)[2:4].max() < 0.05 * abs(bias)


def test_trap_left_euler_error_is_bounded_by_the_first_and_last_step():
    window = identifier_of().window()
    samples = Samples.of(window, window.position[0])
    coarse, _ = track_and_slopes(samples, TRUTH)
    rate = np.diff(coarse, axis=0) / np.diff(samples.seconds)[:, None]
    # The same integrand on the log's own grid: what the paper's sum at 2.5 s leaves out.
    speed, _, _ = steady_speed_and_slopes(window.force, TRUTH[0], TRUTH[1])
    fine = speed[:, None] * np.column_stack([np.cos(window.psi), np.sin(window.psi)]) + TRUTH[2:]
    h = np.diff(window.seconds)[:, None]
    path = np.vstack([[0.0, 0.0], np.cumsum(h * (fine[1:] + fine[:-1]) / 2, axis=0)])
    path = path[window.node] - path[window.node[0]]
    error = np.linalg.norm(coarse - coarse[0] - path, axis=1)[1:-1]
    bound = 1.25 * np.linalg.norm(rate[1:] - rate[0], axis=1)
    assert 1.0 < error.max() < 3.5
    assert (error < bound + 0.35).all()
    noise_free = identifier_of(**TRUE_MODEL).identify(0, 'offline', 'robust')
    assert np.sqrt(noise_free.cost / 600) < 1e-4  # of a sigma: 1 mm


@pytest.mark.parametrize(
    ('changes', 'verdict', 'said'),
    [
        ({'identify_damping': 'fixed', 'identify_mu': 1e4}, Verdict.NOT_CONVERGED, '200 iterat'),
        ({'identify_current_limit': 0.3}, Verdict.UNPHYSICAL, 'current of 0.4'),
        ({'identify_drag_ratio': 1.5}, Verdict.UNPHYSICAL, 'drag of 4'),
        ({'identify_least_fixes': 300, 'identify_fixes': 301}, Verdict.ACCEPTED, 'converged'),
        ({'identify_least_fixes': 302, 'identify_fixes': 302}, Verdict.TOO_FEW_FIXES, '301 fixes'),
    ],
)
def test_verdicts(changes, verdict, said):
    identifier = identifier_of(sensors=Sensors(seed=3), **changes)
    found = identifier.identify(5, 'offline', 'published')
    assert found.verdict is verdict
    assert said in found.reason
    assert found.names == ('drag_linear', 'drag_quadratic', 'current_x', 'current_y')
    assert found.values.shape == (4,)
    assert found.covariance.shape == (4, 4)
