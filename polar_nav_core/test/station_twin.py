"""A vehicle before a hydroacoustic station: 6-DOF truth and what its sensors say, as arrays.

Small twin of the scenario in docs/derivations/station.md for the tests of the core, which may not
import the simulation. Frame A: grid axes at the station. Noise is uniform, amplitudes as given.
"""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

from polar_nav_core import attitude, earth, grid
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.inputs import StationInputs
from polar_nav_core.engine.params import NO_COMMON_ERRORS, EngineParams
from polar_nav_core.identification.polar_fix import PolarFix

START_NS = 1_000_000_000
LATITUDE_DEG, LONGITUDE_DEG, DEPTH = 85.0, 40.0, 5.0
ORIGIN_E = earth.ecef_from_geodetic(
    math.radians(LATITUDE_DEG), math.radians(LONGITUDE_DEG), -DEPTH
)
C_E_A = grid.ecef_to_grid(ORIGIN_E)
STATION_PSI = 0.3
SOUND_SPEED, PERIOD_S, PROCESSING_S, PACKET_S = 1500.0, 2.5, 0.2, 192 / 9600
START = np.array([-850.0, 350.0, -15.0])

MASS = 100.0
ADDED = np.array([1.8, 76.5, 76.5])
INERTIA = np.array([2.05, 20.23, 20.23])
LINEAR = np.array([25.0, 105.0, 105.0, 0.1, 5.5, 5.5])
QUADRATIC = np.array([19.0, 105.0, 105.0, 0.1, 5.5, 5.5])
BUOYANCY, NET = 986.0, 5.0
CENTRE_B = np.array([0.0, 0.0, 0.02])
INVERSE = np.diag(1.0 / (MASS + ADDED))


def cross(a, b):
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def thrust(t, scale=1.0):
    """Surge thrust [N]."""
    return 52.0 + scale * (18.0 * np.sin(0.05 * t) + 14.0 * np.sin(0.013 * t))


def heading(t):
    """Heading psi that the yaw loop follows [rad]."""
    return 1.9 * np.sin(0.011 * t) + 0.45 * np.sin(0.037 * t) + 0.3


def constant_current(_):
    return np.array([0.4, 0.25, 0.0]), np.zeros(3)


def changing_current(t):
    """30 % and 0.6 rad in 30 min."""
    size = math.hypot(0.4, 0.25)
    phase = 2.0 * math.pi * t / 3600.0
    a = math.atan2(0.25, 0.4) + 0.3 * (1.0 - math.cos(phase))
    s = size * (1.0 - 0.3 * 0.5 * (1.0 - math.cos(phase)))
    h = 1e-3
    v = s * np.array([math.cos(a), math.sin(a), 0.0])
    a1 = math.atan2(0.25, 0.4) + 0.3 * (1.0 - math.cos(2.0 * math.pi * (t + h) / 3600.0))
    s1 = size * (1.0 - 0.15 * (1.0 - math.cos(2.0 * math.pi * (t + h) / 3600.0)))
    return v, (s1 * np.array([math.cos(a1), math.sin(a1), 0.0]) - v) / h


CURRENTS = {'constant': constant_current, 'changing': changing_current}


def rates(R, v_r, omega, force, torque, current_rate):
    """Accelerations of velocity through the water and of rotation, body axes."""
    up = R[2]
    momentum = (MASS + ADDED) * v_r
    f = force + NET * up - cross(omega, momentum) - MASS * (R.T @ current_rate)
    f = f - (LINEAR[:3] + QUADRATIC[:3] * np.abs(v_r)) * v_r
    n = torque + cross(CENTRE_B, BUOYANCY * up) - cross(v_r, ADDED * v_r)
    n = n - cross(omega, INERTIA * omega)
    n = n - (LINEAR[3:] + QUADRATIC[3:] * np.abs(omega)) * omega
    return f / (MASS + ADDED), n / INERTIA


