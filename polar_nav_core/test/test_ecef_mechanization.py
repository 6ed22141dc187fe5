"""Grid strapdown against an independent ECEF mechanization of the same signal, for an hour.

The oracle (core_oracle.py) integrates quaternion, velocity and position in ECEF by RK4 from the
exact rates; the strapdown gets exact increments at 100 Hz. The vehicle sails 11 km and swings 4, 5
and 3 degrees at periods of 3, 5 and 7 s. Difference in the horizontal after an hour: under 1 mm,
with the vertical free and held.
"""

import numba
import numpy as np
import pytest
from core_oracle import Trajectory, integrate, state_vector, up_height

from polar_nav_core import attitude, earth, grid
from polar_nav_core.kernels.frames import strapdown

DT = 0.01
DURATION = 3600.0 if not numba.config.DISABLE_JIT else 3.0
SPEED = 3.1
# Without the compiler it is three seconds of sailing, and quick.
AN_HOUR = () if numba.config.DISABLE_JIT else pytest.mark.slow

# name: (latitude, longitude [deg], course as a vector in ECEF x, y; None: towards the axis)
STARTS = {
    '80N 120E': (80.0, 120.0, None),
    '89.9N over the pole': (90.0 - 0.05, 20.0, None),
    'exact pole': (90.0, 0.0, (0.8, 0.6)),
    '75S 60W': (-75.0, -60.0, (0.6, -0.8)),
    '89.99N 180E': (89.99, 180.0, (0.3, 0.95)),
    'exact south pole': (-90.0, 0.0, (-1.0, 0.0)),
}


def trajectory_of(name):
    lat, lon, course = STARTS[name]
    r_e = earth.ecef_from_geodetic(np.radians(lat), np.radians(lon), -100.0)
    x, y = (0.0, 0.0) if abs(lat) == 90.0 else (r_e[0], r_e[1])
    direction = -np.array([x, y]) / np.hypot(x, y) if course is None else np.array(course)
    v = SPEED * direction / np.linalg.norm(direction)
    return Trajectory(x, y, v[0], v[1], sign=np.sign(lat))


@pytest.mark.parametrize('name', [pytest.param(n, marks=AN_HOUR) for n in STARTS])
def test_horizontal_difference_after_an_hour_is_under_a_millimetre(name):
    trajectory = trajectory_of(name)
    n = round(DURATION / DT)
    dtheta, dvel = trajectory.increments(DURATION, DT)
    before = trajectory.increments(DT, DT, begin=-DT)
    omega, f = trajectory.imu(np.arange(2 * n + 1) * (DT / 2))
    C_b_e, v_e, r_e = trajectory.start()
    end, v_end = trajectory.path([DURATION])
    C_e_G = grid.ecef_to_grid(end[0])
    if name == '89.9N over the pole':
        passed = trajectory.path(np.arange(0.0, DURATION, 1.0))[0]
        assert DURATION < 100.0 or np.min(np.hypot(passed[:, 0], passed[:, 1])) < 3.0

    # Height above the ellipsoid along the true path, for the held case
    minutes = np.linspace(0.0, DURATION, 61)
    heights = [up_height(row)[1] for row in trajectory.path(minutes)[0]]
    height = np.interp(DT * np.arange(1, n + 1), minutes, heights)

    for held in (False, True):
        oracle = state_vector(C_b_e, v_e, r_e)
        integrate(oracle, omega, f, DT, height, held)
        C, v, r = grid.ecef_to_grid(r_e) @ C_b_e, grid.ecef_to_grid(r_e) @ v_e, r_e.copy()
        arguments = C, v, r, dtheta, dvel, before[0][0].copy(), before[1][0].copy(), DT
        if held:
            strapdown.strapdown_batch_held(*arguments, height, np.zeros(n))
        else:
            strapdown.strapdown_batch(*arguments)
        difference = C_e_G @ (r - oracle[7:])
        assert np.hypot(*difference[:2]) < 1e-3, f'held={held}: {difference}'
        assert abs(difference[2]) < (1e-6 if held else 0.1)
        # and both know where the vehicle really is
        assert np.hypot(*(C_e_G @ (r - end[0]))[:2]) < 1e-3
        np.testing.assert_allclose(v, C_e_G @ v_end[0], rtol=0.0, atol=1e-4)
        true_C = C_e_G @ trajectory.attitude([DURATION])[0]
        assert np.linalg.norm(attitude.log(C @ true_C.T)) < 1e-8
