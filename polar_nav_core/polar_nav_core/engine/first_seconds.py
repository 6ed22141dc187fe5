"""What IMU and DVL show of a vehicle in its first two seconds after a restart.

A saved state knows how the vehicle turned before; gyros and pings after it show how it turns now,
how fast it is, and its way since. So a turn that began or ended while nobody navigated is known,
and only one that did both is not.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..attitude import matrix_from_euler
from ..earth import OMEGA_IE
from .away import Seen
from .events import DvlPing, ImuSample
from .params import EngineParams
from .plausibility import is_covariance, within
from .saved import SavedState
from .start.level import LevelFrame

WATCHED_SINCE = 3
"""Format of saved states; a filter begins at once from an older one, as recordings of then do."""
WATCH_S = 2.0
"""A restarted filter begins with the first ping so long after its first IMU sample [s]."""
NO_PING_S = 1.0
"""Without a ping for so long it begins at once [s]."""
MOST_WATCH_S = 4.0
"""After so long it begins, whatever was found [s]."""
LEAST_SPEED = 0.3
"""Slower vehicles have no course [m/s]."""
_LEAST_PINGS, _LEAST_SPAN_S = 3, 1.0
_BENT = 4.0
"""Sigmas of a bend of the track that shows."""


class FirstSeconds:
    """Collects samples and pings after a restart.

    Parameters
    ----------
    params : EngineParams
    saved : SavedState
        Of a strapdown filter: its sensor errors are subtracted, its latitude is used.

    Attributes
    ----------
    fresh : DvlPing or None
        Ping since the newest IMU sample.
    """

    def __init__(self, params: EngineParams, saved: SavedState) -> None:
        self._p = params
        self._b_gyro_b = saved.values['b_gyro_b']
        self._b_accel_b = saved.values['b_accel_b']
        self._frame = LevelFrame(WATCH_S, params.gyro_bias_sigma, params.accel_bias_sigma)
        self._frame.earth_up = OMEGA_IE * math.sin(saved.latitude)
        roll, pitch, yaw = np.radians(params.dvl_rpy_deg)
        self._C_m_b = matrix_from_euler(yaw, pitch, roll)
        self._first_ns: int | None = None
        self._begin_ns = 0
        self._pings: list[tuple[int, Array, float]] = []
        self.fresh: DvlPing | None = None

    def imu(self, sample: ImuSample) -> bool:
        """Take a sample; whether the filter begins at it, with the ping that is `fresh`."""
        frame, restarts = self._frame, self._frame.restarts
        frame.imu(
            sample.stamp_ns, sample.omega_ib_b - self._b_gyro_b, sample.f_b - self._b_accel_b
        )
        if self._first_ns is None:
            self._first_ns = self._begin_ns = sample.stamp_ns
        elif frame.restarts != restarts:
            self._begin_ns = sample.stamp_ns
            self._pings.clear()
        since_s = (sample.stamp_ns - self._begin_ns) * 1e-9
        in_all_s = (sample.stamp_ns - self._first_ns) * 1e-9
        if since_s >= WATCH_S and self.fresh is not None:
            return True
        self.fresh = None
        return (since_s >= NO_PING_S and not self._pings) or in_all_s >= MOST_WATCH_S

    def ping(self, ping: DvlPing) -> None:
        """Take a ping of the bottom that is one."""
        if self._first_ns is None or ping.water or not is_covariance(ping.covariance_m):
            return
        if not within(ping.v_m, self._p.max_speed):
            return
        frame = self._frame
        v_b = self._C_m_b @ ping.v_m - np.cross(frame.omega_b, np.asarray(self._p.dvl_lever_b))
        sigma = math.sqrt(float(np.diagonal(ping.covariance_m).max()))
        self.fresh = ping
        self._pings.append((ping.stamp_ns, frame.C_b_L @ v_b, sigma))
        frame.velocity(ping.stamp_ns, v_b, sigma, np.zeros(3))

    def seen(self, stamp_ns: int) -> Seen | None:
        """What was seen until a stamp; None where that is too little."""
        frame, n = self._frame, len(self._pings)
        before = frame.C_b_L
        frame.look()
        if n < _LEAST_PINGS or not math.isfinite(frame.sigma_tilt):
            return None
        time_s = np.array([ns - self._begin_ns for ns, _, _ in self._pings]) * 1e-9
        span_s = float(time_s[-1] - time_s[0])
        v_L = np.array([v for _, v, _ in self._pings]) @ (frame.C_b_L @ before.T).T
        speeds = np.hypot(v_L[:, 0], v_L[:, 1])
        if span_s < _LEAST_SPAN_S or speeds.min() < LEAST_SPEED:
            return None
        watched_s = (stamp_ns - self._begin_ns) * 1e-9
        sigma = max(s for _, _, s in self._pings)
        courses = np.unwrap(np.arctan2(v_L[:, 1], v_L[:, 0]))
        bend, rate, course = _parabola(time_s, courses, sigma / float(speeds.min()))
        turned = (bend * watched_s + rate) * watched_s
        late = time_s >= time_s[-1] - 0.5 * span_s
        speed = float(speeds[late].mean())
        p = self._p
        slow = math.hypot(p.dvl_markov_sigma, p.dvl_scale_sigma * speed)
        sigma_speed = math.hypot(2.0 * sigma / math.sqrt(n), slow)
        return Seen(
            begin_ns=self._begin_ns,
            rate=rate,
            turned=turned,
            sigma_rate=0.5 * abs(bend) * watched_s,
            watched_s=watched_s,
            path=_turn(-course) @ v_L[:, :2].mean(axis=0) * watched_s,
            speed=speed,
            up=float(v_L[late, 2].mean()),
            C_b_c=matrix_from_euler(-course - turned, 0.0, 0.0) @ frame.C_b_L,
            sigma_tilt=frame.sigma_tilt,
            sigma_speed=sigma_speed,
        )


def _parabola(time_s: Array, courses: Array, sigma: float) -> tuple[float, float, float]:
    """Coefficients of a parabola through courses of an error sigma [rad], the highest first.

    It is a line where no bend shows, which is more certain of the rate of turn.
    """
    if len(time_s) > _LEAST_PINGS:
        bend, rate, course = (float(x) for x in np.polyfit(time_s, courses, 2))
        # Of n equal errors over a span W the bend has the sigma sqrt(180 / n) / W^2.
        span_s = float(time_s[-1] - time_s[0])
        if abs(bend) * span_s**2 > _BENT * sigma * math.sqrt(180.0 / len(time_s)):
            return bend, rate, course
    rate, course = (float(x) for x in np.polyfit(time_s, courses, 1))
    return 0.0, rate, course


def _turn(angle: float) -> Array:
    """Rotation (2, 2) by an angle, counter-clockwise [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])
