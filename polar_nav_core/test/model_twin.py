"""A vehicle that obeys the reduced model in moving water, near a pole: truth and its sensors.

Independent of polar_nav_sim. Thrust and yaw follow the laws of the DVL-less paper's mission; the
drag is the true one (25, 19 where navigation believes 15, 90). The path that results is handed to
the strapdown by increments that lead along it, so that truth and ideal IMU agree to rounding.
"""

from dataclasses import dataclass

import numpy as np

from polar_nav_core import attitude, earth, grid
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.params import NO_COMMON_ERRORS, NO_RESERVE, EngineParams
from polar_nav_core.kernels.frames import earth as earth_kernels
from polar_nav_core.kernels.frames import grid as grid_kernels
from polar_nav_core.kernels.frames import strapdown
from polar_nav_core.kernels.vehicle import model as vehicle_model
from polar_nav_core.vehicle_model import VehicleModel

START_NS = 1_772_323_200_000_000_000
IMU_NS = 10_000_000
DT = 0.01
CURRENT = (0.4, 0.25)
TRUE_MODEL = VehicleModel.of(
    100.0, (1.8, 76.5, 76.5), (25.0, 105.0, 105.0), (19.0, 105.0, 105.0), 5.0
)


@dataclass(frozen=True)
class Imu:
    """1-sigma biases and noise densities, SI."""

    gyro_bias: float
    gyro_noise: float
    accel_bias: float
    accel_noise: float
    tilt_deg: float
    heading_deg: float


PAPER = Imu(1.454e-7, 1.533e-9, 9.80665e-6, 3.101e-7, 0.5 / 60, 5.0 / 60)
"""As the cooperative paper has it: 0.03 deg/h, 1e-6 g."""
LOW_COST = Imu(4.848e-6, 2.909e-5, 9.80665e-3, 8.3e-4, 0.1, 0.5)
"""1 deg/h and 0.1 deg/sqrt(h), 1 mg and 0.05 m/s/sqrt(h)."""


def thrust(t):
    """Surge [N] (the DVL-less paper's mission)."""
    return 52.0 + 18.0 * np.sin(0.05 * t) + 14.0 * np.sin(0.013 * t)


def yaw(t):
    """psi and its rate (the DVL-less paper's mission)."""
    return (
        1.9 * np.sin(0.011 * t) + 0.45 * np.sin(0.037 * t) + 0.3,
        1.9 * 0.011 * np.cos(0.011 * t) + 0.45 * 0.037 * np.cos(0.037 * t),
    )


