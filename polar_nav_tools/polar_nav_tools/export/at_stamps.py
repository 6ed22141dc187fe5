"""A trajectory at other times than its own: those of a camera, a sonar, a sampler."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.errors import ConfigError

from ..series.vehicle import Ints
from .formats import Trajectory


def at_stamps(track: Trajectory, stamps_ns: Ints) -> Trajectory:
    """Trajectory at given times; times outside it are left out and counted.

    Between two poses the position is the cubic through places and velocities of both, the attitude
    turns at a constant rate, and sigmas are linear.

    Parameters
    ----------
    track : Trajectory
        Of stamps that grow.
    stamps_ns : (n,) array
        In any order; they are sorted [ns].

    Raises
    ------
    ConfigError
        Where none of the times is within the trajectory.
    """
    wanted = np.sort(stamps_ns)
    inside = wanted[(wanted >= track.stamp_ns[0]) & (wanted <= track.stamp_ns[-1])]
    if len(track) < 2 or not len(inside):
        raise ConfigError('none of the times is within the trajectory')
    start_ns = track.stamp_ns[0]
    own_s, t = (track.stamp_ns - start_ns) * 1e-9, (inside - start_ns) * 1e-9
    path = CubicHermiteSpline(own_s, track.r_e, track.v_e)
    sigma = track.sigma_G
    if sigma is not None:
        sigma = np.column_stack([np.interp(t, own_s, sigma[:, k]) for k in range(3)])
    r_e = path(t)
    latitude, longitude, height = geodetic_from_ecef(r_e)
    return replace(
        track,
        stamp_ns=inside,
        r_e=r_e,
        C_b_e=Slerp(own_s, Rotation.from_matrix(track.C_b_e))(t).as_matrix(),
        v_e=path(t, 1),
        sigma_G=sigma,
        latitude=latitude,
        longitude=longitude,
        height=height,
        left_out=len(wanted) - len(inside),
    )
