"""State and covariance that a filter begins with: as stated, or of a filter that was lost.

One that was saved is continued by `resume`.
"""

from __future__ import annotations

import math

import numpy as np

from ... import attitude, earth, grid
from ...arrays import Array
from ...error_model import X
from ...kernels.limits import EARTH
from ...kernels.sins import compass
from ...kernels.sins import fuse as ff
from ...kernels.sins import state as fs
from ...kernels.sins import update as kf
from ...kernels.sins.settings import Settings
from ..events import InitialState
from ..params import EngineParams
from ..plausibility import MOST_VARIANCE
from . import aiding

_ENLARGED = 4.0
"""Factor on the variances of a state that is restored."""
_LOST_RATE, _LOST_ACCELERATION = 0.1, 0.5
"""What the vehicle may have done since [rad/s], [m/s^2], as in a gap between IMU samples."""


def set_out(own: fs.State, c: Settings, p: EngineParams, s: InitialState) -> None:
    """Fill the state with a stated start, its sigmas and those of the sensors."""
    own.r_e[:] = earth.ecef_from_geodetic(s.latitude, s.longitude, s.height)
    own.v_G[:] = s.v_G
    psi = 0.5 * math.pi - s.grid_heading
    own.C_b_G[:] = attitude.matrix_from_euler(psi, s.pitch, s.roll)
    sigma = np.concatenate(
        [
            [s.sigma_tilt, s.sigma_tilt, s.sigma_heading],
            np.full(3, s.sigma_velocity),
            np.zeros(3),
            np.full(3, p.gyro_bias_sigma),
            np.full(3, p.accel_bias_sigma),
            np.full(3, p.dvl_scale_sigma),
            np.full(3, p.dvl_markov_sigma),
            np.full(3, 1.0 if c.shares_leader else p.usbl_bias_sigma),
        ]
    )
    if c.heading.on:
        sigma[kf.USBL :] = heading_sigmas(c)
    own.P[:] = np.diag(sigma**2)
    C_e_G = grid.ecef_to_grid(own.r_e)
    position_G = np.diag([s.sigma_position_horizontal**2] * 2 + [s.sigma_position_vertical**2])
    own.P[X.dr_e, X.dr_e] = C_e_G.T @ position_G @ C_e_G
    aiding.start(own, p)


def heading_sigmas(c: Settings) -> Array:
    """Sigmas at the start of the last three states where headings are used [rad], (3,)."""
    coloured = math.sqrt(c.heading.noise[compass.MARKOV_VARIANCE])
    bias = c.heading.noise[compass.START]
    return np.array([bias, coloured, bias])


def restore(s: fs.State, frames: fs.Frames, c: Settings, good: Array, since_s: float) -> None:
    """Fill the state with the newest sound one of a filter that was lost, moved on and enlarged.

    Correlations are dropped: they may be what was lost.

    Parameters
    ----------
    s, frames, c : State, Frames, Settings
        Of the filter that begins.
    good : (n,) array
        The sound state and its vehicle's model, flat, as a log keeps it.
    since_s : float
        Its age [s].
    """
    s.flat[:] = good[: fs.FLAT]
    s.model[:] = good[fs.FLAT :].reshape(s.model.shape)
    s.P[:] = np.diag(np.minimum(_ENLARGED * np.diagonal(s.P), MOST_VARIANCE))
    if c.aiding.on:
        block = s.model[fs.P_EE : fs.MEAN]
        block[:] = np.diag(_ENLARGED * np.diagonal(block))
        s.model[fs.P_XE : fs.P_EE] = 0.0
        s.model[fs.THRUST] = 0.0
    for x in (
        s.sensitivity,
        s.memories,
        s.shared,
        s.bank,
        s.windows,
        s.conflict,
        s.runs,
        s.heading_memories,
        s.increments,
        s.sums,
        s.previous,
        s.previous_dt,
    ):
        x[:] = 0.0
    s.P[X.phi_G, X.phi_G] += np.eye(3) * (_LOST_RATE * since_s) ** 2
    s.P[X.dv_G, X.dv_G] += np.eye(3) * (_LOST_ACCELERATION * since_s) ** 2
    ff.locate(s, frames, c)
    moved_e = s.r_e + frames.velocity_e * since_s
    speed = float(np.linalg.norm(s.v_G))
    if EARTH[0] < float(np.linalg.norm(moved_e)) < EARTH[1]:
        s.r_e[:] = moved_e
    else:  # with this velocity it would be lost again at once
        s.v_G[:] = 0.0
        ff.locate(s, frames, c)
        speed = c.max_speed
        s.P[X.dv_G, X.dv_G] += np.eye(3) * speed**2
    s.P[X.dr_e, X.dr_e] += np.eye(3) * ((speed + _LOST_ACCELERATION) * since_s) ** 2
