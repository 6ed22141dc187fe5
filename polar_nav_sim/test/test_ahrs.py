"""The AHRS and the uniform error of depth: bounds, moments, bias, independence of blocks."""

import math

import numpy as np
import pytest

from polar_nav_core.attitude import euler_from_matrix, matrix_from_euler
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors.ahrs import AhrsErrors, AhrsSensor
from polar_nav_sim.sensors.depth import DepthErrors, DepthSensor

N = 4000
TRUE = (0.7, -0.1, 0.05)
C_B_G = np.broadcast_to(matrix_from_euler(*TRUE), (N, 3, 3))


def sensor(**errors):
    return AhrsSensor(AhrsErrors(**errors), stream(3, 'auv/ahrs'))


def test_errors_are_uniform_of_stated_amplitude():
    rates, C = sensor().measure(0, np.zeros((N, 3)), C_B_G)
    angles = np.stack(euler_from_matrix(C), axis=1) - TRUE
    for x, amplitude in ((rates, 0.01), (angles, 0.02)):
        assert 0.99 * amplitude < np.abs(x).max() <= amplitude * (1 + 1e-12)
        np.testing.assert_allclose(x.mean(axis=0), 0.0, atol=4 * amplitude / math.sqrt(3 * N))
        np.testing.assert_allclose(x.var(axis=0), amplitude**2 / 3, rtol=4 * 0.9 / math.sqrt(N))
        assert abs(np.corrcoef(x[1:, 0], x[:-1, 0])[0, 1]) < 4 / math.sqrt(N)
    e = AhrsErrors()
    assert e.angle_variance == pytest.approx(0.02**2 / 3)
    assert e.rate_variance == pytest.approx(0.01**2 / 3)


def test_the_heading_bias_is_to_port():
    _, C = sensor(ahrs_angle_error=0.0, ahrs_heading_bias_deg=2.0).measure(
        0, np.zeros((N, 3)), C_B_G
    )
    expected = matrix_from_euler(TRUE[0] + math.radians(2.0), *TRUE[1:])
    np.testing.assert_allclose(C[0], expected, atol=1e-12)


def test_blocks_and_gaps_change_nothing():
    whole = sensor().measure(0, np.zeros((N, 3)), C_B_G)
    parts = sensor()
    got = [parts.measure(k, np.zeros((n, 3)), C_B_G[:n]) for k, n in ((0, 1), (1, 300), (700, 50))]
    for i in (0, 1):
        np.testing.assert_array_equal(got[1][i], whole[i][1:301])
        np.testing.assert_array_equal(got[2][i], whole[i][700:750])
    with pytest.raises(ValueError, match='sample 5 comes after'):
        parts.measure(5, np.zeros((1, 3)), C_B_G[:1])


def test_depth_has_a_uniform_error_that_changes_no_other_draw():
    plain, uniform = (
        DepthSensor(DepthErrors(uniform_error_m=e), stream(1, 'auv/depth')) for e in (0.0, 0.05)
    )
    x = np.array(
        [uniform.measure(k, 20.0, np.eye(3)) - plain.measure(k, 20.0, np.eye(3)) for k in range(N)]
    )
    assert 0.049 < np.abs(x).max() <= 0.05
    assert x.var() == pytest.approx(0.05**2 / 3, rel=0.06)
    assert uniform.variance - plain.variance == pytest.approx(0.05**2 / 3)
