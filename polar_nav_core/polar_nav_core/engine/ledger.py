"""Record of position fixes: duplicates, counts, verdicts that change, receipts."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Sequence

from ..kernels.sins.update import Ints
from .events import Array, Fix, Receipt, Verdict
from .integrity import IntegrityMonitor
from .params import EngineParams
from .receipts import age_s, decided_receipt, fused_receipts
from .refusals import Refusal, unusable_fix
from .results import FixResult

_SEQUENCES_KEPT = 4096
_FIX = 'fix'


class FixLedger:
    """Record of one vehicle's fixes.

    Parameters
    ----------
    params : EngineParams
    verdicts, fused : Counter
        The engine's counts, which are kept up here for what is decided here.
    """

    def __init__(
        self, params: EngineParams, verdicts: Counter[Verdict], fused: Counter[str]
    ) -> None:
        self._params = params
        self._configuration = params.resolved()
        self._max_delay_ns = round(params.max_delay_s * 1e9)
        self._verdicts = verdicts
        self._fused = fused
        self._seen: OrderedDict[tuple[str, int], int] = OrderedDict()
        self._last_validity_ns = 0
        self.received = 0
        self.integrity = IntegrityMonitor(params.max_gated_s)

    def start_anew(self) -> None:
        """Reset the agreement of fixes with the estimate, after a reset of the filter."""
        self.integrity = IntegrityMonitor(self._params.max_gated_s)

    def counts(self) -> tuple[int, int, int]:
        """Number of fixes received, of fixes fused, and newest validity of a fused one [ns]."""
        return self.received, self._fused[_FIX], self._last_validity_ns

    def refusal(self, fix: Fix) -> Refusal | None:
        """Verdict and reason if a fix cannot be used in any state; None if it can."""
        unusable = unusable_fix(self._params, fix)
        if unusable is not None:
            return unusable
        if fix.validity_ns > fix.receive_ns:
            return Verdict.FROM_FUTURE, f'valid {-age_s(fix):.3f} s after it was received'
        if (fix.source, fix.sequence) in self._seen:
            return Verdict.DUPLICATE, f'fix {fix.sequence} of {fix.source} came before'
        if fix.receive_ns - fix.validity_ns > self._max_delay_ns:
            return (
                Verdict.TOO_OLD,
                f'{age_s(fix):.2f} s old, max_delay_s is {self._params.max_delay_s:.2f} s',
            )
        return None

    def remember(self, *fixes: Fix) -> None:
        """Store (source, sequence) of fixes; a later fix with the same pair is a DUPLICATE."""
        for fix in fixes:
            self._seen[(fix.source, fix.sequence)] = 0
        while len(self._seen) > _SEQUENCES_KEPT:
            self._seen.popitem(last=False)

    def decided(self, fix: Fix, cause: Fix, result: FixResult, now_ns: int) -> Receipt:
        """Receipt of a fix after the gate's decision; ``cause`` is the fix that led to it."""
        outcome, name, revision = result.outcome, (fix.source, fix.sequence), 0
        if fix is not cause:
            revision = self._seen[name] = self._seen[name] + 1
            self._verdicts[Verdict.GATED if outcome.fused else Verdict.FUSED] -= 1
        if outcome.fused:
            self.integrity.fused(fix.validity_ns, cause.receive_ns)
            self._fused[_FIX] += 1
            self._last_validity_ns = max(self._last_validity_ns, fix.validity_ns)
        else:
            self.integrity.gated(fix.validity_ns, cause.receive_ns, -outcome.z)
            self._fused[_FIX] -= revision > 0
        return decided_receipt(fix, cause, result, now_ns, revision, self._configuration)

    def fused(
        self, fixes: Sequence[Fix], outcomes: Array, notes: Ints, gate: float
    ) -> list[Receipt]:
        """Receipts of consecutive fixes that were all fused; see `fused_receipts`.

        None was refused before them since the newest that was fused.
        """
        newest_ns = max(fix.validity_ns for fix in fixes)
        self.received += len(fixes)
        self._fused[_FIX] += len(fixes)
        self._verdicts[Verdict.FUSED] += len(fixes)
        self._last_validity_ns = max(self._last_validity_ns, newest_ns)
        self.integrity.fused(newest_ns, fixes[-1].receive_ns)
        self.remember(*fixes)
        return fused_receipts(fixes, outcomes, notes, gate, self._configuration)
