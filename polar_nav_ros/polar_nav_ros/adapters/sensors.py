"""IMU, DVL and depth of any adapter as arrays in SI units and the axes that the engine takes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.arrays import Array
from polar_nav_core.depth import depth_from_pressure
from polar_nav_core.dvl import corrected, sound_speed_factors
from polar_nav_core.errors import ConfigError

from .arrays import congruent, finite_rows, turned
from .mapping import LENGTH_UNITS, PRESSURE_UNITS, DepthMapping, DvlMapping, ImuMapping
from .rows import Rows, Stamps

IN_THE_AIR = -1.0
"""Depth above which a vehicle flies [m]; a low barometer makes a tenth of it."""
_FEWEST_BEAMS = 3


@dataclass(frozen=True)
class ImuRows:
    """Rates [rad/s] and specific forces [m/s^2], body axes, in the order of the bag."""

    topic: str
    stamps_ns: Stamps
    log_ns: Stamps
    omega_ib_b: Array
    f_b: Array


@dataclass(frozen=True)
class DvlRows:
    """Velocities [m/s] with covariance, body axes; ``stated`` where the message had one.

    ``water`` are those through the water where the mapping says that velocities are over ground.
    """

    topic: str
    stamps_ns: Stamps
    log_ns: Stamps
    velocity: Array
    covariance: Array
    stated: NDArray[np.bool_]
    valid: NDArray[np.bool_]
    water: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))


@dataclass(frozen=True)
class DepthRows:
    """Depths [m], positive down, with variance [m^2]; ``pressure`` [Pa] where that was given."""

    topic: str
    stamps_ns: Stamps
    log_ns: Stamps
    depth: Array
    variance: Array
    stated: NDArray[np.bool_]
    pressure: Array | None


def imu_of(rows: Rows, mapping: ImuMapping) -> ImuRows:
    """Samples of an IMU; the covariances in its messages are no error model and are not used."""
    C_s_b = mapping.C_s_b
    omega = turned(C_s_b, _scaled(_vectors(rows, 'rate'), mapping.gyro_scale))
    force = turned(C_s_b, _scaled(_vectors(rows, 'force'), mapping.accel_scale))
    return ImuRows(rows.topic, rows.stamps_ns, rows.log_ns, omega, force)


def pings_of(
    rows: Rows, mapping: DvlMapping, default_sigma: float, water_sound_speed: float
) -> DvlRows:
    """Pings of a DVL, corrected for the sound speed of the water [m/s] where it is known (not 0).

    The default stands where neither mapping nor message says how good a ping is.
    """
    n = len(rows)
    covariance, stated = _velocity_covariance(rows, n, mapping.scale)
    v, covariance = corrected(
        _vectors(rows, 'velocity') * mapping.scale,
        covariance,
        sound_speed_factors(_assumed(rows, n, mapping), water_sound_speed, _phased(rows, n)),
    )
    if mapping.sigma is not None:
        covariance = np.broadcast_to(mapping.sigma**2 * np.eye(3), (n, 3, 3)).copy()
        stated = np.ones(n, dtype=bool)
    covariance[~stated] = default_sigma**2 * np.eye(3)
    valid = finite_rows(v)
    if 'valid' in rows.values:
        valid &= rows.values['valid'].astype(bool)
    water = np.zeros(n, dtype=bool)
    if 'mode' in rows.values:
        # Types with these fields differ in the number that stands for bottom lock.
        bottom = rows.values['mode'] == rows.constants.get('DVL_MODE_BOTTOM', 0)
        through = np.asarray(rows.values['mode'] == rows.constants.get('DVL_MODE_WATER', 2))
        water = valid & through & (not mapping.water)
        valid &= through if mapping.water else bottom
    if 'beams' in rows.values:
        valid &= rows.values['beams'] >= _FEWEST_BEAMS
    C = mapping.C_s_b
    in_body = congruent(C, covariance)
    return DvlRows(
        rows.topic, rows.stamps_ns, rows.log_ns, turned(C, v), in_body, stated, valid, water
    )


def _assumed(rows: Rows, n: int, mapping: DvlMapping) -> Array:
    """Sound speed that the instrument assumed at each ping: of its messages, or of the mapping."""
    stated = rows.floats('sound_speed')
    if stated is None:
        return np.full(n, mapping.sound_speed)
    return np.where(stated > 0.0, stated, mapping.sound_speed)


def _phased(rows: Rows, n: int) -> NDArray[np.bool_]:
    if 'type' not in rows.values:
        return np.zeros(n, dtype=bool)
    return np.asarray(rows.values['type'] == rows.constants.get('DVL_TYPE_PHASED_ARRAY', 1))


def _velocity_covariance(rows: Rows, n: int, scale: float) -> tuple[Array, NDArray[np.bool_]]:
    sigma = rows.floats('sigma')
    if sigma is not None:
        variance = (sigma * scale) ** 2
        return variance[:, None, None] * np.eye(3), np.ones(n, dtype=bool)
    flat = rows.floats('covariance')
    if flat is None:
        return np.zeros((n, 3, 3)), np.zeros(n, dtype=bool)
    matrix = _position_block(flat)
    return matrix * scale**2, matrix[:, 0, 0] != -1.0


def _position_block(flat: Array) -> Array:
    """Covariance of the first three of 3 or 6 quantities, row major. (n, 9 or 36) -> (n, 3, 3)."""
    if flat.shape[1] == 36:
        return flat.reshape(-1, 6, 6)[:, :3, :3].copy()
    return flat.reshape(-1, 3, 3).copy()


def depths_of(
    rows: Rows, mapping: DepthMapping, default_sigma: float, latitude_deg: float
) -> DepthRows:
    """Depths, or pressures through the equation of state of sea water (TEOS-10).

    The latitude [deg] is that of the start, unless the mapping states one; over the whole range of
    latitudes it changes depth by half a per cent.
    """
    name = 'pressure' if 'pressure' in rows.values else 'depth'
    raw = rows.floats(name)
    if raw is None or raw.ndim != 1:
        raise ConfigError(f'{mapping.stream.topic}: {name} is not one number per message')
    least, most = rows.floats('least'), rows.floats('most')
    if least is not None and most is not None:  # a sounder says so where it heard no echo
        raw = np.where((raw >= least) & (raw <= most), raw, np.nan)
    unit = mapping.unit or ('Pa' if name == 'pressure' else 'm')
    pressure = None
    if unit in PRESSURE_UNITS:
        pressure = raw * PRESSURE_UNITS[unit]
        at = latitude_deg if mapping.latitude_deg is None else mapping.latitude_deg
        depth = np.asarray(
            depth_from_pressure(pressure, np.radians(at), mapping.atmospheric_pressure)
        )
        to_depth = PRESSURE_UNITS[unit] / _PASCAL_PER_METRE
    else:
        depth = raw * LENGTH_UNITS[unit] * mapping.sign
        to_depth = LENGTH_UNITS[unit]
    variance = rows.floats('variance')
    n = len(rows)
    stated = np.zeros(n, dtype=bool)
    if variance is not None:
        # Zero stands for unknown in sensor_msgs, -1 in this project.
        stated = variance != (0.0 if name == 'pressure' else -1.0)
        variance = variance * to_depth**2
    if mapping.sigma is not None:
        variance, stated = np.full(n, mapping.sigma**2), np.ones(n, dtype=bool)
    if variance is None:
        variance = np.zeros(n)
    variance = np.where(stated, variance, default_sigma**2)
    return DepthRows(rows.topic, rows.stamps_ns, rows.log_ns, depth, variance, stated, pressure)


_PASCAL_PER_METRE = 1.0e4
"""Of sea water, to a few per cent: enough for a variance."""


def _vectors(rows: Rows, name: str) -> Array:
    found = rows.floats(name)
    if found is None or found.ndim != 2 or found.shape[1] != 3:
        shape = None if found is None else found.shape
        raise ConfigError(f'{rows.topic}: {name} is not 3 numbers per message, but {shape}')
    return found


def _scaled(values: Array, scale: float) -> Array:
    """Without a copy where nothing changes: half a day of an IMU is 100 MB each."""
    return values if scale == 1.0 else values * scale
