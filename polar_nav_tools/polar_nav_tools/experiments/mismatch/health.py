"""What a run reported of its own health, for the judge: the one place that knows who watches.

Today only position fixes are watched: by the engine's integrity monitor
(polar_nav_core/engine/integrity.py), which the node turns into diagnostics in
polar_nav_ros/navigation_health.py. A watchdog for every sensor will have a history of its own;
`health_history` is all that has to be replaced then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from polar_nav_core.engine.events import Receipt, Verdict
from polar_nav_core.engine.integrity import Integrity, IntegrityMonitor
from polar_nav_core.engine.params import EngineParams

from .judge import ERROR, OK, UNEXPLAINED, HealthReport

_TICK_NS = 10_000_000_000
"""Between looks while no fix comes: silence is a finding, too."""


@dataclass(frozen=True)
class WatchedRun:
    """What the watch of a run has to go by.

    Attributes
    ----------
    params : EngineParams
    receipts : sequence of Receipt
        In the order in which they were given.
    start_ns, end_ns : int
        First and last estimate.
    divergence : str
        Why the filter stopped at ``end_ns``; empty when it did not.
    """

    params: EngineParams
    receipts: Sequence[Receipt]
    start_ns: int
    end_ns: int
    divergence: str = ''


def health_history(run: WatchedRun) -> list[HealthReport]:
    """Changes of level or culprit over a run, in the order of stamps, the first at the start.

    Replays the integrity monitor over the receipts of fixes and looks at it after every one, and
    every 10 s while none comes. Its sentences blame "leader or follower displaced" when refused
    fixes share an offset, which counts as naming the fixes; without a common offset they name
    nothing.
    """
    monitor = IntegrityMonitor(run.params.max_gated_s)
    out: list[HealthReport] = []
    next_ns = run.start_ns
    for receipt in run.receipts:
        while next_ns < receipt.stamp_ns:
            _look(monitor, next_ns, out)
            next_ns += _TICK_NS
        _note(monitor, receipt)
        _look(monitor, receipt.stamp_ns, out)
        next_ns = max(next_ns, receipt.stamp_ns + _TICK_NS)
    while next_ns <= run.end_ns:
        _look(monitor, next_ns, out)
        next_ns += _TICK_NS
    if run.divergence:
        out = [r for r in out if r.stamp_ns <= run.end_ns]
        out.append(HealthReport(run.end_ns, ERROR, run.divergence, UNEXPLAINED))
    return out


def _note(monitor: IntegrityMonitor, receipt: Receipt) -> None:
    """Give the monitor what the ledger of the engine gives it for this verdict."""
    if receipt.verdict == Verdict.FUSED:
        monitor.fused(receipt.validity_ns, receipt.stamp_ns)
    elif receipt.verdict == Verdict.GATED and receipt.dof:  # not one that `held` refused
        monitor.gated(receipt.validity_ns, receipt.stamp_ns, receipt.innovation_G)


def _look(monitor: IntegrityMonitor, stamp_ns: int, out: list[HealthReport]) -> None:
    state = monitor.state(stamp_ns)
    report = HealthReport(stamp_ns, int(state.level), state.sentence, _culprit(state))
    if not out or (out[-1].level, out[-1].culprit) != (report.level, report.culprit):
        out.append(report)


def _culprit(state: Integrity) -> str:
    if int(state.level) == OK:
        return ''
    if not state.gated_run or state.sentence.startswith('no fix'):
        return 'fixes'
    return 'fixes' if 'displaced' in state.sentence else UNEXPLAINED
