"""An IMU that is not at base_link: its own point is navigated, and the estimates are moved back.

With l from base_link to the IMU, body axes, the two points are one rigid body:

    r_imu = r_base + C_b_e l        v_imu = v_base + C_b_G (omega_eb_b x l)

An accelerometer feels ``omega' x l + omega x (omega x l)`` more at l than at base_link. To take
that off, the gyros would have to be differentiated. At the IMU's own point nothing of the kind is
needed: its force is the right one there, every other lever arm is counted from there, and only the
start and the estimates are moved, as above (`kernels.sins.lever`). The grid axes at the two points
differ by ``l / R`` (2e-7 rad for a metre), which is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any, Self, TypeVar

import numpy as np

from ..arrays import Array, Ints
from ..attitude import matrix_from_euler
from ..earth import ecef_from_geodetic, geodetic_from_ecef
from ..errors import ConfigError
from ..grid import earth_rate, ecef_to_grid
from ..kernels.sins.lever import move_to_base_link
from .events import InitialState
from .outputs import Estimate
from .params import EngineParams

_LEVERS = ('dvl_lever_b', 'depth_lever_b', 'transponder_lever_b')
_FARTHEST = 100.0
"""Of any two sensors from each other [m], as of the parameters."""
_USUAL = 3.0
"""Of an interval longer than so many of the one before the sample is no mean: a gap."""
_P = TypeVar('_P', bound=EngineParams)


def params_at_imu(params: _P, lever_b: Array) -> _P:
    """Parameters whose lever arms are counted from the IMU, not from base_link.

    Parameters
    ----------
    params : EngineParams
    lever_b : (3,) array
        IMU from base_link [m].

    Raises
    ------
    ConfigError
        When two sensors are too far from each other, in station mode, and with model aiding,
        whose vehicle model moves base_link.
    """
    if params.mode != 'sins':
        raise ConfigError(
            f'imu: lever_b does not go with parameter mode {params.mode}: no specific force is '
            'integrated there'
        )
    if params.model_aiding:
        raise ConfigError(
            'imu: lever_b does not go with parameter model_aiding: the model of the vehicle is of '
            'base_link, and the filter is at the IMU'
        )
    levers = {name: np.asarray(getattr(params, name)) - lever_b for name in _LEVERS}
    for name, lever in levers.items():
        if np.abs(lever).max() > _FARTHEST:
            raise ConfigError(
                f'imu: lever_b: {name} {list(getattr(params, name))} is '
                f'{np.abs(lever).max():g} m from it along an axis (limit {_FARTHEST:g} m)'
            )
    changes: dict[str, Any] = {n: tuple(float(v) for v in lever) for n, lever in levers.items()}
    return replace(params, **changes)


def state_at(initial: InitialState, lever_b: Array, omega_ib_b: Array) -> InitialState:
    """State of another point of the body, as certain as it was.

    Parameters
    ----------
    initial : InitialState
    lever_b : (3,) array
        That point from the one that ``initial`` is of, body axes [m].
    omega_ib_b : (3,) array
        Rate of the body [rad/s].
    """
    values = {f.name: getattr(initial, f.name) for f in fields(InitialState)}
    r_e = np.asarray(ecef_from_geodetic(initial.latitude, initial.longitude, initial.height))
    psi = 0.5 * math.pi - initial.grid_heading
    C_b_G = np.asarray(matrix_from_euler(psi, initial.pitch, initial.roll))
    omega_eb_b = omega_ib_b - C_b_G.T @ earth_rate(r_e)
    lat, lon, height = geodetic_from_ecef(r_e + ecef_to_grid(r_e).T @ C_b_G @ lever_b)
    v_x, v_y, v_z = np.asarray(initial.v_G) + C_b_G @ np.cross(omega_eb_b, lever_b)
    values |= {'latitude': float(lat), 'longitude': float(lon), 'height': float(height)}
    return InitialState(**values | {'v_G': (float(v_x), float(v_y), float(v_z))})


@dataclass(frozen=True)
class Rates:
    """Angular rates at the stamps of IMU samples, by the samples up to there.

    A mean belongs to the middle of its interval: the last two means are carried on to the stamp,
    ``omega_k + (omega_k - omega_k-1) dt_k / (dt_k + dt_k-1)``. A value at the stamp, the first
    mean and the one after a gap are used as they are.

    Attributes
    ----------
    stamps_ns : (n,) array
        Of the samples that are used, increasing.
    omega_ib_b : (n, 3) array
        [rad/s]
    mean : bool
        Whether samples are means.
    """

    stamps_ns: Ints
    omega_ib_b: Array
    mean: bool

    def at(self, stamps_ns: Ints) -> tuple[Array, Array]:
        """Rates at stamps of samples [rad/s], and the noise in them.

        Returns
        -------
        omega_ib_b : (k, 3) array
            [rad/s]
        bandwidth : (k,) array
            Variance of the noise over its density squared [Hz]; of the first sample, whose
            interval is not known, 1.
        """
        known = self.stamps_ns
        k = np.searchsorted(known, stamps_ns)
        before, long_before = np.maximum(k - 1, 0), np.maximum(k - 2, 0)
        dt = (known[k] - known[before]) * 1e-9
        dt_before = (known[before] - known[long_before]) * 1e-9
        apart = np.where(dt > 0.0, dt + dt_before, 1.0)
        carried = (dt_before > 0.0) & (dt <= _USUAL * dt_before) & self.mean
        share = np.where(carried, dt / apart, 0.0)
        step = self.omega_ib_b[k] - self.omega_ib_b[before]
        own, other = np.where(dt > 0.0, dt, 1.0), np.where(carried, dt_before, 1.0)
        bandwidth = (1.0 + share) ** 2 / own + share**2 / other
        return self.omega_ib_b[k] + share[:, None] * step, bandwidth


class Arm:
    """Moves states between base_link and the IMU of a vehicle that is driven sample by sample.

    Parameters
    ----------
    params : EngineParams
    lever_b : (3,) array
        IMU from base_link [m].
    """

    def __init__(self, params: EngineParams, lever_b: Array) -> None:
        self.lever_b = np.array(lever_b, dtype=np.float64)
        self._mean = params.imu_sample == 'mean'
        self._noise = params.gyro_noise_density
        self._stamps_ns: list[int] = []
        self._omega_b: list[Array] = []
        warm_up()  # not when the first estimate is due

    def imu(self, stamp_ns: int, omega_ib_b: Array) -> None:
        """Note the rate of the next sample that is used [rad/s]."""
        self._stamps_ns = [*self._stamps_ns[-2:], stamp_ns]
        self._omega_b = [*self._omega_b[-2:], omega_ib_b]

    def rate(self) -> tuple[Array, Array]:
        """Rate at the newest sample (1, 3) [rad/s] and its noise (1,), as of `Rates.at`.

        Zeros before the first one, as when a start is stated before the IMU is heard.
        """
        if not self._stamps_ns:
            return np.zeros((1, 3)), np.zeros(1)
        stamps_ns = np.array(self._stamps_ns, dtype=np.int64)
        return Rates(stamps_ns, np.array(self._omega_b), self._mean).at(stamps_ns[-1:])

    def to_imu(self, initial: InitialState) -> InitialState:
        """State of the IMU's point from that of base_link, at the newest sample."""
        return state_at(initial, self.lever_b, self.rate()[0][0])

    def to_base_link(self, initial: InitialState) -> InitialState:
        """State of base_link from that of the IMU's point, at the newest sample."""
        return state_at(initial, -self.lever_b, self.rate()[0][0])

    def moved(self, e: Estimate) -> Estimate:
        """Estimate of base_link from that of the IMU's point, at the newest sample."""
        rows = Rows.of(e.r_e[None], e.v_G[None], e.P[None])
        rows.move(self.lever_b, self._noise, self.rate(), e.gyro_bias_b[None], e.C_b_G[None])
        return replace(e, r_e=rows.r_e[0], v_G=rows.v_G[0], P=rows.P[0])


