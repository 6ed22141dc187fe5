"""A leader without absolute fixes drifts as its instruments' specification says, and knows it."""

import math

import numpy as np
import pytest
from scipy.stats import chi2

from polar_nav_core.engine.sins.leader_way import SLOW_MPS, SLOW_S
from polar_nav_leader.params import LeaderParams
from polar_nav_sim.sensors.imu import DPH, MICRO_G
from polar_nav_sim.sensors.presets import DVL, IMU
from polar_nav_tools.experiments import leader_alone

CONFIDENCE = 0.999
LEAST_SLACK = 0.9
"""The lower bounds leave out small helps, as transport rate beside the rate of the Earth."""


def test_the_filter_knows_the_instruments_that_the_simulation_gives():
    p, imu, dvl = LeaderParams(), IMU['leader'].errors, DVL['leader'].errors
    assert p.gyro_bias_sigma == pytest.approx(imu.gyro_turn_on_sigma_dph * DPH, rel=1e-3)
    assert p.accel_bias_sigma == pytest.approx(imu.accel_turn_on_sigma_ug * MICRO_G, rel=1e-3)
    assert (p.gyro_noise_density,) * 3 == pytest.approx(imu.gyro_noise_density, rel=1e-3)
    assert (p.accel_noise_density,) * 3 == pytest.approx(imu.accel_noise_density, rel=1e-3)
    assert p.dvl_scale_sigma == dvl.scale_sigma
    assert p.dvl_markov_sigma == dvl.markov_sigma
    assert p.dvl_markov_tau == dvl.markov_tau_s
    assert p.dvl_sigma == dvl.noise_sigma
    assert (dvl.markov_sigma, dvl.markov_tau_s) == (SLOW_MPS, SLOW_S)
    assert not any((*imu.gyro_bias_dph, *imu.accel_bias_ug, *dvl.scale, *dvl.bias))


def test_the_initial_heading_is_that_of_a_gyrocompass_with_these_gyros():
    """0.066 deg at 80 degrees; 0.06 is stated."""
    p = LeaderParams()
    compass = p.gyro_bias_sigma / (7.292115e-5 * math.cos(math.radians(80.0)))
    assert p.initial_sigma_heading_deg == pytest.approx(math.degrees(compass), rel=0.1)


def judge(duration_s, seeds):
    """Sigma within what the specification allows; drift, NEES and heading within their bands."""
    runs = [leader_alone.run(duration_s, seed) for seed in seeds]
    n = len(runs)
    expected = leader_alone.expected(duration_s)
    band = chi2.ppf([0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2], n) / n
    last = runs[0]
    found = {
        'along': (expected.along, [r.along[-1] for r in runs], last.sigma_along[-1]),
        'cross': (expected.cross, [r.cross[-1] for r in runs], last.sigma_cross[-1]),
    }
    for name, ((least, most), errors, sigma) in found.items():
        assert LEAST_SLACK * least < sigma < most, name
        mean_square = np.mean(np.square(errors))
        assert band[0] * (LEAST_SLACK * least) ** 2 < mean_square < band[1] * most**2, name
    lo, hi = chi2.ppf([0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2], 3 * n)
    assert lo < sum(r.nees[-1] for r in runs) < hi
    heading = sum((r.heading[-1] / r.sigma_heading[-1]) ** 2 for r in runs)
    assert band[0] * n < heading < band[1] * n
    return runs


@pytest.mark.slow
def test_ten_minutes():
    judge(600.0, range(1, 7))


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_two_hours():
    """Drift of about a tenth of a per cent of the distance; NEES of position in its band."""
    runs = judge(7200.0, range(1, 17))
    distance = leader_alone.SPEED * runs[0].time_s[-1]
    rms = math.sqrt(np.mean([r.along[-1] ** 2 + r.cross[-1] ** 2 for r in runs]))
    expected = leader_alone.expected(7200.0)
    assert rms < 1.5 * math.hypot(expected.along[1], expected.cross[1])
    assert rms / distance < 0.0015
    # Over the whole run, not only at its end: mean over the seeds, each epoch by itself.
    n = len(runs)
    nees = np.mean([r.nees for r in runs], axis=0)
    inside = (nees > chi2.ppf(5e-3, 3 * n) / n) & (nees < chi2.ppf(1 - 5e-3, 3 * n) / n)
    assert inside.mean() > 0.9
