"""Truth at the stamps of estimates: by stamp, never by index."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from polar_nav_tools.report.example import estimate_with_errors, example_truth
from polar_nav_tools.scoring import ScoringError, align, errors

TRUTH = example_truth('follower', 80.0, 120.0, 1.0)
N = len(TRUTH)
STEP_NS = int(TRUTH.stamp_ns[1] - TRUTH.stamp_ns[0])


def estimate_of(truth, dr=0.0):
    n = len(truth)
    one = np.ones((n, 3))
    return estimate_with_errors(
        truth,
        'c',
        dr_G=dr * one,
        dv_G=0.0 * one,
        phi_G=0.0 * one,
        sigma_r=one,
        sigma_v=one,
        sigma_phi=one,
    )


ESTIMATE = estimate_of(TRUTH, 0.5)


def shifted(estimate, offset_ns):
    return dataclasses.replace(estimate, stamp_ns=estimate.stamp_ns + offset_ns)


def test_equal_stamps_are_taken_as_they_are():
    pairs = align(TRUTH, ESTIMATE)
    assert pairs.counts.exact == N
    assert pairs.counts.interpolated == 0
    assert_array_equal(pairs.truth.r_e, TRUTH.r_e)
    assert_array_equal(pairs.truth.C_b_G, TRUTH.C_b_G)


def test_order_of_arrival_and_missing_samples_do_not_matter():
    rng = np.random.default_rng(3)
    truth = TRUTH.rows(rng.permutation(N))
    estimate = ESTIMATE.rows(np.sort(rng.choice(N, 100, replace=False))[::-1].copy())
    error = errors(align(truth, estimate))
    assert len(error.stamp_ns) == 100
    assert (np.diff(error.stamp_ns) > 0).all()
    # By index this would be hundreds of metres: the vehicle moves at 3 m/s.
    assert_allclose(error.dr_G, 0.5, atol=1e-8)


def test_interpolation_between_stamps():
    """Against the same formula of motion, sampled ten times as often."""
    t = np.arange(0.0, 20.0, 0.1)
    fine = np.arange(0.05, 19.9, 0.1)

    def motion(time):
        angle = 0.05 * time
        east, north = 60.0 * np.sin(angle), 60.0 * (1.0 - np.cos(angle))
        v = 3.0 * np.stack([np.cos(angle), np.sin(angle), 0 * time], axis=1)
        C = Rotation.from_euler(
            'ZYX', np.stack([angle, 0.07 * np.sin(2 * time), 0.05 * np.sin(time)], axis=1)
        ).as_matrix()
        return np.stack([east, north, 0 * time], axis=1), v, C

    # At the pole: grid axes are parallel to the earth's there, so the local plane is the truth.
    base = np.array([0.0, 0.0, 6356752.0])
    C_G_e = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    offset, v_G, C_b_G = motion(t)
    n = len(t)
    truth = dataclasses.replace(
        TRUTH.rows(slice(0, n)),
        stamp_ns=(t * 1e9).round().astype(np.int64),
        r_e=base + offset @ C_G_e.T,
        v_G=v_G,
        C_b_G=C_b_G,
    )
    offset, v_G, C_b_G = motion(fine)
    estimate = dataclasses.replace(
        ESTIMATE.rows(slice(0, len(fine))),
        stamp_ns=(fine * 1e9).round().astype(np.int64),
        r_e=base + offset @ C_G_e.T,
        v_G=v_G,
        C_b_G=C_b_G,
    )
    pairs = align(truth, estimate)
    assert pairs.counts.interpolated == len(fine)
    error = errors(pairs)
    # Grid axes turn by 1e-5 rad over the 60 m of this track: 3e-5 m/s of 3 m/s; a linear
    # interpolation of position would be off by 0.05 rad/s * 3 m/s * (0.1 s)^2 / 8 = 2e-4 m.
    assert np.abs(error.dr_G).max() < 2e-5
    assert np.abs(error.dv_G).max() < 3.0 * 0.05**2 * 0.1**2 / 8 * 1.5
    assert np.abs(error.phi_G).max() < 0.07 * 2.0**2 * 0.1**2 / 8 * 1.5


def test_slow_truth_on_one_clock_grid_is_not_interpolated():
    slow = TRUTH.rows(slice(0, None, 10))
    pairs = align(slow, ESTIMATE)
    assert pairs.counts.exact == len(slow)
    assert pairs.counts.skipped == N - len(slow)
    assert_allclose(errors(pairs).dr_G, 0.5, atol=1e-8)
    filled = align(slow, ESTIMATE, mode='interpolate')
    assert filled.counts.interpolated == N - len(slow)


def test_offset_stamps_are_interpolated():
    late = shifted(ESTIMATE, 1_234_567)
    pairs = align(TRUTH, late)
    assert pairs.counts.interpolated == N - 1
    assert pairs.counts.outside == 1
    # The estimate is 1.23 ms late: 3 m/s x 1.23 ms = 3.7 mm behind, on top of 0.5 m.
    assert_allclose(np.linalg.norm(errors(pairs).dr_G - 0.5, axis=1), 3.0 * 1.234567e-3, rtol=1e-2)
    with pytest.raises(ScoringError, match='without a truth sample of the same stamp'):
        align(TRUTH, late, mode='exact')


def test_gaps_are_not_bridged():
    keep = np.r_[0:200, 260:N]
    pairs = align(TRUTH.rows(keep), shifted(ESTIMATE, STEP_NS // 2))
    assert pairs.counts.in_gap == 61
    assert pairs.counts.outside == 1
    bridged = align(TRUTH.rows(keep), shifted(ESTIMATE, STEP_NS // 2), max_gap_s=10.0)
    assert bridged.counts.in_gap == 0


def test_last_of_repeated_estimates_counts():
    twice = dataclasses.replace(
        ESTIMATE, stamp_ns=np.where(np.arange(N) == 7, ESTIMATE.stamp_ns[6], ESTIMATE.stamp_ns)
    )
    pairs = align(TRUTH, twice)
    assert pairs.counts.repeated == 1
    row = np.flatnonzero(pairs.truth.stamp_ns == ESTIMATE.stamp_ns[6])
    assert_array_equal(pairs.estimate.r_e[row[0]], ESTIMATE.r_e[7])


def test_truth_twice_is_one_truth_but_two_truths_are_an_error():
    doubled = TRUTH.rows(np.repeat(np.arange(N), 2))
    assert align(doubled, ESTIMATE).counts.exact == N
    other = dataclasses.replace(doubled, r_e=doubled.r_e + np.arange(2 * N)[:, None] % 2)
    with pytest.raises(ScoringError, match='two different positions'):
        align(other, ESTIMATE)


@pytest.mark.parametrize(
    ('truth', 'estimate', 'words'),
    [
        (TRUTH.rows(slice(0, 0)), ESTIMATE, 'no truth'),
        (TRUTH, ESTIMATE.rows(slice(0, 0)), 'no estimates'),
        (TRUTH, shifted(ESTIMATE, 10**12), 'none of 601 estimates can be scored: 601 outside'),
    ],
)
def test_nothing_to_compare_is_said(truth, estimate, words):
    with pytest.raises(ScoringError, match=words):
        align(truth, estimate)


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="mode='nearest'"):
        align(TRUTH, ESTIMATE, mode='nearest')
    with pytest.raises(ValueError, match='max_gap_s=0'):
        align(TRUTH, ESTIMATE, max_gap_s=0)


@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    kept_truth=st.integers(2, N),
    kept_estimate=st.integers(1, N),
    offset_ns=st.sampled_from([0, 1, STEP_NS // 3, 20 * STEP_NS]),
    mode=st.sampled_from(['auto', 'exact', 'interpolate']),
)
def test_every_estimate_is_accounted_for(seed, kept_truth, kept_estimate, offset_ns, mode):
    rng = np.random.default_rng(seed)
    truth = TRUTH.rows(rng.choice(N, kept_truth, replace=False))
    estimate = shifted(ESTIMATE.rows(rng.choice(N, kept_estimate)), offset_ns)
    try:
        pairs = align(truth, estimate, mode=mode)
    except ScoringError:
        return
    c = pairs.counts
    parts = (c.exact, c.interpolated, c.skipped, c.outside, c.in_gap, c.repeated)
    assert sum(parts) == c.estimates == kept_estimate
    assert len(pairs.truth.stamp_ns) == c.exact + c.interpolated == len(pairs.estimate)
    assert_array_equal(pairs.truth.stamp_ns, pairs.estimate.stamp_ns)
