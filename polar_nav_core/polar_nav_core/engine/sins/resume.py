"""Saving a strapdown filter, and starting one from what was saved."""

from __future__ import annotations

import math

import numpy as np

from ... import attitude, earth, grid
from ...arrays import Array
from ...error_model import X
from ...kernels.sins import state as fs
from ...kernels.sins import update as kf
from ...kernels.sins.reopen import AGAIN_NS
from ...order import FIX_ROW
from .. import away
from ..away import Seen
from ..params import EngineParams
from ..saved import SINCE, VERSION, SavedState, layout_problem
from ..start.model import SAME_AGAIN
from ..version import ENGINE_VERSION
from .leader import HEARD, LeaderError, heard_problem

_NAMES = (
    'C_b_G', 'v_G', 'r_e', 'b_gyro_b', 'b_accel_b', 'dvl_scale_m', 'dvl_markov_m', 'usbl_bias_a',
    'P', 'sensitivity', 'model',
)  # fmt: skip
_TURN, WANDER, _LEADER, _USED, _FREE = 'turn', 'wander', 'leader', 'used', 'free'
LAYOUT = 'sins 24'
_LEAST_GAP_S = 0.01
_MOST = {
    'b_gyro_b': 1.0,
    'b_accel_b': 100.0,
    'dvl_scale_m': 1.0,
    'dvl_markov_m': 50.0,
    _TURN: 100.0,
    _FREE: AGAIN_NS * 1e-9,
}
"""Of arrays of a saved state, beyond what any vehicle has: SI units and radians."""
_SAME_M, _SAME_M_S = 1.0, 0.1
"""That arrays and the plain numbers beside them may differ by: both are of one state."""
_LOCAL = slice(fs.USED_NS, fs.USED_NS + FIX_ROW)
"""Counters of the newest ping and depth that were used."""


def save_state(
    s: fs.State,
    turn_rate: float,
    wander: Array,
    leader: LeaderError,
    fixes: tuple[int, int, int],
    records: tuple[bytes, bytes],
    *,
    heading: bool = False,
    free_since_ns: int | None = None,
) -> SavedState:
    """State of a filter as it is now, with how its track turned and wandered, and its fixes.

    Of measured headings (``heading``) no error is saved: what reads the state may use none.
    """
    values = {name: getattr(s, name).copy() for name in _NAMES}
    if heading:
        values['usbl_bias_a'][:] = 0.0
        _forget_last(values['P'], np.ones(3))
    latitude, longitude, height = (float(x) for x in earth.geodetic_from_ecef(s.r_e))
    psi, pitch, roll = (float(x) for x in attitude.euler_from_matrix(s.C_b_G))
    C_e_G = grid.ecef_to_grid(s.r_e)
    position = np.einsum('ij,jk,ik->i', C_e_G, s.P[X.dr_e, X.dr_e], C_e_G)
    tilt, velocity = np.diagonal(s.P[X.phi_G, X.phi_G]), np.diagonal(s.P[X.dv_G, X.dv_G])
    x, y, z = s.v_G.tolist()
    return SavedState(
        latitude=latitude,
        longitude=longitude,
        height=height,
        v_G=(x, y, z),
        roll=roll,
        pitch=pitch,
        grid_heading=math.remainder(0.5 * math.pi - psi, 2.0 * math.pi),
        sigma_position_horizontal=_sigma(position[:2], 1e-3, 1e6),
        sigma_position_vertical=_sigma(position[2:], 1e-3, 1e6),
        sigma_velocity=_sigma(velocity, 1e-6, 100.0),
        sigma_tilt=_sigma(tilt[:2], 1e-9, 1.0),
        sigma_heading=_sigma(tilt[2:], 1e-9, 3.0),
        stamp_ns=int(s.counters[fs.STAMP]),
        layout=LAYOUT,
        values={
            **values,
            _TURN: np.array([turn_rate]),
            WANDER: wander,
            _LEADER: leader.packed(),
            _USED: (s.counters[_LOCAL] > 0).astype(np.float64),
            _FREE: np.array([_free_for_s(s, free_since_ns)]),
        },
        fixes=fixes,
        records=records,
    )


def _free_for_s(s: fs.State, since_ns: int | None) -> float:
    """For how long the heading may still be any [s]; 0 if nothing has shown that."""
    if since_ns is None:
        return 0.0
    return (since_ns + AGAIN_NS - int(s.counters[fs.STAMP])) * 1e-9


def _forget_last(P: Array, variances: Array) -> None:
    """Let the last three states have these variances (3,) and no correlation, in place."""
    P[kf.USBL :, :] = 0.0
    P[:, kf.USBL :] = 0.0
    P[kf.USBL :, kf.USBL :] = np.diag(variances)


