"""Identifier of drag and current: collects its input, triggers, identifies.

In: fixes as they become known, in any order, and attitude and thrust in their order. Out:
`result.Identification`. `EngineParams` inherits `params.IdentificationParams`; an engine
does this (stamps in ns, axes of the station frame)::

    identifier.add_attitude(imu.stamp_ns, imu.C_b_G, imu.omega_ib_b)
    identifier.add_control(control.stamp_ns, control.force_b)
    identifier.add_fix(position_fix(fix.validity_ns, fix.polar, z), nis)   # gated ones too
    trigger = identifier.due()              # or COMMAND
    if trigger:
        result = identifier.identify(stamp_ns, trigger)
"""

from __future__ import annotations

import bisect
import math
from typing import Any

import numpy as np

from ..arrays import Array
from . import published, robust
from .params import IdentificationParams
from .result import Identification
from .result import IdentificationVerdict as Verdict
from .spread import scaled_condition
from .triggers import OFFLINE, Trigger
from .verdict import judge_fit, judge_minimum
from .window import Log, PositionFix, Window, make_window

_ATTITUDE_NS = 100_000_000
_LEAD_NS = 10_000_000_000
"""Length of the log before the oldest fix, in which errors of the track's start decay."""
_SLACK = 600
"""Number of superfluous rows of the log before they are dropped."""


class Identifier:
    """Window, trigger and methods of one vehicle.

    A fix whose validity is known already, or that is older than a full window, changes nothing.
    Attitude is kept ten times a second. Samples that are older than the last one, or not finite,
    are left out: gaps are bridged as the window's limit allows.
    """

    def __init__(self, params: IdentificationParams) -> None:
        """Identifier with an empty window."""
        self._params = params
        self._window_ns = int(params.identify_window_s * 1e9)
        self._trigger = Trigger(params)
        self._fixes: list[PositionFix] = []
        self._attitude: list[tuple[int, float, float, float]] = []
        self._force: list[tuple[int, float]] = []

    @property
    def fixes(self) -> int:
        """Number of fixes in the window."""
        return len(self._fixes)

    @property
    def mean_nis(self) -> float:
        """Mean NIS used by the trigger; NaN until there are enough."""
        return self._trigger.mean_nis

    def add_attitude(self, stamp_ns: int, C_b_G: Array, omega_b: Array) -> None:
        """Store a measured attitude (3, 3) and body rates (3,) [rad/s]."""
        pitch = -math.asin(min(max(float(C_b_G[2, 0]), -1.0), 1.0))
        psi = math.atan2(float(C_b_G[1, 0]), float(C_b_G[0, 0]))
        self.add_heading(stamp_ns, psi, pitch, float(omega_b[2]))

    def add_heading(self, stamp_ns: int, psi: float, pitch: float, yaw_rate: float) -> None:
        """Store measured heading, pitch (nose down) [rad] and body z rate [rad/s]."""
        if self._attitude and stamp_ns < self._attitude[-1][0] + _ATTITUDE_NS:
            return
        if math.isfinite(psi + pitch + yaw_rate):
            self._attitude.append((stamp_ns, psi, pitch, yaw_rate))
            self._drop_older(self._attitude, stamp_ns - 2 * self._window_ns)

    def add_control(self, stamp_ns: int, force_b: Array) -> None:
        """Store the thrust (3,) [N] that holds from the stamp on."""
        force = float(force_b[0])
        if math.isfinite(force) and (not self._force or stamp_ns > self._force[-1][0]):
            self._force.append((stamp_ns, force))
            self._drop_older(self._force, stamp_ns - 2 * self._window_ns)

    def add_fix(self, fix: PositionFix, nis: float = math.nan) -> None:
        """Store a fix, and its NIS in the filter before the gate; NaN without."""
        if not (math.isfinite(fix.x + fix.y) and np.isfinite(fix.covariance).all()):
            return
        at = bisect.bisect_left(self._fixes, fix.validity_ns, key=lambda f: f.validity_ns)
        if at < len(self._fixes) and self._fixes[at].validity_ns == fix.validity_ns:
            return
        if at == 0 and len(self._fixes) >= self._params.identify_fixes:
            return
        self._fixes.insert(at, fix)
        self._forget()
        self._trigger.add_fix()
        if math.isfinite(nis):
            self._trigger.add_nis(nis)

    def due(self) -> str | None:
        """Return the trigger of an identification that is due, else None."""
        return self._trigger.due()

    def window(self) -> Window | None:
        """Input of an identification now; None without a fix that the log covers."""
        return make_window(
            self._fixes,
            self._log(),
            most=self._params.identify_fixes,
            longest_gap_s=self._params.identify_gap_s,
            lead_s=_LEAD_NS * 1e-9,
        )

    def identify(
        self,
        stamp_ns: int,
        trigger: str,
        method: str | None = None,
        start: Array | None = None,
    ) -> Identification:
        """Identification from the window.

        Parameters
        ----------
        stamp_ns : int
            Place of the result in the order of events.
        trigger : str
            ``count``, ``nis``, ``command`` or ``offline``.
        method : str, optional
            ``robust`` or ``published``; by default the parameter's, or robust if that is none.
        start : (2,) array, optional
            Start of the published method's track; the first fix by default.
        """
        chosen = method or self._params.identify_method
        result = identify(
            self.window(),
            self._params,
            stamp_ns=stamp_ns,
            trigger=trigger,
            method='robust' if chosen == 'none' else chosen,
            start=start,
        )
        self._trigger.done()
        return result

    def _log(self) -> Log:
        attitude = np.array([row[1:] for row in self._attitude], dtype=np.float64).reshape(-1, 3)
        return Log(
            np.array([row[0] for row in self._attitude], dtype=np.int64),
            np.ascontiguousarray(attitude[:, 0]),
            np.ascontiguousarray(attitude[:, 1]),
            np.ascontiguousarray(attitude[:, 2]),
            np.array([stamp for stamp, _ in self._force], dtype=np.int64),
            np.array([force for _, force in self._force], dtype=np.float64),
        )

    def _forget(self) -> None:
        """Drop fixes and log that no later window needs."""
        oldest = self._fixes[-1].validity_ns - self._window_ns
        late = bisect.bisect_left(self._fixes, oldest, key=lambda f: f.validity_ns)
        del self._fixes[: max(late, len(self._fixes) - self._params.identify_fixes)]
        # A full window accepts no older fix; another one may still receive it, late.
        full = len(self._fixes) == self._params.identify_fixes
        needed = (self._fixes[0].validity_ns if full else oldest) - _LEAD_NS
        self._drop_older(self._attitude, needed)
        self._drop_older(self._force, needed)

    @staticmethod
    def _drop_older(rows: list[Any], needed_ns: int) -> None:
        """Drop rows before a stamp except the last, which is held or interpolated; seldom."""
        if len(rows) > _SLACK and rows[_SLACK][0] < needed_ns:
            del rows[: bisect.bisect_left(rows, needed_ns, key=lambda row: row[0]) - 1]


