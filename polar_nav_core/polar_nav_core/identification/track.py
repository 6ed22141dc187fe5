"""Positions of a vehicle at its fixes and their slopes, from the log of its window.

Surge and sway are followed through the whole log (kernels.surge_track), so that turning drag,
surge inertia and side slip are in it; docs/derivations/identification.md, eqs (3)-(8).
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..kernels.vehicle.surge_track import surge_track
from ..vehicle_model import VehicleModel
from .window import Window

LOG_DRAG, SHARE, CURRENT, START, BIAS, SIZE = 0, 1, slice(2, 4), slice(4, 6), 6, 7
"""theta begins with ln Dt, f, V_x, V_y [m/s], place of the first fix x, y [m], heading bias [rad].

V is the current at the last fix; what follows are its changes before, see `TrackModel`.
"""
DRAG = slice(0, 2)


def drag_of(log_total: float, share: float, speed: float) -> Array:
    """(d1x, d2x) of ln Dt and f at a speed: d1 = (1 - f) Dt / U, d2 = f Dt / U^2."""
    total = math.exp(log_total)
    return np.array([(1.0 - share) * total / speed, share * total / speed**2])


def drag_slopes(log_total: float, share: float, speed: float) -> Array:
    """Slopes of (d1x, d2x) with (ln Dt, f), shape (2, 2)."""
    d1, d2 = drag_of(log_total, share, speed)
    total = math.exp(log_total)
    return np.array([[d1, -total / speed], [d2, total / speed**2]])


class TrackModel:
    """Positions at the fixes of a window as a function of theta.

    Parameters
    ----------
    window : Window
    model : VehicleModel
        Inertia and sway drag.
    speed : float
        Speed at which theta's total drag and share are stated [m/s].
    knots_s : (k + 1,) array
        Seconds from the first fix between which the current goes linearly, by the changes (x, y)
        that theta ends with; fewer than two for a constant current.
    """

    def __init__(self, window: Window, model: VehicleModel, speed: float, knots_s: Array) -> None:
        begin, length = knots_s[:-1], np.diff(knots_s)
        self.size = SIZE + 2 * len(length)
        # The current was V less its later changes: their displacement until a fix.
        since = window.seconds[window.node][:, None] - begin
        within = np.clip(since, 0.0, length)
        self._before = -(begin + np.minimum(since, 0.0) + within - within**2 / (2.0 * length))
        self._window = window
        self._speed = speed
        self._inertia = np.ascontiguousarray(model.inertia[:2])
        self._sway_drag = float(model.drag_linear[1]), float(model.drag_quadratic[1])
        self._cos_pitch = np.cos(window.pitch)
        self._force = window.force - model.net_buoyancy * np.sin(window.pitch)
        n = len(window.seconds)
        self._track = np.empty((n, 2))
        self._slopes = np.empty((n, 2, 2))
        self._surge = np.empty(n)

    def positions(self, theta: Array) -> tuple[Array, Array]:
        """Positions (n, 2) at the fixes and their slopes (n, 2, size) with theta.

        ``p_i = X + V (t_i - t_1) - sum_k c_k S_k(t_i) + R(-b) (q_i - q_1)``, q being the way
        through the water along the measured heading, c_k the change of the current between two
        knots and S_k the integral of the remaining share of it.
        """
        self._follow(theta)
        node = self._window.node
        elapsed = self._window.seconds[node]
        way = self._track[node] - self._track[node[0]]
        way_slopes = self._slopes[node] - self._slopes[node[0]]
        c, s = math.cos(theta[BIAS]), math.sin(theta[BIAS])
        turn = np.array([[c, s], [-s, c]])
        turned = way @ turn.T
        changes = theta[SIZE:].reshape(-1, 2)
        places = theta[START] + elapsed[:, None] * theta[CURRENT] + turned + self._before @ changes
        slopes = np.zeros((len(places), 2, self.size))
        by_drag = drag_slopes(theta[LOG_DRAG], theta[SHARE], self._speed)
        slopes[:, :, DRAG] = turn @ way_slopes @ by_drag
        slopes[:, [0, 1], [2, 3]] = elapsed[:, None]
        slopes[:, [0, 1], [4, 5]] = 1.0
        slopes[:, 0, BIAS] = turned[:, 1]
        slopes[:, 1, BIAS] = -turned[:, 0]
        slopes[:, 0, SIZE::2] = slopes[:, 1, SIZE + 1 :: 2] = self._before
        return places, slopes

    def surge(self, theta: Array) -> Array:
        """Surge speed through the water on the window's grid [m/s]."""
        self._follow(theta)
        return self._surge.copy()

    def _follow(self, theta: Array) -> None:
        w = self._window
        d1, d2 = drag_of(theta[LOG_DRAG], theta[SHARE], self._speed)
        surge_track(
            w.seconds,
            w.psi,
            self._cos_pitch,
            w.yaw_rate,
            self._force,
            self._inertia,
            np.array([d1, self._sway_drag[0]]),
            np.array([d2, self._sway_drag[1]]),
            self._track,
            self._slopes,
            self._surge,
        )
