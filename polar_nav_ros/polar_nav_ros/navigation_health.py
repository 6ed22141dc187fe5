"""Health of a navigating node: the worst problem in one sentence, with the numbers.

| level | when |
| --- | --- |
| ERROR | the filter was lost; the IMU is silent or steps back; an ERROR of watchdog or integrity |
| WARN | no state yet; sensors outrun the history; a WARN of those two; refused messages; flood |
| OK | navigating, with the age of the last fix |
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from polar_nav_core.engine.checks import warnings_of
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.health.conditions import Health
from polar_nav_core.engine.integrity import Integrity
from polar_nav_core.engine.verdicts import Verdict

from .diagnostics import Diagnosis, Level, without_numbers

_REFUSED = {
    Verdict.TOO_LATE: 'came after reorder_window_s',
    Verdict.FROM_FUTURE: 'were stamped ahead',
    Verdict.IMPLAUSIBLE: 'said what no sensor can say; nav/receipt says which',
}
"""Verdicts that are a WARN while they go on."""
_SILENT_S = 2.5
_AGAIN_S = 60.0
"""After which a sentence at the same level is logged again."""


class _Silence:
    """Steady time for which no IMU sample was used while other messages came."""

    def __init__(self, now_s: float) -> None:
        self._since_s = now_s
        self._imu_ns: int | None = None
        self._others = 0

    def look(self, now_s: float, imu_ns: int | None, others: int) -> float:
        """Length of the silence [s]; 0 while samples are used, or nothing comes.

        ``others`` counts messages that wait for the IMU or were refused.
        """
        if imu_ns != self._imu_ns:
            self._since_s, self._imu_ns, self._others = now_s, imu_ns, others
        return now_s - self._since_s if others > self._others else 0.0


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
        Logs doubtful parameters at once, every change of level, and what is new at the same one.
    clock : callable
        Steady time [s]. It says that the IMU is silent, and nothing else.
    """

    def __init__(
        self, engine: Engine, logger: Logger, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._engine = engine
        self._clock = clock
        self._silence = _Silence(clock())
        self._logger = logger
        self._warnings = warnings_of(engine.params)
        for warning in self._warnings:
            logger.warning(warning)
        self._last = Level.WARN  # there is no state yet
        self._told: dict[str, float] = {}
        self._refused = dict.fromkeys(_REFUSED, 0)
        self._lost = 0

    def diagnose(
        self,
        values: dict[str, object],
        *,
        behind_s: float = 0.0,
        lost: int = 0,
        waits_for: str = '',
    ) -> Diagnosis:
        """Present status.

        Parameters
        ----------
        values : dict
            The node's own numbers; the engine's come first.
        behind_s : float
            How long its newest input had waited [s]; 0 where that is no time.
        lost : int
            Inputs that were dropped before the node took them.
        waits_for : str
            What a start that is not complete waits for.
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
        for topic, offset_s in engine.clock.offsets_s.items():
            counted[f'clock_offset_s {topic}'] = f'{offset_s:+.3f}'
        counted |= _present(engine.health)
        waiting = values.get('waiting', 0)
        others = sum(engine.verdicts.values()) + (waiting if isinstance(waiting, int) else 0)
        silent_s = self._silence.look(self._clock(), engine.last_imu_ns, others)
        level, message = self._worst(integrity, silent_s, waits_for)
        flood = self._flood(behind_s, lost)
        if flood:
            counted['flood'] = flood
        # Beside what is worse, too: a WARN that stays would hide that no fix is used.
        beside = [*self._refusals(), *([flood] if flood else [])]
        if beside and level is Level.OK:
            level, said = Level.WARN, beside
        else:
            said = [message, *beside]
        self._refused = {v: engine.verdicts[v] for v in _REFUSED}
        self._tell(level, said)
        return Diagnosis(level, '; '.join(said), {**counted, **values})

    def _flood(self, behind_s: float, lost: int) -> str:
        """Sentence about inputs that come faster than they are taken; empty if they do not."""
        new, self._lost = lost - self._lost, lost
        said = []
        if behind_s:
            said.append(f'falls behind by {behind_s:.1f} s: inputs come faster than it takes them')
        if new:
            said.append(
                f'{new} messages were dropped before it took them ({lost} so far), and a replay '
                'has those that are recorded'
            )
        return '; '.join(said)

    def _refusals(self) -> list[str]:
        """Sentences on messages that were refused since the last diagnosis, while it navigates."""
        verdicts = self._engine.verdicts
        new = [v for v in _REFUSED if verdicts[v] > self._refused[v]]
        return [f'{verdicts[v]} messages {_REFUSED[v]}' for v in new if self._engine.navigating]

    def _worst(self, integrity: Integrity, silent_s: float, waits_for: str) -> tuple[Level, str]:
        engine = self._engine
        if engine.divergence:
            return Level.ERROR, engine.divergence
        if not engine.navigating:
            return Level.WARN, _waiting(engine, waits_for)
        if engine.behind_s:
            return Level.ERROR, (
                f'IMU stamps are {engine.behind_s:.1f} s behind the newest: the clock stepped '
                'back, and the estimate stands until it has caught up'
            )
        if silent_s > _SILENT_S:
            return Level.ERROR, f'no IMU sample for {silent_s:.0f} s while other sensors go on'
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
        if engine.aiding_warning:
            return Level.WARN, engine.aiding_warning
        return Level.OK, f'navigating, {integrity.sentence}'

    def _tell(self, level: Level, said: Sequence[str]) -> None:
        """Log another level, and at the same one what was not said of late, but for numbers."""
        now_s = self._clock()
        shapes = {text: without_numbers(text) for text in said}
        if level is self._last:
            said = [t for t in said if now_s > self._told.get(shapes[t], -math.inf) + _AGAIN_S]
            if level is Level.OK or not said or not self._engine.navigating:
                return  # what a start waits for is in the log of StartPorts
        self._told |= dict.fromkeys((shapes[text] for text in said), now_s)
        message = '; '.join(said)
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


def _waiting(engine: Engine, waits_for: str) -> str:
    """Sentence about the missing input of a filter without a state."""
    refused = engine.verdicts[Verdict.NOT_FINITE]
    if refused and engine.params.mode == 'station':
        return (
            f'no state yet: {refused} messages were not finite, or had no attitude '
            '(orientation_covariance[0] of imu/data is -1); nav/receipt says which'
        )
    return f'no state yet: {waits_for}'


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
