"""A station and a vehicle that moves in a straight line, for the station's tests."""

import numpy as np

from polar_nav_core.attitude import matrix_from_euler
from polar_nav_core.earth import ecef_from_geodetic
from polar_nav_core.grid import ecef_to_grid
from polar_nav_sim.poses import Pose
from polar_nav_sim.sensors.station import StationFrame

START_NS = 1_772_323_200_000_000_000
ORIGIN_E = np.asarray(ecef_from_geodetic(np.radians(89.5), np.radians(60.0), -5.0))
FRAME = StationFrame(ORIGIN_E)


class Straight:
    """Poses p + v t in station axes, heading psi + rate t."""

    def __init__(self, p, v=(0.0, 0.0, 0.0), psi=0.0, rate=0.0):
        self.p, self.v, self.psi, self.rate = np.array(p), np.array(v), psi, rate

    def place(self, t_ns):
        return self.p + self.v * ((t_ns - START_NS) * 1e-9)

    def pose(self, t_ns):
        t_s = (t_ns - START_NS) * 1e-9
        C_S_e = np.asarray(ecef_to_grid(ORIGIN_E)).T
        p = self.place(t_ns)
        turn = matrix_from_euler(self.psi + self.rate * t_s, 0.0, 0.0)
        return Pose(ORIGIN_E + C_S_e @ p, C_S_e @ turn, 5.0 - float(p[2]))
