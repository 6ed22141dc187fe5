"""Content of a packet from a reading of the array and the leader's states.

The fix is the follower's transponder at t3, seen from the leader's pose at t4:
p_F(t3) = p_L(t4) + C_b_G(t4) (lever + C_a_b p_a), in the leader's grid axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import attitude, earth, usbl
from polar_nav_core.link.packet import Broadcast

from .params import LeaderParams
from .states import LeaderState

Array = NDArray[np.float64]


class Unusable(ValueError):
    """A reading without a fix; the text is the reason."""


@dataclass(frozen=True)
class ArrayMeasurement:
    """Reading of polar_nav_msgs/UsblFix in SI units.

    Attributes
    ----------
    ping_ns, validity_ns, return_ns : int
        t1, t3 by the instrument, t4.
    turn_around, round_trip : float
        t3 - t2 and t4 - t1 [s].
    range_variance : float
        [m^2]
    direction_a : (3,) array
        Unit vector at t4, array axes.
    cosine_covariance : (2, 2) array
        Of its x and y components.
    target_depth, target_depth_variance : float
        Depth sent by the transponder [m], [m^2]; NaN: none.
    """

    target: str
    sequence: int
    ping_ns: int
    validity_ns: int
    return_ns: int
    turn_around: float
    round_trip: float
    range_variance: float
    direction_a: Array
    cosine_covariance: Array
    sound_speed: float
    target_depth: float
    target_depth_variance: float


@dataclass(frozen=True)
class Mounting:
    """Mounting of the array on the leader: lever arm [m] and C_a_b."""

    lever_b: Array
    C_a_b: Array

    @classmethod
    def of(cls, lever_b: tuple[float, ...], rpy_deg: tuple[float, ...]) -> Mounting:
        """Mounting with a lever arm [m] and roll, pitch, yaw in degrees."""
        roll, pitch, yaw = (math.radians(a) for a in rpy_deg)
        return cls(
            np.array(lever_b, dtype=np.float64), attitude.matrix_from_euler(yaw, pitch, roll)
        )


def make_broadcast(
    m: ArrayMeasurement,
    at_ping: LeaderState,
    at_return: LeaderState,
    mounting: Mounting,
    params: LeaderParams,
) -> Broadcast:
    """Content of a packet, from a reading and the leader's own states.

    Parameters
    ----------
    m : ArrayMeasurement
        Reading of the array.
    at_ping, at_return : LeaderState
        The leader at t1 and t4.
    mounting : Mounting
        Of the array.
    params : LeaderParams
        Identities and the height of the sea surface.

    Raises
    ------
    Unusable
        If the numbers fit no geometry.
    """
    C_e_G = at_return.C_e_G
    C_b_G = C_e_G @ at_return.C_b_e
    C_a_e = at_return.C_b_e @ mounting.C_a_b
    moved_e = _array_position(at_return, mounting) - _array_position(at_ping, mounting)
    if params.formation:
        # Hearing and replying are a turn-around apart, in which the transponder moves, too.
        moved_e = moved_e - at_return.v_e * m.turn_around
    half_path = 0.5 * m.sound_speed * (m.round_trip - m.turn_around)
    try:
        distance = usbl.range_at_reply(
            half_path, m.range_variance, m.direction_a, C_a_e.T @ moved_e
        )
        relative_a = usbl.relative_in_array(
            m.direction_a,
            m.cosine_covariance,
            distance.distance,
            distance.variance,
            *_height_difference(m, at_return, mounting, C_b_G, C_e_G, params),
        )
    except (ValueError, np.linalg.LinAlgError) as error:
        raise Unusable(f'fix {m.sequence} of {m.target}: {error}') from error
    P_phi_G = C_e_G @ at_return.P_phi_e @ C_e_G.T
    relative_G = usbl.relative_in_grid(
        relative_a, mounting.C_a_b, mounting.lever_b, C_b_G, P_phi_G
    )
    sigma_horizontal, sigma_vertical = position_sigmas(C_e_G @ at_return.P_r_e @ C_e_G.T)
    return Broadcast(
        source=params.own_id,
        target=params.follower_id,
        sequence=m.sequence % 65536,
        # The instrument dates the reply by half the round trip; the leader's motion corrects it.
        validity_ns=m.return_ns - round(distance.distance / m.sound_speed * 1e9),
        return_ns=m.return_ns,
        leader_r_e=at_return.r_e,
        leader_sigma_horizontal=sigma_horizontal,
        leader_sigma_vertical=sigma_vertical,
        leader_v_G=C_e_G @ at_return.v_e,
        leader_sigma_velocity=math.sqrt(_largest(at_return.P_v_e)),
        leader_grid_heading=math.remainder(float(attitude.grid_heading(C_b_G)), 2 * math.pi),
        leader_sigma_heading=math.sqrt(max(float(P_phi_G[2, 2]), 0.0)),
        r_lf_G=relative_G.vector,
        r_lf_covariance_G=relative_G.covariance,
        sound_speed=m.sound_speed,
    )


def position_sigmas(P_G: Array) -> tuple[float, float]:
    """1-sigma per horizontal axis and along up that cover a covariance of position.

    The packet has room for two numbers. They are chosen so that diag(h^2, h^2, v^2) - P is
    positive semi-definite: the horizontal one is the ellipse's long half axis, and a correlation
    rho between horizontal and vertical enlarges both variances by 1 + rho.

    Parameters
    ----------
    P_G : ndarray, shape (3, 3)
        Covariance of the leader's position, its grid axes [m^2].

    Returns
    -------
    horizontal, vertical : float
        [m]
    """
    horizontal, vertical = _largest(P_G[:2, :2]), max(float(P_G[2, 2]), 0.0)
    grow = 1.0
    if horizontal > 0.0 and vertical > 0.0:
        cross = P_G[:2, 2]
        explained = float(cross @ np.linalg.pinv(P_G[:2, :2], hermitian=True) @ cross)
        grow += math.sqrt(min(max(explained / vertical, 0.0), 1.0))
    return math.sqrt(horizontal * grow), math.sqrt(vertical * grow)


def _largest(P: Array) -> float:
    """Largest eigenvalue of a covariance; NaN for one that is not finite."""
    if not np.isfinite(P).all():
        return math.nan
    return max(float(np.linalg.eigvalsh(0.5 * (P + P.T))[-1]), 0.0)


def _array_position(state: LeaderState, mounting: Mounting) -> Array:
    return np.asarray(state.r_e + state.C_b_e @ mounting.lever_b)


def _height_difference(
    m: ArrayMeasurement,
    state: LeaderState,
    mounting: Mounting,
    C_b_G: Array,
    C_e_G: Array,
    params: LeaderParams,
) -> tuple[Array, float, float] | tuple[()]:
    """Up in array axes, height of the transponder above the array, its variance.

    NaN without a depth. Along the up direction of the array: the Earth's curvature
    (r^2/2R, 0.1 m at 1 km) is removed.

    The variance holds that of the leader's height, as it must for the least squares. The follower
    adds the leader's vertical sigma to it, although in the sum the leader's height cancels: the
    fix's vertical sigma is too large by that much, on the safe side.
    """
    if not (math.isfinite(m.target_depth) and m.target_depth_variance > 0.0):
        return ()
    C_a_G = C_b_G @ mounting.C_a_b
    height = float(earth.geodetic_from_ecef(_array_position(state, mounting))[2])
    rise = params.sea_surface_height - m.target_depth - height
    r = 0.5 * m.sound_speed * (m.round_trip - m.turn_around)
    horizontal2 = max(r * r - rise * rise, 0.0)
    drop = horizontal2 / (2.0 * float(np.linalg.norm(state.r_e)))
    variance = m.target_depth_variance + float((C_e_G @ state.P_r_e @ C_e_G.T)[2, 2])
    return C_a_G[2], rise - drop, variance
