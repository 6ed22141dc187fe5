"""A small world of its own for the engine's tests: constant grid velocity, exact increments.

Independent of polar_nav_sim: the truth is what the core's strapdown makes of noise-free
increments, so a filter fed with them and with exact measurements must stay where the truth is.
"""

from functools import cached_property

import numpy as np

from polar_nav_core import attitude, earth, grid
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.events import DepthSample, DvlPing, Fix, ImuSample
from polar_nav_core.engine.params import NO_COMMON_ERRORS, NO_RESERVE, EngineParams
from polar_nav_core.kernels.frames import strapdown

START_NS = 1_772_323_200_000_000_000
IMU_NS = 10_000_000


class World:
    """Truth at every IMU epoch and the ideal IMU samples that lead to it."""

    def __init__(
        self,
        seconds,
        lat_deg=80.0,
        lon_deg=120.0,
        v_G=(2.0, 2.0, 0.0),
        height=-100.0,
        leg_s=0.0,
        turn_s=30.0,
        haste=1.0,
    ):
        """With ``leg_s``: legs of so many seconds, and turns at 6 deg/s between them.

        The vehicle swings with periods of 5 to 9 s over ``haste``.
        """
        n = int(seconds * 100)
        dt = 0.01
        self.n = n
        self.stamps = START_NS + IMU_NS * np.arange(n + 1)
        v_G = np.array(v_G, dtype=float)
        r_e = (
            earth.ecef_from_geodetic(np.deg2rad(lat_deg), np.deg2rad(lon_deg), height)
            .astype(float)
            .copy()
        )
        heading = np.arctan2(v_G[0], v_G[1])
        C_b_G = attitude.matrix_from_euler(np.pi / 2 - heading, 0.0, 0.0).copy()
        self.heading = heading
        self.r_e, self.v_G, self.C_b_G = [r_e.copy()], [v_G.copy()], [C_b_G.copy()]
        self.omega, self.f = [], []
        v = v_G.copy()
        previous = np.zeros(3), np.zeros(3)
        for k in range(n):
            wobble = np.array(
                [
                    0.02 * np.cos(haste * 0.9 * k * dt),
                    0.02 * np.cos(haste * 1.3 * k * dt),
                    0.01 * np.cos(haste * 0.7 * k * dt),
                ]
            )
            turning = leg_s > 0.0 and k * dt % (leg_s + turn_s) > leg_s
            yaw_G = np.array([0.0, 0.0, np.pi / 30.0 if turning else 0.0])
            if turning:
                c, s = np.cos(yaw_G[2] * dt), np.sin(yaw_G[2] * dt)
                v_G = np.array([c * v_G[0] - s * v_G[1], s * v_G[0] + c * v_G[1], v_G[2]])
            omega_ie_G, omega_eG_G = grid.earth_rate(r_e), grid.transport_rate(r_e, v)
            # Rate and force that keep the grid velocity: what a vehicle with a perfect autopilot
            # would feel.
            omega_b = C_b_G.T @ (omega_ie_G + omega_eG_G + yaw_G) + wobble
            f_G = (
                np.array([0.0, 0.0, float(earth.gravity(r_e))])
                + np.cross(2 * omega_ie_G + omega_eG_G, v)
                + np.cross(yaw_G, v_G)
            )
            f_b = C_b_G.T @ (f_G + (v_G - v) * 2.0)
            increments = omega_b * dt, f_b * dt
            strapdown.strapdown_step_uneven(
                C_b_G, v, r_e, *increments, *previous, dt, dt if k > 1 else 0.0
            )
            previous = increments
            self.omega.append(omega_b)
            self.f.append(f_b)
            self.r_e.append(r_e.copy())
            self.v_G.append(v.copy())
            self.C_b_G.append(C_b_G.copy())

    def params(self, kind=EngineParams, **changes):
        """Parameters that start where the world starts."""
        lat, lon, height = earth.geodetic_from_ecef(self.r_e[1])
        psi, pitch, roll = attitude.euler_from_matrix(self.C_b_G[1])
        values = {
            **NO_COMMON_ERRORS,
            **NO_RESERVE,
            'dvl_scale_sigma': 1e-4,
            'dvl_markov_sigma': 0.005,
            'initial_latitude_deg': float(np.rad2deg(lat)),
            'initial_longitude_deg': float(np.rad2deg(lon)),
            'initial_height': float(height),
            'initial_v_G': tuple(float(v) for v in self.v_G[1]),
            'initial_roll_deg': float(np.rad2deg(roll)),
            'initial_pitch_deg': float(np.rad2deg(pitch)),
            'initial_grid_heading_deg': float(np.rad2deg(np.pi / 2 - psi)),
        }
        return kind(**{**values, **changes})

    def imu(self):
        """All IMU samples, as events."""
        return list(self._imu)

    @cached_property
    def _imu(self):
        return tuple(
            ImuSample(int(self.stamps[k + 1]), k, self.omega[k], self.f[k]) for k in range(self.n)
        )

    def dvl(self, every=20, sigma=0.005, rng=None):
        """DVL pings at every n-th IMU epoch."""
        out = []
        for i, k in enumerate(range(every, self.n + 1, every)):
            v_b = self.C_b_G[k].T @ self.v_G[k]
            noise = rng.normal(0, sigma, 3) if rng is not None else np.zeros(3)
            out.append(DvlPing(int(self.stamps[k]), i, True, v_b + noise, sigma**2 * np.eye(3)))
        return out

    def depth(self, every=10, sigma=0.05, rng=None):
        """Depths at every n-th IMU epoch."""
        out = []
        for i, k in enumerate(range(every, self.n + 1, every)):
            height = float(earth.geodetic_from_ecef(self.r_e[k])[2])
            noise = rng.normal(0, sigma) if rng is not None else 0.0
            out.append(DepthSample(int(self.stamps[k]), i, -height + noise, sigma**2))
        return out

    def fixes(self, period_s, delay_s, sigma=1.0, rng=None, first_s=1.0):
        """Fixes of given validity, each received ``delay_s(i)`` later."""
        out = []
        t, i = first_s, 0
        while t * 100 <= self.n:
            k = round(t * 100)
            delay = delay_s(i) if callable(delay_s) else delay_s
            stamp = int(self.stamps[k])
            noise = rng.normal(0, sigma, 3) if rng is not None else np.zeros(3)
            receive = stamp + round(delay * 1e9)
            if receive <= int(self.stamps[-1]):
                out.append(
                    Fix(
                        stamp,
                        receive,
                        receive,
                        'leader',
                        i,
                        i,
                        i,
                        self.r_e[k] + noise,
                        sigma**2 * np.eye(3),
                    )
                )
            t += period_s
            i += 1
        return out


