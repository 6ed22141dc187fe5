"""Health of a navigating node: the worst problem in one sentence, with the numbers.

| level | when |
| --- | --- |
| ERROR | the covariance lost definiteness; an ERROR of the watchdog or of the integrity monitor |
| WARN | no state yet; sensors outrun the history; a WARN of those two; messages came too late |
| OK | navigating, with the age of the last fix |
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from polar_nav_core.engine.checks import warnings_of
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Verdict
from polar_nav_core.engine.health.conditions import Health
from polar_nav_core.engine.integrity import Integrity

from .diagnostics import Diagnosis, Level


class Logger(Protocol):
    """The part of rclpy's logger that is used here."""

    def info(self, message: str) -> object:
        """Log at level INFO."""

    def warning(self, message: str) -> object:
        """Log at level WARN."""

    def error(self, message: str) -> object:
        """Log at level ERROR."""


class NavigationHealth:
    """Watches one engine; logs changes of its health.

    Parameters
    ----------
    engine : Engine
    logger : Logger
        Logs doubtful parameters at once, and every change of level.
    """

    def __init__(self, engine: Engine, logger: Logger) -> None:
        self._engine = engine
        self._logger = logger
        self._warnings = warnings_of(engine.params)
        for warning in self._warnings:
            logger.warning(warning)
        self._last = Level.WARN  # there is no state yet
        self._late = 0

    def diagnose(self, values: dict[str, object]) -> Diagnosis:
        """Present status; ``values`` are the node's own numbers.

        The engine's come first.
        """
        engine, integrity = self._engine, self._engine.integrity
        counted: dict[str, object] = {
            v.name: engine.verdicts[v] for v in Verdict if engine.verdicts[v]
        }
        counted |= {f'fused_{k}': v for k, v in engine.fused.items()}
        counted |= {f'gated_{k}': v for k, v in engine.gated.items()}
        counted |= {'imu_gaps': engine.imu_gaps, **_numbers(integrity)}
        if self._warnings:
            counted['parameter_warnings'] = '; '.join(self._warnings)
        counted |= _present(engine.health)
        level, message = self._worst(integrity)
        self._late = engine.verdicts[Verdict.TOO_LATE]
        self._tell(level, message)
        return Diagnosis(level, message, {**counted, **values})

    def _worst(self, integrity: Integrity) -> tuple[Level, str]:
        engine = self._engine
        if engine.divergence:
            return Level.ERROR, engine.divergence
        if not engine.navigating:
            return Level.WARN, _waiting(engine)
        health = engine.health
        if health is not None and health.level is health.level.ERROR:
            return Level.ERROR, health.sentence
        if integrity.level is integrity.level.ERROR:
            return Level.ERROR, integrity.sentence
        if engine.history_warning:
            return Level.WARN, engine.history_warning
        if health is not None and health.level is health.level.WARN:
            return Level.WARN, health.sentence
        if integrity.level is integrity.level.WARN:
            return Level.WARN, integrity.sentence
        count = engine.verdicts[Verdict.TOO_LATE]
        if count > self._late:
            return Level.WARN, f'{count} messages came after reorder_window_s'
        if engine.aiding_warning:
            return Level.WARN, engine.aiding_warning
        return Level.OK, f'navigating, {integrity.sentence}'

    def _tell(self, level: Level, message: str) -> None:
        if level is self._last:
            return
        # One call each: rclpy ties a level to the line that logs.
        if level is Level.OK:
            self._logger.info(message)
        elif level is Level.WARN:
            self._logger.warning(message)
        else:
            self._logger.error(message)
        self._last = level


def _present(health: Health | None) -> dict[str, object]:
    """Present conditions of the watchdog, the worst first: level, since when, how often."""
    if health is None:
        return {}
    found: dict[str, object] = {
        'radius_95_m': f'{health.radius_95:.1f}',
        'covariance_enlarged': health.resets,
    }
    for number, p in enumerate(health.present, start=1):
        for_s = (health.stamp_ns - p.since_ns) * 1e-9
        c = p.condition
        found[f'condition_{number}'] = (
            f'{c.level.name}: {c.sentence} (for {for_s:.0f} s, {p.count} times)'
        )
    return found


def _waiting(engine: Engine) -> str:
    """Sentence about the missing input of a filter without a state."""
    refused = engine.verdicts[Verdict.NOT_FINITE]
    if refused and engine.params.mode == 'station':
        return (
            f'no state yet: {refused} messages were not finite, or had no attitude '
            '(orientation_covariance[0] of imu/data is -1); nav/receipt says which'
        )
    return 'no state yet: waits for IMU data or ~/set_initial_state'


def _numbers(integrity: Integrity) -> dict[str, object]:
    numbers: dict[str, object] = {
        'since_fused_s': f'{integrity.since_fused_s:.1f}',
        'gated_in_a_row': integrity.gated_run,
        'gated_for_s': f'{integrity.gated_s:.1f}',
    }
    if integrity.gated_run:
        numbers['gated_offset_m'] = f'{float(np.linalg.norm(integrity.offset_G)):.1f}'
        numbers['gated_scatter_m'] = f'{integrity.scatter:.1f}'
    return numbers
