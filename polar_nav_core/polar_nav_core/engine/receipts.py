"""Receipts: verdict on a message, the numbers behind it, and a sentence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Array
from ..kernels.sins import rings
from ..kernels.sins.update import Ints
from .events import Event, Fix
from .methods import Configuration
from .outputs import Receipt
from .results import FixResult, Outcome, chi2_gate, out_of_reach_reason
from .verdicts import Verdict


def receipt_of(
    event: Event,
    stamp_ns: int,
    verdict: Verdict,
    reason: str,
    delay_handling: str,
    **outcome: Any,  # noqa: ANN401
) -> Receipt:
    """Receipt of an event; ``outcome`` holds the extra fields of a fix that reached the gate."""
    if isinstance(event, Fix):
        return Receipt(
            stamp_ns=stamp_ns,
            verdict=verdict,
            reason=reason,
            topic=event.topic,
            source=event.source,
            sequence=event.sequence,
            validity_ns=event.validity_ns,
            transmit_ns=event.transmit_ns,
            receive_ns=event.receive_ns,
            delay_handling=delay_handling,
            **outcome,
        )
    return Receipt(stamp_ns, verdict, reason, event.topic, '', event.sequence, event.stamp_ns)


def decided_receipt(
    fix: Fix, cause: Fix, result: FixResult, now_ns: int, revision: int, chosen: Configuration
) -> Receipt:
    """Receipt of a fix after the gate's decision.

    Parameters
    ----------
    fix, cause : Fix
        The fix, and the one that made the gate decide: another one when it is a revision.
    result : FixResult
    now_ns : int
        Stamp of the filter's state.
    revision : int
        0 at first.
    chosen : Configuration
    """
    outcome = result.outcome
    reason = _fused_reason(fix, outcome.nis)
    if not outcome.fused:
        reason = _refused_reason(outcome)
    if fix is not cause:
        reason += f'; decided anew after fix {cause.sequence}'
    if outcome.inflation > 1.0:
        reason += _weight(outcome.inflation, chosen)
    return receipt_of(
        fix,
        cause.receive_ns,
        Verdict.FUSED if outcome.fused else refused_verdict(outcome),
        reason,
        chosen.delay_handling,
        fused_ns=now_ns if outcome.fused else 0,
        steps_rolled_back=result.steps,
        innovation_G=-outcome.z,
        innovation_variance_G=outcome.variance,
        nis=outcome.nis,
        dof=outcome.dof,
        gate=outcome.gate,
        revision=revision,
    )


@dataclass(frozen=True)
class FusedFixes:
    """Fixes that were fused in order of arrival: their receipts, still to be written.

    Attributes
    ----------
    fixes : sequence of Fix
    outcomes : (n, OUTCOME) array
        As in `Streams.fix_outcomes`.
    notes : (n, 3) array
        As in `Streams.fix_notes`: steps, stamp of the filter's state, rows of output.
    chosen : Configuration
    """

    fixes: Sequence[Fix]
    outcomes: Array
    notes: Ints
    chosen: Configuration

    def __len__(self) -> int:
        return len(self.fixes)

    def columns(self) -> dict[str, Any]:
        """Fields of their receipts by name, each equal to those of `decided_receipt`.

        Columns, or one value for all.
        """
        fixes, outcomes, chosen = self.fixes, self.outcomes, self.chosen
        nis, enlargements = outcomes[:, 1], outcomes[:, rings.ENLARGEMENT].tolist()
        dof = outcomes[:, rings.DOF].astype(np.int64)
        reasons = [
            _fused_reason(fix, x) + (_weight(enlargement, chosen) if enlargement > 1.0 else '')
            for fix, x, enlargement in zip(fixes, nis.tolist(), enlargements, strict=True)
        ]
        receive_ns = [fix.receive_ns for fix in fixes]
        return {
            'stamp_ns': receive_ns,
            'verdict': Verdict.FUSED,
            'reason': reasons,
            'topic': [fix.topic for fix in fixes],
            'source': [fix.source for fix in fixes],
            'sequence': [fix.sequence for fix in fixes],
            'validity_ns': [fix.validity_ns for fix in fixes],
            'transmit_ns': [fix.transmit_ns for fix in fixes],
            'receive_ns': receive_ns,
            'fused_ns': self.notes[:, 1],
            'delay_handling': [chosen.delay_handling] * len(fixes),
            'steps_rolled_back': self.notes[:, 0],
            'innovation_G': -outcomes[:, 2:5],
            'innovation_variance_G': outcomes[:, 5:8],
            'nis': nis,
            'dof': dof,
            'gate': [chi2_gate(chosen.gate_probability, k) for k in dof.tolist()],
            'revision': 0,
        }


def joined(parts: Sequence[FusedFixes]) -> FusedFixes:
    """Fixes of several parts, of one configuration, one behind the other."""
    return FusedFixes(
        [fix for part in parts for fix in part.fixes],
        np.concatenate([part.outcomes for part in parts]),
        np.concatenate([part.notes for part in parts]),
        parts[0].chosen,
    )


def refused_verdict(outcome: Outcome) -> Verdict:
    """GATED; where there is no gate, IMPLAUSIBLE: beyond what the vehicle can have moved."""
    return Verdict.GATED if math.isfinite(outcome.gate) else Verdict.IMPLAUSIBLE


def _refused_reason(outcome: Outcome) -> str:
    if math.isfinite(outcome.gate):
        return f'NIS {outcome.nis:.1f} is above the gate of {outcome.gate:.1f}'
    distance = float(np.linalg.norm(outcome.z[np.isfinite(outcome.z)]))
    return out_of_reach_reason(distance, outcome.nis)


def _fused_reason(fix: Fix, nis: float) -> str:
    return f'{age_s(fix):.2f} s old, NIS {nis:.1f}'


def _weight(enlargement: float, chosen: Configuration) -> str:
    return f'; weight 1/{enlargement:.1f} ({chosen.robust_fixes})'


def age_s(fix: Fix) -> float:
    """Time from validity to reception [s]."""
    return (fix.receive_ns - fix.validity_ns) * 1e-9
