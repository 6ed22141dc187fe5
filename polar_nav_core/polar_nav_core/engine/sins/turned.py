"""A strapdown navigation whose heading refused fixes have shown to be wrong: turned, and unsure.

See engine.disagreement for what they must show.
"""

from __future__ import annotations

import math

import numpy as np

from ...error_model import X
from ...kernels.sins import enlarged, heading
from ...kernels.sins import state as fs
from ...kernels.sins import update as kf
from ...kernels.sins.consider import DVL_YAW
from ...kernels.sins.reopen import AGAIN_NS
from ...kernels.sins.state import State
from ..disagreement import MOST_HEADING, RefusedRow, Turn, Unlearnt
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
    since_ns = _opened_ns(f)
    heading = min(sigma_heading, MOST_HEADING) if since_ns is None else MOST_HEADING
    unlearnt = Unlearnt(heading, p.dvl_scale_sigma, p.gyro_bias_sigma)
    turn = row.turn(f.frames.C_e_G, unlearnt, since_ns)
    if turn is None:
        return False
    turn_state(f, turn.aged((f.stamp_ns - row.newest_ns) * 1e-9), p.dvl_scale_sigma)
    return True


def _opened_ns(f: NavigationFilter) -> int | None:
    """When the DVL's gate had to be opened again [ns]; None if it was not, or is long ago.

    What was wrong with the attitude then, a turn that the gyros missed or one that never was, may
    have been about up, too: a DVL does not show it.
    """
    opened_ns = int(f.state.counters[fs.OPENED_NS + fs.DVL_ROW])
    lately = opened_ns > f.start_ns and f.stamp_ns - opened_ns < AGAIN_NS
    return opened_ns if lately else None


def turn_state(f: NavigationFilter, turn: Turn, scale_sigma: float) -> None:
    """Turn attitude and velocity about up, change the gyro bias, and enlarge the covariance.

    Heading and scale become uncertain together with the velocity, as a DVL cannot show them
    (measurements.md, 1): the pings to come reduce nothing of it.
    """
    state, C_e_G = f.state, f.frames.C_e_G
    P, x, up_b = state.P, np.zeros(kf.N), state.C_b_G[2].copy()
    s, c = math.sin(turn.angle), math.cos(turn.angle)
    v_x, v_y, _ = state.v_G
    x[X.phi_G] = 0.0, 0.0, turn.angle
    x[X.dv_G] = v_x - (c * v_x - s * v_y), v_y - (s * v_x + c * v_y), 0.0
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
    moved = np.zeros((kf.N, 2))
    moved[X.phi_G, 0] = 0.0, 0.0, 1.0
    moved[X.dv_G, 0] = state.v_G[1], -state.v_G[0], 0.0
    moved[X.b_gyro_b, 1] = -up_b
    if f.settings.heading.on:
        moved[heading.BIAS, 0] = 1.0
    P += moved @ turn.covariance @ moved.T
    C_m_G = state.C_b_G @ f.settings.C_m_b
    stretched = np.zeros((kf.N, 3))
    stretched[X.dv_G] = C_m_G * (C_m_G.T @ state.v_G)
    stretched[X.dvl_scale_m] = np.diag(1.0 + state.dvl_scale_m)
    P += scale_sigma**2 * stretched @ stretched.T
    P[X.dr_e, X.dr_e] += turn.distance**2 * C_e_G[:2].T @ C_e_G[:2]
    P[:] = 0.5 * (P + P.T)
    enlarged.tell_enlarged(state, f.work, f.log)
    forget_fixes(f)


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
