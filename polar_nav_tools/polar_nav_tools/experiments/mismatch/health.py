"""Health reported in a run, for the judge, from the watchdog.

The engine looks once a second (polar_nav_core/engine/health).
"""

from __future__ import annotations

from collections.abc import Sequence

from polar_nav_core.engine.health.conditions import Culprit, Health

from .culprits import DEPTH, DVL, FIXES, HEADING, IMU, MODEL, UNEXPLAINED
from .judge import ERROR, HealthReport

NAMES = {
    Culprit.FIXES: FIXES,
    Culprit.DVL: DVL,
    Culprit.DEPTH: DEPTH,
    Culprit.IMU: IMU,
    Culprit.MODEL: MODEL,
    Culprit.HEADING: HEADING,
    Culprit.UNEXPLAINED: UNEXPLAINED,
}
"""Names of the watchdog's culprits as rows state them."""


def health_history(
    looks: Sequence[Health], end_ns: int, divergence: str = ''
) -> list[HealthReport]:
    """Changes of level or culprit that the engine's watchdog saw, in the order of stamps.

    Parameters
    ----------
    looks : sequence of Health
    end_ns : int
        Stamp of the last estimate.
    divergence : str
        Why the filter stopped there; empty when it did not.
    """
    out: list[HealthReport] = []
    for health in looks:
        names = [NAMES[bit] for bit in NAMES if bit & health.culprit] if health.present else []
        culprit = '|'.join(names)
        report = HealthReport(health.stamp_ns, int(health.level), health.sentence, culprit)
        if not out or (out[-1].level, out[-1].culprit) != (report.level, report.culprit):
            out.append(report)
    if divergence:
        out.append(HealthReport(end_ns, ERROR, divergence, UNEXPLAINED))
    return out
