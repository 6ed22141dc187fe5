"""Knots of a path: positions and reference angles that the truth's splines pass through.

Positions are kept relative to a place on the path, so that rounding stays near 1e-11 m where ECEF
coordinates themselves are rounded to 1e-9 m. Nothing here uses longitude or divides by
cos(latitude).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import earth, grid
from polar_nav_core.errors import ConfigError

from .. import splines
from ..specs import PathSpec, TrackSpec, VehicleSpec
from .profile import Profile
from .recorded import RecordedPath
from .track import TrackPath

Floats = NDArray[np.float64]

SPACING_S = 0.5
"""Time between knots: turns of 0.1 rad/s are reproduced to micrometres, straight lines exactly."""
MARGIN = 16
"""Knots before the start and after the end, which keep the spline's end conditions away."""
DEGREE = 5
_LARGEST_TURN = math.radians(5.0)
"""Fastest turn that knots half a second apart are asked to follow [rad/s]."""
_PICARD_M = 1e-10
_PICARD_TURNS = 40


@dataclass(frozen=True)
class Knots:
    """Knots of the splines of one vehicle.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
        Time since the start of the mission [s].
    origin_e : ndarray, shape (3,)
        Origin of the positions, ECEF [m].
    d_e : ndarray, shape (n, 3)
        Position minus origin, ECEF axes [m].
    angles : ndarray, shape (n, 3)
        Reference psi, theta, phi of C_b_G = Rz(psi) Ry(theta) Rx(phi) [rad], continuous.
    """

    t_s: Floats
    origin_e: Floats
    d_e: Floats
    angles: Floats


def knot_times(duration_s: float) -> Floats:
    """Knot times from :data:`MARGIN` knots before the start to as many after the end [s]."""
    count = math.ceil(duration_s / SPACING_S)
    return SPACING_S * np.arange(-MARGIN, count + MARGIN + 1, dtype=np.float64)


def initial_psi(spec: PathSpec) -> float:
    """Angle of the initial course, counter-clockwise from grid east [rad]."""
    heading = math.radians(spec.course_deg)
    if spec.course_north == 'true':
        lat, lon = math.radians(spec.latitude_deg), math.radians(spec.longitude_deg)
        heading -= float(grid.convergence(lat, lon))
    return math.remainder(0.5 * math.pi - heading, 2.0 * math.pi)


def start_position(
    spec: PathSpec, vehicle: VehicleSpec, psi: float, sea_surface_height: float
) -> Floats:
    """Start of one vehicle: the path's start, moved by its offset, at its depth, ECEF [m]."""
    lat, lon = math.radians(spec.latitude_deg), math.radians(spec.longitude_deg)
    height = sea_surface_height - vehicle.depth_m
    r_e = np.asarray(earth.ecef_from_geodetic(lat, lon, height))
    return np.asarray(_displace(r_e[None, :], vehicle, psi, height)[0])


def _displace(r_e: Floats, vehicle: VehicleSpec, psi: float, height: float) -> Floats:
    """Positions moved horizontally by the offset, all at one height."""
    a, b = vehicle.offset_m
    if vehicle.offset_frame == 'course':
        a, b = (
            a * math.cos(psi) - b * math.sin(psi),
            a * math.sin(psi) + b * math.cos(psi),
        )
    moved = r_e + np.array([a, b, 0.0]) @ np.asarray(grid.ecef_to_grid(r_e))
    up_e = np.asarray(grid.ecef_to_grid(moved))[:, 2, :]
    return np.asarray(moved + (height - earth.geodetic_from_ecef(moved)[2])[:, None] * up_e)


def still_knots(r_e: Floats, psi: float, t_s: Floats) -> Knots:
    """Knots of a vehicle at rest (ECEF [m]), level, with one heading psi [rad]."""
    n = len(t_s)
    return Knots(t_s, r_e, np.zeros((n, 3)), np.tile([psi, 0.0, 0.0], (n, 1)))


