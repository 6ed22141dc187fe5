"""The filters as the paper prints them: one measurement of six rows, noise by Sage-Husa.

For showing, not for use: eqs. (29)-(38) with `ignore` and (56)-(65) with `back_propagate`, in the
corrected reading of docs/derivations/adaptation.md. As in the paper DVL velocity enters with the
fix, H is the identity on dv and dr only, and DVL errors are not estimated. Depth stays local: the
vertical channel of an inertial navigation is unstable and must be held. Where the adaptation
destroys the filter, it stops with `FilterDivergence`; nothing is repaired. Plain NumPy.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...error_model import X
from ...errors import FilterDivergence
from ...kernels.sins import update as kf
from ..events import DepthSample, Fix, HeadingSample, ImuSample, InitialState, Local
from ..level import degrees_of_freedom
from ..params import EngineParams
from ..results import FixResult, Outcome, chi2_gate
from .fusion import Fusion
from .rows import fill_dvl, refer_to_now, walk_to_now
from .sage_husa import Printed, lower_inverse, sandwich

PING_AGE_NS = 1_000_000_000
"""An older ping is no velocity at the time of a fix; the position rows then enter alone."""
LIMITS = np.concatenate([np.full(3, 1.0), np.full(3, 100.0), np.full(3, 1e5)])
"""Attitude [rad], velocity [m/s], position [m]: with larger errors a linear error model means
nothing (1 rad is no small angle, 100 km turn the grid axes by 16 mrad), nor is any vehicle here
that fast."""
_BLOCKS = (
    ('attitude [rad]', X.phi_G),
    ('velocity [m/s]', X.dv_G),
    ('position [m]', X.dr_e),
)
_NONE = np.full(3, np.nan)
_KEPT = Outcome(False, _NONE, _NONE, float('nan'), 0, float('inf'))
"""Of a ping that waits for a fix: no rows were judged."""
_SIX = np.arange(6)
_POSITION = np.arange(3, 6)


Rows = NDArray[np.intp]


@dataclass
class _Ping:
    """A DVL velocity resolved at its stamp, beside the estimate then."""

    stamp_ns: int
    z: Array
    R: Array
    step: int
    correction: int
    used: bool = False


class Published(Fusion):
    """Conventional or modified AKF as printed.

    Parameters
    ----------
    params, initial, stamp_ns
        As for :class:`Fusion`; ``delay_handling`` is ignore or back_propagate.
    """

    def __init__(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> None:
        super().__init__(params, initial, stamp_ns)
        configuration = params.resolved()
        self._late = configuration.delay_handling == 'back_propagate'
        self._gate = configuration.gate_probability
        self._printed = Printed(
            simplified=configuration.noise_adaptation == 'sage_husa_published',
            forgetting=params.forgetting,
            start=params.published_start,
            size=kf.N,
        )
        self.filter.process = self._printed
        self._pings: deque[_Ping] = deque()
        self._history_ns = round(params.history_s * 1e9)
        # A start that is more uncertain than the limits is the user's own choice.
        self._limits = np.maximum(
            LIMITS, 3.0 * np.sqrt(np.diagonal(self.filter.state.P)[: kf.NAV])
        )

    def imu(self, sample: ImuSample) -> None:
        """Advance by one IMU sample; q-hat moves the state at the end of a step."""
        f = self.filter
        step = f.history.step
        with np.errstate(all='ignore'):  # an overflow ends as a divergence, not as a warning
            f.imu(sample)
        if f.history.step != step:
            with np.errstate(all='ignore'):
                drift = self._printed.q * self._printed.last_dt
            self._check_spread()
            self._check(drift, 'q-hat')
            if drift.any():
                f.replace_estimate(f.state.P, -drift)

    def local(self, event: Local) -> Outcome:
        """Fuse a depth; store a DVL ping, resolved with the present estimate, for the next fix."""
        f, w = self.filter, self.filter.work
        if isinstance(event, DepthSample):
            outcome = f.depth(event)
            self._check(w.x, 'a depth')
            return outcome
        if isinstance(event, HeadingSample):  # the paper has none
            return _KEPT
        fill_dvl(f, event)
        while self._pings and self._pings[0].stamp_ns < event.stamp_ns - self._history_ns:
            self._pings.popleft()
        self._pings.append(
            _Ping(event.stamp_ns, w.z.copy(), w.R.copy(), f.history.step, f.history.correction)
        )
        return _KEPT

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix together with the DVL velocity at its time."""
        f, w = self.filter, self.filter.work
        when = fix.validity_ns if self._late else fix.receive_ns
        epoch = f.history.before(when) if self._late else self._present()
        if epoch is None:
            return None
        self._fuse_at(fix, epoch, when)
        w.H[:, : kf.NAV - 3] = 0.0
        w.H[:, kf.NAV :] = 0.0
        steps = walk_to_now(f, epoch.step, epoch.correction) if self._late else 0
        H, z, R = w.H.copy(), w.z.copy(), w.R.copy()
        ping = self._ping(when)
        rows = _POSITION
        if ping is not None:
            rows = _SIX
            H, z = np.vstack([self._velocity(ping), H]), np.concatenate([w.z, z])
            R = np.block([[ping.R, np.zeros((3, 3))], [np.zeros((3, 3)), R]])
        with np.errstate(all='ignore'):
            outcome = self._update(H, z, R, rows, len(rows) - 3 + degrees_of_freedom(fix))
        if ping is not None and outcome.fused:
            ping.used = True
        return FixResult(outcome, steps)

    def _ping(self, when_ns: int) -> _Ping | None:
        """Newest unused ping at or before a stamp [ns]; None without one."""
        number = bisect_right(self._pings, when_ns, key=lambda p: p.stamp_ns) - 1
        if number < 0:
            return None
        ping, history = self._pings[number], self.filter.history
        stored = history.step - ping.step < len(
            history.transitions
        ) and history.correction - ping.correction <= len(history.corrections)
        good = stored and not ping.used and when_ns - ping.stamp_ns <= PING_AGE_NS
        return ping if good else None

    def _velocity(self, ping: _Ping) -> Array:
        """Rows of a ping, (3, 24); its innovation, referred to now, is left in the filter's z."""
        f, w = self.filter, self.filter.work
        w.H[:] = 0.0
        w.H[:, X.dv_G] = np.eye(3)
        w.z[:] = ping.z
        if self._late:
            walk_to_now(f, ping.step, ping.correction)
        else:
            refer_to_now(f, ping.correction)
        return w.H

    def _update(self, H: Array, z: Array, stated: Array, rows: Rows, dof: int) -> Outcome:
        """Eqs. (31)-(34) or (58)-(61), then the adaptation; feeds the correction back.

        ``dof`` are the degrees of freedom of the rows.
        """
        f, m = self.filter, len(rows)
        v = z - self._printed.r[rows]
        P = f.state.P.copy()
        PHt = np.einsum('ik,ak->ia', P, H)
        HPHt = np.einsum('ak,kb->ab', H, PHt)
        R = self._printed.noise(rows, stated)
        S, L = HPHt + 0.5 * (R + R.T), np.zeros((m, m))
        if not kf.cholesky(L, S, m):
            raise FilterDivergence('an innovation covariance is not positive definite')
        inverse = lower_inverse(L)
        whitened = np.einsum('ab,b->a', inverse, v)
        nis = float(np.sum(whitened**2))
        gate = chi2_gate(self._gate, dof)
        variance = np.diagonal(S)[-3:].copy()
        outcome = Outcome(nis <= gate, z[-3:].copy(), variance, nis, dof, gate)
        if not outcome.fused:
            return outcome
        K = np.einsum('ia,ba,bc->ic', PHt, inverse, inverse)
        x = np.einsum('ia,a->i', K, v)
        self._check(x, 'a fix')
        after = sandwich(np.eye(kf.N) - np.einsum('ia,ak->ik', K, H), P) + sandwich(K, R)
        after = 0.5 * (after + after.T)
        self._printed.learn_printed(x, z, v, P, after, HPHt, rows)
        f.replace_estimate(after, -x)
        self._check_spread()
        return outcome

    def _check(self, x: Array, what: str) -> None:
        """Raise FilterDivergence for a correction beyond the linear error model."""
        for name, i in _BLOCKS:
            size, limit = float(np.abs(x[i]).max()), float(self._limits[i].min())
            if not size <= limit:
                raise FilterDivergence(
                    f'the correction of {name} by {what} is {size:.3g}, beyond {limit:.3g}, '
                    'where a linear error model ends'
                )

    def _check_spread(self) -> None:
        """Raise FilterDivergence for a 1-sigma beyond the linear error model."""
        variances = np.diagonal(self.filter.state.P)
        for name, i in _BLOCKS:
            largest, limit = float(variances[i].max()), float(self._limits[i].min())
            if not largest <= limit**2:
                raise FilterDivergence(
                    f'the 1-sigma of {name} is {largest**0.5:.3g}, beyond {limit:.3g}, '
                    'where a linear error model ends'
                )
