"""Health reported in a run, for the judge, from the watchdog or the integrity monitor.

In the strapdown mode the engine's watchdog looks once a second (polar_nav_core/engine/health). In
station mode only position fixes are watched, by the integrity monitor, which is replayed here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from polar_nav_core.engine.events import Receipt, Verdict
from polar_nav_core.engine.health.conditions import Culprit, Health
from polar_nav_core.engine.integrity import Integrity, IntegrityMonitor
from polar_nav_core.engine.params import EngineParams

from .judge import ERROR, OK, UNEXPLAINED, HealthReport

_NAMES = {
    Culprit.FIXES: 'fixes',
    Culprit.DVL: 'DVL',
    Culprit.DEPTH: 'depth',
    Culprit.IMU: 'IMU',
    Culprit.MODEL: 'model',
    Culprit.HEADING: 'heading',
    Culprit.UNEXPLAINED: UNEXPLAINED,
}
_TICK_NS = 10_000_000_000
"""Interval of checks without fixes; their absence is reported too."""


@dataclass(frozen=True)
class WatchedRun:
    """Run as the input of its health history.

    Attributes
    ----------
    params : EngineParams
    receipts : sequence of Receipt
        In the order in which they were given.
    start_ns, end_ns : int
        First and last estimate.
    divergence : str
        Reason why the filter stopped at ``end_ns``; empty if it did not.
    """

    params: EngineParams
    receipts: Sequence[Receipt]
    start_ns: int
    end_ns: int
    divergence: str = ''
    health: Sequence[Health] = ()


def health_history(run: WatchedRun) -> list[HealthReport]:
    """Changes of level or culprit over a run, in the order of stamps, the first at the start.

    Replays the integrity monitor over the receipts of fixes and looks at it after every one, and
    every 10 s while none comes. Its sentences blame "leader or follower displaced" when refused
    fixes share an offset, which counts as naming the fixes; without a common offset they name
    nothing.
    """
    if run.params.mode == 'sins':
        return _watched(run)
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


def _watched(run: WatchedRun) -> list[HealthReport]:
    """Changes of level or culprit reported by the engine's watchdog."""
    out: list[HealthReport] = []
    for health in run.health:
        names = [_NAMES[bit] for bit in _NAMES if bit & health.culprit] if health.present else []
        culprit = '|'.join(names)
        report = HealthReport(health.stamp_ns, int(health.level), health.sentence, culprit)
        if not out or (out[-1].level, out[-1].culprit) != (report.level, report.culprit):
            out.append(report)
    if run.divergence:
        out.append(HealthReport(run.end_ns, ERROR, run.divergence, UNEXPLAINED))
    return out


def _note(monitor: IntegrityMonitor, receipt: Receipt) -> None:
    """Pass the integrity monitor the same data as the engine's ledger does for this verdict."""
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
