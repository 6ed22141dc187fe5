"""A vehicle with exact motion, whose sensors feed a start: rest or way, any place, any noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from polar_nav_core import magnetic
from polar_nav_core.attitude import log, matrix_from_euler
from polar_nav_core.earth import ecef_from_geodetic, gravity
from polar_nav_core.engine.events import DepthSample, DvlPing, Fix, HeadingSample, ImuSample
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.grid import convergence, earth_rate, ecef_to_grid, transport_rate

HZ, YEAR = 50, 2026.9
MEMS = {
    'gyro_bias_sigma': 3e-4,
    'gyro_noise_density': 6e-5,
    'accel_bias_sigma': 0.02,
    'accel_noise_density': 1e-3,
}
FOG = {
    'gyro_bias_sigma': 2.4e-7,  # 0.05 deg/h
    'gyro_noise_density': 1.5e-6,
    'accel_bias_sigma': 5e-4,
    'accel_noise_density': 5e-4,
}


@dataclass(frozen=True)
class Vehicle:
    """Speed [m/s] along body x, rate of turn [rad/s], waves: amplitude of roll and pitch [rad]."""

    latitude_deg: float = 70.0
    longitude_deg: float = 20.0
    heading_deg: float = 40.0  # grid
    speed: float = 0.0
    turn: float = 0.0
    waves: float = 0.0
    roll: float = 0.02
    pitch: float = -0.03
    depth: float = 0.0

    def psi(self, t: float) -> float:
        return math.radians(90.0 - self.heading_deg) + self.turn * t

    def C_b_G(self, t: float) -> np.ndarray:
        wave = self.waves * math.sin(0.9 * t + 0.3)
        return matrix_from_euler(self.psi(t), self.pitch + wave, self.roll - 0.7 * wave)

    def v_G(self, t: float) -> np.ndarray:
        psi = self.psi(t)
        return self.speed * np.array([math.cos(psi), math.sin(psi), 0.0])

    @property
    def origin_e(self) -> np.ndarray:
        lat, lon = np.radians([self.latitude_deg, self.longitude_deg])
        return np.asarray(ecef_from_geodetic(lat, lon, -self.depth))

    def path(self, t: float) -> np.ndarray:
        """Way from the origin, grid axes."""
        psi, w = self.psi(0.0), self.turn
        if not w:
            return t * self.v_G(0.0)
        x = math.sin(psi + w * t) - math.sin(psi)
        y = math.cos(psi) - math.cos(psi + w * t)
        return self.speed / w * np.array([x, y, 0.0])

    def r_e(self, t: float) -> np.ndarray:
        return self.origin_e + ecef_to_grid(self.origin_e).T @ self.path(t)


@dataclass(frozen=True)
class Sensors:
    """Which there are, with 1-sigma of a fix, of a heading; the reference of headings."""

    dvl: bool = False
    depth: bool = False
    fix_s: float = 0.0
    fix_sigma: float = 2.0
    fix_delay_s: float = 0.0
    heading_sigma_deg: float = 0.0
    heading_reference: str = 'true'
    outliers: tuple[int, ...] = ()

    @property
    def inputs(self) -> frozenset[str]:
        there = {
            'dvl': self.dvl,
            'depth': self.depth,
            'fix': self.fix_s > 0.0,
            'heading': self.heading_sigma_deg > 0.0,
        }
        return frozenset(name for name, is_there in there.items() if is_there)


def params_of(noise: dict[str, float], **changes) -> EngineParams:
    return replace(EngineParams(**noise), initialize='alignment', **changes)


def with_heading(params: EngineParams, sensors: Sensors) -> EngineParams:
    """Parameters that state the heading of the sensors, where there is one."""
    if not sensors.heading_sigma_deg:
        return params
    return replace(
        params,
        heading_reference=sensors.heading_reference,
        heading_bias_sigma_deg=sensors.heading_sigma_deg,
        heading_markov_sigma_deg=1e-3,
        heading_tilt_sigma_deg=1e-3,
        magnetic_year=YEAR,
    )


def declination(lat: float, lon: float) -> float:
    """Of the magnetic field at `YEAR`, clockwise from true north [rad]."""
    field = magnetic.field_near(lat, lon, 0.0, YEAR)
    s, c, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    east, north = np.array([-sl, cl, 0.0]), np.array([-s * cl, -s * sl, c])
    return math.atan2(east @ field.field_e, north @ field.field_e)


def events(vehicle: Vehicle, sensors: Sensors, params: EngineParams, seed: int, seconds: float):
    """Events in the order of their coming, of errors as the parameters state them."""
    rng = np.random.default_rng(seed)
    gyro_bias = params.gyro_bias_sigma * rng.standard_normal(3)
    accel_bias = params.accel_bias_sigma * rng.standard_normal(3)
    heading_bias = math.radians(sensors.heading_sigma_deg) * rng.standard_normal()
    misaligned = math.radians(params.dvl_misalignment_sigma_deg) * rng.standard_normal()
    C_error = matrix_from_euler(misaligned, 0.0, 0.0)
    slow = params.dvl_markov_sigma * rng.standard_normal(3)
    omega_ie = earth_rate(vehicle.origin_e)
    g = np.array([0.0, 0.0, float(gravity(vehicle.origin_e))])
    dt = 1.0 / HZ
    white_g = params.gyro_noise_density / math.sqrt(dt)
    white_a = params.accel_noise_density / math.sqrt(dt)
    waiting, fixes = [], 0
    for k in range(1, int(seconds * HZ)):
        t = k * dt
        before, now, middle = (vehicle.C_b_G(s) for s in (t - dt, t, t - 0.5 * dt))
        v = vehicle.v_G(t - 0.5 * dt)
        omega_iG = omega_ie + transport_rate(vehicle.origin_e, v)
        omega = log(before.T @ now) / dt + middle.T @ omega_iG
        a = (vehicle.v_G(t) - vehicle.v_G(t - dt)) / dt
        f = middle.T @ (a + np.cross(omega_ie + omega_iG, v) + g)
        ns = round(t * 1e9)
        yield ImuSample(
            ns,
            k,
            omega + gyro_bias + white_g * rng.standard_normal(3),
            f + accel_bias + white_a * rng.standard_normal(3),
        )
        if sensors.heading_sigma_deg:
            lat, lon = np.radians([vehicle.latitude_deg, vehicle.longitude_deg])
            heading = 0.5 * math.pi - vehicle.psi(t) + heading_bias
            if sensors.heading_reference in ('true', 'magnetic'):
                heading += float(convergence(lat, lon))
            if sensors.heading_reference == 'magnetic':
                heading -= declination(lat, lon)
            yield HeadingSample(ns, k, heading, topic='ahrs')
        if sensors.dvl and k % (HZ // 5) == 0:
            v_m = C_error @ now.T @ vehicle.v_G(t) + slow + 0.01 * rng.standard_normal(3)
            yield DvlPing(ns, k, valid=True, v_m=v_m, covariance_m=1e-4 * np.eye(3))
        if sensors.depth and k % (HZ // 5) == 0:
            yield DepthSample(ns, k, vehicle.depth + 0.05 * rng.standard_normal(), 0.0025)
        if sensors.fix_s and k % round(sensors.fix_s * HZ) == 0:
            error = sensors.fix_sigma * rng.standard_normal(3)
            if fixes in sensors.outliers:
                error = error + 50.0
            r_e = vehicle.r_e(t) + ecef_to_grid(vehicle.origin_e).T @ error
            P = sensors.fix_sigma**2 * np.eye(3)
            received = ns + round(sensors.fix_delay_s * 1e9)
            fix = Fix(ns, ns, received, 'gnss', fixes, fixes, fixes, r_e, P, topic='fix')
            waiting.append(fix)
            fixes += 1
        while waiting and waiting[0].receive_ns <= ns:
            yield waiting.pop(0)


def errors(vehicle: Vehicle, aligned) -> dict[str, tuple[float, float]]:
    """Error and stated 1-sigma by part, at the stamp of the state."""
    t, s = aligned.stamp_ns * 1e-9, aligned.state
    C = matrix_from_euler(0.5 * math.pi - s.grid_heading, s.pitch, s.roll)
    phi = log(C @ vehicle.C_b_G(t).T)
    r_e = np.asarray(ecef_from_geodetic(s.latitude, s.longitude, s.height))
    d = ecef_to_grid(vehicle.origin_e) @ (r_e - vehicle.r_e(t))
    dv = np.array(s.v_G) - vehicle.v_G(t)
    return {
        'heading': (float(phi[2]), s.sigma_heading),
        'tilt': (float(phi[0]), s.sigma_tilt),
        'east': (float(d[0]), s.sigma_position_horizontal),
        'north': (float(d[1]), s.sigma_position_horizontal),
        'velocity': (float(dv[0]), s.sigma_velocity),
    }
