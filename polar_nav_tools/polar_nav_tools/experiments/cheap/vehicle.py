"""Motion and sensor readings of a vehicle of the BlueROV2's kind, as arrays; numpy and scipy only.

Nothing of this project is imported (an import contract holds it), so that a mistake of the
navigation's own mathematics does not cancel. Level axes are north, east, down at a topside unit;
body axes are those of the sensors' drivers: forward, left, up for the AHRS (REP 103), forward,
right, down for the DVL. Times are seconds since the start. All numbers of the sensors are from
data sheets of the kind (VN-100, DVL A50, Bar30) but where `Ugps` and `Sensors` say otherwise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]

LATITUDE, LONGITUDE = math.radians(63.4), math.radians(10.4)
"""Topside unit, the origin of the level axes [rad], at the height of the ellipsoid."""
RATE_HZ = 50.0
EARTH_RATE = 7.292115e-5
_A, _E2 = 6378137.0, 6.69437999014e-3
_S = math.sin(LATITUDE)
_W = math.sqrt(1.0 - _E2 * _S * _S)
NORTH_RADIUS = _A * (1.0 - _E2) / _W**3
EAST_RADIUS = _A / _W
GRAVITY = 9.7803253359 * (1.0 + 0.00193185265241 * _S * _S) / _W
"""On the ellipsoid, Somigliana's formula [m/s^2]."""
WATER_DENSITY, ATMOSPHERE = 1027.0, 101325.0
FLU_OF_FRD = np.diag([1.0, -1.0, -1.0])


class Motion(NamedTuple):
    """True motion at the IMU's rate; rows are samples.

    Attributes
    ----------
    time_s : (n,) array
    position_n, velocity_n : (n, 3) arrays
        North, east, down of the topside unit [m], [m/s].
    euler : (n, 3) array
        Yaw clockwise from true north, pitch nose up, roll right side down [rad].
    C_b_n : (n, 3, 3) array
        Body forward-right-down to level axes.
    """

    time_s: Floats
    position_n: Floats
    velocity_n: Floats
    euler: Floats
    C_b_n: Floats


class Imu(NamedTuple):
    """An AHRS' readings: forward, left, up; orientation to east, north, up."""

    time_s: Floats
    rate_b: Floats
    force_b: Floats
    quaternion_xyzw: Floats


class Dvl(NamedTuple):
    """Velocities over ground of a DVL, forward, right, down [m/s], and their figure of merit."""

    time_s: Floats
    velocity_b: Floats
    valid: NDArray[np.bool_]
    figure_of_merit: Floats
    altitude: Floats


class Fixes(NamedTuple):
    """Positions of a UGPS: received at ``time_s``, valid ``lag_s`` before, which is not stated."""

    time_s: Floats
    lag_s: Floats
    latitude_deg: Floats
    longitude_deg: Floats
    jumped: NDArray[np.bool_]


@dataclass(frozen=True)
class Ugps:
    """Errors of the position fixes.

    Attributes
    ----------
    white, slow, slow_s : float
        1-sigma per axis of white noise [m]; of a Gauss-Markov error [m], its correlation time [s].
    scale : float
        1-sigma of an error of range per range, one for a run.
    jump, jump_share, jump_s : float, float, (float, float)
        Distance [m], share of time and least and longest time [s] of jumps in one direction.
    gap_s, gaps_per_s : (float, float), float
        Least and longest time without fixes [s], their rate [1/s].
    lag_s, lag_tau_s : (float, float), float
        Least and largest lag of a fix [s], and how fast it wanders between [s].
    period_s : float
    """

    white: float = 1.0
    slow: float = 2.0
    slow_s: float = 60.0
    scale: float = 0.01
    jump: float = 20.0
    jump_share: float = 0.05
    jump_s: tuple[float, float] = (5.0, 20.0)
    gap_s: tuple[float, float] = (10.0, 90.0)
    gaps_per_s: float = 1.0 / 300.0
    lag_s: tuple[float, float] = (0.5, 2.0)
    lag_tau_s: float = 20.0
    period_s: float = 1.0


