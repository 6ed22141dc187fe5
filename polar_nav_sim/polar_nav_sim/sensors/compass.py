"""Heading of an AHRS: by a magnetometer in the Earth's field, or against true or grid north.

    m_b = (I + S) C_b_G^T B_G + h_b + noise        magnetometer, soft and hard iron
    u_b = C_b_G^T up + tilt x up                   vertical: coloured, and off in turns
    heading = atan2(m_b . (u x f), m_b . f),       f: the body's x axis less its vertical part

With another reference the field is a unit vector along it and the iron is left out. On top come a
constant error, a coloured one and white noise. In a turn the accelerometers feel v x rate, which
an AHRS that knows no speed takes for tilt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import magnetic
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.params import param

from ..section import Spec
from .noise import GaussMarkov

Floats = NDArray[np.float64]
GRAVITY = 9.83
"""[m/s^2]."""
REFERENCES = ('magnetic', 'true', 'grid')


@dataclass(frozen=True)
class CompassErrors(Spec):
    """Errors of a heading; defaults are a calibrated consumer AHRS."""

    bias_deg: float = param(0.0, 'deg', -180.0, 180.0, 'Constant error of the heading')
    coloured_deg: float = param(1.5, 'deg', 0.0, 90.0, '1-sigma of its coloured error')
    coloured_s: float = param(60.0, 's', 0.1, 1e5, 'Time constant of coloured errors')
    white_deg: float = param(0.3, 'deg', 0.0, 90.0, 'White noise of the heading, 1-sigma')
    tilt_deg: float = param(0.5, 'deg', 0.0, 45.0, '1-sigma of roll and pitch, coloured')
    hard_iron_nt: float = param(0.0, 'nT', 0.0, 1e5, 'Along x and y of the body')
    soft_iron: float = param(0.0, '', 0.0, 1.0, 'Of x against y of the body')
    noise_nt: float = param(100.0, 'nT', 0.0, 1e5, 'White noise of the magnetometer per axis')
    turn_factor: float = param(1.0, '', 0.0, 10.0, 'Tilt error per v x rate / g in a turn')


def measured_headings(
    errors: CompassErrors,
    reference: str,
    stamps_ns: NDArray[np.int64],
    r_e: Floats,
    C_e_G: Floats,
    C_b_G: Floats,
    v_G: Floats,
    rng: np.random.Generator,
) -> tuple[Floats, Floats]:
    """Headings [rad], clockwise from their reference, and verticals in body axes.

    Parameters
    ----------
    errors : CompassErrors
    reference : str
        One of `REFERENCES`.
    stamps_ns : (n,) array
        Evenly spaced.
    r_e, C_e_G, C_b_G, v_G : (n, 3), (n, 3, 3), (n, 3, 3), (n, 3) arrays
        True position, ECEF [m]; Earth to grid; body to grid; velocity, grid axes [m/s].
    rng : numpy.random.Generator

    Returns
    -------
    headings, up_b : (n,), (n, 3) arrays
    """
    n, deg = len(stamps_ns), math.pi / 180.0
    dt = float(stamps_ns[1] - stamps_ns[0]) * 1e-9 if n > 1 else 1.0
    sigma = np.array([errors.tilt_deg, errors.tilt_deg, errors.coloured_deg]) * deg
    slow = GaussMarkov(sigma, errors.coloured_s, dt, rng.standard_normal(3))
    coloured = slow.advance(rng.standard_normal((n, 3)))
    tilt_G = np.column_stack([coloured[:, :2], np.zeros(n)])
    tilt_G += errors.turn_factor * _by_turning(v_G, dt)
    up_G = np.cross(tilt_G, [0.0, 0.0, 1.0]) + np.array([0.0, 0.0, 1.0])
    up_b = np.einsum('nji,nj->ni', C_b_G, up_G)
    up_b /= np.linalg.norm(up_b, axis=1)[:, None]
    field_G = _field(reference, stamps_ns, r_e, C_e_G)
    m_b = np.einsum('nji,nj->ni', C_b_G, field_G)
    white = rng.standard_normal((n, 4))
    if reference == 'magnetic':
        x, y = m_b[:, 0].copy(), m_b[:, 1].copy()
        m_b[:, 0] += errors.soft_iron * y + errors.hard_iron_nt
        m_b[:, 1] += errors.soft_iron * x + errors.hard_iron_nt
        m_b += errors.noise_nt * white[:, :3]
    ahead = np.array([1.0, 0.0, 0.0]) - up_b[:, :1] * up_b
    left = np.cross(up_b, ahead)
    own = np.arctan2(np.sum(m_b * left, axis=1), np.sum(m_b * ahead, axis=1))
    own += errors.bias_deg * deg + coloured[:, 2] + errors.white_deg * deg * white[:, 3]
    return np.asarray(np.remainder(own + math.pi, 2.0 * math.pi) - math.pi), up_b


def _by_turning(v_G: Floats, dt: float) -> Floats:
    """Tilt (n, 3) that the acceleration of a vehicle is taken for, grid axes [rad]."""
    a_G = np.gradient(v_G, dt, axis=0) if len(v_G) > 1 else np.zeros_like(v_G)
    # The vertical leans along a / g: tilt x up = a / g.
    return np.column_stack([-a_G[:, 1], a_G[:, 0], np.zeros(len(a_G))]) / GRAVITY


def _field(reference: str, stamps_ns: NDArray[np.int64], r_e: Floats, C_e_G: Floats) -> Floats:
    """Reference of headings, grid axes (n, 3): the field [nT], or a unit vector along it."""
    if reference == 'grid':
        return np.tile([0.0, 1.0, 0.0], (len(r_e), 1))
    if reference == 'true':
        north = C_e_G[:, :, 2].copy()
        north[:, 2] = 0.0
        return np.asarray(north / np.linalg.norm(north, axis=1)[:, None])
    lat, lon, height = (float(x) for x in geodetic_from_ecef(r_e[0]))
    near = magnetic.field_near(lat, lon, height, magnetic.year_of(int(stamps_ns[0])))
    if near is None:
        raise ValueError('no magnetic model is of the date of the mission')
    field_e = near.field_e + (r_e - near.r_e) @ near.gradient_e.T
    return np.asarray(np.einsum('nij,nj->ni', C_e_G, field_e))
