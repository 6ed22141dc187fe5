"""After a fix was decided: what refused fixes change in a strapdown navigation.

Refused fixes that agree contradict the estimate. Which of the two is right is judged in three
steps: a track that is turned and stretched shows a wrong heading (engine.disagreement); a start
that was wrong, or DVL and IMU in doubt, cannot vouch against them (engine.integrity); else nobody
knows, and the published covariance reaches to where they lie.
"""

from __future__ import annotations

from .health.watchdog import doubts_local, is_alone
from .ledger import FixLedger
from .params import EngineParams
from .results import Outcome
from .sins.fusion import Fusion
from .sins.turned import weigh_refused
from .sins.view import view_of


def reconsider(
    fusion: Fusion, ledger: FixLedger, p: EngineParams, outcome: Outcome, sigma_heading: float
) -> bool:
    """Whether the heading was turned; the covariance shows what refused fixes contradict.

    Where they outweigh the estimate, the filter's covariance is enlarged, so that the next are
    fused. Those that are valid before this moment do not count any more, for they are judged by
    what was stored then. Nothing is done where ``reopen_after_s`` is 0.

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
    turned = False
    if not outcome.fused:
        turned = weigh_refused(fusion.filter, ledger.refused_row, p, sigma_heading)
        if turned:
            fusion.forget_past()
            ledger.believed(fusion.stamp_ns, turned=True)
        else:
            _outweigh(fusion, ledger, p, outcome)
    fusion.contradict(*ledger.integrity.conflict())
    return turned


def _outweigh(fusion: Fusion, ledger: FixLedger, p: EngineParams, outcome: Outcome) -> None:
    """Enlarge the covariance where refused fixes outweigh start, DVL or IMU."""
    stamp_ns = fusion.stamp_ns
    view = view_of(fusion, stamp_ns, 0)
    found = ledger.integrity.contradiction(
        ledger.fused_since_start,
        doubted=doubts_local(view),
        alone=is_alone(view),
        least_s=p.reopen_after_s,
    )
    if found is None:
        return
    if found.constant:
        fusion.doubt_position(found.distance)
    else:
        fusion.doubt_all(outcome.nis / outcome.dof)
    ledger.believed(stamp_ns, found.distance if found.constant else 0.0)
