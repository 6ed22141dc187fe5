"""The leader's own state between the samples of its odometry.

Odometry comes at 10 Hz, attitude oscillates within seconds: straight lines between samples would
turn a bearing by hundredths of a degree, decimetres at a kilometre. Positions and attitudes are
cubic Hermite curves through samples and their rates.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import attitude, grid

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LeaderState:
    """State of the leader's base_link at a stamp.

    Attributes
    ----------
    r_e, v_e : (3,) arrays
        Position [m] and velocity over ground [m/s], ECEF axes.
    C_b_e : (3, 3) array
        Body to ECEF.
    omega_eb_b : (3,) array
        Rate against the earth, body axes [rad/s].
    P_r_e, P_phi_e, P_v_e : (3, 3) arrays
        Covariances of position [m^2], attitude [rad^2] and velocity [m^2/s^2], ECEF axes.
    """

    stamp_ns: int
    r_e: Array
    v_e: Array
    C_b_e: Array
    omega_eb_b: Array
    P_r_e: Array
    P_phi_e: Array
    P_v_e: Array = field(default_factory=lambda: np.zeros((3, 3)))

    @property
    def C_e_G(self) -> Array:
        """ECEF to the leader's grid axes."""
        return grid.ecef_to_grid(self.r_e)


class LeaderStates:
    """States of the last seconds, in order of stamp.

    Parameters
    ----------
    length_s : float
        Length of the stored past [s].
    """

    def __init__(self, length_s: float) -> None:
        self._length_ns = round(length_s * 1e9)
        self._stamps: list[int] = []
        self._states: list[LeaderState] = []
        self.refused = 0

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest state."""
        return self._stamps[-1] if self._stamps else None

    @property
    def oldest_ns(self) -> int | None:
        """Stamp of the oldest state."""
        return self._stamps[0] if self._stamps else None

    def add(self, state: LeaderState) -> bool:
        """Store a state; False for one that is not newer than the newest or not finite."""
        finite = all(
            np.isfinite(a).all() for a in (state.r_e, state.v_e, state.C_b_e, state.omega_eb_b)
        )
        if not finite or (self._stamps and state.stamp_ns <= self._stamps[-1]):
            self.refused += 1
            return False
        self._stamps.append(state.stamp_ns)
        self._states.append(state)
        while self._stamps[-1] - self._stamps[0] > self._length_ns:
            del self._stamps[0], self._states[0]
        return True

    def clear(self) -> None:
        """Drop all states; later ones do not continue them."""
        self._stamps.clear()
        self._states.clear()

    def at(self, stamp_ns: int) -> LeaderState | None:
        """State at a stamp between stored ones; None outside of them."""
        i = bisect_right(self._stamps, stamp_ns) - 1
        if i < 0 or (i == len(self._stamps) - 1 and self._stamps[i] != stamp_ns):
            return None
        a = self._states[i]
        if a.stamp_ns == stamp_ns:
            return a
        b = self._states[i + 1]
        return interpolate(a, b, stamp_ns)


def interpolate(a: LeaderState, b: LeaderState, stamp_ns: int) -> LeaderState:
    """Cubic Hermite interpolation between two states.

    Attitude: C(t) = C_a exp([theta(t) x]) with theta a cubic from 0 to log(C_a^T C_b); its end
    rates are the body rates, the second one through the inverse right Jacobian,
    I + [theta x]/2 + [theta x]^2/12.
    """
    T = (b.stamp_ns - a.stamp_ns) * 1e-9
    s = (stamp_ns - a.stamp_ns) * 1e-9 / T
    h00, h10, h01, h11 = (
        (1 + 2 * s) * (1 - s) ** 2,
        s * (1 - s) ** 2,
        s * s * (3 - 2 * s),
        s * s * (s - 1),
    )
    r_e = h00 * a.r_e + h10 * T * a.v_e + h01 * b.r_e + h11 * T * b.v_e
    d00, d10, d11 = 6 * s * (s - 1), (1 - s) * (1 - 3 * s), s * (3 * s - 2)
    v_e = d00 / T * (a.r_e - b.r_e) + d10 * a.v_e + d11 * b.v_e
    theta_b = attitude.log(a.C_b_e.T @ b.C_b_e)
    S = attitude.skew(theta_b)
    rate_b = b.omega_eb_b + 0.5 * S @ b.omega_eb_b + S @ S @ b.omega_eb_b / 12.0
    theta = h10 * T * a.omega_eb_b + h01 * theta_b + h11 * T * rate_b
    return LeaderState(
        stamp_ns=stamp_ns,
        r_e=r_e,
        v_e=v_e,
        C_b_e=a.C_b_e @ attitude.exp(theta),
        omega_eb_b=(1 - s) * a.omega_eb_b + s * b.omega_eb_b,
        P_r_e=(1 - s) * a.P_r_e + s * b.P_r_e,
        P_phi_e=(1 - s) * a.P_phi_e + s * b.P_phi_e,
        P_v_e=(1 - s) * a.P_v_e + s * b.P_v_e,
    )
