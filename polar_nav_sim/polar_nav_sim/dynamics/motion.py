"""Motion of a vehicle by its dynamics, integrated on demand.

The reference axes are rigid and fixed to the Earth (docs/simulation.md). The states of the steps
are those of the Runge-Kutta method; between them position is the quintic that has their positions,
velocities and accelerations, and each angle the cubic that has their values and rates. That
function of time *is* the motion: truth and ideal IMU are both derived from it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.attitude import matrix_from_euler
from polar_nav_core.errors import PolarNavError
from polar_nav_core.vehicle_model import steady_speed

from ..dynamics_spec import DynamicsSpec
from ..kernels import dynamics as kernels

Floats = NDArray[np.float64]

_STEEPEST = math.radians(80.0)
"""Angles of pitch beyond this are refused: phi and psi lose their meaning at 90 degrees."""
_SAME = 1e-6
"""Part of a step by which a time may be rounded."""


class OutOfControl(PolarNavError):
    """The loops of a vehicle have lost control of it."""


class Place(NamedTuple):
    """Start of the vehicle, and depth in the reference axes.

    ``start`` is the position [m], shape (3,); ``origin_depth`` the depth of the axes' origin [m];
    ``half_curvature`` 1 / (2 R) of the Earth [1/m], 0 for a plane.
    """

    start: Floats
    depth: float
    origin_depth: float
    half_curvature: float


class Kinematics(NamedTuple):
    """Position, velocity, acceleration in reference axes; psi, theta, phi and their rates."""

    p: Floats
    v: Floats
    a: Floats
    angles: Floats
    rates: Floats


class Motion:
    """One vehicle from rest in the moving water, at the steady speed of its first thrust.

    Parameters
    ----------
    spec : DynamicsSpec
        The vehicle.
    place : Place
        Its start.
    step_s : float
        Step of the integration; the loops act once a step [s].
    """

    def __init__(self, spec: DynamicsSpec, place: Place, step_s: float) -> None:
        self.spec = spec
        self.step_s = step_s
        self.steps = 0
        """Number of integrated steps."""
        self._body = spec.body.body()
        self._water = spec.current.water()
        self._loops = spec.kernel_loops(place.depth, place.origin_depth, place.half_curvature)
        self._wanted = np.full(4, math.nan)
        self._wrench = np.full(6, math.nan)
        self._scratch = np.zeros((30, 3))
        self._x = np.zeros((2, kernels.STATES))
        self._tau = np.zeros((1, 6))
        self._rate_start = np.zeros((1, kernels.STATES))
        self._rate_end = np.zeros((1, kernels.STATES))
        self._x[0] = self._first(place)

    @property
    def x(self) -> Floats:
        """States at the steps' ends, shape (steps + 1, 12): p, phi, theta, psi, v_b, omega_b."""
        return self._x[: self.steps + 1]

    @property
    def tau(self) -> Floats:
        """Force and torque of each step, body axes, shape (steps, 6) [N], [N m]."""
        return self._tau[: self.steps]

    @property
    def rates(self) -> tuple[Floats, Floats]:
        """Rates of the state at both ends of each step, with its thrust, shape (steps, 12)."""
        return self._rate_start[: self.steps], self._rate_end[: self.steps]

    def want(self, heading: float, pitch: float, depth: float, speed: float) -> None:
        """Replace the laws by set points from the next step on; NaN keeps the law of one."""
        self._wanted[:] = heading, pitch, depth, speed

    def push(self, wrench: Floats | None) -> None:
        """Replace the thrust of the loops by (6,) from the next step on; None: use the loops'."""
        self._wrench[:] = math.nan if wrench is None else wrench

    def advance(self, steps: int) -> None:
        """Integrate up to a number of steps.

        Raises
        ------
        OutOfControl
            If the pitch exceeds its limit, or the state is not finite.
        """
        if steps <= self.steps:
            return
        self._room(steps)
        kernels.run(
            self._x,
            self._tau,
            self._rate_start,
            self._rate_end,
            self.steps,
            steps - self.steps,
            self.step_s,
            self._body,
            self._water,
            self._loops,
            self._wanted,
            self._wrench,
            self._scratch,
        )
        new = self._x[self.steps + 1 : steps + 1]
        bad = ~(np.abs(new[:, 4]) < _STEEPEST) | ~np.isfinite(new).all(axis=1)
        if bad.any():
            at = self.steps + 1 + int(np.argmax(bad))
            raise OutOfControl(
                f'vehicle out of control after {at * self.step_s:.2f} s: pitch'
                f' {math.degrees(self._x[at, 4]):.0f} deg; raise pitch_gain'
                f' ({self.spec.loops.pitch_gain} N m/rad)'
            )
        self.steps = steps

    def at(self, t_s: Floats) -> Kinematics:
        """Motion at times up to the last step that is integrated, any shape [s]."""
        # The step that ends at a time, whatever its rounding: thrust jumps from step to step.
        ends = np.ceil(t_s / self.step_s - _SAME).astype(np.int64)
        step = np.clip(ends - 1, 0, self.steps - 1)
        s = t_s / self.step_s - step
        h = self.step_s
        x0, x1 = self._x[step], self._x[step + 1]
        d0, d1 = self._rate_start[step], self._rate_end[step]
        p, v, a = _quintic(
            s,
            h,
            (x0[..., :3], d0[..., :3], _acceleration(x0, d0)),
            (x1[..., :3], d1[..., :3], _acceleration(x1, d1)),
        )
        angles, rates = _cubic(s, h, (x0[..., 3:6], d0[..., 3:6]), (x1[..., 3:6], d1[..., 3:6]))
        return Kinematics(p, v, a, angles[..., ::-1], rates[..., ::-1])

    def _first(self, place: Place) -> Floats:
        spec, loops = self.spec, self._loops
        force = float(kernels.law(loops.surge, 0.0))
        drag = spec.body.drag_linear[0], spec.body.drag_quadratic[0]
        speed = spec.law.speed_mps if spec.law.speed_mps > 0.0 else steady_speed(force, *drag)
        psi = float(kernels.law(loops.heading, 0.0))
        R = matrix_from_euler(psi, 0.0, 0.0)
        v_b = R.T @ spec.current.at(np.array(0.0)) + [speed, 0.0, 0.0]
        return np.concatenate([place.start, [0.0, 0.0, psi], v_b, np.zeros(3)])

    def _room(self, steps: int) -> None:
        """Allocate room for a number of steps, at least twice as much as before."""
        have = len(self._tau)
        if steps <= have:
            return
        more = max(steps, 2 * have) - have
        self._x = np.concatenate([self._x, np.zeros((more, kernels.STATES))])
        self._tau = np.concatenate([self._tau, np.zeros((more, 6))])
        self._rate_start = np.concatenate([self._rate_start, np.zeros((more, kernels.STATES))])
        self._rate_end = np.concatenate([self._rate_end, np.zeros((more, kernels.STATES))])


