"""Where the filter starts: from a topic, from stated values, or aligned on the data at rest.

Whatever the mapping states among ``parameters`` (``initial_*``) wins over what is found here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping as Names
from dataclasses import dataclass
from typing import Any

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.attitude import euler_from_matrix, exp, grid_heading, log, matrix_from_euler
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.start.gyrocompass import gyrocompass
from polar_nav_core.engine.start.level import (
    REST_FORCE,
    REST_RATE,
    Tilt,
    at_rest,
    spread,
    tilt_of,
)
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import convergence, ecef_to_grid
from polar_nav_core.params import default_of
from polar_nav_ros.adapters.arrays import finite_rows
from polar_nav_ros.adapters.mapping import InitialMapping
from polar_nav_ros.adapters.position import PositionRows
from polar_nav_ros.adapters.sensors import DvlRows, ImuRows
from polar_nav_ros.adapters.stated import START_SIGMAS

from ..bags.finding import Finding, Severity
from .findings import finding
from .levelling import gravity_at_start

_LEVEL = ('initial_roll_deg', 'initial_pitch_deg')
_G = 9.81
_NEAR_NS = 5_000_000_000
"""A ping further from the start says nothing of the velocity there."""
_NOWHERE = np.zeros(3)


@dataclass(frozen=True)
class Start:
    """Initial parameters, the stamp they hold at, and what was found on the way."""

    stamp_ns: int
    values: dict[str, Any]
    findings: tuple[Finding, ...]
    how: str


def find_start(
    mapping: InitialMapping,
    place: str,
    stated: Names[str, Any],
    imu: ImuRows,
    dvl: DvlRows | None,
    positions: PositionRows | None,
    *,
    dvl_from_imu_b: Array = _NOWHERE,
) -> Start:
    """Find the initial state, that of base_link.

    Parameters
    ----------
    mapping : InitialMapping
    place : str
        Of the mapping, for sentences.
    stated : mapping
        Parameters that the mapping states.
    imu, dvl, positions : rows
        By stamp; positions are those of ``initial: topic``.
    dvl_from_imu_b : (3,) array
        [m]

    Raises
    ------
    ConfigError
        When position or heading come from nowhere.
    """
    first_ns = int(imu.stamps_ns[0])
    values: dict[str, Any] = dict(START_SIGMAS)
    C_b_G = np.full((3, 3), np.nan)
    v_G = np.full(3, np.nan)
    notes = []
    if positions is not None:
        if not len(positions.stamps_ns):
            raise ConfigError(
                f'{place}: initial: {positions.topic} has no usable position (of which the height '
                'is a part); without the topic the start is aligned (docs/start.md)'
            )
        first_ns = max(first_ns, int(positions.stamps_ns[0]))
        r_e, v_G, C_b_G, row = _state_at(positions, first_ns)
        lat, lon, height = (float(v) for v in geodetic_from_ecef(r_e))
        values |= {
            'initial_latitude_deg': math.degrees(lat),
            'initial_longitude_deg': math.degrees(lon),
            'initial_height': height,
        }
        P_G = ecef_to_grid(r_e) @ positions.covariance_e[row] @ ecef_to_grid(r_e).T
        if np.isfinite(P_G).all() and (np.diagonal(P_G) > 0.0).all():
            values['initial_sigma_position'] = math.sqrt(max(P_G[0, 0], P_G[1, 1]))
            values['initial_sigma_height'] = math.sqrt(P_G[2, 2])
        notes.append(f'position from {positions.topic}')
    elif not {'initial_latitude_deg', 'initial_longitude_deg'} <= set(stated):
        raise ConfigError(
            f'{place}: initial: position comes from nowhere: give a topic, or '
            'initial_latitude_deg and initial_longitude_deg among parameters'
        )
    where = {**values, **stated}
    findings: list[Finding] = []
    aligned = mapping.kind == 'alignment'
    if np.isfinite(C_b_G).all() and not aligned:
        _, theta, phi = (math.degrees(float(a)) for a in euler_from_matrix(C_b_G))
        values |= {
            'initial_pitch_deg': theta,
            'initial_roll_deg': phi,
            'initial_grid_heading_deg': math.degrees(float(grid_heading(C_b_G))),
        }
        notes.append('attitude from the same')
    elif aligned or mapping.heading_from == 'gyrocompass' or not set(_LEVEL) <= set(stated):
        first_ns, found, level = _levelled(
            mapping, place, where, imu, first_ns, None if aligned else dvl, dvl_from_imu_b
        )
        findings += found
        values |= level
        notes.append('roll and pitch from gravity')
    heading = _stated_heading(mapping, where)
    if heading is not None:
        values['initial_grid_heading_deg'] = heading
        notes.append('heading as stated')
    if 'initial_grid_heading_deg' not in {**values, **stated}:
        raise ConfigError(
            f'{place}: initial: heading comes from nowhere: give heading_deg (true), '
            'grid_heading_deg, a topic with attitude, or `heading: gyrocompass`; without '
            'section initial the start is aligned, by a measured heading too (docs/start.md)'
        )
    if 'initial_v_G' not in stated:
        velocity, said = _velocity(mapping, v_G, {**values, **stated}, imu, dvl, first_ns)
        values['initial_v_G'] = [float(v) for v in velocity]
        notes.append(said)
    own = [name for name in stated if name.startswith('initial_')]
    if own:
        notes.append(f'{len(own)} values as stated among parameters')
    return Start(first_ns, values, tuple(findings), '; '.join(notes))


def _state_at(rows: PositionRows, stamp_ns: int) -> tuple[Array, Array, Array, int]:
    """Position, velocity, attitude between the rows around a stamp, and the row before."""
    k = int(np.searchsorted(rows.stamps_ns, stamp_ns, side='right')) - 1
    k = min(max(k, 0), len(rows.stamps_ns) - 1)
    if k + 1 == len(rows.stamps_ns) or rows.stamps_ns[k] == stamp_ns:
        return rows.r_e[k], rows.v_G[k], rows.C_b_G[k], k
    share = (stamp_ns - int(rows.stamps_ns[k])) / int(rows.stamps_ns[k + 1] - rows.stamps_ns[k])
    turn = log(rows.C_b_G[k].T @ rows.C_b_G[k + 1])
    return (
        rows.r_e[k] + share * (rows.r_e[k + 1] - rows.r_e[k]),
        rows.v_G[k] + share * (rows.v_G[k + 1] - rows.v_G[k]),
        rows.C_b_G[k] @ exp(share * turn),
        k,
    )


def _levelled(
    mapping: InitialMapping,
    place: str,
    where: Names[str, Any],
    imu: ImuRows,
    first_ns: int,
    dvl: DvlRows | None,
    dvl_from_imu_b: Array,
) -> tuple[int, list[Finding], dict[str, Any]]:
    """Roll and pitch from specific force; with an alignment, from rest and with a gyrocompass."""
    aligned = mapping.kind == 'alignment'
    last_ns = first_ns + round(mapping.rest_s * 1e9)
    rest = (imu.stamps_ns >= first_ns) & (imu.stamps_ns <= last_ns)
    rest &= finite_rows(imu.f_b) & finite_rows(imu.omega_ib_b)
    if rest.sum() < 2:
        raise ConfigError(
            f'{place}: initial: {int(rest.sum())} IMU samples in the first {mapping.rest_s:g} s '
            '(rest_s): too few to find the vertical'
        )
    f, omega = imu.f_b[rest], imu.omega_ib_b[rest]
    mean, known = f.mean(axis=0), True
    if not aligned:
        mean, known = gravity_at_start(imu.stamps_ns[rest], omega, f, dvl, dvl_from_imu_b)
    roll, pitch = tilt_of(mean)
    values = {'initial_roll_deg': math.degrees(roll), 'initial_pitch_deg': math.degrees(pitch)}
    if not known:
        tilt = math.degrees(spread(f) / float(np.linalg.norm(mean)))
        values['initial_sigma_tilt_deg'] = max(START_SIGMAS['initial_sigma_tilt_deg'], tilt)
    findings = list(_motion(imu, first_ns, f, omega)) if aligned else []
    if mapping.heading_from == 'gyrocompass':
        found, heading = _gyrocompass(mapping, where, imu, first_ns, omega, roll, pitch)
        values |= heading
        findings += found
    # An alignment ends where the vehicle may begin to move; levelling alone costs no data.
    return (last_ns if aligned else first_ns), findings, values


def _motion(imu: ImuRows, first_ns: int, f: Array, omega: Array) -> list[Finding]:
    rate, force = spread(omega), spread(f)
    if at_rest(rate, force):
        return []
    return [
        finding(
            'not_at_rest',
            Severity.SEVERE,
            imu.topic,
            first_ns,
            len(f),
            rate,
            f'RMS about the mean is {rate:.3g} rad/s and {force:.3g} m/s^2 (limits {REST_RATE} '
            f'and {REST_FORCE}): the vehicle is not at rest during rest_s',
        )
    ]


def _gyrocompass(
    mapping: InitialMapping,
    where: Names[str, Any],
    imu: ImuRows,
    first_ns: int,
    omega: Array,
    roll: float,
    pitch: float,
) -> tuple[list[Finding], dict[str, Any]]:
    """Heading from the direction of the Earth's rate, with its sigma, as of a live start."""
    lat = math.radians(float(where['initial_latitude_deg']))
    lon = math.radians(float(where['initial_longitude_deg']))
    bias = float(where.get('gyro_bias_sigma', default_of(EngineParams, 'gyro_bias_sigma')))
    noise = float(where.get('gyro_noise_density', default_of(EngineParams, 'gyro_noise_density')))
    accel = float(where.get('accel_bias_sigma', default_of(EngineParams, 'accel_bias_sigma')))
    found = gyrocompass(
        omega.mean(axis=0),
        Tilt(roll, pitch),
        lat,
        bias=bias,
        noise=noise / math.sqrt(mapping.rest_s),
        tilt_sigma=accel / _G,
        v_sigma=0.0,  # the mapping states that it rests
    )
    heading = math.degrees(found.heading - float(convergence(lat, lon)))
    sigma = math.degrees(found.sigma)
    values = {
        'initial_grid_heading_deg': math.remainder(heading, 360.0),
        'initial_sigma_heading_deg': min(max(sigma, 1e-7), 180.0),
    }
    if not found.refusal:
        return [], values
    said = f'{found.refusal}: state heading_deg'
    uncertain = finding(
        'gyrocompass', Severity.SEVERE, imu.topic, first_ns, len(omega), sigma, said
    )
    return [uncertain], values