def identify(
    window: Window | None,
    params: IdentificationParams,
    *,
    stamp_ns: int,
    trigger: str,
    method: str,
    start: Array | None = None,
) -> Identification:
    """Identification of drag and current from a window; arguments as `Identifier.identify`."""
    names = robust.NAMES if method == 'robust' else published.NAMES
    least = params.identify_least_fixes
    if window is None or window.fixes < least:
        n = len(names)
        count = 0 if window is None else window.fixes
        return Identification(
            stamp_ns=stamp_ns,
            method=method,
            verdict=Verdict.TOO_FEW_FIXES,
            reason=f'{count} fixes with attitude and thrust around them (least {least})',
            trigger=trigger,
            fixes=count,
            first_validity_ns=0 if window is None else int(window.validity_ns[0]),
            last_validity_ns=0 if window is None else int(window.validity_ns[-1]),
            names=names,
            values=np.full(n, np.nan),
            covariance=np.full((n, n), np.nan),
            condition_number=math.nan,
            cost=math.nan,
            iterations=0,
        )
    if method == 'robust':
        fit = robust.fit(window, params.vehicle_model(), params.model_speed, limits_of(params))
        verdict, reason = judge_fit(window, fit, params)
        values, covariance, condition = fit.values, fit.covariance, fit.condition_number
        cost, iterations, used = fit.cost, fit.iterations, fit.fixes
    else:
        model = params.vehicle_model()
        minimum = published.levenberg_marquardt(
            published.Samples.of(window, start),
            np.array([model.drag_linear[0], model.drag_quadratic[0], 0.0, 0.0]),
            adaptive=params.identify_damping == 'adaptive',
            mu=params.identify_mu,
            epsilon=params.identify_epsilon,
            most_iterations=params.identify_iterations,
        )
        verdict, reason = judge_minimum(minimum, params)
        values, covariance = minimum.values, minimum.covariance(window.fixes)
        condition = scaled_condition(minimum.normal)
        cost, iterations, used = minimum.cost, minimum.iterations, window.fixes
    return Identification(
        stamp_ns=stamp_ns,
        method=method,
        verdict=verdict,
        reason=reason,
        trigger=trigger,
        fixes=used,
        first_validity_ns=int(window.validity_ns[0]),
        last_validity_ns=int(window.validity_ns[-1]),
        names=names,
        values=values,
        covariance=covariance,
        condition_number=condition,
        cost=cost,
        iterations=iterations,
    )


def limits_of(params: IdentificationParams) -> robust.Limits:
    """Bounds of the robust fit by the parameters."""
    return robust.Limits(
        drag_ratio=params.identify_drag_ratio,
        current=params.identify_current_limit,
        heading_bias_sigma=params.identify_heading_bias_sigma,
        current_walks=params.identify_current_walks,
        loss_scale=params.identify_loss_scale,
    )


def warm_up() -> None:
    """Compile the kernels of an identification, on a vehicle that turns once in three minutes."""
    identifier = Identifier(IdentificationParams())
    for k in range(1800):
        stamp_ns = (k + 1) * _ATTITUDE_NS
        identifier.add_heading(stamp_ns, 0.0035 * k, 0.0, 0.035)
        identifier.add_control(stamp_ns, np.array([50.0, 0.0, 0.0]))
        if k % 30 == 15:
            x, y = 20.0 * math.sin(0.0035 * k), -20.0 * math.cos(0.0035 * k)
            identifier.add_fix(PositionFix(stamp_ns, x, y, np.eye(2)))
    identifier.identify(0, OFFLINE, 'robust')
