"""An IMU that is not at base_link: its own point is navigated, and the estimates are moved back.

With l from base_link to the IMU, body axes, the two points are one rigid body:

    r_imu = r_base + C_b_e l        v_imu = v_base + C_b_G (omega_eb_b x l)

An accelerometer feels ``omega' x l + omega x (omega x l)`` more at l than at base_link. To take
that off, the gyros would have to be differentiated. At the IMU's own point nothing of the kind is
needed: its force is the right one there, every other lever arm is counted from there, and only the
start and the estimates are moved, as above. The grid axes at the two points differ by
``l / R`` (2e-7 rad for a metre), which is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from polar_nav_core.attitude import matrix_from_euler, skew
from polar_nav_core.earth import ecef_from_geodetic, geodetic_from_ecef
from polar_nav_core.engine.events import Array
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.track import Track
from polar_nav_core.error_model import X
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import earth_rate, ecef_to_grid
from polar_nav_follower.params import FollowerParams
from polar_nav_ros.adapters.arrays import finite_rows

from .sources import Stamps

_LEVERS = ('dvl_lever_b', 'depth_lever_b', 'transponder_lever_b')
_MOVED = slice(X.dv_G.start, X.dr_e.stop)
"""Rows of the error state that another point of the body changes: velocity and position."""
_FARTHEST = 100.0
"""Of any two sensors from each other [m], as of the parameters."""


@dataclass(frozen=True)
class Rates:
    """Angular rates at IMU stamps, as near as the samples tell.

    A mean belongs to the middle of its interval: between two of them the rate at the stamp is
    interpolated, ``(omega_k dt_k+1 + omega_k+1 dt_k) / (dt_k + dt_k+1)``. A value at the stamp is
    taken as it is.

    Attributes
    ----------
    stamps_ns : (n,) array
        Of the finite samples, increasing.
    omega_ib_b : (n, 3) array
        [rad/s]
    mean : bool
        Whether samples are means.
    """

    stamps_ns: Stamps
    omega_ib_b: Array
    mean: bool

    @classmethod
    def of(cls, inputs: Inputs, *, mean: bool) -> Self:
        """Take those of a run's inputs."""
        stamps_ns, omega = inputs.imu_stamps_ns, inputs.omega_ib_b
        good = finite_rows(omega) & finite_rows(inputs.f_b)
        good[1:] &= np.diff(stamps_ns) > 0
        if good.all():
            return cls(stamps_ns, omega, mean)
        return cls(stamps_ns[good], omega[good], mean)

    def at(self, stamps_ns: Stamps) -> tuple[Array, Array]:
        """Rates at stamps of samples [rad/s], and the noise in them.

        Returns
        -------
        omega_ib_b : (k, 3) array
            [rad/s]
        bandwidth : (k,) array
            Variance of the noise over its density squared [Hz].
        """
        known, last = self.stamps_ns, len(self.stamps_ns) - 1
        k = np.clip(np.searchsorted(known, stamps_ns), 0, last)
        before, after = np.maximum(k - 1, 0), np.minimum(k + 1, last)
        dt = (known[k] - known[before]) * 1e-9
        dt_next = (known[after] - known[k]) * 1e-9
        # Of the first sample the interval is not known: that of its neighbour is taken.
        dt = np.where(dt > 0.0, dt, np.where(dt_next > 0.0, dt_next, 1.0))
        ends = dt_next <= 0.0
        share = np.where(ends, 0.0, dt / (dt + np.where(ends, 0.0, dt_next)))
        if not self.mean:
            share = np.zeros_like(share)
        omega = (1.0 - share)[:, None] * self.omega_ib_b[k]
        omega += share[:, None] * self.omega_ib_b[after]
        bandwidth = (1.0 - share) ** 2 / dt + share**2 / np.where(ends, 1.0, dt_next)
        return omega, bandwidth