@dataclass(frozen=True)
class Sensors:
    """Errors of the vehicle's own sensors, 1-sigma each.

    Attributes
    ----------
    gyro_bias, gyro_noise, gyro_walk : float
        [rad/s], [rad/s/sqrt(Hz)], [rad/s/sqrt(s)].
    accel_bias, accel_noise : float
        [m/s^2], [m/s^2/sqrt(Hz)].
    yaw_offset_deg, yaw_slow_deg, yaw_slow_s : float
        Of the AHRS' heading: constant, Gauss-Markov and its correlation time (ours: a magnetic
        heading on a vehicle with thrusters).
    tilt_deg : float
        Of its roll and pitch, Gauss-Markov of 60 s.
    dvl_scale, dvl_white, dvl_slow, dvl_yaw_deg : float
        Scale [-], white and slow (300 s) error [m/s], yaw of the mounting.
    dvl_lever_b : (3,) tuple
        Place of the DVL, forward, right, down [m].
    pressure_offset, pressure_white : float
        [Pa].
    """

    gyro_bias: float = math.radians(0.02)
    gyro_noise: float = math.radians(0.005)
    gyro_walk: float = math.radians(2e-4)
    accel_bias: float = 0.05
    accel_noise: float = 1.4e-3
    yaw_offset_deg: float = 3.0
    yaw_slow_deg: float = 2.0
    yaw_slow_s: float = 300.0
    tilt_deg: float = 0.5
    dvl_scale: float = 0.015
    dvl_white: float = 0.005
    dvl_slow: float = 0.005
    dvl_yaw_deg: float = 0.5
    dvl_lever_b: tuple[float, float, float] = (-0.1, 0.0, 0.15)
    pressure_offset: float = 2000.0
    pressure_white: float = 150.0


def _ramp(time_s: Floats, start_s: float, length_s: float) -> Floats:
    """From 0 to 1 with a cosine over a time."""
    x = np.clip((time_s - start_s) / length_s, 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * x))


def _markov(rng: np.random.Generator, n: int, step_s: float, tau_s: float) -> Floats:
    """Gauss-Markov row of unit variance, (n,)."""
    out, decay = np.empty(n), math.exp(-step_s / tau_s)
    noise = rng.standard_normal(n)
    value = noise[0]
    for k in range(n):
        out[k] = value
        value = decay * value + math.sqrt(1.0 - decay * decay) * noise[(k + 1) % n]
    return out


def motion(seed: int, duration_s: float) -> Motion:
    """A search of parallel legs of 60 to 110 m at 0.3 to 0.8 m/s, turns on the spot, and rests."""
    rng = np.random.default_rng([seed, 1])
    n = round(duration_s * RATE_HZ) + 1
    t = np.arange(n) / RATE_HZ
    speed, yaw = np.zeros(n), np.full(n, rng.uniform(-np.pi, np.pi))
    at_s, side = 30.0, 1.0 if rng.random() < 0.5 else -1.0
    while at_s < duration_s:
        for length in (rng.uniform(60.0, 110.0), rng.uniform(6.0, 15.0)):
            pace = rng.uniform(0.3, 0.8)
            leg_s = length / pace
            speed += pace * (_ramp(t, at_s, 3.0) - _ramp(t, at_s + leg_s, 3.0))
            at_s += leg_s + 5.0
            turn_s = 90.0 / rng.uniform(10.0, 25.0)
            yaw += side * 0.5 * np.pi * _ramp(t, at_s, turn_s)
            at_s += turn_s + 1.0
        side = -side
        if rng.random() < 0.3:
            at_s += rng.uniform(10.0, 40.0)
    yaw += np.radians(3.0) * np.sin(2.0 * np.pi * t / rng.uniform(6.0, 12.0))
    moving = _ramp(t, 20.0, 10.0)
    sway = 0.06 * moving * np.sin(2.0 * np.pi * t / rng.uniform(25.0, 60.0))
    depth = 3.0 + 7.0 * _ramp(t, 30.0, 40.0) + moving * np.sin(2.0 * np.pi * t / 70.0)
    pitch = np.radians(2.0) * np.sin(2.0 * np.pi * t / rng.uniform(3.0, 5.0))
    roll = np.radians(3.0) * np.sin(2.0 * np.pi * t / rng.uniform(2.5, 4.0) + 1.0)
    velocity = np.column_stack(
        [
            speed * np.cos(yaw) - sway * np.sin(yaw),
            speed * np.sin(yaw) + sway * np.cos(yaw),
            np.gradient(depth, t),
        ]
    )
    position = np.zeros((n, 3))
    position[1:] = np.cumsum(0.5 * (velocity[1:] + velocity[:-1]), axis=0) / RATE_HZ
    position += [*rng.uniform(-40.0, 40.0, 2), depth[0]]
    euler = np.column_stack([yaw, pitch, roll])
    C_b_n = Rotation.from_euler('ZYX', euler).as_matrix()
    return Motion(t, position, velocity, euler, C_b_n)


