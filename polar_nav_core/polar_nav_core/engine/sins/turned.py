"""A strapdown navigation whose heading refused fixes have shown to be wrong: turned, and unsure.

See engine.disagreement for what they must show.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from ...arrays import Array, Ints
from ...error_model import X
from ...kernels.sins import enlarged, heading
from ...kernels.sins import state as fs
from ...kernels.sins import update as kf
from ...kernels.sins.consider import DEPTH_ZERO, DVL_YAW
from ...kernels.sins.reopen import AGAIN_NS
from ...kernels.sins.state import State
from ..disagreement import MOST_HEADING, Complex, Present, RefusedRow, Turn, Unlearnt
from ..params import EngineParams
from .doubt import forget_fixes
from .filter import NavigationFilter


def weigh_refused(
    f: NavigationFilter, row: RefusedRow, p: EngineParams, sigma_heading: float
) -> bool:
    """Whether refused fixes show a wrong heading; the state is turned and P enlarged then.

    The fixes to come are judged by that; those refused stay refused.

    Parameters
    ----------
    f : NavigationFilter
    row : RefusedRow
    p : EngineParams
        For the sigmas of the start; nothing is done where ``reopen_after_s`` is 0.
    sigma_heading : float
        Of the start [rad].
    """
    if not p.reopen_after_s:
        return False
    since_ns = free_since_ns(f)
    heading = min(sigma_heading, MOST_HEADING) if since_ns is None else MOST_HEADING
    unlearnt = Unlearnt(heading, p.dvl_scale_sigma, p.gyro_bias_sigma)
    present = Present(f.stamp_ns, f.frames.point_e, partial(_track, f))
    turn = row.turn(f.frames.C_e_G, present, unlearnt, since_ns)
    if turn is None:
        return False
    turn_state(f, turn, p.dvl_scale_sigma)
    return True


def _track(f: NavigationFilter, stamps_ns: Ints) -> Complex | None:
    """Way from stamps to the present; see `Present.track`."""
    past = f.history.since(int(stamps_ns[0]))
    if past is None:
        return None
    turned = np.concatenate([[0.0], np.cumsum(past.corrections[:, X.phi_G][:, 2])])
    since = turned[-1] - turned[past.firsts - past.firsts[0]]
    v = (past.velocities_G[:, 0] + 1j * past.velocities_G[:, 1]) * np.exp(1j * since)
    time_s = np.append((past.stamps_ns - f.stamp_ns) * 1e-9, 0.0)
    way = np.concatenate([[0.0], np.cumsum(v * np.diff(time_s))])
    ahead = np.interp((stamps_ns - f.stamp_ns) * 1e-9, time_s, way[-1] - way)
    return np.asarray(ahead, dtype=np.complex128)


def free_since_ns(f: NavigationFilter) -> int | None:
    """Since when the heading may be any [ns]; None if nothing has shown that, or long ago.

    The DVL's gate had to be opened again, or a ping was used whose correction leaps. What was
    wrong with the attitude then, a turn that the gyros missed or one that never was, may have been
    about up, too: a DVL does not show it. Where no ping was used since a gate was opened, dead
    reckoning has a velocity that is wrong in other ways than by a turn.
    """
    counters = f.state.counters
    opened_ns = int(counters[fs.OPENED_NS + fs.DVL_ROW])
    if not counters[fs.USED_NS + fs.DVL_ROW] > opened_ns > f.start_ns:
        opened_ns = 0
    since_ns = max(opened_ns, int(counters[fs.LEAPT_NS]))
    lately = since_ns > 0 and f.stamp_ns - since_ns < AGAIN_NS
    return since_ns if lately else None


def turn_state(f: NavigationFilter, turn: Turn, scale_sigma: float) -> None:
    """Turn attitude and velocity about up, move the position, and change the gyro bias.

    Their covariance becomes that of the turn: what the filter knew of heading and position was
    wrong. Heading and scale become uncertain together with the velocity, as a DVL cannot show them
    (measurements.md, 1): the pings to come reduce nothing of it. What is stored of the past is
    that of another track, so fixes that are valid before now are out of reach.
    """
    state, C_e_G = f.state, f.frames.C_e_G
    P, x, up_b = state.P, np.zeros(kf.N), state.C_b_G[2].copy()
    s, c = math.sin(turn.angle), math.cos(turn.angle)
    R = np.array([[c, -s], [s, c]])
    lever = f.frames.lever_G[:2]
    x[X.phi_G] = 0.0, 0.0, turn.angle
    x[X.dv_G][:2] = state.v_G[:2] - R @ state.v_G[:2]
    x[X.dr_e] = -C_e_G[:2].T @ (turn.moved - (R @ lever - lever))
    x[X.b_gyro_b] = -turn.rate * up_b
    if f.settings.heading.on:  # a compass that agreed is off by as much
        x[heading.BIAS] = turn.angle
    enlarged.hold_covariance(state, f.work)
    before = P.copy()  # velocity goes round the arc: nothing nonlinear is left
    taken = state.carried + state.v_G[:2]
    f.feed_back(x)
    P[:] = before
    if f.settings.carries_heading:
        state.carried[:] = taken - state.v_G[:2]
        carry_now(state)
    forget(state, C_e_G)
    moved = np.zeros((kf.N, 4))
    moved[X.phi_G, 0] = 0.0, 0.0, 1.0
    moved[X.dv_G, 0] = state.v_G[1], -state.v_G[0], 0.0
    moved[X.b_gyro_b, 1] = -up_b
    moved[X.dr_e, 2:] = -C_e_G[:2].T
    if f.settings.heading.on:
        moved[heading.BIAS, 0] = 1.0
    state.sensitivity[:, DVL_YAW] += moved[:, 0]  # fixes show where a turned DVL goes
    P += moved @ turn.covariance @ moved.T
    C_m_G = state.C_b_G @ f.settings.C_m_b
    stretched = np.zeros((kf.N, 3))
    stretched[X.dv_G] = C_m_G * (C_m_G.T @ state.v_G)
    stretched[X.dvl_scale_m] = np.diag(1.0 + state.dvl_scale_m)
    P += scale_sigma**2 * stretched @ stretched.T
    P[:] = 0.5 * (P + P.T)
    enlarged.tell_enlarged(state, f.work, f.log)
    state.counters[fs.FROM_NS] = state.counters[fs.STAMP]
    forget_fixes(f)


def forget(state: State, C_e_G: Array) -> None:
    """Take away what is known of heading and horizontal position, and what others know by it.

    What common errors of fixes have done to the position stays: those of the turn have them, too.
    """
    P, S, up = state.P, state.sensitivity, X.phi_G.start + 2
    S -= np.outer(P[:, up] / P[up, up], S[up])
    S[X.dr_e, DVL_YAW:DEPTH_ZERO] = 0.0
    P -= np.outer(P[:, up], P[up]) / P[up, up]
    P[up] = P[:, up] = 0.0
    upright = np.eye(kf.N)
    upright[X.dr_e, X.dr_e] = np.outer(C_e_G[2], C_e_G[2])
    P[:] = upright @ P @ upright


def carry_now(state: State) -> None:
    """Do at once what the next transition would: dv less carried x u phi (kernels.sins.carried).

    What is added to the covariance then has the velocity of now.
    """
    x, y = state.carried
    T = np.eye(kf.N)
    T[X.dv_G, X.phi_G] = [[0.0, 0.0, -y], [0.0, 0.0, x], [0.0, 0.0, 0.0]]
    state.P[:] = T @ state.P @ T.T
    state.sensitivity[:] = T @ state.sensitivity
    state.sensitivity[X.dv_G, DVL_YAW] += np.cross([x, y, 0.0], state.C_b_G[:, 2])
    state.carried[:] = 0.0
