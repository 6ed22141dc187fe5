"""Gravity in the body of a vehicle under way, from a few seconds of IMU and DVL."""

from __future__ import annotations

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.attitude import exp
from polar_nav_ros.adapters.sensors import DvlRows

from .sources import Stamps

_FEWEST_PINGS = 2


def gravity_at_start(
    stamps_ns: Stamps,
    omega_ib_b: Array,
    f_b: Array,
    dvl: DvlRows | None,
    dvl_from_imu_b: Array,
) -> tuple[Array, bool]:
    """Mean specific force without the vehicle's own acceleration, in the body axes at the start.

    With ``C(t)`` from the body at t to the body at the start by the gyros, the mean of ``C f`` is
    the reaction to gravity plus ``(C v(T) - v(0)) / T`` of the IMU's point, which the DVL
    measures: ``v = v_dvl - omega x d``. What the earth turns is left out: some hundredths of a
    degree in some seconds.

    Parameters
    ----------
    stamps_ns, omega_ib_b, f_b : (n,), (n, 3), (n, 3) arrays
        IMU, body axes, all finite.
    dvl : DvlRows, optional
    dvl_from_imu_b : (3,) array
        d [m]

    Returns
    -------
    f_b : (3,) array
        [m/s^2]
    known : bool
        Whether the acceleration was taken off.
    """
    dt = np.diff(stamps_ns, prepend=stamps_ns[0]) * 1e-9
    steps = exp(omega_ib_b * dt[:, None])
    C = np.empty((len(stamps_ns), 3, 3))
    now = np.eye(3)
    for k, step in enumerate(steps):
        now = now @ step
        C[k] = now
    mean = np.einsum('nij,nj->ni', C, f_b).mean(axis=0)
    if dvl is None:
        return mean, False
    inside = dvl.valid & (dvl.stamps_ns >= stamps_ns[0]) & (dvl.stamps_ns <= stamps_ns[-1])
    pings = np.flatnonzero(inside)
    if len(pings) < _FEWEST_PINGS:
        return mean, False
    first, last = int(pings[0]), int(pings[-1])
    a, b = np.searchsorted(stamps_ns, dvl.stamps_ns[[first, last]])
    took = float(dvl.stamps_ns[last] - dvl.stamps_ns[first]) * 1e-9
    if took < 0.5 * float(stamps_ns[-1] - stamps_ns[0]) * 1e-9:
        return mean, False
    part = np.einsum('nij,nj->ni', C[a : b + 1], f_b[a : b + 1]).mean(axis=0)
    v_first, v_last = (
        dvl.velocity[ping] - np.cross(omega_ib_b[k], dvl_from_imu_b)
        for ping, k in ((first, a), (last, b))
    )
    return part - (C[b] @ v_last - C[a] @ v_first) / took, True
