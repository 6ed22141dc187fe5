"""Initial state of a follower as parameters: truth plus errors drawn from its sigmas.

The follower never reads truth. In a real mission its first state comes from a GNSS fix and an
alignment; the demo stands in for those, so this is the one place between truth and the follower's
parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from polar_nav_core import attitude, earth

from .trajectory import TruthState


@dataclass(frozen=True)
class InitialSigma:
    """1-sigma of the initial state, the parameters ``initial_sigma_*`` of follower_node.

    Attributes
    ----------
    position, height : float
        Per horizontal axis and along up [m].
    velocity : float
        Per axis [m/s].
    tilt_deg, heading_deg : float
        Of phi_G about the horizontal axes and about up [deg].
    """

    position: float
    height: float
    velocity: float
    tilt_deg: float
    heading_deg: float


def initial_parameters(
    truth: TruthState, sigma: InitialSigma, rng: np.random.Generator
) -> dict[str, float | list[float]]:
    """Parameters ``initial_*`` of a follower_node that starts at ``truth`` plus drawn errors.

    The errors have the signs of the filter: ``Chat = exp(-[phi_G x]) C``, ``vhat = v + dv``,
    ``rhat = r + dr``. They are drawn in the order position, velocity, attitude, three numbers
    each, so that another sigma changes no other draw.

    Parameters
    ----------
    truth : TruthState
        True state at the stamp of the first IMU sample.
    sigma : InitialSigma
        1-sigma of the drawn errors, stated in the parameters.
    rng : numpy.random.Generator
        The stream of this follower's initial state.
    """
    unit = rng.standard_normal((3, 3))
    dr_G = unit[0] * [sigma.position, sigma.position, sigma.height]
    dv_G = unit[1] * sigma.velocity
    phi_G = unit[2] * np.radians([sigma.tilt_deg, sigma.tilt_deg, sigma.heading_deg])
    r_e = truth.r_e + truth.C_e_G.T @ dr_G
    latitude, longitude, height = (float(x) for x in earth.geodetic_from_ecef(r_e))
    C_b_G = attitude.exp(-phi_G) @ truth.C_b_G
    psi, pitch, roll = (float(x) for x in attitude.euler_from_matrix(C_b_G))
    return {
        'initial_latitude_deg': math.degrees(latitude),
        'initial_longitude_deg': math.degrees(longitude),
        'initial_height': height,
        'initial_v_G': [float(x) for x in truth.v_G + dv_G],
        'initial_roll_deg': math.degrees(roll),
        'initial_pitch_deg': math.degrees(pitch),
        'initial_grid_heading_deg': math.degrees(math.remainder(0.5 * math.pi - psi, math.tau)),
        'initial_sigma_position': sigma.position,
        'initial_sigma_height': sigma.height,
        'initial_sigma_velocity': sigma.velocity,
        'initial_sigma_tilt_deg': sigma.tilt_deg,
        'initial_sigma_heading_deg': sigma.heading_deg,
    }