def from_imu(params: FollowerParams, lever_b: Array, omega_ib_b: Array) -> FollowerParams:
    """Parameters as the engine needs them when it navigates the IMU's point.

    Parameters
    ----------
    params : FollowerParams
        Lever arms and initial state from base_link.
    lever_b : (3,) array
        IMU from base_link [m].
    omega_ib_b : (3,) array
        Rate at the start [rad/s].

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
    lat, lon = np.radians([params.initial_latitude_deg, params.initial_longitude_deg])
    r_e = np.asarray(ecef_from_geodetic(lat, lon, params.initial_height))
    pitch, roll = np.radians([params.initial_pitch_deg, params.initial_roll_deg])
    psi = 0.5 * math.pi - math.radians(params.initial_grid_heading_deg)
    C_b_G = np.asarray(matrix_from_euler(psi, pitch, roll))
    omega_eb_b = omega_ib_b - C_b_G.T @ earth_rate(r_e)
    lat, lon, height = geodetic_from_ecef(r_e + ecef_to_grid(r_e).T @ C_b_G @ lever_b)
    v_G = np.asarray(params.initial_v_G) + C_b_G @ np.cross(omega_eb_b, lever_b)
    changes: dict[str, Any] = {n: tuple(float(v) for v in lever) for n, lever in levers.items()}
    changes |= {
        'initial_latitude_deg': math.degrees(float(lat)),
        'initial_longitude_deg': math.degrees(float(lon)),
        'initial_height': float(height),
        'initial_v_G': tuple(float(v) for v in v_G),
    }
    return replace(params, **changes)


def at_base_link(track: Track, lever_b: Array, rates: Rates, gyro_noise_density: float) -> Track:
    """Move estimates from the IMU's point to base_link, with their covariance.

    With ``L = C_b_G l`` and ``U = C_b_G (omega_eb_b x l)``, of estimate minus truth:

        dr_base = dr - C_G_e [L x] phi
        dv_base = dv - [U x] phi + [L x][omega_ie x] phi + C_b_G [l x] b_gyro + noise

    the last the white noise of the rate that was used.

    Parameters
    ----------
    track : Track
        As the engine gave it; it stays as it is.
    lever_b : (3,) array
        IMU from base_link [m].
    rates : Rates
        With the estimates' stamps among its own.
    gyro_noise_density : float
        [rad/s/sqrt(Hz)]
    """
    C_b_G, P = track.C_b_G, track.P.copy()
    C_G_e = np.swapaxes(ecef_to_grid(track.r_e), 1, 2)
    omega_ie_G = earth_rate(track.r_e)
    measured, bandwidth = rates.at(track.stamps_ns)
    omega_eb_b = measured - track.sensor_errors[:, 0:3]
    omega_eb_b -= np.einsum('nji,nj->ni', C_b_G, omega_ie_G)
    L_G = C_b_G @ lever_b
    U_G = np.einsum('nij,nj->ni', C_b_G, np.cross(omega_eb_b, lever_b))
    velocity, position = slice(0, 3), slice(3, 6)
    A = np.zeros((len(P), 6, 6))  # of phi and b_gyro on dv and dr
    A[:, velocity, 0:3] = skew(L_G) @ skew(omega_ie_G) - skew(U_G)
    A[:, position, 0:3] = -(C_G_e @ skew(L_G))
    A[:, velocity, 3:6] = C_b_G @ skew(lever_b)
    causes = np.r_[X.phi_G, X.b_gyro_b]
    P[:, _MOVED, :] += A @ P[:, causes, :]
    P[:, :, _MOVED] += P[:, :, causes] @ np.swapaxes(A, 1, 2)
    noise = (gyro_noise_density**2 * bandwidth)[:, None, None]
    P[:, X.dv_G, X.dv_G] += noise * (A[:, velocity, 3:6] @ np.swapaxes(A[:, velocity, 3:6], 1, 2))
    return replace(
        track,
        r_e=track.r_e - np.einsum('nij,nj->ni', C_G_e, L_G),
        v_G=track.v_G - U_G,
        P=P,
    )