class Voyage:
    """Truth at every IMU epoch and the ideal samples that lead to it.

    Parameters
    ----------
    seconds : float
    lat_deg : float
        Where it starts.
    slow_current : bool
        The current changes by 30 % and 0.6 rad in 30 minutes.
    """

    def __init__(self, seconds, lat_deg=80.0, lon_deg=120.0, slow_current=False):
        n = self.n = round(seconds / DT)
        self.stamps = START_NS + IMU_NS * np.arange(n + 1)
        t = DT * np.arange(n + 1)
        psi, self.psi_rate = yaw(t)
        theta, phi = 0.02 * np.sin(0.05 * t), 0.03 * np.sin(0.9 * t)
        C_wanted = attitude.matrix_from_euler(psi, theta, phi)
        self.force_b = np.zeros((n, 3))
        self.force_b[:, 0] = thrust(DT * 10 * (np.arange(n) // 10))  # held for 0.1 s
        self.force_b[:, 2] = -5.0
        turn, size = np.zeros(n + 1), np.ones(n + 1)
        if slow_current:
            turn, size = 0.6 * t / 1800.0, 1.0 + 0.3 * t / 1800.0
        c, s = np.cos(turn) * size, np.sin(turn) * size
        self.current_G = np.column_stack(
            [c * CURRENT[0] - s * CURRENT[1], s * CURRENT[0] + c * CURRENT[1], np.zeros(n + 1)]
        )
        self.v_r_b, turns = self._relative(C_wanted)
        v_wanted = np.einsum('tij,tj->ti', C_wanted, self.v_r_b) + self.current_G
        self._follow(C_wanted, v_wanted, turns, lat_deg, lon_deg)

    def _relative(self, C_b_G):
        """v_r by the true model, midpoint rule; also the turn of each interval."""
        m = TRUE_MODEL
        v_r_b = np.zeros((self.n + 1, 3))
        v_r_b[0, 0] = 1.0
        turns = attitude.log(np.einsum('tji,tjk->tik', C_b_G[:-1], C_b_G[1:]))
        rates, up = turns / DT, np.ascontiguousarray(C_b_G[:, 2])
        fixed = m.inertia, m.drag_linear, m.drag_quadratic, m.net_buoyancy
        a, slope = np.zeros(3), vehicle_model.relative_acceleration
        for k in range(self.n):
            slope(a, v_r_b[k], rates[k], up[k], self.force_b[k], *fixed)
            middle = v_r_b[k] + 0.5 * DT * a
            slope(a, middle, rates[k], up[k], self.force_b[k], *fixed)
            v_r_b[k + 1] = v_r_b[k] + DT * a
        return v_r_b, turns

    def _follow(self, C_wanted, v_wanted, turns, lat_deg, lon_deg):
        """The increments that lead along the wanted path, and where the strapdown takes them."""
        n = self.n
        r_e = np.array(
            earth.ecef_from_geodetic(np.deg2rad(lat_deg), np.deg2rad(lon_deg), -100.0), dtype=float
        )
        C_b_G, v_G = C_wanted[0].copy(), v_wanted[0].copy()
        self.r_e, self.v_G = np.empty((n + 1, 3)), np.empty((n + 1, 3))
        self.C_b_G = np.empty((n + 1, 3, 3))
        self.omega, self.f = np.empty((n, 3)), np.empty((n, 3))
        self.r_e[0], self.v_G[0], self.C_b_G[0] = r_e, v_G, C_b_G
        omega_ie, omega_eG = np.zeros(3), np.zeros(3)
        previous = np.zeros(3), np.zeros(3)
        for k in range(n):
            grid_kernels.fill_rates(r_e, v_G, omega_ie, omega_eG)
            _, _, sin_lat, height = earth_kernels.up_and_height(*r_e.tolist())
            off = C_b_G.T @ C_wanted[k]
            turn = turns[k] + [off[2, 1], off[0, 2], off[1, 0]]
            omega = turn / DT + C_b_G.T @ (omega_ie + omega_eG)
            f_G = (v_wanted[k + 1] - v_G) / DT + _cross(2.0 * omega_ie + omega_eG, v_G)
            f_G[2] += earth_kernels.gravity(sin_lat, height)
            f = C_b_G.T @ f_G  # and in the axes of the middle of the interval
            half = -0.5 * turn
            aside = _cross(half, f)
            f = f + aside + 0.5 * _cross(half, aside)
            increments = omega * DT, f * DT
            strapdown.strapdown_step_uneven(
                C_b_G, v_G, r_e, *increments, *previous, DT, DT if k else 0.0
            )
            previous = increments
            self.omega[k], self.f[k] = omega, f
            self.r_e[k + 1], self.v_G[k + 1], self.C_b_G[k + 1] = r_e, v_G, C_b_G

    def params(self, imu=PAPER, rng=None, **changes):
        """Parameters that start where the voyage does, off by what they state.

        They state its sensors: nothing is in common, gravity is the normal one, biases stay.
        """
        p = EngineParams()
        draw = np.zeros(9) if rng is None else rng.normal(size=9)
        C = attitude.exp(np.deg2rad([imu.tilt_deg, imu.tilt_deg, imu.heading_deg]) * draw[:3])
        psi, pitch, roll = attitude.euler_from_matrix(C @ self.C_b_G[1])
        start = self.r_e[1] + grid.ecef_to_grid(self.r_e[1]).T @ (
            draw[3:6] * p.initial_sigma_position
        )
        lat, lon, height = (float(v) for v in earth.geodetic_from_ecef(start))
        v_G = self.v_G[1] + draw[6:] * 0.05
        values = {
            **NO_COMMON_ERRORS,
            **NO_RESERVE,
            'dvl_scale_sigma': 1e-4,
            'dvl_markov_sigma': 0.005,
            'configuration': 'default',
            'initial_latitude_deg': float(np.rad2deg(lat)),
            'initial_longitude_deg': float(np.rad2deg(lon)),
            'initial_height': height,
            'initial_v_G': tuple(float(v) for v in v_G),
            'initial_sigma_velocity': 0.05,
            'initial_roll_deg': float(np.rad2deg(roll)),
            'initial_pitch_deg': float(np.rad2deg(pitch)),
            'initial_grid_heading_deg': float(np.rad2deg(np.pi / 2 - psi)),
            'initial_sigma_tilt_deg': imu.tilt_deg,
            'initial_sigma_heading_deg': imu.heading_deg,
            'gyro_bias_sigma': imu.gyro_bias,
            'gyro_noise_density': imu.gyro_noise,
            'accel_bias_sigma': imu.accel_bias,
            'accel_noise_density': imu.accel_noise,
        }
        return EngineParams(**{**values, **changes})

    def inputs(self, rng, imu=PAPER, gap=None, fix_gap=None, delay_s=2.0):
        """Sensor data of a run.

        Parameters
        ----------
        rng : numpy Generator
        imu : Imu
        gap, fix_gap : (float, float), optional
            From when to when [s] the DVL has no lock; there are no fixes.
        delay_s : float
            Of a fix.
        """
        n = self.n
        white = rng.normal(size=(2, n, 3)) / np.sqrt(DT)
        omega = self.omega + rng.normal(0.0, imu.gyro_bias, 3) + imu.gyro_noise * white[0]
        f = self.f + rng.normal(0.0, imu.accel_bias, 3) + imu.accel_noise * white[1]
        pings = np.arange(20, n + 1, 20)
        scale, markov = rng.normal(0.0, 1e-4, 3), rng.normal(0.0, 0.005, 3)
        decay = np.exp(-0.2 / 300.0)
        v_m = np.empty((len(pings), 3))
        for i, k in enumerate(pings):
            v_m[i] = (1.0 + scale) * (self.C_b_G[k].T @ self.v_G[k]) + markov
            v_m[i] += rng.normal(0.0, 0.005, 3)
            markov = decay * markov + rng.normal(0.0, 0.005 * np.sqrt(1.0 - decay**2), 3)
        valid = ~_inside(pings * DT, gap)
        depths = np.arange(10, n + 1, 10)
        height = np.array([float(earth.geodetic_from_ecef(self.r_e[k])[2]) for k in depths])
        fixes = []
        for i, k in enumerate(range(100, n + 1, 250)):
            noise = rng.normal(size=3)
            validity = int(self.stamps[k])
            received = validity + round(delay_s * 1e9)
            if received <= self.stamps[-1] and not _inside(np.array([k * DT]), fix_gap)[0]:
                fixes.append(
                    Fix(
                        validity, received, received, 'leader', i, i, i, self.r_e[k] + noise,
                        np.eye(3),
                    )
                )  # fmt: skip
        controls = np.arange(0, n, 10)
        return engine_run.Inputs(
            self.stamps[1:],
            omega,
            f,
            self.stamps[pings],
            v_m,
            np.tile(0.005**2 * np.eye(3), (len(pings), 1, 1)),
            valid,
            self.stamps[depths],
            -height + rng.normal(0.0, 0.05, len(depths)),
            np.full(len(depths), 0.05**2),
            tuple(fixes),
            self.stamps[controls],
            self.force_b[controls],
            np.zeros((len(controls), 3)),
        )

    def errors(self, track):
        """Horizontal position error in grid axes (k, 2), its covariance (k, 2, 2), times [s]."""
        k = ((track.stamps_ns - START_NS) // IMU_NS).astype(int)
        C = np.array([grid.ecef_to_grid(r) for r in self.r_e[k]])
        e = np.einsum('tij,tj->ti', C, track.r_e - self.r_e[k])[:, :2]
        P = np.einsum('tij,tjk,tlk->til', C, track.P[:, 6:9, 6:9], C)[:, :2, :2]
        return e, P, k * DT


def _cross(a, b):
    """numpy.cross, ten times as fast for two vectors."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _inside(times, gap):
    return (
        np.zeros(len(times), dtype=bool) if gap is None else (times >= gap[0]) & (times < gap[1])
    )
