"""Moments of DVL and USBL against what their parameters state, each with its estimation band.

Seeds were chosen before any result was seen. A band is Z = 4 standard errors wide on each side: a
right model leaves one with probability 6e-5, and any of the 89 numbers here with less than 1 %.
"""

import dataclasses
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from polar_nav_core.attitude import matrix_from_euler
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors import presets
from polar_nav_sim.sensors.dvl import DvlSensor
from polar_nav_sim.sensors.usbl import Cycle, Usbl
from polar_nav_sim.sound_speed import SoundSpeed

pytestmark = pytest.mark.slow

Z = 4.0
SEED = 1
PERIOD_S = 1.0
V = np.array([1.5, -0.4, 0.2])
C = 1440.0
TURN_AROUND_S = 0.1


@pytest.fixture(scope='module', params=presets.DVL)
def dvl(request):
    """Six hours at rest with a ping a second, and a piece of it at V with the same noise."""
    errors = presets.DVL[request.param].errors
    runs = []
    for v, n in ((np.zeros(3), 6 * 3600), (V, 100)):
        sensor = DvlSensor(errors, PERIOD_S, stream(SEED, f'moments/{request.param}'))
        runs.append([sensor.measure(k, v, np.zeros(3)).velocity_m for k in range(n)])
    return errors, *map(np.array, runs)


def test_dvl_scale(dvl):
    errors, rest, moving = dvl
    # The same draws: what the difference has beyond V is the scale, exactly, and what was drawn.
    found = (moving - rest[: len(moving)]).mean(axis=0) / V - 1.0
    assert_allclose(found, errors.scale, atol=1e-12 + Z * errors.scale_sigma)
    assert (np.abs(found - errors.scale).max() > 1e-6) == (errors.scale_sigma > 0.0)


def test_dvl_white_noise(dvl):
    """Differences of neighbours hold 2 sigma^2 and almost nothing of the slow error."""
    errors, rest, _ = dvl
    d = np.diff(rest, axis=0)
    slow = 2.0 * errors.markov_sigma**2 * -math.expm1(-PERIOD_S / errors.markov_tau_s)
    sigma = np.sqrt(np.maximum(d.var(axis=0) - slow, 0.0) / 2.0)
    # Var of a mean of squared differences of white noise: 3/n relative, so 0.87/sqrt(n) of sigma.
    assert_allclose(sigma, errors.noise_sigma, rtol=Z * math.sqrt(0.75 / len(d)))


def test_dvl_markov_sigma_and_correlation_time(dvl):
    """Autocovariance at 0, tau/2, tau and 2 tau; white noise only adds to the first.

    The standard error is that of the mean of x_k x_{k+lag} for a Gaussian process, by Bartlett's
    sum over its autocovariance r: sqrt(sum_j (r_j^2 + r_{j+lag} r_{j-lag}) / n).
    """
    errors, rest, _ = dvl
    n, q = len(rest), math.exp(-PERIOD_S / errors.markov_tau_s)
    j = np.arange(-n + 1, n)

    def covariance(lag):
        white = np.where(lag == 0, errors.noise_sigma**2, 0.0)
        return errors.markov_sigma**2 * q ** np.abs(lag) + white

    for times_tau in (0.0, 0.5, 1.0, 2.0):
        lag = round(times_tau * errors.markov_tau_s / PERIOD_S)
        # The mean is known to be zero: no loss of a degree of freedom.
        got = np.mean(rest[lag:] * rest[: n - lag], axis=0)
        spread = np.sum(covariance(j) ** 2 + covariance(j + lag) * covariance(j - lag))
        assert_allclose(
            got, covariance(lag), atol=Z * math.sqrt(spread) / (n - lag) * math.sqrt(n)
        )


