"""Exact truth of one vehicle: state at any time, ideal IMU increments over any interval.

The truth *is* a quintic B-spline of position (relative to a place on the path, ECEF axes) and of
the reference angles, plus sines of attitude. Velocity and acceleration are its derivatives, not
differences, so truth and ideal IMU agree to rounding:

    v_G        = C_e_G r'
    f_b        = C_G_b C_e_G (r'' + 2 omega_ie x r' + gamma u)
    omega_ib_b = C_G_b (omega_ie_G + omega_eG_G) + omega_Gb_b(angles, their rates)

``gamma`` contains the centrifugal part; where a mission's gravity is not normal, the specific
force has its disturbance too (:mod:`polar_nav_sim.environment`), and the motion stays as it is.
Increments are Gauss-Legendre integrals of the last two.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import attitude, earth, grid

from . import splines
from .environment import CALM, Environment
from .paths.knots import DEGREE, Knots
from .specs import OscillationSpec

Floats = NDArray[np.float64]

NS = 1_000_000_000
ABYSS_M = 6000.0
"""Depth of the floor where it is out of reach of every instrument [m]."""
_NODES = 3
"""Quadrature points per IMU interval; for 10 ms and periods of seconds the rest is below 1e-16."""


@dataclass(frozen=True)
class TruthState:
    """True state; every array has the shape of the requested time in front of the stated one.

    Attributes
    ----------
    r_e : ndarray, shape (3,)
        Position of base_link, ECEF [m].
    v_e, v_G : ndarray, shape (3,)
        Velocity over ground in ECEF and in grid axes [m/s].
    C_e_G, C_b_G : ndarray, shape (3, 3)
        Earth to grid, body to grid.
    omega_ib_b : ndarray, shape (3,)
        Angular rate against inertial space, body axes [rad/s].
    f_b : ndarray, shape (3,)
        Specific force, body axes [m/s^2].
    lat, lon, h : ndarray, shape ()
        Geodetic position [rad, rad, m]; lon means nothing exactly at a pole.
    depth, altitude : ndarray, shape ()
        Below the sea surface, above the sea floor [m]; altitude is NaN where the floor is unknown.
    current_G : ndarray, shape (3,)
        Velocity of the water over ground, grid axes [m/s].
    """

    r_e: Floats
    v_e: Floats
    v_G: Floats
    C_e_G: Floats
    C_b_G: Floats
    omega_ib_b: Floats
    f_b: Floats
    lat: Floats
    lon: Floats
    h: Floats
    depth: Floats
    altitude: Floats
    current_G: Floats


@dataclass(frozen=True)
class TruthBlock:
    """Consecutive IMU samples: their states, and the ideal increments of the intervals they end.

    Attributes
    ----------
    k0 : int
        Number of the first sample; sample k has the stamp start + k period.
    stamp_ns : ndarray of int64, shape (n,)
    state : TruthState
        At the stamps.
    delta_theta_b, delta_v_b : ndarray, shape (n, 3)
        Integrals of omega_ib_b [rad] and f_b [m/s] over (stamp - interval, stamp].
    interval_s : ndarray, shape (n,)
        0 for sample 0, which no interval ends.
    """

    k0: int
    stamp_ns: NDArray[np.int64]
    state: TruthState
    delta_theta_b: Floats
    delta_v_b: Floats
    interval_s: Floats


@dataclass(frozen=True)
class Surroundings:
    """Surroundings of a vehicle.

    Attributes
    ----------
    surface_height, floor_depth : float
        Sea surface above the ellipsoid; floor below the surface, NaN if unknown [m].
    floor_lost_s : (float, float)
        From when to when the floor is :data:`ABYSS_M` deep [s since the start].
    environment : Environment
        True gravity and sea surface.
    """

    surface_height: float = 0.0
    floor_depth: float = math.nan
    floor_lost_s: tuple[float, float] = (0.0, 0.0)
    environment: Environment = CALM


UNDISTURBED = Surroundings()


class Truth(ABC):
    """Truth of one vehicle over a mission; base of paths and dynamics.

    Parameters
    ----------
    start_ns, period_ns : int
        Stamp of sample 0, time between samples [ns].
    surroundings : Surroundings
        Sea surface, sea floor and gravity.
    """

    def __init__(
        self,
        start_ns: int,
        period_ns: int,
        surroundings: Surroundings = UNDISTURBED,
    ) -> None:
        self.start_ns = start_ns
        self.period_ns = period_ns
        self._surface = surroundings.surface_height
        self._floor = surroundings.floor_depth
        self._lost_s = surroundings.floor_lost_s
        self._environment = surroundings.environment
        self._pieces = 1
        """Parts of an IMU interval within which the motion is smooth."""

    def state(self, t_ns: int | NDArray[np.int64]) -> TruthState:
        """State at a time or at an array of times [ns].

        Raises
        ------
        ValueError
            For a time outside of the mission and its margin of a few seconds.
        """
        # The difference of integers is exact; seconds since the start have 1e-12 s or better.
        since_ns = np.asarray(t_ns, dtype=np.int64) - self.start_ns
        return self._at(since_ns.astype(np.float64) * 1e-9)

    def samples(self, k0: int, k1: int) -> TruthBlock:
        """Samples k0 to k1 - 1 with their ideal increments."""
        if not 0 <= k0 < k1:
            raise ValueError(f'samples [{k0}, {k1}) are none: need 0 <= k0 < k1')
        k = np.arange(k0, k1, dtype=np.int64)
        period_s = self.period_ns * 1e-9
        end_s = k * self.period_ns * 1e-9
        x, w = np.polynomial.legendre.leggauss(_NODES)
        piece_s = period_s / self._pieces
        back_s = piece_s * np.arange(1 - self._pieces, 1)[:, None] + (0.5 * piece_s) * (x - 1.0)
        # No interval ends at sample 0: its quadrature points are not used.
        inner_s = np.maximum(end_s[:, None] + back_s.ravel(), 0.0)
        # One evaluation for the stamps and all quadrature points.
        both = self._at(np.concatenate([end_s[:, None], inner_s], axis=1))
        weights = np.tile(0.5 * piece_s * w, self._pieces)
        interval_s = np.where(k > 0, period_s, 0.0)
        used = (k > 0)[:, None]
        return TruthBlock(
            k0=k0,
            stamp_ns=self.start_ns + k * self.period_ns,
            state=TruthState(*(getattr(both, name)[:, 0] for name in _STATE_FIELDS)),
            delta_theta_b=np.where(
                used, np.einsum('j,njc->nc', weights, both.omega_ib_b[:, 1:]), 0.0
            ),
            delta_v_b=np.where(used, np.einsum('j,njc->nc', weights, both.f_b[:, 1:]), 0.0),
            interval_s=interval_s,
        )

    @abstractmethod
    def _at(self, t_s: Floats) -> TruthState:
        """State at times since the start [s], any shape."""

    def _state(
        self,
        *,
        r_e: Floats,
        v_e: Floats,
        C_e_G: Floats,
        C_b_G: Floats,
        omega_ib_b: Floats,
        f_b: Floats,
        current_G: Floats,
        t_s: Floats,
    ) -> TruthState:
        """Complete a state."""
        lat, lon, h = (np.asarray(x) for x in earth.geodetic_from_ecef(r_e))
        depth = self._surface - h
        if self._environment.geoid is not None:
            depth = depth + self._environment.geoid.undulation(r_e)
        if self._environment.gravity is not None:
            # A body at rest is held up against the gravity that there is.
            f_b = f_b - apply_transposed(C_b_G, self._environment.gravity.disturbance(r_e))
        lost = (t_s >= self._lost_s[0]) & (t_s < self._lost_s[1])
        return TruthState(
            r_e=r_e,
            v_e=v_e,
            v_G=apply(C_e_G, v_e),
            C_e_G=C_e_G,
            C_b_G=C_b_G,
            omega_ib_b=omega_ib_b,
            f_b=f_b,
            lat=lat,
            lon=lon,
            h=h,
            depth=depth,
            altitude=np.where(lost, ABYSS_M, self._floor) - depth,
            current_G=current_G,
        )


class Trajectory(Truth):
    """Truth of a vehicle that follows a path.

    Parameters
    ----------
    knots : Knots
        Knots of the splines.
    oscillation : OscillationSpec
        Sines added to the reference angles.
    start_ns, period_ns, surroundings
        As of :class:`Truth`.
    """

    def __init__(
        self,
        knots: Knots,
        oscillation: OscillationSpec,
        start_ns: int,
        period_ns: int,
        surroundings: Surroundings = UNDISTURBED,
    ) -> None:
        super().__init__(start_ns, period_ns, surroundings)
        self._origin_e = knots.origin_e
        self._first_s, self._last_s = float(knots.t_s[0]), float(knots.t_s[-1])
        position = splines.make_interp_spline(knots.t_s, knots.d_e, k=DEGREE)
        self._d_e = (position, position.derivative(1), position.derivative(2))
        angles = splines.make_interp_spline(knots.t_s, knots.angles, k=DEGREE)
        self._angles = (angles, angles.derivative(1))
        # Order psi, theta, phi, as in Knots.angles.
        sines = (oscillation.yaw, oscillation.pitch, oscillation.roll)
        self._amplitude = np.radians([s.amplitude_deg for s in sines])
        self._rate = np.array([2.0 * np.pi / s.period_s for s in sines])
        self._phase = np.radians([s.phase_deg for s in sines])

    def angles(self, t_s: Floats) -> tuple[Floats, Floats]:
        """Angles (psi, theta, phi) [rad] and their rates [rad/s], shape (..., 3)."""
        argument = self._rate * t_s[..., None] + self._phase
        return (
            self._angles[0](t_s) + self._amplitude * np.sin(argument),
            self._angles[1](t_s) + self._amplitude * self._rate * np.cos(argument),
        )

    def _at(self, t_s: Floats) -> TruthState:
        if np.min(t_s) < self._first_s or np.max(t_s) > self._last_s:
            raise ValueError(
                f'no truth from {np.min(t_s):.3f} to {np.max(t_s):.3f} s: the mission has'
                f' {self._first_s:.1f} to {self._last_s:.1f} s'
            )
        d_e, v_e, a_e = (spline(t_s) for spline in self._d_e)
        r_e = self._origin_e + d_e
        C_e_G = np.asarray(grid.ecef_to_grid(r_e))
        v_G = apply(C_e_G, v_e)
        angles, rates = self.angles(t_s)
        C_b_G = attitude.matrix_from_euler(angles[..., 0], angles[..., 1], angles[..., 2])
        omega_iG_G = grid.earth_rate(r_e) + grid.transport_rate(r_e, v_G)
        return self._state(
            r_e=r_e,
            v_e=v_e,
            C_e_G=C_e_G,
            C_b_G=C_b_G,
            omega_ib_b=apply_transposed(C_b_G, omega_iG_G) + euler_rate(angles, rates),
            f_b=apply_transposed(C_b_G, specific_force(r_e, v_e, a_e, C_e_G)),
            current_G=np.zeros_like(r_e),
            t_s=t_s,
        )


_STATE_FIELDS = tuple(TruthState.__dataclass_fields__)


def apply(C: Floats, x: Floats) -> Floats:
    """C x, arrays of both."""
    return np.asarray(np.einsum('...ij,...j->...i', C, x))


def apply_transposed(C: Floats, x: Floats) -> Floats:
    """Transposed C x, arrays of both."""
    return np.asarray(np.einsum('...ji,...j->...i', C, x))


def specific_force(r_e: Floats, v_e: Floats, a_e: Floats, C_e_G: Floats) -> Floats:
    """Specific force of a motion against the earth, grid axes [m/s^2]."""
    f_G = apply(C_e_G, a_e + 2.0 * earth.OMEGA_IE * _spin_cross(v_e))
    f_G[..., 2] += earth.gravity(r_e)
    return f_G


def _spin_cross(x_e: Floats) -> Floats:
    """Cross product e_z x x."""
    return np.stack([-x_e[..., 1], x_e[..., 0], np.zeros_like(x_e[..., 0])], axis=-1)


def euler_rate(angles: Floats, rates: Floats) -> Floats:
    """Rate of b against G of C_b_G = Rz(psi) Ry(theta) Rx(phi), body axes [rad/s].

    omega_Gb_b = (phi' - psi' sin theta, theta' cos phi + psi' cos theta sin phi,
    psi' cos theta cos phi - theta' sin phi).
    """
    theta, phi = angles[..., 1], angles[..., 2]
    psi_dot, theta_dot, phi_dot = np.moveaxis(rates, -1, 0)
    across = psi_dot * np.cos(theta)
    return np.stack(
        [
            phi_dot - psi_dot * np.sin(theta),
            theta_dot * np.cos(phi) + across * np.sin(phi),
            across * np.cos(phi) - theta_dot * np.sin(phi),
        ],
        axis=-1,
    )
