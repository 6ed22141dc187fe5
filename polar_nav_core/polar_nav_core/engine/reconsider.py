"""After a fix was decided: what refused fixes change in a strapdown navigation.

Refused fixes that agree contradict the estimate. Which of the two is right is judged in steps: an
estimate without a DVL that is faster than the vehicle can be is wrong for certain, and begins anew
at the fixes (engine.sins.anew); a track that is turned and stretched shows a wrong heading
(engine.disagreement); a start that was wrong, or DVL and IMU in doubt, cannot vouch against them
(engine.integrity); else nobody knows, and the published covariance reaches to where they lie.
"""

from __future__ import annotations

from ..kernels.sins.reopen import MOST
from .health.view import View
from .health.watchdog import doubts_local, is_alone
from .integrity import SETTLED
from .ledger import Believed, FixLedger
from .params import EngineParams
from .results import Outcome
from .sins.anew import begin_at_fixes
from .sins.doubt import is_too_much
from .sins.fusion import Fusion
from .sins.turned import weigh_refused
from .sins.view import view_of


def reconsider(
    fusion: Fusion, ledger: FixLedger, p: EngineParams, outcome: Outcome, sigma_heading: float
) -> bool:
    """Whether refused fixes have replaced a heading, or all but the biases, of an estimate.

    Where they outweigh the estimate, the filter's covariance is enlarged, so that the next are
    fused; the published one reaches to where they lie. Those that are valid before this moment do
    not count any more, for they are judged by what was stored then. Nothing is done where
    ``reopen_after_s`` is 0.

    Parameters
    ----------
    fusion : Fusion
    ledger : FixLedger
        It has the fix that was decided.
    p : EngineParams
    outcome : Outcome
        Of that fix.
    sigma_heading : float
        Of the start [rad].
    """
    if not p.reopen_after_s:
        return False
    replaced = not outcome.fused and _replaced(fusion, ledger, p, outcome, sigma_heading)
    fusion.contradict(*ledger.integrity.conflict())
    return replaced


def _replaced(
    fusion: Fusion, ledger: FixLedger, p: EngineParams, outcome: Outcome, sigma_heading: float
) -> bool:
    """Whether refused fixes replace a part of the estimate; else they may outweigh it."""
    f, row, stamp_ns = fusion.filter, ledger.refused_row, fusion.stamp_ns
    view = view_of(fusion, stamp_ns, 0)
    how = Believed.ANEW
    if not (_is_lost(ledger, p, outcome, view) and begin_at_fixes(f, row, p.max_speed)):
        if weigh_refused(f, row, p, sigma_heading):
            how = Believed.TURNED
        elif not _outweigh(fusion, ledger, p, outcome, view):
            return False
    fusion.forget_past()
    ledger.believed(stamp_ns, how=how)
    return True


def _is_lost(ledger: FixLedger, p: EngineParams, outcome: Outcome, view: View) -> bool:
    """Whether an estimate without a DVL is none that its covariance could lead back.

    It is faster than the vehicle can be; or it was settled, and runs away from fixes that it would
    refuse with the largest covariance that doubt may give it.
    """
    if not is_alone(view):
        return False
    settled = ledger.fused_since_start >= SETTLED
    beyond = settled and outcome.nis > MOST * outcome.dof
    return view.speed > p.max_speed or (beyond and ledger.integrity.runs_away(p.reopen_after_s))


def _outweigh(
    fusion: Fusion, ledger: FixLedger, p: EngineParams, outcome: Outcome, view: View
) -> bool:
    """Enlarge the covariance where refused fixes outweigh start, DVL or IMU.

    Whether the filter began anew in place of that: enlarged once more, angles would be possible
    that no linear filter can have.
    """
    alone, factor = is_alone(view), outcome.nis / outcome.dof
    found = ledger.integrity.contradiction(
        ledger.fused_since_start,
        doubted=doubts_local(view),
        alone=alone,
        least_s=p.reopen_after_s,
    )
    if found is None:
        return False
    f = fusion.filter
    if found.constant:
        fusion.doubt_position(found.distance)
    elif alone and is_too_much(f, factor) and begin_at_fixes(f, ledger.refused_row, p.max_speed):
        return True
    else:
        fusion.doubt_all(factor)
    ledger.believed(fusion.stamp_ns, found.distance if found.constant else 0.0)
    return False
