"""A Kalman filter of three states on a DVL's dead reckoning, for late fixes: what it is up to us.

North, east, and what the AHRS' heading is off by. A fix counts for a time before its arrival, the
same for all: the filter goes back to its state of then, takes the fix and goes forward again,
which is exact. Fixes beyond a gate are refused; if they have all been for a while, the filter
starts again at one. Nothing of this project is imported, as in `vehicle`.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation, Slerp

from . import vehicle
from .vehicle import Floats


@dataclass(frozen=True)
class Tuning:
    """Numbers of the filter, found once: least pooled RMS over seeds 1 to 5, 1200 s each.

    A search along one number after the other, twice, over grids of four to eight values; 2.02 m.

    Attributes
    ----------
    fix_sigma : float
        1-sigma per axis that is taken for white [m].
    drift : float
        Random walk of position per axis [m/sqrt(s)].
    heading_sigma, heading_walk : float
        1-sigma of the AHRS' heading at the start [rad], its random walk [rad/sqrt(s)].
    lag_s : float
        Age of every fix [s].
    gate : float
        Largest distance of a fix from where it is expected, in sigmas.
    again_s : float
        Time after which refused fixes are believed [s].
    """

    fix_sigma: float = 4.0
    drift: float = 0.02
    heading_sigma: float = 0.03
    heading_walk: float = 0.0002
    lag_s: float = 1.25
    gate: float = 3.0
    again_s: float = 30.0


class Track(NamedTuple):
    """Positions at the pings, north and east [m], and whether each fix was refused."""

    time_s: Floats
    position_n: Floats
    refused: np.ndarray


def dead_reckoned(imu: vehicle.Imu, dvl: vehicle.Dvl) -> tuple[Floats, Floats]:
    """Times [s] and horizontal velocities [m/s] up to each by the DVL and the AHRS.

    A velocity is the mean of this ping's and the one's before; a lost ping repeats the last.
    """
    attitude = Slerp(imu.time_s, Rotation.from_quat(imu.quaternion_xyzw))
    C_b_enu = attitude(np.clip(dvl.time_s, imu.time_s[0], imu.time_s[-1]))
    enu = C_b_enu.apply(dvl.velocity_b @ vehicle.FLU_OF_FRD)
    good = np.maximum.accumulate(np.where(dvl.valid, np.arange(len(dvl.valid)), 0))
    v = enu[good][:, [1, 0]]
    return dvl.time_s, 0.5 * (v + v[np.maximum(np.arange(len(v)) - 1, 0)])


def run(imu: vehicle.Imu, dvl: vehicle.Dvl, fixes: vehicle.Fixes, tuning: Tuning) -> Track:
    """Estimates at each ping from what had arrived by then; it starts at the first fix."""
    t, v = dead_reckoned(imu, dvl)
    found = vehicle.level_of(np.radians(fixes.latitude_deg), np.radians(fixes.longitude_deg))
    position, refused = _filtered(t, v, fixes.time_s, found, np.array(astuple(tuning)))
    return Track(t, position, refused)


@njit
def _forward(x, p, v, dt, noise):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    F = np.eye(3)
    F[0, 2], F[1, 2] = -v[1] * dt, v[0] * dt
    out = x.copy()
    out[0] += (v[0] - x[2] * v[1]) * dt
    out[1] += (v[1] + x[2] * v[0]) * dt
    return out, F @ p @ F.T + np.diag(noise * dt)


@njit
def _filtered(t, v, arrivals, found, numbers):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    fix_sigma, drift, heading_sigma, heading_walk, lag_s, gate, again_s = numbers
    n = len(t)
    X, P, published = np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 2))
    refused = np.zeros(len(arrivals), dtype=np.bool_)
    R = fix_sigma**2 * np.eye(2)
    noise = np.array([drift**2, drift**2, heading_walk**2])
    first = np.diag(np.array([fix_sigma**2, fix_sigma**2, heading_sigma**2]))
    X[0, :2], P[0] = found[0], first
    arrived, believed_s = 1, arrivals[0]
    for k in range(n):
        if k:
            X[k], P[k] = _forward(X[k - 1], P[k - 1], v[k], t[k] - t[k - 1], noise)
        while arrived < len(found) and arrivals[arrived] <= t[k]:
            i = min(k, np.searchsorted(t, arrivals[arrived] - lag_s))
            z = found[arrived] - X[i, :2]
            S = P[i][:2, :2] + R
            refused[arrived] = z @ np.linalg.solve(S, z) > gate**2
            if not refused[arrived]:
                K = np.ascontiguousarray(np.linalg.solve(S, P[i][:2]).T)
                X[i] += K @ z
                P[i] = P[i] - K @ P[i][:2]
                believed_s = arrivals[arrived]
            elif arrivals[arrived] - believed_s > again_s:
                X[i, :2] = found[arrived]
                P[i] = first
                believed_s = arrivals[arrived]
            for j in range(i + 1, k + 1):
                X[j], P[j] = _forward(X[j - 1], P[j - 1], v[j], t[j] - t[j - 1], noise)
            arrived += 1
        # Published is what was known at this ping; going back changes no row before it.
        published[k] = X[k, :2]
    return published, refused
