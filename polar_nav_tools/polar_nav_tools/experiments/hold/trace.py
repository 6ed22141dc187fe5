"""What a follower published in a run, live or in a replay: estimates, reports, levels."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_msgs.msg import FixReceipt, NavHealth, NavState
from polar_nav_ros import topics

from ...inject.readings import NS

_NUMBER = re.compile(r'[-+]?\d[\d.,]*(?:e[-+]?\d+)?')
_ACCEPTED = (Verdict.FUSED, Verdict.GATED)
_LEVELS = {'OK': 0, 'WARN': 1, 'ERROR': 2}


class Word(NamedTuple):
    """A sentence that was published at a true time [s] at a level (2: ERROR)."""

    time_s: float
    level: int
    sentence: str

    @property
    def kind(self) -> str:
        """The sentence without its numbers."""
        return _NUMBER.sub('#', self.sentence)


class Innovation(NamedTuple):
    """Horizontal innovation of a fix that was judged at a true time [s], grid axes.

    Attributes
    ----------
    time_s : float
    z_G, variance_G : (float, float)
        Fix minus estimate [m], and its variance [m^2].
    """

    time_s: float
    z_G: tuple[float, float]
    variance_G: tuple[float, float]


@dataclass(frozen=True)
class Trace:
    """What a follower published in a run.

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
    fixes : mapping
        First judgement of each fix, by sender and number.
    """

    time_s: Array
    r_e: Array
    sigma_G: Array
    words: tuple[Word, ...]
    level: Array
    fused_s: Array
    ended: str
    fixes: Mapping[tuple[str, int], Innovation] = field(default_factory=dict)

    @classmethod
    def nothing(cls, ended: str) -> Trace:
        """Trace of a run that ended with an exception."""
        none = np.zeros(0)
        return cls(none, np.zeros((0, 3)), np.zeros((0, 3)), (), none, none, ended)


class Listener:
    """Collects the messages of a run to a `Trace`; times are true ones [ns]."""

    def __init__(self, start_ns: int) -> None:
        self._start_ns = start_ns
        self._time_s: list[float] = []
        self._r_e: list[Array] = []
        self._variance_G: list[Array] = []
        self._words: list[Word] = []
        self._fused_s: list[float] = []
        self._fixes: dict[tuple[str, int], Innovation] = {}

    def hear(self, topic: str, message: Any, true_ns: int) -> None:  # noqa: ANN401 - of the topic
        """Take a message on a topic of the follower."""
        time_s = (true_ns - self._start_ns) / NS
        if topic == topics.STATE:
            self._state(time_s, message)
        elif topic == topics.RECEIPT:
            self._receipt(time_s, message)
        elif topic == topics.HEALTH:
            self._health(time_s, message)

    def word(self, true_ns: int, level: int, sentence: str) -> None:
        """Take a sentence that was published elsewhere; one at level OK is none."""
        if level:
            self._words.append(Word((true_ns - self._start_ns) / NS, level, sentence))

    def trace(self, until_ns: int, ended: str) -> Trace:
        """What was heard until a true time."""
        words = tuple(sorted(self._words))
        level = np.zeros((until_ns - self._start_ns) // NS)
        for word in words:
            # Of a report at the end of a second, that second.
            second = int(np.ceil(word.time_s)) - 1
            if 0 <= second < len(level):
                level[second] = max(level[second], word.level)
        variance = np.array(self._variance_G).reshape(-1, 3)
        with np.errstate(invalid='ignore'):
            sigma_G = np.sqrt(variance)
        r_e = np.array(self._r_e).reshape(-1, 3)
        fused_s = np.array(self._fused_s)
        return Trace(
            np.array(self._time_s), r_e, sigma_G, words, level, fused_s, ended, self._fixes
        )

    def _state(self, time_s: float, message: NavState) -> None:
        self._time_s.append(time_s)
        self._r_e.append(np.array(message.r_e))
        self._variance_G.append(np.array(message.position_covariance_g)[::4])

    def _receipt(self, time_s: float, message: FixReceipt) -> None:
        verdict = Verdict(message.verdict)
        if message.source and np.isfinite(message.innovation_g).all():
            name = message.source, message.sequence
            (z_x, z_y, _), (v_x, v_y, _) = message.innovation_g, message.innovation_variance_g
            self._fixes.setdefault(name, Innovation(time_s, (z_x, z_y), (v_x, v_y)))
        if verdict is Verdict.FUSED:
            self._fused_s.append(time_s)
        elif verdict not in _ACCEPTED:
            sentence = f'{message.topic} {verdict.name}: {message.reason}'
            self._words.append(Word(time_s, 1, sentence))

    def _health(self, time_s: float, message: NavHealth) -> None:
        for line in message.conditions:
            name, sentence = line.split(': ', 1)
            if _LEVELS[name]:
                self._words.append(Word(time_s, _LEVELS[name], sentence))