def geodetic_deg(position_n: Floats) -> tuple[Floats, Floats]:
    """Latitude and longitude [deg] of points near the topside unit; 1 mm within 300 m."""
    north, east = position_n[..., 0], position_n[..., 1]
    lat = LATITUDE + north / NORTH_RADIUS - 0.5 * (east / EAST_RADIUS) ** 2 * math.tan(LATITUDE)
    lon = LONGITUDE + east / EAST_RADIUS / np.cos(LATITUDE + north / NORTH_RADIUS)
    return np.degrees(lat), np.degrees(lon)


def level_of(latitude: Floats, longitude: Floats) -> Floats:
    """North and east of the topside unit [m], (n, 2), of points near it [rad]; 1 mm in 300 m."""
    east = (longitude - LONGITUDE) * np.cos(latitude) * EAST_RADIUS
    north = latitude - LATITUDE + 0.5 * (east / EAST_RADIUS) ** 2 * math.tan(LATITUDE)
    return np.column_stack([north * NORTH_RADIUS, east])


def _inertial_rate_n(m: Motion) -> tuple[Floats, Floats]:
    """Earth rate (3,) and rate of the level axes against the Earth (n, 3), level axes [rad/s]."""
    earth = EARTH_RATE * np.array([math.cos(LATITUDE), 0.0, -math.sin(LATITUDE)])
    v = m.velocity_n
    along = np.column_stack(
        [
            v[:, 1] / EAST_RADIUS,
            -v[:, 0] / NORTH_RADIUS,
            -v[:, 1] * math.tan(LATITUDE) / EAST_RADIUS,
        ]
    )
    return earth, along


def imu(m: Motion, seed: int, e: Sensors) -> Imu:
    """Means over the interval before each stamp, with the AHRS' own orientation."""
    rng = np.random.default_rng([seed, 2])
    earth, along = _inertial_rate_n(m)
    turning = Rotation.from_matrix(np.swapaxes(m.C_b_n[:-1], 1, 2) @ m.C_b_n[1:]).as_rotvec()
    half = Rotation.from_rotvec(0.5 * turning).as_matrix()
    C_mid = m.C_b_n[:-1] @ half
    mean = 0.5 * (along[:-1] + along[1:])
    rate = turning * RATE_HZ + np.einsum('nji,nj->ni', C_mid, earth + mean)
    v = 0.5 * (m.velocity_n[1:] + m.velocity_n[:-1])
    force_n = np.diff(m.velocity_n, axis=0) * RATE_HZ + np.cross(2.0 * earth + mean, v)
    force_n[:, 2] -= GRAVITY + 3.086e-6 * m.position_n[1:, 2]
    force = np.einsum('nji,nj->ni', C_mid, force_n)
    n = len(rate)
    walk = np.cumsum(rng.standard_normal((n, 3)), axis=0) * e.gyro_walk / math.sqrt(RATE_HZ)
    rate += e.gyro_bias * rng.standard_normal(3) + walk
    rate += e.gyro_noise * math.sqrt(RATE_HZ) * rng.standard_normal((n, 3))
    force += e.accel_bias * rng.standard_normal(3)
    force += e.accel_noise * math.sqrt(RATE_HZ) * rng.standard_normal((n, 3))
    wrong = np.radians(
        np.column_stack(
            [
                e.yaw_offset_deg * rng.standard_normal()
                + e.yaw_slow_deg * _markov(rng, n, 1.0 / RATE_HZ, e.yaw_slow_s),
                e.tilt_deg * _markov(rng, n, 1.0 / RATE_HZ, 60.0),
                e.tilt_deg * _markov(rng, n, 1.0 / RATE_HZ, 60.0),
            ]
        )
    )
    yaw, pitch, roll = (m.euler[1:] + wrong).T
    enu = Rotation.from_euler('ZYX', np.column_stack([0.5 * np.pi - yaw, -pitch, roll]))
    return Imu(m.time_s[1:], rate @ FLU_OF_FRD, force @ FLU_OF_FRD, enu.as_quat())


