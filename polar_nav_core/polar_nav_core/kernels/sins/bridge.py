"""Prediction over a gap between IMU samples: last rates, which decay, and constant velocity.

The steps are covariance steps like others, with transitions, epochs and snapshots, so that late
fixes find their way across a gap. Measurements that come in it are fused at their stamps.
"""

from __future__ import annotations

import math

from ..cache import apart, entry, kernel, routine
from ..frames.body import rotation_coefficients
from ..frames.earth import up_and_height
from ..frames.grid import fill_C_e_G
from . import state as fs
from .events import (
    finish_step,
    take_snapshot,
)
from .fuse import locate
from .gap import HELD_S, LONG_NS, add_gap_noise, add_path_not_known
from .rings import Log, Past
from .settings import Settings
from .state import Frames, State
from .work import Work

USUAL = 3.0
"""A gap is longer than so many of the intervals that were usual before it."""
FIRST_NS = 1_000_000_000
"""What is a gap after the first sample, whose interval is not known."""
_AT_ONCE_S = 1e-3
"""Length [s] for the covariance of the one step that leads over all that is longer than LONG_S."""


@kernel
def is_gap(s: State, c: Settings, stamp_ns: int) -> bool:
    """Whether a stamp is so far from the newest IMU sample that the gap is bridged."""
    if c.gap_ns == 0:
        return False
    usual_s = usual_interval(s, c)
    least_ns = FIRST_NS
    if usual_s > 0.0:
        least_ns = max(c.gap_ns, int(USUAL * usual_s * 1e9))
    return bool(stamp_ns - s.counters[fs.IMU_NS] > least_ns)


@kernel
def usual_interval(s: State, c: Settings) -> float:
    """Interval of the IMU before a gap [s]: that of the last sample, if it is whole."""
    usual_s = float(s.previous_dt[0])
    if c.fills and s.counters[fs.HELD_NS] > 0:
        usual_s = s.counters[fs.USUAL_NS] * 1e-9
    elif c.fills:
        usual_s = max(usual_s, s.counters[fs.USUAL_NS] * 1e-9)
    return usual_s


@apart
@routine
def bridge(s: State, c: Settings, past: Past, w: Work, log: Log, until_ns: int) -> None:
    """Move the state to a stamp [ns] without IMU samples.

    It ends early where a covariance is lost: the step or update that follows fails by that.
    """
    imu_ns = s.counters[fs.IMU_NS]
    code = fs.DONE
    if s.counters[fs.HELD_NS] > 0:  # of a gap that is too long to be filled
        held = (s.counters[fs.HELD_NS] - imu_ns) * 1e-9
        s.counters[fs.HELD_NS] = 0
        for k in range(6):
            w.q[k] = 0.0
        add_gap_noise(w.q, s.P, c.gap_variances, 0.0, held)
        for k in range(6):
            s.P[k, k] += w.q[k]
    while s.counters[fs.STAMP] < until_ns and code == fs.DONE:
        before_ns, gap = s.counters[fs.STAMP], 0.0
        stamp_ns = before_ns  # a step that runs ends at the gap
        if s.counters[fs.BOUNDARY] == before_ns:
            next_ns = (before_ns // c.step_ns + 1) * c.step_ns
            stamp_ns = until_ns
            if before_ns - imu_ns < LONG_NS:
                stamp_ns = min(until_ns, next_ns)
        step = (stamp_ns - s.counters[fs.BOUNDARY]) * 1e-9
        if stamp_ns > before_ns:
            before = (before_ns - imu_ns) * 1e-9
            gap = before + step
            if before_ns - imu_ns < LONG_NS:
                _hold(s, w, before, gap)
            else:
                add_path_not_known(s.P, s.v_G, before, gap)
                step = _AT_ONCE_S
                s.sums[5, 0] = step
            s.counters[fs.STAMP] = stamp_ns
        code = finish_step(s, c, past, w, log, stamp_ns, step, gap)
        if s.counters[fs.STEPS] % c.steps_per_snapshot == 0:
            take_snapshot(s, log)


@kernel
def _hold(s: State, w: Work, before: float, after: float) -> None:
    """Turn the attitude by the last rates, which decay; move by the velocity. Times in the gap."""
    turn = HELD_S * (math.exp(-before / HELD_S) - math.exp(-after / HELD_S))
    x = (s.omega_ib_b[0] - s.b_gyro_b[0]) * turn
    y = (s.omega_ib_b[1] - s.b_gyro_b[1]) * turn
    z = (s.omega_ib_b[2] - s.b_gyro_b[2]) * turn
    half, cosine, _ = rotation_coefficients(x * x + y * y + z * z)
    a, b, d, q = half * x, half * y, half * z, cosine
    for i in range(3):
        c_x, c_y, c_z = s.C_b_G[i, 0], s.C_b_G[i, 1], s.C_b_G[i, 2]
        s.C_b_G[i, 0] = (
            c_x * (1.0 - 2.0 * (b * b + d * d)) + c_y * 2.0 * (a * b + q * d)
            + c_z * 2.0 * (a * d - q * b)
        )  # fmt: skip
        s.C_b_G[i, 1] = (
            c_x * 2.0 * (a * b - q * d) + c_y * (1.0 - 2.0 * (a * a + d * d))
            + c_z * 2.0 * (b * d + q * a)
        )  # fmt: skip
        s.C_b_G[i, 2] = (
            c_x * 2.0 * (a * d + q * b) + c_y * 2.0 * (b * d - q * a)
            + c_z * (1.0 - 2.0 * (a * a + b * b))
        )  # fmt: skip
    u_x, u_y, u_z, _ = up_and_height(s.r_e[0], s.r_e[1], s.r_e[2])
    fill_C_e_G(u_x, u_y, u_z, w.C_e_G)
    dt = after - before
    for k in range(3):
        for n in range(3):
            s.r_e[k] += w.C_e_G[n, k] * s.v_G[n] * dt
    s.sums[4, 0] = x
    s.sums[4, 1] = y
    s.sums[4, 2] = z
    s.sums[5, 0] = dt


@kernel
def bridge_to_sample(s: State, c: Settings, past: Past, w: Work, log: Log, stamp_ns: int) -> None:
    """`bridge` up to the beginning of a sample's interval, and note the gap."""
    usual_ns = int(usual_interval(s, c) * 1e9)
    length_ns = stamp_ns - s.counters[fs.IMU_NS]
    until_ns = max(s.counters[fs.STAMP], stamp_ns - max(usual_ns, 1_000_000))
    bridge(s, c, past, w, log, until_ns)
    s.counters[fs.HAS_PREVIOUS] = 0
    s.span[0] = 0.0
    s.counters[fs.GAPS] += 1
    s.counters[fs.GAP_NS] = length_ns
    s.counters[fs.GAP_END_NS] = stamp_ns


@entry
@routine
def reach(s: State, fr: Frames, c: Settings, past: Past, w: Work, log: Log, stamp_ns: int) -> None:
    """Move the state to a measurement's stamp if that lies in a gap."""
    if is_gap(s, c, stamp_ns):
        bridge(s, c, past, w, log, stamp_ns)
        locate(s, fr, c)