def controls(t, R, omega, excitation):
    """Thrust as a time law; loops of heading and pitch."""
    psi, theta, _ = attitude.euler_from_matrix(R)
    off = math.remainder(heading(t) - float(psi), 2.0 * math.pi)
    pitch = 0.03 * math.sin(0.02 * t) - float(theta)
    force = np.array([thrust(t, excitation), 0.0, -NET])
    torque = np.array([0.0, 400.0 * pitch - 200.0 * omega[1], 200.0 * off - 120.0 * omega[2]])
    return force, torque


@dataclass(frozen=True)
class Truth:
    """Truth at 100 Hz: times from 0, position in frame A, and so on."""

    t: np.ndarray
    p: np.ndarray
    v_r: np.ndarray
    R: np.ndarray
    omega: np.ndarray
    current: np.ndarray

    @property
    def v(self):
        return np.einsum('nij,nj->ni', self.R, self.v_r) + self.current


@cache
def truth(duration=1600.0, current='constant', excitation=1.0):
    flow = CURRENTS[current]

    def derivative(t, y):
        R = y[6:15].reshape(3, 3)
        v_r, omega = y[3:6], y[15:18]
        now, rate = flow(t)
        force, torque = controls(t, R, omega, excitation)
        a, alpha = rates(R, v_r, omega, force, torque, rate)
        turn = np.array(
            [[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]]
        )
        return np.concatenate([R @ v_r + now, a, (R @ turn).ravel(), alpha])

    y0 = np.concatenate(
        [START, [0.0, 0, 0], attitude.matrix_from_euler(0.3, 0.0, 0.0).ravel(), np.zeros(3)]
    )
    t = np.arange(round(duration * 100) + 1) * 0.01
    y = solve_ivp(
        derivative, (0.0, duration), y0, method='RK45', t_eval=t, rtol=1e-6, atol=1e-7
    ).y.T
    R = y[:, 6:15].reshape(-1, 3, 3)
    psi, theta, phi = attitude.euler_from_matrix(R)
    return Truth(
        t,
        y[:, :3],
        y[:, 3:6],
        attitude.matrix_from_euler(psi, theta, phi),
        y[:, 15:18],
        np.array([flow(s)[0] for s in t]),
    )


def interpolated(truth, t):
    i = min(int(t * 100), len(truth.t) - 2)
    s = t * 100 - i
    return (1 - s) * truth.p[i] + s * truth.p[i + 1]


def fixes(truth, rng, *, noise=1.0, loss=0.0, processing=PROCESSING_S, stated=True):
    """Fixes of a standing station, in the order of interrogation."""
    result = []
    duration = truth.t[-1]
    half_quantum = 0.5 * noise
    for n in range(int(duration / PERIOD_S)):
        ping = n * PERIOD_S
        t3 = ping
        for _ in range(4):
            distance = float(np.linalg.norm(interpolated(truth, min(t3, duration))))
            t3 = ping + distance / SOUND_SPEED
        arrival = t3 + 2.0 * distance / SOUND_SPEED + PACKET_S + processing
        lost = rng.random() < loss
        e_range, e_bearing = rng.uniform(-noise, noise, 2)
        if arrival > duration or lost:
            continue
        p = interpolated(truth, t3)
        measured = distance * (1.0 + 0.01 * e_range)
        bearing = math.atan2(p[1], p[0]) - STATION_PSI + math.radians(e_bearing)
        if half_quantum:
            measured = round(measured / 0.5) * 0.5
            bearing = round(math.degrees(bearing) / 0.5) * 0.5
            bearing = math.radians(bearing)
        nan = float('nan')
        s_range = math.sqrt((0.01 * measured) ** 2 / 3 + 0.25 / 12) if stated else nan
        s_bearing = math.sqrt(1.0 / 3 + 0.25 / 12) * math.pi / 180 if stated else nan
        result.append(
            Fix(
                validity_ns=START_NS + round(t3 * 1e9),
                transmit_ns=START_NS + round((arrival - PACKET_S) * 1e9),
                receive_ns=START_NS + round(arrival * 1e9),
                source='station',
                sequence=n,
                order=n,
                arrival=n,
                r_e=np.full(3, nan),
                covariance_e=np.full((3, 3), nan),
                polar=PolarFix(
                    np.zeros(3),
                    STATION_PSI,
                    0.0,
                    measured,
                    s_range,
                    bearing,
                    s_bearing,
                    SOUND_SPEED,
                ),
            )
        )
    return tuple(result)