def _beside_saved(variances: Array, heading: float) -> Array:
    """Variances (3,) of the errors of headings beside a saved heading that may be from them.

    That one may be off by as much as the same compass is, and nothing correlates the two: the
    bias is less certain, so that the first heading changes a variance ``heading`` [rad^2] little.
    One that others measured better than the compass costs the compass nothing.
    """
    out = variances.copy()
    out[0] += SAME_AGAIN**2 * min(heading, float(variances[:2].sum()))
    return out


def _sigma(variances: Array, low: float, high: float) -> float:
    return float(np.clip(math.sqrt(max(float(np.max(variances)), 0.0)), low, high))


def problem_of(saved: SavedState, *, model: bool) -> str:
    """Sentence about a saved state that a filter cannot start from; empty if it can."""
    like = fs.make_state(model=model)
    shapes = {n: getattr(like, n).shape for n in _NAMES}
    if saved.layout == LAYOUT and _TURN not in saved.values:
        return (
            f'the state has no rate of turn: it is of format {saved.version} and engine 3, '
            f'this is format {VERSION} and engine {ENGINE_VERSION}'
        )
    added = dict(since[LAYOUT] for since in SINCE.values() if LAYOUT in since)
    known = {**shapes, _TURN: (1,), **added, _LEADER: (HEARD,)}
    problem = layout_problem(saved, LAYOUT, known)
    if problem:
        return problem
    problem = heard_problem(saved.values[_LEADER])
    if problem:
        return problem
    problem = _odd_value(saved)
    if problem:
        return problem
    C, P = saved.values['C_b_G'], saved.values['P']
    if np.abs(C @ C.T - np.eye(3)).max() > 1e-6:
        return 'the attitude of the state is no rotation'
    size = np.sqrt(np.maximum(np.diagonal(P), 1e-300))
    if np.abs(P - P.T).max() > 1e-6 * float(size.max()) ** 2:
        return 'the covariance of the state is not symmetric'
    L = np.zeros((kf.N, kf.N))
    if not kf.is_positive_definite(P, kf.USBL, L):
        return 'the covariance of the state is not positive definite'
    return ''


def _odd_value(saved: SavedState) -> str:
    """Sentence about a value that no state has, or that another one contradicts; else empty."""
    for name, most in _MOST.items():
        if np.abs(saved.values[name]).max() > most:
            return f'{name} of the state is beyond {most:g}, which no vehicle has'
    place_e = earth.ecef_from_geodetic(saved.latitude, saved.longitude, saved.height)
    if np.abs(saved.values['r_e'] - place_e).max() > _SAME_M:
        return 'the state has two positions'
    if np.abs(saved.values['v_G'] - np.array(saved.v_G)).max() > _SAME_M_S:
        return 'the state has two velocities'
    return ''


def resume(
    s: fs.State,
    leader: LeaderError,
    p: EngineParams,
    saved: SavedState,
    stamp_ns: int,
    heading_sigmas: Array | None = None,
) -> None:
    """Set a state from a saved one, carried on to a stamp [ns], with its covariance grown.

    ``heading_sigmas`` (3,) are those of the last three states where headings are used [rad].
    """
    leader.unpack(saved.values[_LEADER])
    for name in _NAMES:
        getattr(s, name)[:] = saved.values[name]
    if len(s.model):
        s.model[fs.THRUST] = 0.0
    away_s = saved.away_s(stamp_ns)
    decay = math.exp(-away_s / p.dvl_markov_tau)
    markov = slice(kf.MARKOV, kf.MARKOV + 3)
    F = np.eye(kf.N)
    F[markov, markov] *= decay
    s.dvl_markov_m[:] *= decay
    _carry(s, F)
    if len(s.model):
        s.model[fs.P_XE : fs.P_EE] = 0.0
    if saved.seen is None:
        _unseen(s, saved, away_s)
    else:
        _seen(s, saved, saved.seen)
    s.P[markov, markov] += np.eye(3) * p.dvl_markov_sigma**2 * (1.0 - decay**2)
    for states, walk in ((X.b_gyro_b, p.gyro_bias_walk), (X.b_accel_b, p.accel_bias_walk)):
        s.P[states, states] += np.eye(3) * walk**2 * away_s
    if heading_sigmas is not None:
        s.usbl_bias_a[:] = 0.0
        _forget_last(s.P, _beside_saved(heading_sigmas**2, float(s.P[2, 2])))
    s.P[:] = 0.5 * (s.P + s.P.T)