def _acceleration(x: Floats, rate: Floats) -> Floats:
    """Acceleration in reference axes: R (v' + omega x v)."""
    R = matrix_from_euler(x[..., 5], x[..., 4], x[..., 3])
    a_b = rate[..., 6:9] + np.cross(x[..., 9:12], x[..., 6:9])
    return np.asarray(np.einsum('...ij,...j->...i', R, a_b))


def _quintic(
    s: Floats, h: float, first: tuple[Floats, ...], last: tuple[Floats, ...]
) -> tuple[Floats, Floats, Floats]:
    """Hermite polynomial of value, slope and curvature at both ends, with its derivatives."""
    s = s[..., None]
    p0, v0, a0 = first[0], h * first[1], h * h * first[2]
    p1, v1, a1 = last[0] - p0, h * last[1], h * h * last[2]
    c3 = 10.0 * p1 - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
    c4 = -15.0 * p1 + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1
    c5 = 6.0 * p1 - 3.0 * (v0 + v1) - 0.5 * (a0 - a1)
    p = p0 + s * (v0 + s * (0.5 * a0 + s * (c3 + s * (c4 + s * c5))))
    v = v0 + s * (a0 + s * (3.0 * c3 + s * (4.0 * c4 + s * 5.0 * c5)))
    a = a0 + s * (6.0 * c3 + s * (12.0 * c4 + s * 20.0 * c5))
    return p, v / h, a / (h * h)


def _cubic(
    s: Floats, h: float, first: tuple[Floats, ...], last: tuple[Floats, ...]
) -> tuple[Floats, Floats]:
    """Hermite polynomial of value and slope at both ends, with its derivative."""
    s = s[..., None]
    y0, d0 = first[0], h * first[1]
    y1, d1 = last[0] - y0, h * last[1]
    c2, c3 = 3.0 * y1 - 2.0 * d0 - d1, -2.0 * y1 + d0 + d1
    y = y0 + s * (d0 + s * (c2 + s * c3))
    return y, (d0 + s * (2.0 * c2 + s * 3.0 * c3)) / h
