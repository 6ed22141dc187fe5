"""Truth of a vehicle with dynamics, in the form of all truth.

The dynamics' reference axes A are the grid axes at a place, fixed to the Earth; the vehicle's
motion in them turns into position, attitude and ideal IMU on the rotating ellipsoid:

    r_e = r_0 + C_A_e p      f_b = C_A_b C_e_A (r_e'' + 2 omega_ie x r_e' + gamma u)
    omega_ib_b = C_A_b omega_ie_A + omega_Ab_b
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import attitude, earth, grid

from ..dynamics_spec import DynamicsSpec
from ..poses import Pose
from ..trajectory import (
    NS,
    UNDISTURBED,
    Surroundings,
    Truth,
    TruthState,
    apply,
    apply_transposed,
    euler_rate,
    specific_force,
)
from .motion import Motion, Place

Floats = NDArray[np.float64]

LONGEST_STEP_S = 0.01
_RADIUS = 6.378e6
"""Of the sea surface for the depth loop [m]; 1 % of it is 1 mm of depth at 1 km."""


class DynamicTruth(Truth):
    """Truth of one vehicle with dynamics.

    Parameters
    ----------
    spec : DynamicsSpec
        The vehicle.
    origin_e : ndarray, shape (3,)
        Origin of the reference axes, ECEF [m].
    start_e : ndarray, shape (3,)
        Start of the vehicle, ECEF [m].
    start_ns, period_ns, end_ns : int
        Stamp of sample 0, time between samples, last stamp that can be asked for [ns].
    surroundings : Surroundings
        As of :class:`polar_nav_sim.trajectory.Truth`.
    """

    def __init__(
        self,
        spec: DynamicsSpec,
        origin_e: Floats,
        start_e: Floats,
        start_ns: int,
        period_ns: int,
        end_ns: int,
        surroundings: Surroundings = UNDISTURBED,
    ) -> None:
        super().__init__(start_ns, period_ns, surroundings)
        self.origin_e = np.asarray(origin_e, dtype=np.float64)
        self.C_A_e = np.ascontiguousarray(np.asarray(grid.ecef_to_grid(self.origin_e)).T)
        """Reference axes to ECEF."""
        self._last_s = (end_ns - start_ns) / NS
        period_s = period_ns / NS
        per_sample = max(1, math.ceil(period_s / LONGEST_STEP_S - 1e-9))
        self._pieces = per_sample
        start_A = self.C_A_e.T @ (start_e - self.origin_e)
        h_0, h_start = (
            float(earth.geodetic_from_ecef(r)[2]) for r in (self.origin_e, np.asarray(start_e))
        )
        place = Place(
            start=start_A,
            depth=surroundings.surface_height - h_start,
            origin_depth=surroundings.surface_height - h_0,
            half_curvature=0.5 / _RADIUS,
        )
        self.motion = Motion(spec, place, period_s / per_sample)
        self.omega_ie_A = self.C_A_e.T @ np.array([0.0, 0.0, earth.OMEGA_IE])

    @property
    def spec(self) -> DynamicsSpec:
        """The vehicle."""
        return self.motion.spec

    def thrust(self, t_ns: int) -> Floats:
        """Force and torque that act from a time on, body axes, shape (6,) [N], [N m]."""
        step = round((t_ns - self.start_ns) / NS / self.motion.step_s)
        self.motion.advance(step + 1)
        return np.array(self.motion.tau[step])

    def velocity_through_water(self, t_ns: int) -> Floats:
        """v_r_b at a time, shape (3,) [m/s]."""
        s = self.state(t_ns)
        return np.asarray(s.C_b_G.T @ (s.v_G - s.current_G))

    def depth_of(self, r_e: Floats) -> Floats:
        """Depth of positions, ECEF [m]."""
        depth = np.asarray(self._surface - np.asarray(earth.geodetic_from_ecef(r_e)[2]))
        geoid = self._environment.geoid
        return depth if geoid is None else np.asarray(depth + geoid.undulation(r_e))

    def pose(self, t_ns: int) -> Pose:
        """Pose at a time [ns], the rest of the state left out."""
        t_s = np.array((t_ns - self.start_ns) / NS)
        self._reach(t_s)
        k = self.motion.at(t_s)
        r_e = self.origin_e + self.C_A_e @ k.p
        C_b_A = attitude.matrix_from_euler(k.angles[0], k.angles[1], k.angles[2])
        return Pose(r_e, self.C_A_e @ C_b_A, float(self.depth_of(r_e)))

    def _at(self, t_s: Floats) -> TruthState:
        self._reach(t_s)
        k = self.motion.at(t_s)
        r_e = self.origin_e + _turned(self.C_A_e, k.p)
        v_e, a_e = _turned(self.C_A_e, k.v), _turned(self.C_A_e, k.a)
        C_e_G = np.asarray(grid.ecef_to_grid(r_e))
        C_A_G = np.asarray(C_e_G @ self.C_A_e)
        C_b_A = attitude.matrix_from_euler(k.angles[..., 0], k.angles[..., 1], k.angles[..., 2])
        C_b_G = np.asarray(C_A_G @ C_b_A)
        omega_ie_A = np.broadcast_to(self.omega_ie_A, k.p.shape)
        current_A = self.spec.current.at(t_s)
        return self._state(
            r_e=r_e,
            v_e=v_e,
            C_e_G=C_e_G,
            C_b_G=C_b_G,
            omega_ib_b=apply_transposed(C_b_A, omega_ie_A) + euler_rate(k.angles, k.rates),
            f_b=apply_transposed(C_b_G, specific_force(r_e, v_e, a_e, C_e_G)),
            current_G=apply(C_A_G, current_A),
            t_s=t_s,
        )

    def _reach(self, t_s: Floats) -> None:
        """Integrate as far as a time."""
        if np.min(t_s) < 0.0 or np.max(t_s) > self._last_s + 1e-9:
            raise ValueError(
                f'no truth from {np.min(t_s):.3f} to {np.max(t_s):.3f} s: the mission has'
                f' 0 to {self._last_s:.1f} s'
            )
        self.motion.advance(max(1, math.ceil(float(np.max(t_s)) / self.motion.step_s - 1e-6)))


def _turned(C: Floats, x: Floats) -> Floats:
    return np.asarray(np.einsum('ij,...j->...i', C, x))
