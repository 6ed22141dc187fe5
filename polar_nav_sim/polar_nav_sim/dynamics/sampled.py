"""A whole motion sampled at its steps, in a station's axes, for runs in arrays."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.attitude import matrix_from_euler

from ..poses import NotYet, Pose
from ..sensors.station import StationFrame
from ..trajectory import NS
from .truth import DynamicTruth

Floats = NDArray[np.float64]


class SampledMotion:
    """Truth at every step, and positions between them; do not write into the arrays.

    Parameters
    ----------
    truth : DynamicTruth
        The vehicle.
    count : int
        Samples, the one at the start included.
    frame : StationFrame
        The axes S.

    Attributes
    ----------
    t_s, depth, psi : ndarray, shape (n,)
        Time since the start [s], depth [m], heading from x, counter-clockwise, continuous [rad].
    p, v, current : ndarray, shape (n, 3)
        Position [m], velocity over ground and of the water [m/s], axes S.
    v_r_b, omega_ib_b : ndarray, shape (n, 3)
        Velocity through the water [m/s]; mean angular rate over the step that ends there [rad/s].
    C_b_S : ndarray, shape (n, 3, 3)
        Body to S.
    force_b, torque_b : ndarray, shape (n, 3)
        Thrust from the time on [N], [N m].
    """

    def __init__(self, truth: DynamicTruth, count: int, frame: StationFrame) -> None:
        motion = truth.motion
        motion.advance(count)
        step_s = motion.step_s
        C_A_S = frame.C_e_S @ truth.C_A_e
        x = motion.x[:count]
        C_b_A = matrix_from_euler(x[:, 5], x[:, 4], x[:, 3])
        v_A = np.einsum('nij,nj->ni', C_b_A, x[:, 6:9])
        self.t_s: Floats = np.arange(count, dtype=np.float64) * step_s
        current_A = truth.spec.current.at(self.t_s)
        r_e = truth.origin_e + x[:, :3] @ truth.C_A_e.T
        self.depth = truth.depth_of(r_e)
        self.p = frame.position(r_e)
        self.v = v_A @ C_A_S.T
        self.current = current_A @ C_A_S.T
        self.v_r_b = x[:, 6:9] - np.einsum('nji,nj->ni', C_b_A, current_A)
        self.C_b_S = C_A_S @ C_b_A
        # The axes A and S differ by less than 1e-3 rad: no turn is lost.
        difference = math.atan2(C_A_S[1, 0], C_A_S[0, 0])
        self.psi = x[:, 5] + difference
        rate_b = x[:, 9:12] + np.einsum('nji,j->ni', C_b_A, truth.omega_ie_A)
        # Mean of the cubic that has rate and its slope at both ends of a step.
        first, last = (r[: count - 1, 9:12] for r in motion.rates)
        mean_b = 0.5 * (rate_b[1:] + rate_b[:-1]) + step_s / 12.0 * (first - last)
        self.omega_ib_b = np.concatenate([rate_b[:1], mean_b])
        self.force_b, self.torque_b = np.split(motion.tau[:count].copy(), 2, axis=1)
        self._start_ns, self._step_ns = truth.start_ns, step_s * NS
        self._step_s = step_s
        self._r_e, self._v_e = r_e, v_A @ truth.C_A_e.T
        for array in vars(self).values():
            if isinstance(array, np.ndarray):
                array.flags.writeable = False

    def pose(self, t_ns: int) -> Pose:
        """Pose for acoustics, its attitude that of the axes of ECEF: the transponder has no arm.

        Between steps the position is the cubic of positions and velocities, exact to 1e-9 m.
        """
        u = (t_ns - self._start_ns) / self._step_ns
        i = min(max(int(u), 0), len(self._r_e) - 2)
        s, h = u - i, self._step_s
        if s > 1.0 + 1e-9:
            raise NotYet(t_ns)
        d0, d1 = h * self._v_e[i], h * self._v_e[i + 1]
        step = self._r_e[i + 1] - self._r_e[i]
        r_e = self._r_e[i] + s * (
            d0 + s * (3.0 * step - 2.0 * d0 - d1 + s * (d0 + d1 - 2.0 * step))
        )
        depth = (1.0 - s) * self.depth[i] + s * self.depth[i + 1]
        return Pose(r_e, _NO_TURN, float(depth))


_NO_TURN = np.eye(3)
