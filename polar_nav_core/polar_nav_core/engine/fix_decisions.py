"""Decision on each fix, in either mode: refused before the filter sees it, fused, or gated."""

from __future__ import annotations

from typing import NamedTuple

from ..identification.result import Identification
from .driver import Adaptation, Driver
from .events import Fix
from .fix_rules import held, out_of_reach, submerged
from .ledger import FixLedger
from .level import degrees_of_freedom
from .outputs import Receipt
from .params import EngineParams
from .plausibility import believed, best_sigma
from .receipts import age_s, receipt_of
from .results import FixResult, Outcome, chi2_gate
from .sins.fusion import Fusion
from .station.fixes import dated
from .station.fusion import StationFusion
from .verdicts import Verdict


class Decided(NamedTuple):
    """What became of a fix: receipts of it and of others whose verdict it changed.

    Attributes
    ----------
    receipts : list of Receipt
    outcome : Outcome or None
        Where the filter decided.
    identified : Identification or None
        Where one was due with it.
    """

    receipts: list[Receipt]
    outcome: Outcome | None = None
    identified: Identification | None = None


class FixDecisions:
    """Decisions on the fixes of one vehicle, which its ledger keeps.

    Parameters
    ----------
    params : EngineParams
    ledger : FixLedger
    """

    def __init__(self, params: EngineParams, ledger: FixLedger) -> None:
        self._params, self._ledger = params, ledger
        self._configuration = params.resolved()

    def decide(
        self,
        fix: Fix,
        fusion: Driver | None,
        start_ns: int,
        adaptation: Adaptation | None,
        why_none: str,
    ) -> Decided:
        """Decision on a fix that was received.

        Parameters
        ----------
        fix : Fix
        fusion : Driver or None
            The filter, at work since ``start_ns``; None before there is a state.
        start_ns : int
        adaptation : Adaptation or None
            Identifies by the fixes.
        why_none : str
            Why there is no filter; empty where it has not started yet.

        Raises
        ------
        FilterDivergence
            Where the filter is lost with the fix.
        """
        ledger, stated_ns = self._ledger, fix.validity_ns
        if self._params.mode == 'station':
            fix = dated(self._params, fix)
        refused = ledger.refusal(fix, stated_ns)
        if refused is not None:
            ledger.refused(fix, refused[0], stated_ns)
            return self._refused(fix, *refused)
        if fusion is None:
            reason = why_none or 'the filter has no state yet'
            return self._refused(fix, Verdict.NOT_READY, reason)
        verdict, why, believed = self._unseen(fix, fusion, start_ns)
        if why:
            ledger.remember(fix, stated_ns, fused=False)
            return self._refused(believed, verdict, why)
        result = fusion.fix(believed)
        if result is None:
            return self._refused(believed, Verdict.TOO_OLD, _too_old(believed, fusion))
        ledger.remember(fix, stated_ns, fused=result.outcome.fused)
        identified = None
        if adaptation is not None:
            identified = adaptation.fix(believed, result.outcome, fusion)
        now_ns = fusion.stamp_ns
        first = ledger.decided(believed, believed, result, now_ns)
        revised = [
            ledger.decided(other, believed, FixResult(outcome, 0), now_ns)
            for other, outcome in result.revised
        ]
        return Decided([first, *revised], result.outcome, identified)

    def _unseen(self, fix: Fix, fusion: Driver, start_ns: int) -> tuple[Verdict, str, Fix]:
        """Verdict and reason, if the filter shall not see a fix; and the fix as it is believed."""
        params, ledger = self._params, self._ledger
        why = submerged(params, fix, fusion)
        if why:
            return Verdict.IMPLAUSIBLE, why, fix
        gate = chi2_gate(self._configuration.gate_probability, degrees_of_freedom(fix))
        if isinstance(fusion, Fusion):
            sure, fix = fix, believed(fix, params.min_fix_sigma)
            if fix is not sure:
                ledger.too_sure(fix.receive_ns, best_sigma(fix, params.min_fix_sigma))
            fix = fusion.widened(fix)
        why = held(ledger.integrity, fix, fusion, gate)
        if why:
            return Verdict.GATED, why, fix
        since_ns = max(start_ns, ledger.counts()[2])
        why = out_of_reach(params, fix, fusion, gate, since_ns)
        if why:
            ledger.suspect(Verdict.IMPLAUSIBLE, fix.receive_ns)
        return Verdict.IMPLAUSIBLE, why, fix

    def _refused(self, fix: Fix, verdict: Verdict, reason: str) -> Decided:
        handling = self._configuration.delay_handling
        return Decided([receipt_of(fix, fix.receive_ns, verdict, reason, handling)])


def _too_old(fix: Fix, fusion: Driver) -> str:
    """Reason why a fix lies before the stored past."""
    reach = (fix.receive_ns - fusion.oldest_ns()) * 1e-9
    limit = fusion.limit if isinstance(fusion, StationFusion) else ''
    return f'valid {age_s(fix):.2f} s before it was received, ' + (
        limit or f'the stored history reaches back {reach:.2f} s'
    )