@dataclass(frozen=True)
class Rows:
    """Position, velocity and covariance of n estimates, to be moved in place.

    Attributes
    ----------
    r_e, v_G : (n, 3) arrays
        ECEF [m]; grid axes [m/s].
    P : (n, m, m) array
        Of `error_model.X`, at least up to the gyro bias.
    """

    r_e: Array
    v_G: Array
    P: Array

    @classmethod
    def of(cls, r_e: Array, v_G: Array, P: Array) -> Self:
        """Copy what is to be moved."""
        return cls(*(np.array(x, dtype=np.float64, order='C') for x in (r_e, v_G, P)))

    def move(
        self,
        lever_b: Array,
        gyro_noise_density: float,
        rate: tuple[Array, Array],
        gyro_bias_b: Array,
        C_b_G: Array,
    ) -> None:
        """Move from the IMU's point to base_link.

        Parameters
        ----------
        lever_b : (3,) array
            IMU from base_link [m].
        gyro_noise_density : float
            [rad/s/sqrt(Hz)]
        rate : tuple
            As measured (n, 3) [rad/s], and its noise (n,) (`Rates.at`).
        gyro_bias_b : (n, 3) array
            As estimated [rad/s].
        C_b_G : (n, 3, 3) array
        """
        move_to_base_link(
            np.ascontiguousarray(lever_b),
            gyro_noise_density,
            np.ascontiguousarray(rate[0]),
            np.ascontiguousarray(rate[1]),
            np.ascontiguousarray(gyro_bias_b),
            np.ascontiguousarray(C_b_G),
            self.v_G,
            self.r_e,
            self.P,
            np.empty((8, 3, 3)),
        )


def warm_up() -> None:
    """Compile or load the kernel used here."""
    zero, one = np.zeros((1, 3)), np.eye(3)[None]
    rows = Rows(np.array([[0.0, 0.0, 6356752.0]]), zero.copy(), np.zeros((1, 24, 24)))
    rows.move(zero[0], 0.0, (zero, np.ones(1)), zero, one)