def inputs(truth, seed, *, noise=1.0, depth_every=1, excitation=1.0, **kwargs):
    """What the sensors say of the truth."""
    rng = np.random.default_rng(seed)
    n = len(truth.t)
    stamps = START_NS + np.round(truth.t * 1e9).astype(np.int64)
    psi, theta, phi = attitude.euler_from_matrix(truth.R)
    e = rng.uniform(-0.02 * noise, 0.02 * noise, (n, 3))
    C_m = attitude.matrix_from_euler(psi + e[:, 0], theta + e[:, 1], phi + e[:, 2])
    r_e = ORIGIN_E + truth.p @ C_E_A
    C_A_G = np.einsum('nij,kj->nik', grid.ecef_to_grid(r_e), C_E_A)
    mean = 0.5 * (truth.omega + np.vstack([truth.omega[:1], truth.omega[:-1]]))
    omega = mean + np.einsum('nji,j->ni', truth.R, C_E_A @ [0.0, 0.0, 7.292115e-5])
    omega = omega + rng.uniform(-0.01 * noise, 0.01 * noise, (n, 3))
    height = earth.geodetic_from_ecef(r_e)[2]
    depth = -height + rng.uniform(-0.05 * noise, 0.05 * noise, n)
    every = slice(0, None, depth_every)
    force = np.zeros((n, 3))
    force[:, 0] = thrust(truth.t + 0.005, excitation)
    force[:, 2] = -NET
    return StationInputs(
        imu_stamps_ns=stamps,
        omega_ib_b=omega,
        C_b_G=np.einsum('nij,njk->nik', C_A_G, C_m),
        control_stamps_ns=stamps,
        force_b=force,
        depth_stamps_ns=stamps[every].copy(),
        depth=depth[every].copy(),
        depth_variance=np.full(len(depth[every]), max(0.05**2 / 3, 1e-6)),
        fixes=fixes(truth, rng, noise=noise, **kwargs),
    )


def params(**changes):
    """Parameters for this place; the vehicle starts at rest in the water."""
    latitude, longitude, height = earth.geodetic_from_ecef(ORIGIN_E + START @ C_E_A)
    base = EngineParams(
        mode='station',
        configuration='default',
        **NO_COMMON_ERRORS,
        station_latitude_deg=LATITUDE_DEG,
        station_longitude_deg=LONGITUDE_DEG,
        station_height=-DEPTH,
        initial_latitude_deg=math.degrees(latitude),
        initial_longitude_deg=math.degrees(longitude),
        initial_height=float(height),
        initial_sigma_position=5.0,
        initial_sigma_height=1.0,
        initial_sigma_velocity=0.1,
        max_delay_s=20.0,
        history_s=25.0,
    )
    return replace(base, **changes)


def errors(track, truth):
    """Position and velocity errors of estimates in frame A: times, (k, 3), (k, 3)."""
    k = np.round((track.stamps_ns - START_NS) * 1e-7).astype(int)
    p = (track.r_e - ORIGIN_E) @ C_E_A.T
    C_G_A = np.einsum('ij,nkj->nik', C_E_A, grid.ecef_to_grid(track.r_e))
    v = np.einsum('nij,nj->ni', C_G_A, track.v_G)
    return truth.t[k], p - truth.p[k], v - truth.v[k]
