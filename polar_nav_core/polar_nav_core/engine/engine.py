"""The navigation engine: stamped events in, stamped estimates and receipts out.

It owns no clock, no thread and no randomness. The live node and the offline replay drive the same
object with events in the same total order, so they get the same bytes. Events must come in that
order: `reorder.py` sees to it live, `replay` sorts the bag.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from ..errors import FilterDivergence
from ..kernels.sins.update import Ints
from .checks import aiding_warning, history_warning
from .driver import Driver
from .events import (
    LOCAL_DOF,
    LOCAL_GATED,
    UPDATES,
    Array,
    Command,
    CommandKind,
    ControlSample,
    DepthSample,
    DvlPing,
    Event,
    Fix,
    Identification,
    ImuSample,
    InitialState,
    OrderKey,
    Output,
    Receipt,
    Verdict,
)
from .integrity import Integrity, held
from .ledger import FixLedger
from .params import EngineParams
from .receipts import age_s, receipt_of
from .refusals import unusable_local
from .results import FixResult, chi2_gate
from .sins.filter import NavigationFilter
from .sins.fusion import Fusion
from .station.fixes import dated
from .station.identify import Adaptation, make_adaptation
from .strategies import compiled, make_fusion


class Engine:
    """Navigation of one vehicle.

    Parameters
    ----------
    params : EngineParams
        Everything that can be chosen.
    """

    def __init__(self, params: EngineParams) -> None:
        self.params = params
        self.configuration = params.resolved()
        self._make_fusion = make_fusion(params)
        self._output_ns = round(params.output_period_s * 1e9)
        self._fusion: Driver | None = None
        self._thrust: ControlSample | None = None
        self._adaptation = make_adaptation(params)
        self._identified: Identification | None = None
        self._initial: InitialState | None = params.initial_state()
        self._last_key: OrderKey | None = None
        self._last_imu_ns: int | None = None
        self._due_ns: int | None = None
        self.verdicts: Counter[Verdict] = Counter()
        self.gated: Counter[str] = Counter()
        self.fused: Counter[str] = Counter()
        self.imu_gaps = 0
        self.divergence = ''
        self._ledger = FixLedger(params, self.verdicts, self.fused)
        self._start_ns = 0

    # -- driving ----------------------------------------------------------------------------------

    def process(self, event: Event) -> Iterator[Output]:
        """Take the next event of the total order; yields what it leads to.

        Raises
        ------
        ValueError
            When the event does not come after the one before: a fault of the caller.
        """
        self._require_order(event)
        yield from self.advance(event.stamp_ns)
        self._last_key = event.key
        if isinstance(event, Fix):
            self._ledger.received += 1
            yield from self._guarded_fix(event)
            return
        if isinstance(event, Command):
            yield from self._command(event)
            return
        refused = unusable_local(self.params, event, self._last_imu_ns)
        if refused is not None:
            yield self._count(self._receipt(event, event.stamp_ns, *refused))
        elif isinstance(event, ImuSample):
            self._imu(event)
        elif isinstance(event, ControlSample):
            self._control(event)
        else:
            self._local(event)

    def _require_order(self, event: Event) -> None:
        if self._last_key is not None and event.key <= self._last_key:
            raise ValueError(
                f'event {event.key} after {self._last_key}: events must come in order'
            )

    def advance(self, stamp_ns: int) -> Iterator[Output]:
        """Give the estimate that is due before ``stamp_ns``.

        No event before that stamp may come any more.
        """
        if self._due_ns is not None and stamp_ns > self._due_ns:
            self._due_ns = None
            if self._fusion is not None:
                yield self._fusion.estimate(self.fix_counts())

    def finish(self) -> Iterator[Output]:
        """Give what is left at the end of the events."""
        if self._due_ns is not None:
            yield from self.advance(self._due_ns + 1)

    def refuse(self, event: Event, verdict: Verdict, reason: str, stamp_ns: int) -> Receipt:
        """Receipt of a message that never became an event, decided at ``stamp_ns``."""
        return self._count(self._receipt(event, stamp_ns, verdict, reason))

    @property
    def navigating(self) -> bool:
        """Whether there is a state."""
        return self._fusion is not None

    @property
    def integrity(self) -> Integrity:
        """Whether fixes agree with the estimate, at the newest IMU sample."""
        return self._ledger.integrity.state(self._last_imu_ns or 0)

    @property
    def bottom_lock(self) -> bool | None:
        """Whether the DVL is in use; None without a state or without `model_aiding`."""
        return self._aided.has_bottom_lock if self._aided is not None else None

    @property
    def thrust_known(self) -> bool | None:
        """Whether the thrust that the model needs comes; None as of `bottom_lock`."""
        return self._aided.knows_thrust if self._aided is not None else None

    @property
    def aiding_warning(self) -> str:
        """Say that the vehicle's model lacks the thrust, or stands in for the DVL; or empty."""
        return aiding_warning(self._aided) if self._aided is not None else ''

    @property
    def _aided(self) -> NavigationFilter | None:
        if isinstance(self._fusion, Fusion) and self.params.model_aiding:
            return self._fusion.filter
        return None

    @property
    def history_warning(self) -> str:
        """Say that sensors outrun the stored history; empty when not."""
        if self._fusion is None:
            return ''
        return history_warning(self.params, self._fusion, self._start_ns)

    # -- for the driver of whole runs (batch.py) --------------------------------------------------

    @property
    def compiled(self) -> bool:
        """Whether IMU, DVL and depth can go through the compiled loop."""
        return self.params.mode == 'sins' and compiled(self.configuration)

    @property
    def fusion(self) -> Driver | None:
        """The filter with its measurements."""
        return self._fusion

    def hand_over(self) -> Fusion | None:
        """Return the filter with its measurements; from now on the caller sees to estimates."""
        self.pass_on_estimates()
        return self._fusion if isinstance(self._fusion, Fusion) else None

    @property
    def adaptation(self) -> Adaptation | None:
        """What identifies; None in a mode without."""
        return self._adaptation

    def pass_on_estimates(self) -> None:
        """From now on the caller sees to estimates."""
        self._due_ns = None

    def leaves_to_filter(self, fix: Fix) -> bool:
        """Whether nothing but the filter's history and gate can refuse a fix now."""
        return self._ledger.integrity.quiet and self._ledger.refusal(fix) is None

    def take_decided(self, fix: Fix, result: FixResult | None, stamp_ns: int) -> Receipt:
        """Take what the filter has decided on a fix at its state of ``stamp_ns``.

        Without a result the filter is lost since then, for the reason told to `diverge`.
        """
        self._require_order(fix)
        self._last_key = fix.key
        self._ledger.received += 1
        if result is None:
            reason = self.divergence
            return self._count(self._receipt(fix, fix.receive_ns, Verdict.NOT_READY, reason))
        self._ledger.remember(fix)
        return self._count(self._ledger.decided(fix, fix, result, stamp_ns))

    def take_fused(
        self, fixes: Sequence[Fix], outcomes: Array, notes: Ints, gate: float
    ) -> list[Receipt]:
        """Take fixes that the filter has fused one after the other (`FixLedger.fused`)."""
        self._require_order(fixes[0])
        self._last_key = fixes[-1].key
        return self._ledger.fused(fixes, outcomes, notes, gate)

    def note_imu(self, stamp_ns: int) -> None:
        """Take note of the newest IMU sample that the caller processed."""
        self._last_imu_ns = stamp_ns

    def count_locals(self, statistics: Array, imu_gaps: int) -> None:
        """Count local measurements, rows and columns as in an estimate's ``local_statistics``."""
        for row, name in enumerate(LOCAL_DOF):
            self.fused[name] += int(statistics[row, UPDATES])
            self.gated[name] += int(statistics[row, LOCAL_GATED])
        self.imu_gaps += imu_gaps

    def fix_counts(self) -> tuple[int, int, int]:
        """Fixes received, fixes fused, newest validity of a fused one [ns]."""
        return self._ledger.counts()

    # -- events -----------------------------------------------------------------------------------

    def _imu(self, sample: ImuSample) -> None:
        if (
            self._last_imu_ns is not None
            and sample.stamp_ns - self._last_imu_ns > self.params.max_imu_gap_s * 1e9
        ):
            self.imu_gaps += 1
        self._last_imu_ns = sample.stamp_ns
        if self._adaptation is not None and sample.C_b_G is not None:
            force_b = np.zeros(3) if self._thrust is None else self._thrust.force_b
            self._adaptation.log(sample.stamp_ns, sample.C_b_G, sample.omega_ib_b, force_b)
        if self._fusion is None:
            if self._initial is not None and not self.divergence:
                self._fusion = self._make_fusion(self.params, self._initial, sample.stamp_ns)
                self._fusion.begin(sample)
                if self._thrust is not None:  # it still holds
                    self._fusion.control(self._thrust)
                self._due_ns = self._start_ns = sample.stamp_ns
            return
        before_ns = self._fusion.stamp_ns
        try:
            self._fusion.imu(sample)
        except FilterDivergence as error:
            self.diverge(str(error), sample.stamp_ns)
            return
        if sample.stamp_ns // self._output_ns != before_ns // self._output_ns:
            self._due_ns = sample.stamp_ns

    def _control(self, sample: ControlSample) -> None:
        self._thrust = sample
        if self._fusion is not None:
            self._fusion.control(sample)

    def _local(self, event: DvlPing | DepthSample) -> None:
        """Fuse DVL and depth: local, current, never treated as delayed."""
        name = 'dvl' if isinstance(event, DvlPing) else 'depth'
        if isinstance(event, DvlPing) and not event.valid:
            self.gated['dvl_invalid'] += 1
            return
        if self._fusion is None:
            return
        try:
            outcome = self._fusion.local(event)
        except FilterDivergence as error:
            self.diverge(str(error), event.stamp_ns)
            return
        if not outcome.dof:  # kept for a fix to come, as the paper has it
            return
        (self.fused if outcome.fused else self.gated)[name] += 1

    def _guarded_fix(self, fix: Fix) -> Iterator[Output]:
        try:
            receipts = self._fix(fix)
        except FilterDivergence as error:
            self.diverge(str(error), fix.receive_ns)
            receipts = [self._receipt(fix, fix.receive_ns, Verdict.NOT_READY, self.divergence)]
        for receipt in receipts:
            yield self._count(receipt)
        if self._identified is not None:
            yield self._identified
            self._identified = None

    def _fix(self, fix: Fix) -> list[Receipt]:
        """Fuse a fix or say why not; with receipts of other fixes whose verdict it changed."""
        if self.params.mode == 'station':
            fix = dated(self.params, fix)
        refused = self._ledger.refusal(fix)
        if refused is not None:
            return [self._receipt(fix, fix.receive_ns, *refused)]
        if self._fusion is None:
            reason = self.divergence or 'the filter has no state yet'
            return [self._receipt(fix, fix.receive_ns, Verdict.NOT_READY, reason)]
        gate = chi2_gate(self.configuration.gate_probability, 3 if fix.polar is None else 2)
        why = held(self._ledger.integrity, fix, self._fusion, gate)
        if why:
            self._ledger.remember(fix)
            return [self._receipt(fix, fix.receive_ns, Verdict.GATED, why)]
        result = self._fusion.fix(fix)
        if result is None:
            reach = (fix.receive_ns - self._fusion.oldest_ns()) * 1e-9
            reason = (
                f'valid {age_s(fix):.2f} s before it was received, '
                f'the stored history reaches back {reach:.2f} s'
            )
            return [self._receipt(fix, fix.receive_ns, Verdict.TOO_OLD, reason)]
        self._ledger.remember(fix)
        if self._adaptation is not None:
            self._identified = self._adaptation.fix(fix, result.outcome, self._fusion)
        now_ns = self._fusion.stamp_ns
        first = self._ledger.decided(fix, fix, result, now_ns)
        revised = (
            self._ledger.decided(other, fix, FixResult(outcome, 0), now_ns)
            for other, outcome in result.revised
        )
        return [first, *revised]

    def _command(self, command: Command) -> Iterator[Output]:
        if command.kind is CommandKind.IDENTIFY and self._adaptation is not None:
            yield self._adaptation.identify(command.stamp_ns, 'command', self._fusion)
        if command.kind in (CommandKind.SHUTDOWN, CommandKind.IDENTIFY):
            return
        self._initial = command.initial_state or self.params.initial_state()
        self._fusion = None
        self._due_ns = None
        self.divergence = ''
        self._ledger.start_anew()
        self._adaptation = make_adaptation(self.params)

    # -- outputs ----------------------------------------------------------------------------------

    def diverge(self, why: str, stamp_ns: int) -> None:
        """Stop navigating, and remember why."""
        self.divergence = (
            f'{why} (at {stamp_ns * 1e-9:.3f} s); no estimates are published until a reset'
        )
        self._fusion = None
        self._due_ns = None

    def _count(self, receipt: Receipt) -> Receipt:
        self.verdicts[receipt.verdict] += 1
        return receipt

    def _receipt(self, event: Event, stamp_ns: int, verdict: Verdict, reason: str) -> Receipt:
        return receipt_of(event, stamp_ns, verdict, reason, self.configuration.delay_handling)
