"""`clone`: late fixes exactly, on the linearization that was stored when the inputs came.

A single late fix is carried as a clone of the past position through the stored steps and
measurements (a fixed-point smoother), at a fraction of the cost of going back. When another late
fix was fused inside those steps, a pass that forgets their correlation would be wrong by
kilometres within minutes; then all of them are put where they belong and the stored linear steps
are filtered again. Both give what a filter with explicitly augmented states gives. Gates and
linearization stay as they were decided.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field, replace

import numpy as np

from ...kernels import filter as kf
from ...kernels import filter_clone as kc
from ..events import Array, DepthSample, DvlPing, Fix, ImuSample, InitialState, OrderKey, Rank
from ..params import EngineParams
from .fusion import FixResult, Fusion
from .navigation import Outcome


@dataclass
class _Step:
    """A covariance step: transition, added variances, covariance after it."""

    key: OrderKey
    epochs: int
    Phi: Array
    q: Array
    P: Array


@dataclass
class _Update:
    """A fused measurement: rows, noise, innovation, correction, gain, S and its factor."""

    key: OrderKey
    epochs: int
    m: int
    H: Array
    R: Array
    z: Array
    x: Array
    K: Array
    S: Array
    L: Array
    late: _Late | None = None


@dataclass
class _Late:
    """A late fix where it belongs: rows and innovation against the estimate in force then."""

    key: OrderKey
    epochs: int
    H: Array
    R: Array
    z: Array


@dataclass
class _Rerun:
    """State of a second pass over stored steps: covariance, and new estimate minus old."""

    P: Array
    change: Array
    operations: list[_Step | _Update] = field(default_factory=list)


class Clone(Fusion):
    """Late fixes by smoothing over stored linear steps.

    Parameters
    ----------
    params, initial, stamp_ns
        As for :class:`Fusion`.
    """

    def __init__(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> None:
        super().__init__(params, initial, stamp_ns)
        self._length_ns = round(params.history_s * 1e9)
        start = _Step(
            (stamp_ns, Rank.IMU, 0, 0), 0, np.eye(kf.N), np.zeros(kf.N), self.filter.P.copy()
        )
        self._operations: list[_Step | _Update] = [start]
        self._work9 = np.zeros((kf.NAV, 3))
        self._work6 = np.zeros((6, 3))

    def imu(self, sample: ImuSample) -> None:
        """Advance by one IMU sample."""
        f = self.filter
        step = f.history.step
        f.imu(sample)
        if f.history.step != step:
            Phi = f.history.transitions[f.history.step % len(f.history.transitions)]
            # The epoch of this sample is stored after the step that it ends.
            self._operations.append(
                _Step(sample.key, f.history.count - 1, Phi.copy(), f.last_q, f.P.copy())
            )
            self._forget(sample.stamp_ns - self._length_ns)

    def local(self, event: DvlPing | DepthSample) -> Outcome:
        """Fuse DVL or depth."""
        outcome = super().local(event)
        if outcome.fused:
            self._operations.append(self._last_update(event.key, outcome.dof))
        return outcome

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix; lazily when no other late fix lies between, by filtering again otherwise."""
        f = self.filter
        key: OrderKey = (fix.validity_ns, Rank.FIX, fix.order, fix.arrival)
        epoch = f.history.before(fix.validity_ns)
        place = bisect_right(self._operations, key, key=lambda o: o.key)
        if epoch is None or place == 0 or not isinstance(self._operations[0], _Step):
            return None
        steps = f.history.step - epoch.step
        self._fuse_at(fix, epoch, fix.validity_ns)
        for o in self._operations[:place]:  # fed back after the epoch was stored, before the fix
            if isinstance(o, _Update) and o.epochs > epoch.number:
                f.z -= np.sum(f.H * o.x, axis=1)
        late = _Late(key, epoch.number + 1, f.H.copy(), f.R.copy(), f.z.copy())
        if any(isinstance(o, _Update) and o.late is not None for o in self._operations[place:]):
            return FixResult(self._filter_again(late, place), steps)
        return FixResult(self._smooth(late, place, fix), steps)

    # -- a single late fix ------------------------------------------------------------------------

    def _smooth(self, late: _Late, place: int, fix: Fix) -> Outcome:
        C, P_cc, z = np.zeros((kf.N, 3)), np.zeros((3, 3)), late.z.copy()
        kc.clone_begin(C, P_cc, self._covariance_at(place), late.H)
        for o in self._operations[place:]:
            if isinstance(o, _Step):
                kc.clone_step(C, o.Phi, self._work9)
            else:
                kc.clone_measurement(C, P_cc, z, o.H, o.L, o.K, o.z, o.m, self._work6)
        outcome, (x, K, S, L, R) = self.filter.fuse_clone(C, P_cc, late.R, z, self._noise_fix)
        if outcome.fused:
            key: OrderKey = (fix.receive_ns, Rank.FIX, fix.order, fix.arrival)
            count = self.filter.history.count
            late = replace(late, R=R)  # as it was used: adapted noise is not decided again
            self._operations.append(_Update(key, count, 3, late.H, R, z, x, K, S, L, late=late))
        return outcome

    def _covariance_at(self, place: int) -> Array:
        """Covariance after the operations before ``place``."""
        start = self._step_before(place)
        step = self._operations[start]
        if not isinstance(step, _Step):
            raise RuntimeError('the stored operations do not begin with a covariance step')
        P = step.P.copy()
        for o in self._operations[start + 1 : place]:
            if isinstance(o, _Update):
                kc.drop_information(P, o.K, o.S, o.m)
        return P

    def _step_before(self, place: int) -> int:
        while not isinstance(self._operations[place - 1], _Step):
            place -= 1
        return place - 1

    # -- several late fixes -----------------------------------------------------------------------

    def _filter_again(self, new: _Late, place: int) -> Outcome:
        start = self._first_affected(place)
        base = self._step_before(start)
        step = self._operations[base]
        if not isinstance(step, _Step):
            raise RuntimeError('the stored operations do not begin with a covariance step')
        run = _Rerun(self._covariance_at(start), np.zeros(kf.N), self._operations[:start])
        pending = [o.late for o in self._operations[start:] if isinstance(o, _Update) and o.late]
        # A late fix that was taken out again: what it had done to the estimate goes with it.
        waiting = sorted([*pending, new], key=lambda late: late.key)
        outcome: Outcome | None = None
        for o in self._operations[start:]:
            while waiting and waiting[0].key < o.key:
                outcome = self._insert(run, waiting.pop(0), new) or outcome
            self._shift_epochs(run, o.epochs)
            self._repeat(run, o)
        while waiting:
            outcome = self._insert(run, waiting.pop(0), new) or outcome
        self._shift_epochs(run, self.filter.history.count)
        self._operations = run.operations
        self.filter.replace_estimate(run.P, run.change)
        if outcome is None:
            raise RuntimeError('the fix was not among those that were put in their places')
        return outcome

    def _first_affected(self, place: int) -> int:
        """Where filtering again must begin: before every fix fused inside what is repeated."""
        while True:
            inside = [
                bisect_right(self._operations, o.late.key, key=lambda o: o.key)
                for o in self._operations[place:]
                if isinstance(o, _Update) and o.late is not None
            ]
            first = min([place, *inside])
            if first == place:
                return place
            place = first

    def _insert(self, run: _Rerun, late: _Late, new: _Late) -> Outcome | None:
        """Fuse a late fix at its place; the outcome if it is the new one."""
        self._shift_epochs(run, late.epochs)
        z = late.z + np.sum(late.H * run.change, axis=1)
        noise = self._noise_fix if late is new else None
        outcome, (x, K, S, L, R) = self.filter.fuse_into(
            run.P, late.H, late.R, z, noise, gated=late is new
        )
        if outcome.fused:
            run.change -= x
            run.operations.append(_Update(late.key, late.epochs, 3, late.H, R, z, x, K, S, L))
        return outcome if late is new else None

    def _repeat(self, run: _Rerun, o: _Step | _Update) -> None:
        if isinstance(o, _Step):
            kf.predict(run.P, o.Phi, o.q, self.filter.scratch['M'])
            run.change[:] = np.sum(o.Phi * run.change, axis=1)
            run.operations.append(replace(o, P=run.P.copy()))
        elif o.late is not None:
            run.change += o.x
        else:
            z = o.z + np.sum(o.H * run.change, axis=1)
            _, (x, K, S, L, R) = self.filter.fuse_into(
                run.P, o.H, o.R, z, None, gated=False, m=o.m
            )
            run.change += o.x - x
            run.operations.append(_Update(o.key, o.epochs, o.m, o.H, R, z, x, K, S, L))

    def _shift_epochs(self, run: _Rerun, until: int) -> None:
        """Move the stored positions between the last operation and this one by the change."""
        last = run.operations[-1].epochs
        self.filter.history.shift(last, until, run.change, self.filter.C_e_G)

    def _last_update(self, key: OrderKey, m: int) -> _Update:
        f = self.filter
        w = f.scratch
        return _Update(
            key,
            f.history.count,
            m,
            f.H.copy(),
            f.R.copy(),
            f.z.copy(),
            f.x.copy(),
            w['K'].copy(),
            w['S'].copy(),
            w['L'].copy(),
        )

    def _forget(self, before_ns: int) -> None:
        """Drop what is older than the history, in bulk, so that a step stands first."""
        if self._operations[0].key[0] < before_ns - self._length_ns // 4:
            keep = bisect_right(self._operations, before_ns, key=lambda o: o.key[0])
            del self._operations[: self._step_before(max(keep, 1))]
