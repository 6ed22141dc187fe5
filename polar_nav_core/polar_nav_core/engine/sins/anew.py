"""A strapdown navigation that cannot be right and that no DVL holds: it begins anew at its fixes.

Without a DVL nothing but fixes shows what a gyro that jumps or a turn that was missed makes of the
estimate: gravity leaks into the velocity, the gate refuses what contradicts it, and soon no linear
correction leads back. An estimate that is faster than the vehicle can be (`max_speed`) is wrong
for certain, one that runs away from its fixes is if it would refuse them with any covariance that
doubt may give it, and one whose covariance would have to hold any attitude for possible knows none
(engine.reconsider). Then the refused fixes say where the vehicle is and how fast, and the
accelerometers where down is, however far the attitude was off: a vehicle accelerates little, so
that what they feel is gravity. The heading stays, and is doubted. Where the attitude was not off,
a bias of the accelerometers may be what the velocity has run away by.
"""

from __future__ import annotations

import math

import numpy as np

from ... import attitude, earth
from ...arrays import Array
from ...error_model import X
from ...kernels.sins import enlarged
from ...kernels.sins import state as fs
from ...kernels.sins import update as kf
from ...kernels.sins.consider import DEPTH_ZERO, DVL_YAW
from ...kernels.sins.gap import MOST_HEADING, MOST_TILT
from ...kernels.sins.runaway import MOST_GYRO
from ..course import course_of
from ..disagreement import RefusedRow
from .doubt import opened_for_fixes
from .filter import NavigationFilter

_LEVELLED_S = 2.0
"""The accelerometers' mean of so long says where down is."""
_TILT = 0.05
"""1-sigma of that [rad]: accelerations of 0.5 m/s^2."""
_MOST_PUSH = 0.1
"""Most that an accelerometer's bias can have jumped [m/s^2]: 10 mg."""
_CLIMB = 1.0
"""1-sigma of the vertical velocity, of which fixes say little [m/s]."""


def begin_at_fixes(f: NavigationFilter, row: RefusedRow, max_speed: float) -> bool:
    """Whether the filter began anew at refused fixes: they must lie on a course it can have.

    Fixes that are valid before this moment are out of reach then.

    Parameters
    ----------
    f : NavigationFilter
        It has used no ping lately. Where pings were refused since, they, too, say something of
        the velocity: nothing is done.
    row : RefusedRow
    max_speed : float
        The fastest that the vehicle can be [m/s].
    """
    if f.state.counters[fs.REFUSED_ROW + fs.DVL_ROW]:
        return False
    course = course_of(row.in_order(), f.frames.C_e_G, f.stamp_ns)
    if course is None or float(np.linalg.norm(course.velocity)) > max_speed:
        return False
    state, C_e_G = f.state, f.frames.C_e_G
    P, S, counters = state.P, state.sensitivity, state.counters
    used_ns = max(counters[fs.USED_NS + fs.FIX_ROW], counters[fs.USED_NS + fs.DEPTH_ROW])
    held_s = (counters[fs.STAMP] - max(int(used_ns), f.start_ns)) * 1e-9
    change_G = np.array([*course.velocity, 0.0]) - state.v_G
    turned = _levelling(f)
    angle = math.hypot(turned[0], turned[1])
    is_turn = angle > MOST_TILT  # and no gyro's bias
    enlarged.hold_covariance(state, f.work)
    x = np.zeros(kf.N)
    x[X.phi_G] = turned
    x[X.dv_G] = -change_G
    to_G = C_e_G @ (course.newest_e - f.frames.point_e)
    to_G[:2] += course.position
    # The fixes are of a transponder, which turns with the vehicle.
    to_G += f.frames.lever_G - attitude.exp(turned) @ f.frames.lever_G
    x[X.dr_e] = -C_e_G[:2].T @ to_G[:2]
    sigma_z = _CLIMB + abs(float(state.v_G[2])) * held_s
    before = P.copy()
    f.feed_back(x)
    P[:] = before
    known = slice(X.phi_G.start, X.dr_e.stop)
    P[known] = P[:, known] = 0.0
    S[X.phi_G] = S[X.dv_G] = 0.0
    S[X.dr_e, DVL_YAW:DEPTH_ZERO] = 0.0  # what fixes have in common, the position has still
    P[X.phi_G, X.phi_G] = np.diag([_TILT**2, _TILT**2, MOST_HEADING**2])
    axes = C_e_G[:2]
    (r_r, r_v), (_, v_v) = course.covariance.tolist()
    P[X.dr_e, X.dr_e] = r_r * axes.T @ axes + sigma_z**2 * np.outer(C_e_G[2], C_e_G[2])
    P[X.dv_G, X.dv_G] = np.diag([v_v, v_v, _CLIMB**2])
    P[X.dr_e, X.dv_G] = r_v * np.column_stack([axes.T, np.zeros(3)])
    P[X.dv_G, X.dr_e] = P[X.dr_e, X.dv_G].T
    jumped = min((_TILT if is_turn else angle) / max(held_s, 1.0), MOST_GYRO)
    P[X.b_gyro_b, X.b_gyro_b] += jumped**2 * np.eye(3)
    if not is_turn:
        pushed = min(float(np.linalg.norm(change_G)) / max(held_s, 1.0), _MOST_PUSH)
        P[X.b_accel_b, X.b_accel_b] += pushed**2 * np.eye(3)
    if len(state.model):
        state.model[fs.P_XE + known.start : fs.P_XE + known.stop] = 0.0
    state.carried[:] = 0.0
    opened_for_fixes(f)
    counters[fs.FROM_NS] = counters[fs.STAMP]
    return True


def _levelling(f: NavigationFilter) -> Array:
    """Rotation vector (3,) that levels the attitude [rad]; of zeros where the past is too short.

    What the accelerometers felt, by the attitude of then, is what the velocity has gained, free of
    corrections, and gravity; it is to point up.
    """
    past = f.history.since(f.stamp_ns - round(_LEVELLED_S * 1e9))
    if past is None or len(past.stamps_ns) < 2:
        return np.zeros(3)
    time_s = (past.stamps_ns[-1] - past.stamps_ns[0]) * 1e-9
    corrections = past.corrections[: past.firsts[-1] - past.firsts[0]]
    gained = past.velocities_G[-1] - past.velocities_G[0] + corrections[:, X.dv_G].sum(axis=0)
    gravity = float(np.linalg.norm(earth.gravity(f.state.r_e)))
    felt_G = gained / time_s + [0.0, 0.0, gravity]
    axis = np.cross(felt_G, [0.0, 0.0, 1.0])
    size = float(np.linalg.norm(axis))
    if size == 0.0:
        return np.zeros(3)
    return np.asarray(axis * (math.atan2(size, float(felt_G[2])) / size))
