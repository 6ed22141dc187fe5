"""RMS and its like, windows, and chi-square consistency."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from polar_nav_tools.scoring import (
    Window,
    chi_square_band,
    consistency,
    normalized_squared,
    standard_windows,
    statistics,
)
from polar_nav_tools.scoring.consistency import consistency_along, effective_count


def test_by_hand():
    s = statistics([3.0, -4.0, np.nan, 0.0, np.inf])
    assert (s.count, s.missing) == (3, 2)
    assert s.rms == pytest.approx(np.sqrt(25.0 / 3.0))
    assert s.median == 3.0
    assert s.max == 4.0
    assert s.mean == pytest.approx(-1.0 / 3.0)
    assert s.p95 == pytest.approx(3.9)  # 0.9 of the way from 3 to 4


def test_nothing_finite_is_nan_and_null_in_json():
    s = statistics([np.nan])
    assert (s.count, s.missing) == (0, 1)
    assert np.isnan(s.rms)
    assert s.to_dict()['rms'] is None


def test_scaled_changes_the_unit_of_everything():
    s = statistics([1.0, -2.0])
    t = statistics([1000.0, -2000.0])
    assert_allclose(list(s.scaled(1000.0).to_dict().values()), list(t.to_dict().values()))
    with pytest.raises(ValueError, match='factor=0'):
        s.scaled(0.0)


def test_windows():
    whole, half = standard_windows(0, 10_000_000_001)
    assert (half.start_ns, half.end_ns) == (5_000_000_000, 10_000_000_001)
    stamps = np.array([4_999_999_999, 5_000_000_000, 10_000_000_001, 10_000_000_002])
    assert half.mask(stamps).tolist() == [False, True, True, False]
    assert whole.duration == pytest.approx(10.0)
    stamp_ns = np.array([0, 4_999_999_999, 5_000_000_000, 5_000_000_000, 10_000_000_001])
    for window, shift_ns in (
        (whole, 0),
        (half, 0),
        (half, 10_000_000_000),
        (whole, -20_000_000_000),
    ):
        rows = stamp_ns[window.rows(stamp_ns + shift_ns)]
        assert_array_equal(rows, stamp_ns[window.mask(stamp_ns + shift_ns)])
    with pytest.raises(ValueError, match="window 'x'"):
        Window('x', 1, 0)


@pytest.mark.parametrize('dof', [1, 2, 3, 15, 24, 4500.0])
@pytest.mark.parametrize('probability', [0.5, 0.95, 0.9999])
def test_bands_are_those_of_scipy_stats(dof, probability):
    low, high = chi_square_band(dof, probability)
    tail = (1.0 - probability) / 2.0
    assert_allclose([low, high], chi2.ppf([tail, 1.0 - tail], dof), rtol=1e-9)


def test_a_probability_of_one_has_no_band():
    with pytest.raises(ValueError, match='probability=1'):
        chi_square_band(3, 1.0)


def test_nees_against_the_formula():
    rng = np.random.default_rng(5)
    A = rng.normal(size=(50, 3, 3)) * np.array([1e-6, 1.0, 1e4])[:, None]
    P = A @ A.transpose(0, 2, 1)
    e = rng.normal(size=(50, 3)) * np.array([1e-6, 1.0, 1e4])
    expected = [x @ np.linalg.inv(p) @ x for x, p in zip(e, P, strict=True)]
    assert_allclose(normalized_squared(e, P), expected, rtol=1e-6)


@pytest.mark.parametrize(
    'P',
    [
        np.diag([1.0, 0.0]),
        np.diag([1.0, -1.0]),
        np.array([[1.0, 2.0], [2.0, 1.0]]),
        np.diag([1.0, np.nan]),
        np.diag([1.0, np.inf]),
        np.array([[1e-300, 1e300], [1e300, 1e-300]]),
    ],
)
def test_an_unusable_covariance_gives_no_nees(P):
    good = np.eye(2)
    values = normalized_squared(np.ones((2, 2)), np.stack([P, good]))
    assert np.isnan(values[0])
    assert values[1] == pytest.approx(2.0)


def test_nees_does_not_depend_on_its_neighbours():
    """One matrix that is not definite sends all of them another way."""
    rng = np.random.default_rng(6)
    A = rng.normal(size=(50, 3, 3))
    P, e = A @ A.transpose(0, 2, 1), rng.normal(size=(50, 3))
    one_bad = P.copy()
    one_bad[7] = np.ones((3, 3))
    found = normalized_squared(e, one_bad)
    assert np.isnan(found[7])
    others = np.arange(50) != 7
    assert_array_equal(found[others], normalized_squared(e, P)[others])


def test_shapes_are_checked():
    with pytest.raises(ValueError, match=r'\(4, 3\)'):
        normalized_squared(np.ones((4, 3)), np.ones((4, 2, 2)))


def gauss_markov(rng, n, rho):
    """A stationary series N(0, 1) with the autocorrelation rho^|lag|, (n, 1)."""
    x = np.empty((n, 1))
    x[0] = rng.normal()
    for k in range(1, n):
        x[k] = rho * x[k - 1] + np.sqrt(1.0 - rho**2) * rng.normal()
    return x


def test_effective_count_of_known_processes():
    rng = np.random.default_rng(2)
    n = 20000
    assert effective_count(rng.normal(size=(n, 3))) == pytest.approx(n, rel=0.1)
    # Squares of AR(1): tau = (1 + rho^2) / (1 - rho^2).
    rho = 0.95
    x = gauss_markov(rng, n, rho)
    assert effective_count(x) == pytest.approx(n * (1 - rho**2) / (1 + rho**2), rel=0.25)
    assert effective_count(np.full((100, 1), 7.3)) == pytest.approx(1.0)
    assert effective_count(np.zeros((100, 1))) == 1.0
    assert effective_count([[1.0], [2.0]]) == 2.0


def test_a_constant_error_with_noise_on_it_is_one_sample():
    """A leader's offset of 1.8 sigma under a little noise of fixes, over a whole run."""
    rng = np.random.default_rng(5)
    c = consistency_along(1.8 + 0.2 * rng.normal(size=(6000, 1)))
    assert c.effective_count < 2.0
    assert c.mean_per_dof == pytest.approx(3.28, rel=0.05)
    assert c.judgement == 'consistent'
    assert consistency_along(np.full((6000, 1), 3.0)).judgement == 'optimistic'


