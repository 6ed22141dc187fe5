"""Saving the bank of station mode, and starting one from what was saved."""

from __future__ import annotations

import math

import numpy as np

from ... import attitude, earth, grid
from ...arrays import Array
from ...kernels.station import state as ss
from ...kernels.station.obey import MOST
from ..away import ACCELERATION, TURN_RATE, add_acceleration
from ..saved import SavedState, layout_problem

_NAMES = ('x', 'P', 'log_weight', 'weight', 'flat', 'loose')
LAYOUT = 'station 12'


def save_state(
    b: ss.Bank,
    c: ss.Settings,
    C_b_G: Array,
    mean: Array,
    fixes: tuple[int, int, int],
    records: tuple[bytes, bytes],
) -> SavedState:
    """State of a bank as it is now, with its fixes.

    Parameters
    ----------
    b : Bank
    c : Settings
    C_b_G : (3, 3) array
        Attitude at the newest sample.
    mean : (12,) array
        Mean of the members.
    fixes, records
        As in `SavedState`.
    """
    r_e = c.origin_e + c.C_e_A.T @ mean[ss.POSITION : ss.CURRENT]
    C_e_G = grid.ecef_to_grid(r_e)
    C_A_G = C_e_G @ c.C_e_A.T
    current_A = np.array([mean[ss.CURRENT], mean[ss.CURRENT + 1], 0.0])
    v_b = mean[ss.V_R : ss.POSITION]
    # The states of the printed filter are the velocity over ground.
    x, y, z = (C_b_G @ v_b + (0.0 if c.published else C_A_G @ current_A)).tolist()
    latitude, longitude, height = (float(v) for v in earth.geodetic_from_ecef(r_e))
    psi, pitch, roll = (float(v) for v in attitude.euler_from_matrix(C_b_G))
    return SavedState(
        latitude=latitude,
        longitude=longitude,
        height=height,
        v_G=(x, y, z),
        roll=roll,
        pitch=pitch,
        grid_heading=math.remainder(0.5 * math.pi - psi, 2.0 * math.pi),
        sigma_position_horizontal=1.0,
        sigma_position_vertical=1.0,
        sigma_velocity=1.0,
        sigma_tilt=0.1,
        sigma_heading=0.1,
        stamp_ns=int(b.counters[ss.STAMP]),
        layout=LAYOUT,
        values={name: getattr(b, name).copy() for name in _NAMES},
        fixes=fixes,
        records=records,
        followed=(
            1e-3 * int(b.counters[ss.FOLLOWED_MM]),
            1e-3 * int(b.counters[ss.FOLLOWED_MM + 1]),
            bool(b.counters[ss.JUMPED]),
        ),
    )


def problem_of(saved: SavedState, b: ss.Bank) -> str:
    """Sentence about a saved state that a bank like this cannot start from; empty if it can."""
    problem = layout_problem(saved, LAYOUT, {n: getattr(b, n).shape for n in _NAMES})
    if problem:
        return problem
    P, weight = saved.values['P'], saved.values['weight']
    if np.abs(P - P.transpose(0, 2, 1)).max() > 1e-6 * float(np.abs(P).max()):
        return 'the covariance of the state is not symmetric'
    if float(np.linalg.eigvalsh(P).min()) < -1e-9 * float(np.abs(P).max()):
        return 'the covariance of the state is not positive definite'
    if not 0.0 <= saved.values['loose'][ss.EXTRA] <= MOST:
        return 'the state has a current that walks as none does'
    if (weight < 0.0).any() or abs(float(weight.sum()) - 1.0) > 1e-6:
        return 'the weights of the state are none'
    return ''


def resume(b: ss.Bank, c: ss.Settings, C_b_G: Array, saved: SavedState, stamp_ns: int) -> None:
    """Set a bank from a saved one, carried on to a stamp [ns], with its covariances grown.

    ``C_b_G`` (3, 3) is the attitude then: the AHRS knows how the vehicle has turned.
    """
    for name in _NAMES:
        getattr(b, name)[:] = saved.values[name]
    if saved.followed is not None:
        *way, jumped = saved.followed
        b.counters[ss.FOLLOWED_MM : ss.FOLLOWED_MM + 2] = np.rint(1e3 * np.array(way))
        b.counters[ss.JUMPED] = jumped
    away_s = saved.away_s(stamp_ns)
    v_G = np.array(saved.v_G)
    r_e = c.origin_e + c.C_e_A.T @ b.x[0, ss.POSITION : ss.CURRENT]
    C_G_A = c.C_e_A @ grid.ecef_to_grid(r_e).T
    C_b_A = C_G_A @ C_b_G
    b.x[:, ss.POSITION : ss.CURRENT] += C_G_A @ v_G * away_s
    velocity, position = slice(ss.V_R, ss.POSITION), slice(ss.POSITION, ss.CURRENT)
    F = np.eye(ss.N)
    F[position, velocity] = C_b_A * away_s
    if not c.published:
        for k in range(2):
            F[ss.POSITION + k, ss.CURRENT + k] = away_s
    b.loose[ss.TURNED_2] = 0.0  # the AHRS knows how it has turned
    extra = float(b.loose[ss.EXTRA])
    sigma = math.hypot(ACCELERATION, float(np.linalg.norm(v_G)) * TURN_RATE)
    walks = ((ss.DRAG, c.q_drag), (ss.SHARE, c.q_drag), (ss.HEADING, c.q_heading))
    for P in b.P:
        P[:] = F @ P @ F.T
        add_acceleration(P, velocity, position, C_b_A, sigma, away_s)
        if not c.published:
            for state, density in walks:
                P[state, state] += density * away_s
            for state in (ss.CURRENT, ss.CURRENT + 1):
                P[state, state] += extra * away_s
        P[:] = 0.5 * (P + P.T)
