"""The navigation engine: stamped events in, stamped estimates and receipts out.

It owns no clock, no thread and no randomness. The live node and the offline replay drive the same
object with events in the same total order, so they get the same bytes. Events must come in that
order: `reorder.py` sees to it live, `replay` sorts the bag.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..arrays import Array
from ..errors import FilterDivergence
from .beginning import Beginning
from .checks import aiding_warning, history_warning
from .clock_record import ClockRecord
from .driver import Adaptation, Driver, Make
from .events import (
    Command,
    CommandKind,
    ControlSample,
    DvlPing,
    Event,
    Fix,
    HeadingSample,
    ImuSample,
    InitialState,
    Local,
    OrderKey,
    kind_of,
)
from .fix_decisions import FixDecisions
from .health.conditions import Health
from .health_monitor import HealthMonitor
from .imu_sequence import ImuSequence
from .integrity import Integrity
from .ledger import FixLedger
from .lever import Arm, params_at_imu
from .outputs import Output, Receipt
from .params import EngineParams
from .plausibility import widened_pings
from .receipts import receipt_of
from .reconsider import reconsider
from .refusals import unusable_local
from .restored import NOT_RESTORED, Restored
from .results import Outcome
from .saved import SavedState
from .sins.filter import NavigationFilter
from .sins.fusion import Fusion
from .station.identify import make_adaptation
from .strategies import make_fusion
from .switches import Switches
from .verdicts import Verdict

_SECOND_NS = 1_000_000_000
_STEPPED_BACK = 5
"""So many IMU samples in a row, and none between them in time, are a clock that stepped back."""


class Engine:
    """Navigation of one vehicle.

    Parameters
    ----------
    params : EngineParams
        Everything that can be chosen; lever arms from base_link.
    make : callable, optional
        Makes the filter, where it is not that of the configuration.
    imu_lever_b : (3,) array_like, optional
        IMU from base_link, body axes [m]. Parameters, commands, estimates and `state` are of
        base_link; the filter, and a state for a restart, of the IMU's point.

    Attributes
    ----------
    fusion : Driver or None
        The filter with its measurements; None before there is a state.
    arm : Arm or None
        Moves between base_link and the IMU; None where they are one point.
    adaptation : Adaptation or None
        What identifies; None in a mode without.
    ledger : FixLedger
    last_imu_ns, due_ns : int or None
        Stamp of the newest IMU sample; of the estimate that is due.
    too_sure_ns : int or None
        When a ping last stated less noise than pings have [ns]; set by whoever uses columns.
    behind_s : float
        How far the IMU's stamps are behind the newest one since its clock stepped back [s].
    """

    def __init__(
        self,
        params: EngineParams,
        make: Make | None = None,
        *,
        imu_lever_b: Sequence[float] | Array = (0.0, 0.0, 0.0),
    ) -> None:
        lever_b = np.asarray(imu_lever_b, dtype=np.float64)
        self.arm = Arm(params, lever_b) if lever_b.any() else None
        params = params if self.arm is None else params_at_imu(params, lever_b)
        self.params = params
        self.configuration = params.resolved()
        self._make_fusion = make or make_fusion(params)
        self._output_ns = round(params.output_period_s * 1e9)
        self.fusion: Driver | None = None
        self._thrust: ControlSample | None = None
        self.adaptation: Adaptation | None = make_adaptation(params)
        self._beginning = Beginning(params, self.arm)
        self._last_key: OrderKey | None = None
        self.last_imu_ns: int | None = None
        self.due_ns: int | None = None
        self._imu_late, self.behind_s = 0, 0.0
        self.verdicts: Counter[Verdict] = Counter()
        self.gated: Counter[str] = Counter()
        self.fused: Counter[str] = Counter()
        self.resets = 0
        self.health: Health | None = None
        self.imu_gaps = 0
        self._imu_sequence = ImuSequence(params)
        self.switches = Switches()
        self.clock = ClockRecord('imu/data' if params.mode == 'station' else 'imu/data_raw')
        self.divergence = ''
        self.restored = NOT_RESTORED
        self.too_sure_ns: int | None = None
        self.ledger = FixLedger(params, self.verdicts, self.fused)
        self._decisions = FixDecisions(params, self.ledger)
        self._monitor = HealthMonitor(params, self.ledger, self.switches, self.clock)
        self._start_ns = 0

    # -- driving ----------------------------------------------------------------------------------

    def process(self, event: Event) -> Iterator[Output]:
        """Process the next event of the total order; yields the resulting estimates and receipts.

        Raises
        ------
        ValueError
            When the event does not come after the one before: a fault of the caller.
        """
        self.admit(event)
        yield from self.advance(event.stamp_ns)
        if isinstance(event, Command):
            yield from self._command(event)
            return
        refused = self.switches.refusal(event)
        if isinstance(event, Fix):
            self.ledger.came(event, wanted=refused is None)
            if refused is None:
                yield from self._fix(event)
            else:
                yield self._count(self._receipt(event, event.stamp_ns, *refused))
            return
        refused = refused or unusable_local(self.params, event, self.last_imu_ns)
        if refused is None and isinstance(event, ImuSample):
            refused = event.refused or self._imu_sequence.refusal(
                event.stamp_ns, event.omega_ib_b, event.f_b
            )
        if refused is not None:
            yield self._count(self._receipt(event, event.stamp_ns, *refused))
        elif isinstance(event, ImuSample):
            self._imu(event)
        elif isinstance(event, ControlSample):
            self._control(event)
        else:
            self._local(event)

    def admit(self, event: Event) -> None:
        """Check that an event comes after the one before in the total order; else ValueError."""
        if self._last_key is not None and event.key <= self._last_key:
            raise ValueError(
                f'event {event.key} after {self._last_key}: events must come in order'
            )
        self._last_key = event.key

    def advance(self, stamp_ns: int) -> Iterator[Output]:
        """Yield the estimate that is due before ``stamp_ns``, if there is one.

        No event before that stamp may come any more.
        """
        if self.due_ns is not None and stamp_ns > self.due_ns:
            self.due_ns = None
            if self.fusion is not None:
                estimate = self.fusion.estimate(self.fix_counts())
                yield estimate if self.arm is None else self.arm.moved(estimate)

    def finish(self) -> Iterator[Output]:
        """Yield the estimate that is still due at the end of the events."""
        if self.due_ns is not None:
            yield from self.advance(self.due_ns + 1)

    def refuse(self, event: Event, verdict: Verdict, reason: str, stamp_ns: int) -> Receipt:
        """Receipt of a message that never became an event, decided at ``stamp_ns``."""
        if isinstance(event, ImuSample) and verdict is Verdict.TOO_LATE:
            self._imu_late += 1
            if self._imu_late >= _STEPPED_BACK and self.last_imu_ns is not None:
                self.behind_s = (self.last_imu_ns - event.stamp_ns) * 1e-9
        return self._count(self._receipt(event, stamp_ns, verdict, reason))

    @property
    def navigating(self) -> bool:
        """Whether the filter has a state."""
        return self.fusion is not None

    @property
    def integrity(self) -> Integrity:
        """Agreement of fixes with the estimate, at the newest IMU sample."""
        return self.ledger.integrity.state(self.last_imu_ns or 0)

    @property
    def aiding_warning(self) -> str:
        """Warning that the vehicle's model lacks thrust or replaces the DVL; empty if not."""
        return aiding_warning(self.aided)

    @property
    def aided(self) -> NavigationFilter | None:
        """The filter, where a model of the vehicle aids it; None without a state, too."""
        if isinstance(self.fusion, Fusion) and self.params.model_aiding:
            return self.fusion.filter
        return None

    @property
    def history_warning(self) -> str:
        """Warning that sensors are faster than the stored history has room for; empty if not."""
        return history_warning(self.params, self.fusion, self._start_ns)

    def fix_counts(self) -> tuple[int, int, int]:
        """Number of fixes received, of fixes fused, and newest validity of a fused one [ns]."""
        return self.ledger.counts()

    # -- events -----------------------------------------------------------------------------------

    def _imu(self, sample: ImuSample) -> None:
        before_ns = sample.stamp_ns if self.last_imu_ns is None else self.last_imu_ns
        self.imu_gaps += sample.stamp_ns - before_ns > self.params.max_imu_gap_s * 1e9
        self.last_imu_ns = sample.stamp_ns
        self._imu_late, self.behind_s = 0, 0.0
        if self.arm is not None:
            self.arm.imu(sample.stamp_ns, sample.omega_ib_b)
        if self.adaptation is not None and sample.C_b_G is not None:
            force_b = np.zeros(3) if self._thrust is None else self._thrust.force_b
            self.adaptation.log(sample.stamp_ns, sample.C_b_G, sample.omega_ib_b, force_b)
        if self.fusion is None:
            begins = None if self.divergence else self._beginning.at(sample)
            if begins is not None:
                initial, ping = begins
                self.fusion = self._make_fusion(self.params, initial, sample.stamp_ns)
                self.fusion.begin(sample)
                if self._thrust is not None:  # it still holds
                    self.fusion.control(self._thrust)
                self.due_ns = self._start_ns = sample.stamp_ns
                self.ledger.integrity.unused.began(sample.stamp_ns)
                if ping is not None:
                    self._local(ping)
            return
        if sample.stamp_ns // _SECOND_NS != before_ns // _SECOND_NS:
            self.look()
        try:
            self.fusion.imu(sample)
        except FilterDivergence as error:
            self.diverge(str(error), sample.stamp_ns)
            if self.fusion is None:
                return
        if sample.stamp_ns // self._output_ns != before_ns // self._output_ns:
            self.due_ns = sample.stamp_ns

    def look(self) -> Health | None:
        """Health of the navigation at the newest sample, stored as `health`; None without one."""
        self.health = None
        if self.fusion is None:
            return None
        self.health = self._monitor.look(
            self.fusion, self.restored, self._beginning, self.resets, self.too_sure_ns
        )
        return self.health

    def _control(self, sample: ControlSample) -> None:
        self._thrust = sample
        if self.fusion is not None:
            self.fusion.control(sample)

    def _local(self, event: Local) -> None:
        """Fuse a ping, depth or heading, which are never treated as delayed."""
        name = kind_of(event)
        if isinstance(event, DvlPing):
            if not (event.valid or event.water):
                self.gated[name] += 1
                return
            if not event.water:
                self._beginning.ping(event)
            covariance_m = widened_pings(event.covariance_m, self.params.dvl_sigma)
            if covariance_m is not event.covariance_m:
                self.too_sure_ns = event.stamp_ns
                event = replace(event, covariance_m=covariance_m)
        unused = isinstance(event, HeadingSample) and not self.params.uses_heading
        if self.fusion is None or unused:
            return
        try:
            outcome = self.fusion.local(event)
        except FilterDivergence as error:
            self.diverge(str(error), event.stamp_ns)
            return
        if not outcome.dof:  # kept for a fix to come, as the paper has it
            return
        (self.fused if outcome.fused else self.gated)[name] += 1

    def _fix(self, fix: Fix) -> Iterator[Output]:
        """Yield receipts of a fix and of others whose verdict it changed."""
        at_e = self._beginning.watched(self.fusion, self.ledger.fused_since_start)
        try:
            receipts, outcome, identified = self._decisions.decide(
                fix, self.fusion, self._start_ns, self.adaptation, self.divergence
            )
            if outcome is not None:
                self._beginning.watch(self.fusion, at_e)
                self.reconsider(outcome)
        except FilterDivergence as error:
            self.diverge(str(error), fix.receive_ns)
            receipts = [self._receipt(fix, fix.receive_ns, Verdict.NOT_READY, self.why_lost)]
            identified = None
        for receipt in receipts:
            yield self._count(receipt)
        if identified is not None:
            yield identified

    def reconsider(self, outcome: Outcome) -> None:
        """Judge the estimate by refused fixes, after a fix was decided (engine.reconsider)."""
        if isinstance(self.fusion, Fusion) and self._beginning.state is not None:
            sigma = self._beginning.heading_sigma(self.fusion.stamp_ns)
            self.resets += reconsider(self.fusion, self.ledger, self.params, outcome, sigma)

    def _command(self, command: Command) -> Iterator[Output]:
        if command.kind is CommandKind.IDENTIFY and self.adaptation is not None:
            yield self.adaptation.identify(command.stamp_ns, 'command', self.fusion)
        if command.kind in (CommandKind.SHUTDOWN, CommandKind.IDENTIFY):
            return
        if self.switches.turn(command):
            return
        problem = self._beginning.problem(command.initial_state)
        if problem:
            yield self.refuse(command, Verdict.IMPLAUSIBLE, problem, command.stamp_ns)
            return
        self._beginning.reset(
            command.initial_state, command.stamp_ns, self.fusion, self.ledger.fused_since_start
        )
        self._leave()
        self.resets += 1
        self.due_ns = None
        self.divergence = ''
        self.ledger.start_anew()
        saved = self._beginning.state
        if isinstance(saved, SavedState):
            self.ledger.restore(
                saved.fixes, saved.records, saved.since_start, saved.doubt(), saved.followed
            )
        self.adaptation = make_adaptation(self.params)

    def saved(self) -> SavedState | None:
        """State and fixes as they are now, for a restart; None without a state."""
        if self.fusion is None:
            return None
        saved = self.fusion.saved(self.fix_counts(), self.ledger.packed())
        # Who reads it knows nothing of steps of the clock: it counts by the IMU's own.
        own_ns = self.clock.own_ns(saved.stamp_ns)
        return replace(
            saved,
            stamp_ns=own_ns,
            since_start=self.ledger.fused_since_start,
            lost_heading=self._monitor.heading_to_save(self.fusion),
            followed=self.ledger.integrity.followed.to_save() or saved.followed,
        )

    def state(self) -> InitialState | None:
        """State of base_link as it is now, as one to start from; None without a state."""
        saved = self.saved()
        return saved if saved is None or self.arm is None else self.arm.to_base_link(saved)

    # -- outputs ----------------------------------------------------------------------------------

    def diverge(self, why: str, stamp_ns: int) -> None:
        """Restore the newest sound state after a numerical failure, enlarged.

        Where there is none, drop the state, and store the reason.
        """
        lost, now_ns = self.fusion, self.last_imu_ns
        initial = self._beginning.state
        if lost is not None and now_ns is not None and initial is not None:
            self.fusion = self._make_fusion(self.params, initial, now_ns)
            if self.fusion.restore(lost):
                self.restored = Restored(self.restored.count + 1, stamp_ns, why)
                if self._thrust is not None:
                    self.fusion.control(self._thrust)
                return
        self.divergence = (
            f'{why} (at {stamp_ns * 1e-9:.3f} s); no estimates are published until a reset'
        )
        self._leave()
        self.due_ns = None

    def _leave(self) -> None:
        """Drop the filter; its enlargements of the covariance stay counted."""
        self.resets = max(self.resets, 0 if self.health is None else self.health.resets)
        self.fusion = None
        self.health = None

    @property
    def why_lost(self) -> str:
        """Why the filter was lost last, and what became of it."""
        return self.divergence or f'{self.restored.why}; the newest sound state is restored'

    def _count(self, receipt: Receipt) -> Receipt:
        self.verdicts[receipt.verdict] += 1
        return receipt

    def _receipt(self, event: Event, stamp_ns: int, verdict: Verdict, reason: str) -> Receipt:
        return receipt_of(event, stamp_ns, verdict, reason, self.configuration.delay_handling)
