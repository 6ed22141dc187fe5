"""Level axes of an unknown heading, by gyros and gravity: roll, pitch, rest, dead reckoning.

The level axes L have z up; their heading is arbitrary and is held by the gyros. Once a second they
are turned so that the mean specific force, less the acceleration that the DVL measured, points up.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ...attitude import euler_from_matrix, exp, matrix_from_euler, orthonormalised
from ...earth import OMEGA_IE

REST_RATE, REST_FORCE = 0.02, 0.3
"""Largest RMS about the mean at rest [rad/s], [m/s^2]."""
NOT_LEVELLED = math.radians(1.0)
"""Least 1-sigma of tilt where motion is neither absent nor measured [rad]."""
GRAVITY = (9.4, 10.2)
"""Mean specific forces that gravity can be the reason of [m/s^2]."""
_G = 9.81
_LEAST_TILT = 1e-5
_LONGEST_GAP_S = 1.0
_LONGEST_PING_S = 2.0
_MOST_BLOCKS = 1200
_TRACK = 20_000


class Tilt(NamedTuple):
    """Roll and pitch [rad] of a mean specific force, body axes (docs/frames.md)."""

    roll: float
    pitch: float


def tilt_of(f_b: Array) -> Tilt:
    """Roll and pitch of a body at rest from its mean specific force (3,) [m/s^2]."""
    x, y, z = (float(v) for v in f_b)
    return Tilt(math.atan2(y, z), math.atan2(-x, math.hypot(y, z)))


def spread(values: Array) -> float:
    """RMS of the rows (n, 3) about their mean, all three axes together."""
    return float(np.sqrt(np.mean(np.sum((values - values.mean(axis=0)) ** 2, axis=1))))


def at_rest(rate_rms: float, force_rms: float) -> bool:
    """Whether spreads of rate [rad/s] and specific force [m/s^2] are those of a body at rest."""
    return rate_rms <= REST_RATE and force_rms <= REST_FORCE


class Still(NamedTuple):
    """Mean rate at rest.

    Attributes
    ----------
    omega_b : (3,) array
        [rad/s]
    error : float
        1-sigma of the mean per axis, by the scatter of its seconds [rad/s].
    seconds : float
    """

    omega_b: Array
    error: float
    seconds: float


class _Second(NamedTuple):
    """Sums over one second, times dt."""

    dt: float
    omega: Array
    omega_2: float
    f: Array
    f_2: float


class LevelFrame:
    """Attitude of the body in level axes, and what it moved along them.

    Parameters
    ----------
    window_s : float
        Time that gravity is averaged over [s].
    gyro_bias, accel_bias : float
        1-sigma [rad/s], [m/s^2].

    Attributes
    ----------
    C_b_L : (3, 3) array
    earth_up : float
        Vertical part of the Earth's rate, once the latitude is known [rad/s].
    stamp_ns : int or None
        Newest sample.
    levelled_s : float
        Time that gravity has been averaged over so far, `window_s` at most [s].
    sigma_tilt : float
        1-sigma of roll and pitch [rad]; infinite before the window is full.
    resting : bool
        Whether the window was at rest.
    force : float
        Mean specific force of the window [m/s^2].
    """

    def __init__(self, window_s: float, gyro_bias: float, accel_bias: float) -> None:
        self._window_s = window_s
        self._gyro_bias = gyro_bias
        self._accel_bias = accel_bias
        self.earth_up = 0.0
        self.stamp_ns: int | None = None
        self.restarts = 0
        self._clear()

    def _clear(self) -> None:
        self.C_b_L = np.eye(3)
        self.omega_b = np.zeros(3)
        self._rms = [math.inf, math.inf]
        self.levelled_s, self.sigma_tilt = 0.0, math.inf
        self.resting, self.force = False, math.nan
        self._impulse_L = np.zeros(3)
        self._marks: deque[tuple[int, Array, Array | None, float]] = deque()
        self._second = self._empty()
        self._seconds: deque[_Second] = deque()
        self._still: deque[_Second] = deque(maxlen=_MOST_BLOCKS)
        self._v_L: tuple[int, Array] | None = None
        self._xy = np.zeros(2)
        self.track: deque[tuple[int, float, float, float, float]] = deque(maxlen=_TRACK)

    @staticmethod
    def _empty() -> _Second:
        return _Second(0.0, np.zeros(3), 0.0, np.zeros(3), 0.0)

    def imu(self, stamp_ns: int, omega_b: Array, f_b: Array) -> None:
        """Turn by the rate, and sum up the specific force, of a sample."""
        before_ns, self.stamp_ns = self.stamp_ns, stamp_ns
        dt = 0.0 if before_ns is None else (stamp_ns - before_ns) * 1e-9
        if before_ns is None or not 0.0 < dt <= _LONGEST_GAP_S:
            self.restarts += before_ns is not None
            self._clear()
            roll, pitch = tilt_of(f_b)
            self.C_b_L = matrix_from_euler(0.0, pitch, roll)
            self._mark(None, math.inf)
            return
        self.omega_b = omega_b
        before = self.C_b_L
        self.C_b_L = before @ exp((omega_b - self.earth_up * before[2]) * dt)
        self._impulse_L = self._impulse_L + 0.5 * dt * ((before + self.C_b_L) @ f_b)
        s = self._second
        self._second = _Second(
            s.dt + dt,
            s.omega + dt * omega_b,
            s.omega_2 + dt * float(omega_b @ omega_b),
            s.f + dt * f_b,
            s.f_2 + dt * float(f_b @ f_b),
        )

    def attitude(self, C_b_L: Array) -> None:
        """Replace the attitude by one that is measured, of a heading that is known."""
        self.C_b_L = C_b_L

    def velocity(self, stamp_ns: int, v_b: Array, sigma: float, lever_b: Array) -> None:
        """Dead-reckon with a velocity over ground [m/s], body axes; tracks ``lever_b``, too."""
        if self.stamp_ns is None or abs(stamp_ns - self.stamp_ns) > _LONGEST_GAP_S * 1e9:
            return
        v_L = self.C_b_L @ v_b
        if self._v_L is not None:
            dt = (stamp_ns - self._v_L[0]) * 1e-9
            if dt <= 0.0:
                return
            if dt > _LONGEST_PING_S:
                self.track.clear()
            else:
                self._xy = self._xy + 0.5 * dt * (v_L + self._v_L[1])[:2]
        self._v_L = (stamp_ns, v_L)
        x, y = self._xy + (self.C_b_L @ lever_b)[:2]
        self.track.append((stamp_ns, float(x), float(y), float(self._xy[0]), float(self._xy[1])))
        self._mark(v_L, sigma)

    def look(self) -> None:
        """Close a second: level the axes, and judge whether the body is at rest."""
        if self._second.dt <= 0.0:  # the first sample, or the first after a gap
            return
        self._mark(None, math.inf)
        self._seconds.append(self._second)
        self._still.append(self._second)
        self._second = self._empty()
        while sum(s.dt for s in self._seconds) - self._seconds[0].dt >= self._window_s - 1e-6:
            self._seconds.popleft()
        self._judge_rest()
        self._level()

    def _mark(self, v_L: Array | None, sigma: float) -> None:
        assert self.stamp_ns is not None
        self._marks.append((self.stamp_ns, self._impulse_L, v_L, sigma))
        oldest_ns = self.stamp_ns - (self._window_s + 0.5) * 1e9
        while len(self._marks) > 2 and self._marks[0][0] < oldest_ns:
            self._marks.popleft()

    def _judge_rest(self) -> None:
        total = sum(s.dt for s in self._seconds)
        rates = np.array([s.omega for s in self._seconds]).sum(axis=0) / total
        forces = np.array([s.f for s in self._seconds]).sum(axis=0) / total
        squares = sum(s.omega_2 for s in self._seconds), sum(s.f_2 for s in self._seconds)
        rms = [
            math.sqrt(max(0.0, square / total - float(mean @ mean)))
            for mean, square in zip((rates, forces), squares, strict=True)
        ]
        self._rms = rms
        self.resting = at_rest(*rms)
        if not self.resting:
            self._still.clear()

    def _level(self) -> None:
        pings = [m for m in self._marks if m[2] is not None]
        first, last = self._marks[0], self._marks[-1]
        known = len(pings) > 1 and pings[-1][0] - pings[0][0] >= 0.5e9 * self._window_s
        if known:
            first, last = pings[0], pings[-1]
        took = (last[0] - first[0]) * 1e-9
        window_s = (self._marks[-1][0] - self._marks[0][0]) * 1e-9
        self.levelled_s = min(window_s, self._window_s)
        if took <= 0.0:
            return
        up = (last[1] - first[1]) / took
        if known and first[2] is not None and last[2] is not None:
            up = up - (last[2] - first[2]) / took
        self.force = float(np.linalg.norm(up))
        if not GRAVITY[0] <= self.force <= GRAVITY[1]:
            self.sigma_tilt = math.inf
            return
        self._turn(up / self.force)
        full = window_s >= self._window_s - 0.5
        self.sigma_tilt = self._sigma_tilt(known, took, last[3]) if full else math.inf

    def _turn(self, up_L: Array) -> None:
        """Turn the axes by the smallest rotation that takes ``up_L`` to z."""
        axis = np.array([up_L[1], -up_L[0], 0.0])
        sine = float(np.hypot(axis[0], axis[1]))
        R = exp(axis * (math.atan2(sine, float(up_L[2])) / sine)) if sine > 0.0 else np.eye(3)
        self.C_b_L = orthonormalised(R @ self.C_b_L)
        self._impulse_L = R @ self._impulse_L
        self._marks = deque(
            (ns, R @ i, None if v is None else R @ v, s) for ns, i, v, s in self._marks
        )
        if self._v_L is not None:
            self._v_L = (self._v_L[0], R @ self._v_L[1])

    def _sigma_tilt(self, known: bool, took: float, sigma_v: float) -> float:
        # The gyros hold the axes in space: meanwhile the vertical turns with the Earth.
        drift = 0.5 * took * math.hypot(self._gyro_bias, OMEGA_IE)
        if known:
            motion = math.sqrt(2.0) * sigma_v / (took * _G)
        elif self.resting:
            means = np.array([s.f / s.dt for s in self._seconds])
            motion = spread(means) / math.sqrt(2.0 * len(means)) / _G
        else:
            motion = max(NOT_LEVELLED, self._rms[1] / _G)
        return max(_LEAST_TILT, math.sqrt((self._accel_bias / _G) ** 2 + drift**2 + motion**2))

    @property
    def tilt(self) -> Tilt:
        """Present roll and pitch."""
        _, pitch, roll = euler_from_matrix(self.C_b_L)
        return Tilt(float(roll), float(pitch))

    @property
    def yaw(self) -> float:
        """Present heading of body x from x of the level axes, counter-clockwise [rad]."""
        return float(euler_from_matrix(self.C_b_L)[0])

    @property
    def still(self) -> Still | None:
        """Mean rate since the body came to rest; None if it is not, or not for the window."""
        total = sum(s.dt for s in self._still)
        if not self.resting or total < self._window_s - 0.5:
            return None
        means = np.array([s.omega / s.dt for s in self._still])
        omega = np.array([s.omega for s in self._still]).sum(axis=0) / total
        error = spread(means) / math.sqrt(3.0 * max(1, len(means) - 1))
        return Still(omega, error, total)

    def displacement(self, stamp_ns: int) -> Array | None:
        """Present dead-reckoned position less that at a stamp, level axes (2,) [m]; else None."""
        if not self.track or not self.track[0][0] <= stamp_ns:
            return None
        rows = np.array(self.track)
        at = [float(np.interp(stamp_ns, rows[:, 0], rows[:, k])) for k in (3, 4)]
        way: Array = self._xy - np.array(at)
        return way
