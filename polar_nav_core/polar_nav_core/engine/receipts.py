"""Receipts: what became of a message, with the numbers that decided and a sentence."""

from __future__ import annotations

from typing import Any

from .events import Event, Fix, Receipt, Verdict
from .filter.fusion import FixResult
from .params import Configuration


def receipt_of(
    event: Event,
    stamp_ns: int,
    verdict: Verdict,
    reason: str,
    delay_handling: str,
    **outcome: Any,  # noqa: ANN401
) -> Receipt:
    """Receipt of an event; ``outcome`` is what the gate's decision adds to that of a fix."""
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
    """Receipt of a fix that the gate has decided on.

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
    reason = f'{age_s(fix):.2f} s old, NIS {outcome.nis:.1f}'
    if not outcome.fused:
        reason = f'NIS {outcome.nis:.1f} is above the gate of {outcome.gate:.1f}'
    if fix is not cause:
        reason += f'; decided anew after fix {cause.sequence}'
    if outcome.inflation > 1.0:
        reason += f'; weight 1/{outcome.inflation:.1f} ({chosen.robust_fixes})'
    return receipt_of(
        fix,
        cause.receive_ns,
        Verdict.FUSED if outcome.fused else Verdict.GATED,
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


def age_s(fix: Fix) -> float:
    """Time from validity to reception [s]."""
    return (fix.receive_ns - fix.validity_ns) * 1e-9
