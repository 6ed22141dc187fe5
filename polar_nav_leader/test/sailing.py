"""Two vehicles under way, exactly, and what an array hears in one cycle between them."""

import numpy as np

from polar_nav_core import attitude, earth, grid
from polar_nav_leader.broadcast import ArrayMeasurement
from polar_nav_leader.states import LeaderState

T0 = 1_772_323_200_000_000_000
C_SOUND = 1440.0
TURN_AROUND = 0.05


class Sailing:
    """Straight motion with the paper's oscillation of attitude; ECEF, analytic."""

    def __init__(self, lat_deg, lon_deg, depth, v_e, phase=0.0, offset_e=(0.0, 0.0, 0.0)):
        start = earth.ecef_from_geodetic(np.deg2rad(lat_deg), np.deg2rad(lon_deg), -depth)
        self.start = start + np.array(offset_e)
        self.v_e = np.array(v_e, dtype=float)
        self.phase = phase
        self.C_e_G0 = grid.ecef_to_grid(self.start)

    def r_e(self, t):
        return self.start + self.v_e * t

    def C_b_e(self, t):
        a = 2 * np.pi
        pitch = np.deg2rad(4) * np.sin(a * t / 3 + self.phase)
        roll = np.deg2rad(5) * np.sin(a * t / 5)
        yaw = 0.8 + np.deg2rad(3) * np.sin(a * t / 7)
        return self.C_e_G0.T @ attitude.matrix_from_euler(yaw, pitch, roll)

    def state(self, t, h=1e-5):
        C = self.C_b_e(t)
        omega = attitude.log(self.C_b_e(t - h).T @ self.C_b_e(t + h)) / (2 * h)
        zero = np.zeros((3, 3))
        return LeaderState(T0 + round(t * 1e9), self.r_e(t), self.v_e, C, omega, zero, zero)


def solve(f, start):
    t = start
    for _ in range(50):
        t = f(t)
    return t


def cycle(leader, follower, lever_b, C_a_b, t1, tells_depth=True, sound=C_SOUND):
    def array(t):
        return leader.r_e(t) + leader.C_b_e(t) @ lever_b

    t2 = solve(lambda t: t1 + np.linalg.norm(follower.r_e(t) - array(t1)) / sound, t1)
    t3 = t2 + TURN_AROUND
    t4 = solve(lambda t: t3 + np.linalg.norm(array(t) - follower.r_e(t3)) / sound, t3)
    line = C_a_b.T @ leader.C_b_e(t4).T @ (follower.r_e(t3) - array(t4))
    direction = line / np.linalg.norm(line)
    depth = -float(earth.geodetic_from_ecef(follower.r_e(t3))[2])
    measurement = ArrayMeasurement(
        target='follower',
        sequence=4,
        ping_ns=T0 + round(t1 * 1e9),
        validity_ns=T0 + round(t3 * 1e9),
        return_ns=T0 + round(t4 * 1e9),
        turn_around=TURN_AROUND,
        round_trip=t4 - t1,
        range_variance=0.09,
        direction_a=direction,
        cosine_covariance=1e-6 * np.eye(2),
        sound_speed=sound,
        target_depth=depth if tells_depth else np.nan,
        target_depth_variance=0.0025,
    )
    return measurement, t3, t4