def test_honest_correlated_errors_are_consistent_in_most_runs():
    """Of 200 runs of some 17 correlation times 10 are expected outside their band, hardly 40."""
    rng = np.random.default_rng(9)
    found = [consistency_along(gauss_markov(rng, 500, 0.97)).judgement for _ in range(200)]
    assert found.count('consistent') >= 160


def test_an_honest_filter_is_consistent_in_most_runs():
    """The band has 95 %: of 200 runs 10 are expected outside, 22 would be beyond 3.9 sigma."""
    rng = np.random.default_rng(8)
    found = [consistency(rng.chisquare(3, 300), 3).judgement for _ in range(200)]
    assert found.count('consistent') >= 178


@pytest.mark.parametrize(('factor', 'word'), [(2.0, 'optimistic'), (0.5, 'pessimistic')])
def test_a_wrong_covariance_is_found(factor, word):
    values = factor * np.random.default_rng(1).chisquare(3, 300)
    c = consistency(values, 3)
    assert c.judgement == word
    assert c.mean_per_dof == pytest.approx(factor, rel=0.1)
    assert c.share_inside < 0.95


def test_mixed_degrees_of_freedom_are_weighed():
    dof = np.array([2, 3] * 500)
    values = np.random.default_rng(4).chisquare(dof)
    c = consistency(values, dof)
    assert c.dof == 2.5
    assert c.mean_per_dof == pytest.approx(values.sum() / dof.sum())
    low, high = chi2.ppf([0.025, 0.975], 2500) / 2500
    assert_allclose([c.band_low, c.band_high], [low, high], rtol=1e-9)
    assert c.share_inside == pytest.approx(0.95, abs=0.02)


def test_correlated_samples_widen_the_band():
    slow = np.repeat(np.random.default_rng(0).normal(size=(30, 3)), 100, axis=0)
    along = consistency_along(slow)
    assert along.effective_count < 60
    assert along.band_high - along.band_low > 0.4
    assert consistency(np.square(slow).sum(1), 3).band_high < 1.06


def test_no_samples_no_judgement():
    c = consistency([np.nan], 3)
    assert (c.count, c.missing, c.judgement) == (0, 1, 'unknown')
    assert c.to_dict()['mean'] is None