def test_dvl_errors_of_the_axes_are_independent(dvl):
    errors, rest, _ = dvl
    n, q = len(rest), math.exp(-PERIOD_S / errors.markov_tau_s)
    variance = errors.markov_sigma**2 + errors.noise_sigma**2
    # Sum of squared autocovariances over all lags.
    spread = errors.markov_sigma**4 * (1.0 + q * q) / (1.0 - q * q)
    spread += errors.noise_sigma**4 + 2.0 * (errors.markov_sigma * errors.noise_sigma) ** 2
    cross = (rest.T @ rest / n)[np.triu_indices(3, 1)]
    assert np.abs(cross).max() < Z * math.sqrt(spread / n)
    assert_allclose(np.diag(rest.T @ rest / n), variance, atol=Z * math.sqrt(2.0 * spread / n))


N = 10_000
DIRECTION = matrix_from_euler(0.6, 0.0, 0.0) @ np.array([0.6, 0.0, -0.8])


def cycles(errors, name, n=N):
    """Readings of n cycles with one geometry; None where nothing was heard."""
    usbl = Usbl(errors, SoundSpeed.constant(C), SEED, 'leader', f'moments/{name}')
    t4 = round(1e9 * (2.0 * 600.0 / C + TURN_AROUND_S))
    cycle = Cycle(0, 0, t4 // 2 - 50_000_000, t4 // 2 + 50_000_000, t4, DIRECTION, C, 100.0)
    return [usbl.read(dataclasses.replace(cycle, sequence=k)) for k in range(n)]


@pytest.mark.parametrize('name', presets.USBL)
def test_usbl_cosines_range_and_depth(name):
    errors = presets.USBL[name].errors
    readings = cycles(errors, name)
    x = np.array(
        [
            [
                *(r.direction_a[:2] - DIRECTION[:2]),
                r.range_m - 600.0,
                r.target_depth - 100.0,
            ]
            for r in readings
        ]
    )
    sigma = np.array([*[errors.cosine_sigma] * 2, errors.range_sigma_m, errors.told_depth_sigma_m])
    n = len(x)
    assert n == N
    assert_allclose(x.mean(axis=0) / sigma, 0.0, atol=Z / math.sqrt(n) + 1e-6)
    assert_allclose(x.std(axis=0), sigma, rtol=Z / math.sqrt(2.0 * n))
    # Correlations of what is independent, and excess of what is Gaussian.
    correlation = np.corrcoef(x.T)[np.triu_indices(4, 1)]
    assert np.abs(correlation).max() < Z / math.sqrt(n)
    kurtosis = np.mean((x / sigma) ** 4, axis=0)
    assert_allclose(kurtosis, 3.0, atol=Z * math.sqrt(96.0 / n))
    assert_allclose([np.linalg.norm(r.direction_a) for r in readings], 1.0, atol=1e-12)
    assert {r.cosine_variance for r in readings} == {errors.cosine_sigma**2}
    assert {r.range_variance for r in readings} == {errors.range_sigma_m**2}


@pytest.mark.parametrize('share', [0.02, 0.1, 0.3])
def test_usbl_outlier_share_and_size(share):
    """Outliers are late: uniform up to outlier_range_m; the rest keeps its sigma."""
    errors = dataclasses.replace(
        presets.USBL['default'].errors, outlier_probability=share, outlier_range_m=1000.0
    )
    x = np.array([r.range_m - 600.0 for r in cycles(errors, f'outliers {share}')])
    late = x > 5.0 * errors.range_sigma_m
    # An outlier later than 5 sigma: all but 0.15 % of them.
    seen = share * (1.0 - 5.0 * errors.range_sigma_m / 1000.0)
    assert late.mean() == pytest.approx(seen, abs=Z * math.sqrt(seen * (1.0 - seen) / N))
    count = int(late.sum())
    assert x[late].mean() == pytest.approx(500.75, abs=Z * 1000.0 / math.sqrt(12.0 * count))
    kept = x[~late]
    assert kept.std() == pytest.approx(errors.range_sigma_m, rel=Z / math.sqrt(2.0 * len(kept)))


@pytest.mark.parametrize('share', [0.05, 0.5])
def test_usbl_loss_share(share):
    errors = dataclasses.replace(presets.USBL['default'].errors, loss_probability=share)
    lost = np.mean([r is None for r in cycles(errors, f'loss {share}')])
    assert lost == pytest.approx(share, abs=Z * math.sqrt(share * (1.0 - share) / N))
