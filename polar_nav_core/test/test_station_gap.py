"""A gap between AHRS samples in station mode: reported by its name, with an honest sigma."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import station_twin as twin

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.health.conditions import Culprit, Level

pytestmark = pytest.mark.slow

FIRST_S, LENGTH_S = 30.0, 60.0


@cache
def truth():
    return twin.truth(130.0)


@cache
def broken():
    """Inputs without the AHRS samples of a minute; everything else goes on."""
    inputs = twin.inputs(truth(), 4, depth_every=10)
    t = (inputs.imu_stamps_ns - inputs.imu_stamps_ns[0]) * 1e-9
    kept = (t <= FIRST_S) | (t >= FIRST_S + LENGTH_S)
    return replace(
        inputs,
        imu_stamps_ns=inputs.imu_stamps_ns[kept],
        omega_ib_b=inputs.omega_ib_b[kept],
        C_b_G=inputs.C_b_G[kept],
    )


@pytest.mark.parametrize('name', ['rewind', 'clone', 'back_propagate', 'tagged'])
def test_same_bits_across_a_gap_of_the_ahrs(name):
    custom = {'configuration': 'custom', 'delay_handling': name, 'identify_method': 'none'}
    a, b = (
        engine_run.run(twin.params(**custom), broken(), one_by_one=one) for one in (False, True)
    )
    assert not a.divergence
    assert np.array_equal(a.track.x, b.track.x)
    assert np.array_equal(a.track.P_x, b.track.P_x)


def test_a_gap_of_the_ahrs_is_an_error_for_a_minute():
    params = twin.params(identify_method='none')
    result = engine_run.run(params, broken(), one_by_one=True)
    (end_ns,) = (
        int(broken().imu_stamps_ns[k + 1])
        for k in np.flatnonzero(np.diff(broken().imu_stamps_ns) > 10**9)
    )
    after = [h for h in result.health if end_ns < h.stamp_ns < end_ns + 35 * 10**9]
    assert after
    for health in after:
        (found,) = (p.condition for p in health.present if p.condition.key == 'AHRS gap')
        assert found.level is Level.ERROR
        assert found.culprit is Culprit.IMU
        assert 'AHRS gap of 60.0 s ended' in found.sentence
    assert not any('AHRS' in h.sentence for h in result.health if h.stamp_ns < end_ns)


def test_where_the_vehicle_went_in_a_gap_of_the_ahrs_is_in_the_covariance():
    track = engine_run.run(twin.params(identify_method='none'), broken()).track
    k = int(np.argmax(np.diff(track.stamps_ns))) + 1
    variance = np.trace(track.P_x[k, 3:5, 3:5])
    before = np.trace(track.P_x[k - 1, 3:5, 3:5])
    speed = np.linalg.norm(track.x[k - 1, :2])
    assert variance > before + (0.5 * speed * LENGTH_S) ** 2
