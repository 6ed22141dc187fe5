"""One run of a filter over readings, as a live node: reorder window, health, diagnostics."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from polar_nav_core.engine.events import Array, Estimate, Event, Receipt, Verdict
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.grid import ecef_to_grid
from polar_nav_ros.health_message import health_to_msg
from polar_nav_ros.navigation_health import NavigationHealth
from polar_nav_ros.navigation_session import NavigationSession

from ...inject.events import events_of
from ...inject.readings import IMU, NS, Readings

_NUMBER = re.compile(r'[-+]?\d[\d.,]*(?:e[-+]?\d+)?')
_ACCEPTED = (Verdict.FUSED, Verdict.GATED)


class Word(NamedTuple):
    """A sentence that was published at a true time [s] at a level (2: ERROR)."""

    time_s: float
    level: int
    sentence: str

    @property
    def kind(self) -> str:
        """The sentence without its numbers."""
        return _NUMBER.sub('#', self.sentence)


@dataclass(frozen=True)
class Trace:
    """What a node published in a run.

    Attributes
    ----------
    time_s : (n,) array
        True times of the estimates, since the start of the run.
    r_e, sigma_G : (n, 3) arrays
        Positions [m] and their published 1-sigma, grid axes [m].
    words : tuple of Word
        WARN and ERROR, in every second in which they stood, and refusals of messages.
    level : (m,) array
        Worst level in every second.
    fused_s : (k,) array
        When fixes were fused [s].
    ended : str
        Why there is no state at the end; empty where there is one.
    """

    time_s: Array
    r_e: Array
    sigma_G: Array
    words: tuple[Word, ...]
    level: Array
    fused_s: Array
    ended: str


class _Quiet:
    """A logger that logs nothing."""

    def info(self, message: str) -> None:
        del message

    def warning(self, message: str) -> None:
        del message

    def error(self, message: str) -> None:
        del message


class _Run:
    """Drives a session, and collects what it publishes."""

    def __init__(self, params: EngineParams, start_ns: int) -> None:
        self._now_ns = self._start_ns = start_ns
        session = NavigationSession(params, 'follower', {})
        self._reorder, self.engine = session.reorder, session.engine
        self._node = NavigationHealth(self.engine, _Quiet(), lambda: 1e-9 * self._now_ns)
        self._imu_ns: int | None = None
        self._true_ns: dict[int, int] = {}
        self._estimates: list[tuple[int, Estimate]] = []
        self._words: list[Word] = []
        self._levels: list[int] = []
        self._fused: list[float] = []

    def take(self, arrival_ns: int, true_ns: int, event: Event, *, imu: bool) -> None:
        """Take one message, after a look at every second before it."""
        while (self._now_ns + NS) <= arrival_ns:
            self._now_ns += NS
            self._look()
        if imu:
            self._imu_ns = arrival_ns
            self._true_ns[event.stamp_ns] = true_ns
        for output in self._reorder.add(event, arrival_ns):
            self._put(output, arrival_ns)

    def _put(self, output: object, arrival_ns: int) -> None:
        if isinstance(output, Estimate):
            # An estimate that is of no sample's stamp is of the engine's own time.
            own_ns = self.engine.clock.own_ns(output.stamp_ns)
            true_ns = self._true_ns.get(own_ns, output.stamp_ns)
            self._estimates.append((true_ns, output))
        elif isinstance(output, Receipt):
            time_s = self._since_s(arrival_ns)
            if output.verdict is Verdict.FUSED:
                self._fused.append(time_s)
            elif output.verdict not in _ACCEPTED:
                sentence = f'{output.topic} {output.verdict.name}: {output.reason}'
                self._words.append(Word(time_s, 1, sentence))

    def _look(self) -> None:
        """Note what health and diagnostics of the node state in this second."""
        now_s = self._since_s(self._now_ns)
        found = []
        newest_ns = self._reorder.newest_imu_ns
        if newest_ns is not None and self._imu_ns is not None:
            stamp_ns = newest_ns + self._now_ns - self._imu_ns
            message = health_to_msg(self.engine, stamp_ns, math.nan, newest_ns)
            levels = {'OK': 0, 'WARN': 1, 'ERROR': 2}
            for line in message.conditions:
                name, sentence = line.split(': ', 1)
                found.append(Word(now_s, levels[name], sentence))
        diagnosis = self._node.diagnose({'waiting': self._reorder.pending})
        found.append(Word(now_s, int(diagnosis.level), diagnosis.message))
        found = [word for word in found if word.level]
        self._words += found
        self._levels.append(max((word.level for word in found), default=0))

    def _since_s(self, stamp_ns: int) -> float:
        return (stamp_ns - self._start_ns) / NS

    def trace(self, until_ns: int) -> Trace:
        """What was published until a true time."""
        while self._now_ns + NS <= until_ns:
            self._now_ns += NS
            self._look()
        time_s = np.array([self._since_s(t) for t, _ in self._estimates])
        r_e = np.array([e.r_e for _, e in self._estimates]).reshape(-1, 3)
        sigma = [_sigma_G(e) for _, e in self._estimates]
        return Trace(
            time_s,
            r_e,
            np.array(sigma).reshape(-1, 3),
            tuple(sorted(self._words)),
            np.array(self._levels),
            np.array(self._fused),
            '' if self.engine.navigating else self.engine.divergence or 'no state',
        )


def _sigma_G(e: Estimate) -> Array:
    if not (np.isfinite(e.r_e).all() and np.linalg.norm(e.r_e) > 1e6):
        return np.full(3, math.nan)
    C_e_G = np.asarray(ecef_to_grid(e.r_e))
    with np.errstate(invalid='ignore'):
        return np.sqrt(np.diagonal(C_e_G @ e.P[6:9, 6:9] @ C_e_G.T))


def drive(
    params: EngineParams, readings: Readings, events: list[Event], start_ns: int, end_ns: int
) -> Trace:
    """What a node with these parameters publishes when it receives the readings."""
    run = _Run(params, start_ns)
    for reading, event in events_of(readings, events):
        run.take(reading.arrival_ns, reading.true_ns, event, imu=reading.stream == IMU)
    return run.trace(end_ns)