def note_before(s: fs.State, saved: SavedState) -> None:
    """Let the counters know what came before the restart.

    Sensors that were used count as used when the state was saved, and no later: one that is silent
    since the restart is missed. A heading that may have been any may still be (`sins.turned`).
    """
    s.counters[_LOCAL] = np.where(saved.values[_USED] > 0.0, saved.stamp_ns, 0)
    free_for_s = float(saved.values[_FREE][0])
    if free_for_s > 0.0:
        s.counters[fs.LEAPT_NS] = saved.stamp_ns + round(free_for_s * 1e9) - AGAIN_NS


def _carry(s: fs.State, F: Array) -> None:
    s.P[:] = F @ s.P @ F.T
    s.sensitivity[:] = F @ s.sensitivity


def _move(s: fs.State, turned: Array, path: Array) -> Array:
    """Move the state by a turn and its integral [s]; returns grid axes to ECEF (3, 3)."""
    C_G_e = grid.ecef_to_grid(s.r_e).T
    s.r_e[:] += C_G_e @ path @ s.v_G
    s.v_G[:] = turned @ s.v_G
    s.C_b_G[:] = turned @ s.C_b_G
    F = np.eye(kf.N)
    F[X.phi_G, X.phi_G] = turned
    F[X.dv_G, X.dv_G] = turned
    F[X.dr_e, X.dv_G] = C_G_e @ path
    _carry(s, F)
    return C_G_e


_ROWS = away.Rows(X.phi_G, X.dv_G, X.dr_e)


def _unseen(s: fs.State, saved: SavedState, away_s: float) -> None:
    """Go on turning as before, with a turn that may have begun, and the swing of waves."""
    C_G_e = _move(s, *away.held_turn(float(saved.values[_TURN][0]), away_s))
    away.add_turn(s.P, _ROWS, C_G_e, s.v_G, away.turn_variance(away_s), away_s)
    away.add_swing(s.P, X.phi_G, away_s)
    away.add_acceleration(s.P, X.dv_G, X.dr_e, C_G_e, away.ACCELERATION, away_s)


def _seen(s: fs.State, saved: SavedState, seen: Seen) -> None:
    """Bridge the gap by the rates of turn before and after, and go the way that was seen."""
    gap_s = max(saved.away_s(seen.begin_ns), _LEAST_GAP_S)
    before, restless = float(saved.values[_TURN][0]), _restless(saved.values[WANDER])
    pushed = math.hypot(restless[1], _change(s.v_G, seen) / gap_s)
    C_G_e = _move(s, *away.bridged_turn(before, seen.rate, gap_s))
    unknown = math.hypot(restless[0], seen.sigma_rate)
    variance = away.bridged_variance(before, seen.rate, unknown, gap_s)
    away.add_turn(s.P, _ROWS, C_G_e, s.v_G, variance, gap_s)
    away.add_acceleration(s.P, X.dv_G, X.dr_e, C_G_e, pushed, gap_s)
    began_r_e, x, y = s.r_e.copy(), float(s.v_G[0]), float(s.v_G[1])
    halfway = seen.watched_s * away.about_up(0.5 * seen.turned)
    _move(s, away.about_up(seen.turned), halfway)
    path_c = np.append(seen.path, s.v_G[2] * seen.watched_s)
    s.r_e[:] = began_r_e + C_G_e @ away.about_up(math.atan2(y, x)) @ path_c
    s.C_b_G[:] = away.about_up(math.atan2(s.v_G[1], s.v_G[0])) @ seen.C_b_c
    # The ping that the heading is from is fused next: it counts once, with the DVL's slow errors.
    # Of the tilt's error a part is the accelerometers', which the filter knows besides.
    tilt = 2.0 * seen.sigma_tilt
    s.P[X.phi_G, X.phi_G] += np.diag([tilt**2, tilt**2, away.SWING_HEADING**2])


def _restless(wander: Array) -> tuple[float, float]:
    """Rate of turn [rad/s] and acceleration [m/s^2] of a saved track, where they are known."""
    if not (wander > 0.0).all():
        return away.TURN_RATE, away.ACCELERATION
    return min(float(wander[0]), away.MOST_TURN), min(float(wander[1]), 1.0)


def _change(v_G: Array, seen: Seen) -> float:
    """Change of speed or climb beyond what the DVL's own errors may be [m/s]."""
    off = max(abs(seen.speed - math.hypot(v_G[0], v_G[1])), abs(seen.up - float(v_G[2])))
    allowed = 2.0 * math.hypot(seen.sigma_speed, seen.sigma_tilt * seen.speed)
    return off if off > allowed else 0.0