def dvl(m: Motion, seed: int, e: Sensors) -> Dvl:
    """Eight pings a second; a few seconds without bottom lock now and then."""
    rng = np.random.default_rng([seed, 3])
    rows = np.unique(np.round(np.arange(0.3, m.time_s[-1], 0.125) * RATE_HZ).astype(int))
    n = len(rows)
    v_b = np.einsum('nji,nj->ni', m.C_b_n[rows], m.velocity_n[rows])
    lower = np.maximum(rows - 1, 0)
    turned = np.swapaxes(m.C_b_n[lower], 1, 2) @ m.C_b_n[rows]
    omega = Rotation.from_matrix(turned).as_rotvec() * RATE_HZ
    v_b += np.cross(omega, e.dvl_lever_b)
    turn = Rotation.from_euler('Z', e.dvl_yaw_deg * rng.standard_normal(), degrees=True)
    v_b = turn.apply(v_b) * (1.0 + e.dvl_scale * rng.standard_normal())
    v_b += e.dvl_slow * np.column_stack([_markov(rng, n, 0.125, 300.0) for _ in range(3)])
    v_b += e.dvl_white * rng.standard_normal((n, 3))
    lost = np.zeros(n, dtype=bool)
    for start in rng.integers(0, n, max(1, n // 1500)):
        lost[start : start + rng.integers(4, 40)] = True
    fom = np.full(n, e.dvl_white) * rng.uniform(0.8, 1.5, n)
    return Dvl(m.time_s[rows], v_b, ~lost, fom, 20.0 - m.position_n[rows, 2])


def pressure(m: Motion, seed: int, e: Sensors) -> tuple[Floats, Floats]:
    """Times [s] and absolute pressures [Pa], ten a second."""
    rng = np.random.default_rng([seed, 4])
    rows = np.arange(5, len(m.time_s), 5)
    absolute = ATMOSPHERE + WATER_DENSITY * GRAVITY * m.position_n[rows, 2]
    absolute = absolute + e.pressure_offset * rng.standard_normal()
    return m.time_s[rows], absolute + e.pressure_white * rng.standard_normal(len(rows))


def fixes(m: Motion, seed: int, u: Ugps) -> Fixes:
    """Fixes as a topside unit reports them: late, with gaps, and sometimes far off."""
    rng = np.random.default_rng([seed, 5])
    valid = np.arange(1.0, m.time_s[-1] - u.lag_s[1], u.period_s)
    n = len(valid)
    true = np.column_stack([np.interp(valid, m.time_s, m.position_n[:, i]) for i in range(2)])
    error = u.scale * rng.standard_normal() * true
    error += u.white * rng.standard_normal((n, 2))
    error += u.slow * np.column_stack([_markov(rng, n, u.period_s, u.slow_s) for _ in range(2)])
    jumped = np.zeros(n, dtype=bool)
    every_s = sum(u.jump_s) / 2.0 / u.jump_share
    at_s = rng.exponential(every_s - sum(u.jump_s) / 2.0)
    while at_s < valid[-1]:
        length_s, way = rng.uniform(*u.jump_s), rng.uniform(-np.pi, np.pi)
        held = (valid >= at_s) & (valid < at_s + length_s)
        error[held] += u.jump * np.array([math.cos(way), math.sin(way)])
        jumped |= held
        at_s += length_s + rng.exponential(every_s - sum(u.jump_s) / 2.0)
    given = np.ones(n, dtype=bool)
    at_s = rng.exponential(1.0 / u.gaps_per_s)
    while at_s < valid[-1]:
        length_s = rng.uniform(*u.gap_s)
        given &= (valid < at_s) | (valid >= at_s + length_s)
        at_s += length_s + rng.exponential(1.0 / u.gaps_per_s)
    low, high = u.lag_s
    wander = _markov(rng, n, u.period_s, u.lag_tau_s)
    wanted = low + (high - low) * (0.5 + 0.5 * np.sin(1.5 * wander))
    received = np.maximum.accumulate(valid + wanted)
    found = np.column_stack([true + error, np.zeros(n)])
    latitude, longitude = geodetic_deg(found)
    lag = received - valid
    return Fixes(received[given], lag[given], latitude[given], longitude[given], jumped[given])
