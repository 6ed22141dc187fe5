"""Heading of an AHRS: by a magnetometer in the Earth's field, or against true or grid north.

    m_b = (I + S) C_b_G^T B_G + h_b + d_b + noise  magnetometer, soft and hard iron, disturbance
    u_b = C_b_G^T up + tilt x up                   vertical: coloured, and off in turns
    heading = atan2(m_b . (u x f), m_b . f),       f: the body's x axis less its vertical part

With another reference the field is a unit vector along it and the iron is left out. On top come a
constant error, one that drifts, a coloured one and white noise. In a turn the accelerometers feel
v x rate, which an AHRS that knows no speed takes for tilt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import magnetic
from polar_nav_core.attitude import matrix_from_euler
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.params import param

from ..randomness import substream
from ..section import Spec
from .noise import CHUNK, Draws, GaussMarkov, Index

Floats = NDArray[np.float64]
GRAVITY = 9.83
"""[m/s^2]."""
REFERENCES = ('magnetic', 'true', 'grid')
_FAR = 2e4
"""From where the field is looked up again [m]."""


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
    drift_deg: float = param(0.0, 'deg', 0.0, 90.0, '1-sigma of an error that varies slowly')
    drift_s: float = param(3600.0, 's', 0.1, 1e6, 'Its time constant')
    disturbance_nt: float = param(
        0.0, 'nT', 0.0, 1e6, 'Field of something magnetic nearby, along y of the body'
    )
    disturbance_first_s: float = param(
        0.0, 's', 0.0, 1e6, 'When that begins, since the first sample'
    )
    disturbance_s: float = param(60.0, 's', 0.0, 1e6, 'How long it lasts')

    @property
    def heading_sigma_deg(self) -> float:
        """1-sigma of what varies in the heading."""
        return math.hypot(self.coloured_deg, self.drift_deg, self.white_deg)


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
    field_G = _field(reference, stamps_ns, r_e, C_e_G)
    white = rng.standard_normal((n, 4))
    slowly = coloured[:, 2]
    if errors.drift_deg > 0.0:
        drift = GaussMarkov(
            np.array([errors.drift_deg * deg]), errors.drift_s, dt, rng.standard_normal(1)
        )
        slowly = slowly + drift.advance(rng.standard_normal((n, 1)))[:, 0]
    since_s = np.asarray((stamps_ns - stamps_ns[:1]) * 1e-9, dtype=np.float64)
    headings, up_b, _ = _readings(
        errors, reference, since_s, field_G, C_b_G, tilt_G, slowly, white
    )
    return headings, up_b


def _readings(
    errors: CompassErrors,
    reference: str,
    since_s: Floats,
    field_G: Floats,
    C_b_G: Floats,
    tilt_G: Floats,
    slowly: Floats,
    white: Floats,
) -> tuple[Floats, Floats, Floats]:
    """Headings (n,), verticals and magnetometer (n, 3) of samples, by their errors.

    Parameters
    ----------
    errors, reference : CompassErrors, str
    since_s : (n,) array
        Since the first sample [s].
    field_G, C_b_G, tilt_G : (n, 3), (n, 3, 3), (n, 3) arrays
        Reference, attitude, error of the vertical [rad].
    slowly : (n,) array
        Error of the heading that lasts [rad].
    white : (n, 4) array
        Standard normal: magnetometer and heading.
    """
    deg = math.pi / 180.0
    up_G = np.cross(tilt_G, [0.0, 0.0, 1.0]) + np.array([0.0, 0.0, 1.0])
    up_b = np.einsum('nji,nj->ni', C_b_G, up_G)
    up_b /= np.linalg.norm(up_b, axis=1)[:, None]
    m_b = np.einsum('nji,nj->ni', C_b_G, field_G)
    if reference == 'magnetic':
        x, y = m_b[:, 0].copy(), m_b[:, 1].copy()
        m_b[:, 0] += errors.soft_iron * y + errors.hard_iron_nt
        m_b[:, 1] += errors.soft_iron * x + errors.hard_iron_nt
        near = (since_s >= errors.disturbance_first_s) & (
            since_s < errors.disturbance_first_s + errors.disturbance_s
        )
        m_b[near, 1] += errors.disturbance_nt
        m_b += errors.noise_nt * white[:, :3]
    ahead = np.array([1.0, 0.0, 0.0]) - up_b[:, :1] * up_b
    left = np.cross(up_b, ahead)
    own = np.arctan2(np.sum(m_b * left, axis=1), np.sum(m_b * ahead, axis=1))
    own += errors.bias_deg * deg + slowly + errors.white_deg * deg * white[:, 3]
    return np.asarray(np.remainder(own + math.pi, 2.0 * math.pi) - math.pi), up_b, m_b


class CompassReading(NamedTuple):
    """One sample: heading [rad], clockwise from its reference; vertical; magnetometer [nT]."""

    heading: float
    up_b: Floats
    field_b: Floats

    def attitude(self) -> Floats:
        """C_b_n (3, 3) of heading and vertical; n is east and north of the reference, and up."""
        x, y, z = (float(v) for v in self.up_b)
        pitch, roll = math.atan2(-x, math.hypot(y, z)), math.atan2(y, z)
        return np.asarray(matrix_from_euler(0.5 * math.pi - self.heading, pitch, roll))


class CompassSensor:
    """One AHRS with a magnetometer, sample by sample.

    Parameters
    ----------
    errors : CompassErrors
    reference : str
        One of `REFERENCES`.
    period_s : float
        Between samples [s].
    rng : numpy.random.Generator
        Its own stream.
    """

    def __init__(
        self, errors: CompassErrors, reference: str, period_s: float, rng: np.random.Generator
    ) -> None:
        deg = math.pi / 180.0
        self._e, self._reference, self._period_s = errors, reference, period_s
        sigma = np.array([errors.tilt_deg, errors.tilt_deg, errors.coloured_deg]) * deg
        coloured, drift = substream(rng, 'coloured'), substream(rng, 'drift')
        self._coloured = GaussMarkov(
            sigma, errors.coloured_s, period_s, coloured.standard_normal(3)
        )
        self._drift = GaussMarkov(
            np.array([errors.drift_deg * deg]), errors.drift_s, period_s, drift.standard_normal(1)
        )
        self._white = Draws(rng, 4)
        self._coloured_draws, self._drift_draws = Draws(coloured, 3), Draws(drift, 1)
        self._slow, self._slower = np.empty((0, 3)), np.empty((0, 1))
        self._index = Index()
        self._first_ns: int | None = None
        self._before: tuple[int, Floats] | None = None
        self._near: tuple[Floats, magnetic.Field] | None = None

    def measure(
        self, k: int, stamp_ns: int, r_e: Floats, C_b_G: Floats, v_G: Floats
    ) -> CompassReading:
        """Measurement of sample number k.

        Parameters
        ----------
        k : int
            Numbers never go back; skipped ones are skipped in the noise.
        stamp_ns : int
            Of the truth.
        r_e, C_b_G, v_G : (3,), (3, 3), (3,) arrays
            True position, ECEF [m]; body to grid; velocity, grid axes [m/s].
        """
        self._index.take(k, 1)
        chunk, row = divmod(k, CHUNK)
        while self._white.chunk < chunk:
            self._white.advance()
            self._slow = self._coloured.advance(self._coloured_draws.advance())
            self._slower = self._drift.advance(self._drift_draws.advance())
        if self._first_ns is None:
            self._first_ns = stamp_ns
        tilt_G = np.array([[self._slow[row, 0], self._slow[row, 1], 0.0]])
        tilt_G += self._e.turn_factor * self._turning(stamp_ns, v_G)
        C_e_G = np.asarray(ecef_to_grid(r_e))
        headings, up_b, m_b = _readings(
            self._e,
            self._reference,
            np.array([(stamp_ns - self._first_ns) * 1e-9]),
            self._field_at(stamp_ns, r_e, C_e_G),
            C_b_G[None],
            tilt_G,
            self._slow[row : row + 1, 2] + self._slower[row],
            self._white.rows[row : row + 1],
        )
        return CompassReading(float(headings[0]), up_b[0], m_b[0])

    def _turning(self, stamp_ns: int, v_G: Floats) -> Floats:
        """Tilt (1, 3) that the acceleration since the sample before is taken for [rad]."""
        before, self._before = self._before, (stamp_ns, v_G.copy())
        if before is None:
            return np.zeros((1, 3))
        return _tilt_of((v_G - before[1])[None] / ((stamp_ns - before[0]) * 1e-9))

    def _field_at(self, stamp_ns: int, r_e: Floats, C_e_G: Floats) -> Floats:
        """Reference of headings, grid axes (1, 3)."""
        if self._reference != 'magnetic':
            return _field(self._reference, np.array([stamp_ns]), r_e[None], C_e_G[None])
        if self._near is None or np.linalg.norm(r_e - self._near[0]) > _FAR:
            self._near = r_e.copy(), _field_near(stamp_ns, r_e)
        return _field_of(self._near[1], r_e[None], C_e_G[None])


def _by_turning(v_G: Floats, dt: float) -> Floats:
    """Tilt (n, 3) that the acceleration of a vehicle is taken for, grid axes [rad]."""
    return _tilt_of(np.gradient(v_G, dt, axis=0) if len(v_G) > 1 else np.zeros_like(v_G))


def _tilt_of(a_G: Floats) -> Floats:
    """Tilt (n, 3) that accelerations (n, 3) [m/s^2] are taken for, grid axes [rad]."""
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
    return _field_of(_field_near(int(stamps_ns[0]), r_e[0]), r_e, C_e_G)


def _field_near(stamp_ns: int, r_e: Floats) -> magnetic.Field:
    """Magnetic field around a place (3,) at a time."""
    lat, lon, height = (float(x) for x in geodetic_from_ecef(r_e))
    near = magnetic.field_near(lat, lon, height, magnetic.year_of(stamp_ns))
    if near is None:
        raise ConfigError('no magnetic model is of the date of the mission')
    return near


def _field_of(near: magnetic.Field, r_e: Floats, C_e_G: Floats) -> Floats:
    """Field at places (n, 3), grid axes [nT]."""
    field_e = near.field_e + (r_e - near.r_e) @ near.gradient_e.T
    return np.asarray(np.einsum('nij,nj->ni', C_e_G, field_e))