def _stated_heading(mapping: InitialMapping, where: Names[str, Any]) -> float | None:
    if mapping.grid_heading_deg is not None:
        return mapping.grid_heading_deg
    if mapping.heading_deg is None:
        return None
    lat = math.radians(float(where['initial_latitude_deg']))
    lon = math.radians(float(where['initial_longitude_deg']))
    return math.remainder(mapping.heading_deg - math.degrees(float(convergence(lat, lon))), 360.0)


def _velocity(
    mapping: InitialMapping,
    v_G: Array,
    values: Names[str, Any],
    imu: ImuRows,
    dvl: DvlRows | None,
    first_ns: int,
) -> tuple[Array, str]:
    """Velocity of base_link, grid axes, and where it is from."""
    if mapping.kind == 'alignment':
        return np.zeros(3), 'velocity zero, at rest'
    if np.isfinite(v_G).all():
        return v_G, 'velocity from the same'
    if dvl is not None and dvl.valid.any():
        pings = np.flatnonzero(dvl.valid)
        nearest = int(pings[np.argmin(np.abs(dvl.stamps_ns[pings] - first_ns))])
        if abs(int(dvl.stamps_ns[nearest]) - first_ns) < _NEAR_NS:
            psi = math.radians(90.0 - float(values['initial_grid_heading_deg']))
            theta = math.radians(float(values.get('initial_pitch_deg', 0.0)))
            phi = math.radians(float(values.get('initial_roll_deg', 0.0)))
            C_b_G = np.asarray(matrix_from_euler(psi, theta, phi))
            turning = _rate_near(imu, int(dvl.stamps_ns[nearest]))
            lever_b = values.get('dvl_lever_b', default_of(EngineParams, 'dvl_lever_b'))
            v_b = dvl.velocity[nearest] - np.cross(turning, np.asarray(lever_b, dtype=float))
            return C_b_G @ v_b, 'velocity from the DVL'
    return np.zeros(3), 'velocity zero, nothing says more'


def _rate_near(imu: ImuRows, stamp_ns: int) -> Array:
    """Rate of the finite sample nearest to a stamp; zero where there is none [rad/s]."""
    good = np.flatnonzero(finite_rows(imu.omega_ib_b))
    if not len(good):
        return np.zeros(3)
    nearest = good[np.argmin(np.abs(imu.stamps_ns[good] - stamp_ns))]
    return np.asarray(imu.omega_ib_b[nearest])