def knots_of_profile(profile: Profile, start_e: Floats, psi_start: float, t_s: Floats) -> Knots:
    """Knots of a profile from a start.

    Solves dr_e/dt = C_G_e(r_e) v_G(t) by Picard iteration with the quintic spline's integral as
    quadrature: v_G is known beforehand and C_G_e varies over thousands of kilometres, so each turn
    gains three digits or more.
    """
    course, climb = profile.at(t_s)
    psi = psi_start + course
    level = np.cos(climb)
    v_G = profile.speed * np.stack(
        [level * np.cos(psi), level * np.sin(psi), np.sin(climb)], axis=1
    )
    d_e = np.zeros_like(v_G)
    for _ in range(_PICARD_TURNS):
        C_e_G = np.asarray(grid.ecef_to_grid(start_e + d_e))
        v_e = np.einsum('nji,nj->ni', C_e_G, v_G)
        moved = splines.make_interp_spline(t_s, v_e, k=DEGREE).antiderivative()
        new = moved(t_s) - moved(0.0)
        change = float(np.max(np.abs(new - d_e)))
        d_e = new
        if change < _PICARD_M:
            # Nose down is positive: a climbing path has a negative pitch.
            return Knots(t_s, start_e, d_e, np.stack([psi, -climb, np.zeros_like(psi)], axis=1))
    raise ConfigError(f'the path does not settle: it still moves by {change:.1e} m')


def knots_of_track(
    track: TrackPath | RecordedPath,
    spec: TrackSpec,
    vehicle: VehicleSpec,
    sea_surface_height: float,
    t_s: Floats,
) -> Knots:
    """Knots of a recorded track, moved in parallel by the offset."""
    height = sea_surface_height - vehicle.depth_m
    r_e = track.sail(height, t_s)
    psi = _course(r_e, t_s)
    r_e = _displace(r_e, vehicle, float(psi[np.searchsorted(t_s, 0.0)]), height)
    origin_e = r_e[0].copy()
    d_e = r_e - origin_e
    psi = _course(r_e, t_s)
    if spec.as_recorded:
        _check_turn(psi, t_s, spec)
    lateral = _largest_lateral_acceleration(d_e, t_s)
    if lateral > spec.max_lateral_acceleration:
        pace = 'as recorded' if spec.as_recorded else f'at {spec.speed_mps} m/s'
        otherwise = '' if spec.as_recorded else ' or lower speed_mps'
        raise ConfigError(
            f'track {spec.csv}: {pace} it needs a lateral acceleration of'
            f' {lateral:.3g} m/s^2, max_lateral_acceleration is {spec.max_lateral_acceleration};'
            f' raise smoothing_m ({spec.smoothing_m}){otherwise}'
        )
    level = np.zeros_like(psi)
    return Knots(t_s, origin_e, d_e, np.stack([psi, level, level], axis=1))


def _check_turn(psi: Floats, t_s: Floats, spec: TrackSpec) -> None:
    """Raise ConfigError for a drift that almost stops, where the course and heading flip."""
    rate = np.abs(np.diff(psi)) / SPACING_S
    i = int(np.argmax(rate))
    if rate[i] > _LARGEST_TURN:
        raise ConfigError(
            f'track {spec.csv}: as recorded it almost stops {t_s[i]:.0f} s after the start and'
            f' its course turns by {math.degrees(rate[i]):.3g} deg/s, more than'
            f' {math.degrees(_LARGEST_TURN):.3g}; raise smoothing_m ({spec.smoothing_m})'
        )


def _course(r_e: Floats, t_s: Floats) -> Floats:
    """Course angle from grid east along positions, counter-clockwise, continuous [rad]."""
    v_e = splines.make_interp_spline(t_s, r_e - r_e[0], k=DEGREE).derivative()(t_s)
    v_G = np.einsum('nij,nj->ni', np.asarray(grid.ecef_to_grid(r_e)), v_e)
    return np.unwrap(np.arctan2(v_G[:, 1], v_G[:, 0]))


def _largest_lateral_acceleration(d_e: Floats, t_s: Floats) -> float:
    path = splines.make_interp_spline(t_s, d_e, k=DEGREE)
    v_e, a_e = path.derivative(1)(t_s), path.derivative(2)(t_s)
    speed = np.linalg.norm(v_e, axis=1)
    return float(np.max(np.linalg.norm(np.cross(v_e, a_e), axis=1) / speed))
