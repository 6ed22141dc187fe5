"""Health of a navigation for a machine: polar_nav_msgs/NavHealth of an engine's state."""

from __future__ import annotations

import math
from collections.abc import Sequence

from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.health.conditions import Condition, Culprit, Health, Level
from polar_nav_msgs.msg import NavHealth

from .diagnostics import Level as Worst
from .stamps import to_msg

SILENT_S = 2.0
"""An IMU that was silent for longer is an ERROR: nothing is estimated without it."""


_NAMES = {
    NavHealth.STATUS_ALIGNING: 'waiting',
    NavHealth.STATUS_NAVIGATING: 'navigating',
    NavHealth.STATUS_DIVERGED: 'diverged',
    NavHealth.STATUS_DEGRADED: 'degraded',
    NavHealth.STATUS_LOST: 'lost',
}


def status_of(engine: Engine, beside: Sequence[Condition] = ()) -> tuple[str, Worst]:
    """Name of an engine's status as of polar_nav_msgs/NavHealth, and its level.

    ``beside`` has conditions that the node knows of.
    """
    health = engine.health
    levels = [c.level for c in beside] + ([] if health is None else [health.level])
    level = max(levels, default=Level.OK)
    status = _status(engine, health, level)
    worst = Level.ERROR if status == NavHealth.STATUS_DIVERGED else level
    return _NAMES[status], Worst(int(worst))


def health_to_msg(
    engine: Engine,
    stamp_ns: int,
    radius: float,
    imu_ns: int | None,
    waits_for: str = '',
    beside: Sequence[Condition] = (),
) -> NavHealth:
    """polar_nav_msgs/NavHealth of an engine at a stamp.

    Parameters
    ----------
    engine : Engine
    stamp_ns : int
        Of the estimate, or the present time while there is none [ns].
    radius : float
        Horizontal 95 % radius of the published covariance [m]; NaN without an estimate.
    imu_ns : int or None
        Newest IMU sample; None before the first [ns].
    waits_for : str
        Sentence of a start that is not complete.
    beside : sequence of Condition
        What the node knows of its sources; a replay has none.
    """
    health = engine.health
    imu_age_s = math.nan if imu_ns is None else (stamp_ns - imu_ns) * 1e-9
    present = [p.condition for p in health.present] if health is not None else []
    of_engine = _of_engine(engine, imu_age_s, waits_for)
    found = sorted([*of_engine, *present, *beside], key=lambda c: -c.level)
    level = max((c.level for c in found), default=Level.OK)
    culprit = Culprit.NONE
    for condition in found:
        culprit |= condition.culprit if condition.level is level else Culprit.NONE
    dvl_ns, depth_ns, _ = health.used_ns if health is not None else (0, 0, 0)
    msg = NavHealth()
    msg.header.stamp = to_msg(stamp_ns)
    msg.level = bytes([level])
    msg.status = _status(engine, health, level)
    msg.culprit = int(culprit)
    msg.r95_horizontal_m = radius
    msg.imu_age_s = imu_age_s
    msg.fix_age_s = engine.integrity.since_fused_s
    msg.dvl_age_s = _age_s(stamp_ns, dvl_ns)
    msg.depth_age_s = _age_s(stamp_ns, depth_ns)
    msg.reset_counter = engine.resets if health is None else health.resets
    msg.conditions = [f'{c.level.name}: {c.sentence}' for c in found]
    return msg


def _of_engine(engine: Engine, imu_age_s: float, waits_for: str) -> list[Condition]:
    """Conditions of the whole engine that the watchdog has no part in."""
    if engine.divergence:
        return [Condition('diverged', Level.ERROR, Culprit.UNEXPLAINED, engine.divergence)]
    if not engine.navigating:
        sentence = f'no state yet{": " if waits_for else ""}{waits_for}'
        return [Condition('no state', Level.WARN, Culprit.NONE, sentence)]
    found = []
    if imu_age_s > SILENT_S:
        sentence = f'no IMU sample for {imu_age_s:.0f} s: nothing is estimated'
        found.append(Condition('imu silent', Level.ERROR, Culprit.IMU, sentence))
    if engine.history_warning:
        found.append(Condition('history', Level.WARN, Culprit.NONE, engine.history_warning))
    if engine.aiding_warning:
        found.append(Condition('aiding', Level.WARN, Culprit.MODEL, engine.aiding_warning))
    return found


def _status(engine: Engine, health: Health | None, level: Level) -> int:
    if engine.divergence:
        return int(NavHealth.STATUS_DIVERGED)
    if not engine.navigating:
        return int(NavHealth.STATUS_ALIGNING)
    if health is not None and health.lost:
        return int(NavHealth.STATUS_LOST)
    degraded = level is not Level.OK
    return int(NavHealth.STATUS_DEGRADED if degraded else NavHealth.STATUS_NAVIGATING)


def _age_s(stamp_ns: int, used_ns: int) -> float:
    return (stamp_ns - used_ns) * 1e-9 if used_ns else math.nan
