"""Headings of all methods as turns from the level to the grid axes; the best one that there is.

A turn stays as it is while the gyros hold the level axes, and becomes less certain with time: a
heading that was found at rest, or at a lower latitude, is carried along.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from ..events import HeadingSample
from .level import LevelFrame
from .model import MOST_HEADING, Candidate
from .north import North

_FRESH_S = 0.5
_STEEP = math.radians(75.0)
"""Pitch beyond which body x has no heading to speak of [rad]."""
_FEWEST = 3
_LEAST_SPAN_S = 1.0


class Headings:
    """Candidates for the heading at the start.

    Parameters
    ----------
    frame : LevelFrame
    window_s : float
        Measured headings are averaged over it [s].
    bias, noise : float
        Of the gyros: 1-sigma [rad/s], and density [rad/s/sqrt(Hz)].
    allowed : str
        ``auto``, or the only method whose headings count.

    Attributes
    ----------
    stated : Candidate or None
        Of the user, which wins.
    """

    def __init__(
        self, frame: LevelFrame, window_s: float, bias: float, noise: float, allowed: str
    ) -> None:
        self._frame = frame
        self._window_ns = round(window_s * 1e9)
        self._bias, self._noise = bias, noise
        self._allowed = allowed
        self._measured: deque[tuple[int, float, str]] = deque()
        self._best: dict[str, Candidate] = {}
        self.stated: Candidate | None = None

    def clear(self) -> None:
        """Forget all: the level axes began anew."""
        self._measured.clear()
        self._best.clear()

    def allows(self, method: str) -> bool:
        """Whether headings of a method count."""
        return self._allowed in ('auto', method)

    def take(self, sample: HeadingSample) -> None:
        """Store a measured heading that is of now."""
        now_ns = self._frame.stamp_ns
        if now_ns is None or not self.allows('measured'):
            return
        age_s = (now_ns - sample.stamp_ns) * 1e-9
        if abs(age_s) > _FRESH_S or not math.isfinite(sample.heading):
            return
        if abs(self._frame.tilt.pitch) > _STEEP:
            return
        yaw = 0.5 * math.pi - sample.heading + float(self._frame.omega_b[2]) * age_s
        self._measured.append((sample.stamp_ns, yaw - self._frame.yaw, sample.topic))
        while sample.stamp_ns - self._measured[0][0] > self._window_ns:
            self._measured.popleft()

    def offer(self, candidate: Candidate) -> None:
        """Store a candidate, if it is better than the one of its method, carried to now."""
        if not self.allows(candidate.method):
            return
        older = self._best.get(candidate.method)
        if older is None or candidate.sigma <= self._aged(older, candidate.stamp_ns):
            self._best[candidate.method] = candidate

    def measured(self, north: North) -> Candidate | None:
        """Mean of what was measured lately; None while there is too little of it."""
        rows = list(self._measured)
        now_ns = self._frame.stamp_ns
        if len(rows) < _FEWEST or now_ns is None:
            return None
        first, last = rows[0][0], rows[-1][0]
        if (last - first) * 1e-9 < _LEAST_SPAN_S or (now_ns - last) * 1e-9 > 2.0 * _FRESH_S:
            return None
        turns = np.exp(1j * np.array([turn for _, turn, _ in rows]))
        mean = complex(turns.mean())
        scatter = float(np.sqrt(np.mean(np.angle(turns / mean) ** 2)))
        turn = math.atan2(mean.imag, mean.real) - north.azimuth
        how = f'measured by {rows[-1][2]} ({north.name})'
        return Candidate('measured', turn, math.hypot(north.sigma, scatter), last, how)

    def best(self) -> Candidate | None:
        """The most certain candidate now, its sigma aged; None without one within the limit."""
        if self.stated is not None:
            return self.stated
        now_ns = self._frame.stamp_ns
        if now_ns is None:
            return None
        found = []
        for c in self._best.values():
            sigma = self._aged(c, now_ns)
            age_s = (now_ns - c.stamp_ns) * 1e-9
            how = c.how if age_s < 5.0 else f'{c.how}, carried by the gyros for {age_s:.0f} s'
            found.append(Candidate(c.method, c.turn, sigma, now_ns, how))
        return min((c for c in found if c.sigma <= MOST_HEADING), key=_sigma, default=None)

    def _aged(self, candidate: Candidate, now_ns: int) -> float:
        age_s = max(0.0, (now_ns - candidate.stamp_ns) * 1e-9)
        return math.sqrt(candidate.sigma**2 + (self._bias * age_s) ** 2 + self._noise**2 * age_s)


def _sigma(candidate: Candidate) -> float:
    return candidate.sigma