def inputs_of(world, fixes, seed=1):
    """Measurements of a world as arrays, with the noise of a seed."""
    rng = np.random.default_rng(seed)
    return gathered([*world.imu(), *world.dvl(rng=rng), *world.depth(rng=rng), *fixes])


def gathered(events):
    """Events as arrays, from which the same is computed in a fraction of the time."""
    imu, dvl, depth, fixes = (
        [e for e in events if isinstance(e, kind)]
        for kind in (ImuSample, DvlPing, DepthSample, Fix)
    )
    return engine_run.Inputs(
        np.array([s.stamp_ns for s in imu]),
        np.array([s.omega_ib_b for s in imu]),
        np.array([s.f_b for s in imu]),
        np.array([p.stamp_ns for p in dvl]),
        np.array([p.v_m for p in dvl]),
        np.array([p.covariance_m for p in dvl]),
        np.ones(len(dvl), dtype=bool),
        np.array([d.stamp_ns for d in depth]),
        np.array([d.depth for d in depth]),
        np.array([d.variance for d in depth]),
        tuple(fixes),
    )


def run(engine, events):
    """Drive an engine with events in their total order; all outputs."""
    out = []
    for event in sorted(events, key=lambda e: e.key):
        out.extend(engine.process(event))
    out.extend(engine.finish())
    return out
