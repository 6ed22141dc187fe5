"""Vehicle model in the filter: prediction, pseudo-measurement, thrust, bottom lock.

All of it stands in `State.model`; without a model that has no rows and nothing here is called.
Derivation: docs/derivations/model_aiding.md.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import apart, entry, kernel, routine
from ..frames.earth import OMEGA_IE, up_and_height
from ..frames.grid import fill_C_e_G
from ..vehicle.model import surge_drag
from . import settings
from . import state as fs
from .block import is_jointly_definite, joint_innovation, rows_of_block
from .model import (
    CURRENT,
    LOG_DRAG,
    SHARE,
    E,
    add_model_noise,
    fill_model_slopes,
    fill_model_transition,
    model_rows,
    move_relative_velocity,
    predict_block,
)
from .rows import dvl_rows
from .settings import Settings
from .state import Frames, State
from .update import N, cholesky, gain_of, nis_of, subtract
from .work import Work

LONGEST_STEP = 0.05
"""Of the integration of v_r [s]."""

# Rows of Work.model: first matrices, each of as many rows as are free up to the next (slopes of
# v_r' with rate and velocity in the first three columns), then vectors of a step.
_F_EE, _PHI_EE, _A, _B, _G_E, _K_E, _D_E, _H_E = 0, 3, 6, 30, 37, 40, 43, 46
_BY_RATE, _BY_VELOCITY = 49, 52
_D1, _D2, _UP, _OMEGA, _FORCE, _ACCELERATION, _MIDDLE, _EARTH = 55, 56, 57, 58, 59, 60, 61, 62


@kernel
def _fill_surge_drag(s: State, c: Settings, w: Work) -> None:
    """Fill the drag of the model, that of surge as estimated."""
    e, numbers = s.model[fs.MEAN], c.aiding.numbers
    for k in range(3):
        w.model[_D1, k] = numbers[settings.LINEAR, k]
        w.model[_D2, k] = numbers[settings.QUADRATIC, k]
    d1, d2 = surge_drag(e[LOG_DRAG], e[SHARE], numbers[settings.OTHER, 1])
    w.model[_D1, 0] = d1
    w.model[_D2, 0] = d2


@kernel
def _fill_means(s: State, w: Work, stamp_ns: int, dt: float) -> None:
    """Fill vertical, rate against the Earth and thrust as means over the filter step."""
    x, y, z, _ = up_and_height(s.r_e[0], s.r_e[1], s.r_e[2])
    fill_C_e_G(x, y, z, w.C_e_G)
    thrust = s.model[fs.THRUST]
    rest = (stamp_ns - s.counters[fs.IMPULSE_NS]) * 1e-9
    for k in range(3):
        w.model[_EARTH, k] = OMEGA_IE * w.C_e_G[k, 2]
    for k in range(3):
        w.model[_UP, k] = w.C_mean[2, k]
        w.model[_OMEGA, k] = w.omega_mean[k] - (
            w.C_mean[0, k] * w.model[_EARTH, 0]
            + w.C_mean[1, k] * w.model[_EARTH, 1]
            + w.C_mean[2, k] * w.model[_EARTH, 2]
        )
        w.model[_FORCE, k] = (thrust[fs.IMPULSE + k] + thrust[k] * rest) / dt
        thrust[fs.IMPULSE + k] = 0.0
    s.counters[fs.IMPULSE_NS] = stamp_ns


@routine
def predict_model(s: State, c: Settings, w: Work, Phi: Array, stamp_ns: int, dt: float) -> None:
    """Advance e and its covariances by a filter step, before P follows by Phi.

    The means over the step, and F15, are left in the scratch by the step of the 24 states.

    Parameters
    ----------
    s, c, w : state (in place), settings, scratch
    Phi : (24, 24) array
        Transition of the step.
    stamp_ns, dt : end of the step [ns], its length [s]
    """
    _fill_surge_drag(s, c, w)
    _fill_means(s, w, stamp_ns, dt)
    numbers, rows = c.aiding.numbers, w.model
    buoyancy, speed = numbers[settings.OTHER, 0], numbers[settings.OTHER, 1]
    v_r_b, middle = s.model[fs.MEAN], rows[_MIDDLE]
    x, y, z = v_r_b[0], v_r_b[1], v_r_b[2]
    move_relative_velocity(
        v_r_b,
        rows[_ACCELERATION],
        middle,
        rows[_OMEGA],
        rows[_UP],
        rows[_FORCE],
        numbers[settings.INERTIA],
        rows[_D1],
        rows[_D2],
        buoyancy,
        dt,
        LONGEST_STEP,
    )
    middle[0] = 0.5 * (x + v_r_b[0])
    middle[1] = 0.5 * (y + v_r_b[1])
    middle[2] = 0.5 * (z + v_r_b[2])
    F_ee, Phi_ee = rows[_F_EE : _F_EE + 3], rows[_PHI_EE : _PHI_EE + 3]
    F_ex, Phi_ex = w.model_slopes[0:3], w.model_slopes[3:6]
    G = rows[_BY_RATE : _BY_RATE + 3]
    fill_model_slopes(
        F_ee,
        F_ex,
        G,
        rows[_BY_VELOCITY : _BY_VELOCITY + 3],
        middle,
        rows[_OMEGA],
        w.C_mean,
        rows[_EARTH],
        numbers[settings.INERTIA],
        rows[_D1],
        rows[_D2],
        buoyancy,
        speed,
    )
    fill_model_transition(Phi_ee, Phi_ex, F_ee, F_ex, w.F15, dt)
    P_xe, P_ee = s.model[fs.P_XE : fs.P_EE], s.model[fs.P_EE : fs.MEAN]
    predict_block(P_xe, P_ee, s.P, Phi, Phi_ee, Phi_ex, rows[_A : _A + 24], rows[_B : _B + E])
    thrust_ns = s.counters[fs.THRUST_NS]
    known = thrust_ns > 0 and stamp_ns - thrust_ns <= c.aiding.thrust_ns
    walks = numbers[settings.WALKS]
    w.z[0] = walks[0] if known else numbers[settings.OTHER, 2]  # variances per second
    w.z[1] = walks[1]
    w.z[2] = walks[2]
    add_model_noise(P_xe, P_ee, w.z, w.C_mean, G, c.densities[0], dt)


@entry
@routine
def model_is_definite(s: State, c: Settings, w: Work, thorough: bool) -> bool:
    """Whether the 31 states' covariance is positive definite; its diagonal, if not thorough."""
    P_xe, P_ee = s.model[fs.P_XE : fs.P_EE], s.model[fs.P_EE : fs.MEAN]
    good = True
    for k in range(E):
        good = good and P_ee[k, k] > 0.0 and math.isfinite(s.model[fs.MEAN, k])
    if good and thorough:
        A, B = w.model[_A : _A + 24], w.model[_B : _B + E]
        good = cholesky(w.LP, s.P, c.active) and is_jointly_definite(
            P_xe, P_ee, w.LP, A, B, c.active
        )
    return good


@routine
def correct_block(s: State, w: Work, m: int) -> None:
    """Correct e by a measurement of x, after the update of P, which left K, D, L and S."""
    rows = w.model
    P_xe, P_ee = s.model[fs.P_XE : fs.P_EE], s.model[fs.P_EE : fs.MEAN]
    fill_block_gain(s, w, m)
    _correct(s, w, P_xe, P_ee, rows[_K_E : _K_E + 3], rows[_D_E : _D_E + 3])


@kernel
def fill_block_gain(s: State, w: Work, m: int) -> None:
    """Gain of e by a measurement of x into the scratch; L and S of it stand there."""
    rows = w.model
    G_e, H_e = rows[_G_E : _G_E + 3], rows[_H_E : _H_E + 3]
    rows_of_block(G_e, w.H, s.model[fs.P_XE : fs.P_EE], m)
    gain_of(rows[_K_E : _K_E + 3], rows[_D_E : _D_E + 3], G_e, w.L, w.S, m)
    for a in range(3):
        for k in range(E):
            H_e[a, k] = 0.0


@kernel
def store_block_rows(out: Array, w: Work) -> None:
    """Rows and gain of e of the last update, from the scratch into (2, 3, 7)."""
    for a in range(3):
        for k in range(E):
            out[0, a, k] = w.model[_H_E + a, k]
            out[1, a, k] = w.model[_K_E + a, k]


@kernel
def store_block_step(out: Array, w: Work) -> None:
    """Transition of e over the last step, from the scratch into (3, 31)."""
    for i in range(3):
        for k in range(N):
            out[i, k] = w.model_slopes[3 + i, k]
        for k in range(E):
            out[i, N + k] = w.model[_PHI_EE + i, k]


@kernel
def _correct(s: State, w: Work, P_xe: Array, P_ee: Array, K_e: Array, D_e: Array) -> None:
    """Change e and its covariances by the gains of x and e; w.D belongs to w.K."""
    subtract(P_xe, w.K, w.D, K_e, D_e)
    subtract(P_ee, K_e, D_e, K_e, D_e)
    for i in range(E):
        s.model[fs.MEAN, i] -= K_e[0, i] * w.z[0] + K_e[1, i] * w.z[1] + K_e[2, i] * w.z[2]


@apart
@routine
def compare_velocities(s: State, c: Settings, w: Work, dt: float) -> int:
    """v_G = C_b_G v_r + V_c into both: P, P_xe, P_ee and e; of x the correction stands in w.x.

    Its error lasts for tau: white noise once per step must have a variance 2 tau/dt times as large
    for the sum over many steps to be as uncertain as it is.
    """
    e, H_e = s.model[fs.MEAN], w.model[_H_E : _H_E + 3]
    model_rows(w.H, H_e, w.z, s.C_b_G, s.v_G, e, e[CURRENT:LOG_DRAG])
    stated = c.aiding.numbers[settings.DIFFERENCE]
    times = max(1.0, 2.0 * stated[2] / dt)
    for a in range(3):
        for b in range(3):
            w.R[a, b] = 0.0
        w.R[a, a] = (stated[0] if a < 2 else stated[1]) * times
    code: int = _fuse_jointly(s, c, w)
    return code


@kernel
def _fuse_jointly(s: State, c: Settings, w: Work) -> int:
    """Fuse three rows H, H_e of x and e with R and z, all in the scratch; the code, as there."""
    rows = w.model
    P_xe, P_ee = s.model[fs.P_XE : fs.P_EE], s.model[fs.P_EE : fs.MEAN]
    H_e, G_e = rows[_H_E : _H_E + 3], rows[_G_E : _G_E + 3]
    K_e, D_e = rows[_K_E : _K_E + 3], rows[_D_E : _D_E + 3]
    joint_innovation(w.S, w.PHt, G_e, s.P, P_xe, P_ee, w.H, H_e, w.R)
    if not cholesky(w.L, w.S, 3):
        return fs.S_NOT_DEFINITE
    if not nis_of(w.L, w.z, w.w, 3) <= c.gates[3]:
        return fs.REFUSED
    gain_of(w.K, w.D, w.PHt, w.L, w.S, 3)
    gain_of(K_e, D_e, G_e, w.L, w.S, 3)
    subtract(s.P, w.K, w.D, w.K, w.D)
    _correct(s, w, P_xe, P_ee, K_e, D_e)
    for i in range(w.x.shape[0]):
        w.x[i] = w.K[0, i] * w.z[0] + w.K[1, i] * w.z[1] + w.K[2, i] * w.z[2]
    return fs.FUSED


@routine
def fuse_water_ping(s: State, fr: Frames, c: Settings, w: Work, v_m: Array, R_m: Array) -> int:
    """Fuse a velocity through the water into x and e, that over ground being it plus V_c.

    Its rows are those of a ping over ground at the velocity v_G - V_c, less V_c. What lasts in it
    beside the current (the layer that it is of, the wake) is taken as in `compare_velocities`; a
    vertical current too. Returns FUSED, REFUSED or S_NOT_DEFINITE; of x the correction is in w.x.
    """
    e, H_e = s.model[fs.MEAN], w.model[_H_E : _H_E + 3]
    for k in range(3):
        w.f[k] = s.v_G[k]
    for k in range(2):
        w.f[k] -= e[CURRENT + k]
    dvl_rows(
        w.H,
        w.R,
        w.z,
        w.C_m_G,
        s.C_b_G,
        w.f,
        s.omega_ib_b,
        fr.omega_ie_G,
        s.b_gyro_b,
        s.dvl_scale_m,
        s.dvl_markov_m,
        v_m,
        R_m,
        c.C_m_b,
        c.lever_dvl_b,
    )
    dt = (s.counters[fs.STAMP] - s.counters[fs.WATER_NS]) * 1e-9
    lasting, vertical = c.aiding.numbers[settings.WATER], c.aiding.numbers[settings.DIFFERENCE]
    for a in range(3):
        for k in range(E):
            H_e[a, k] = 0.0
        if a < 2:
            H_e[a, CURRENT + a] = -1.0
        w.R[a, a] += lasting[0] * max(1.0, 2.0 * lasting[1] / max(dt, 1e-3))
    w.R[2, 2] += vertical[1] * max(1.0, 2.0 * vertical[2] / max(dt, 1e-3))
    code: int = _fuse_jointly(s, c, w)
    if code >= 0:
        w.nis[0] = nis_of(w.L, w.z, w.w, 3)
        w.nis[1] = 1.0
    if code == fs.FUSED:
        s.counters[fs.WATER_NS] = s.counters[fs.STAMP]
    return code


@kernel
def control_event(s: State, stamp_ns: int, force_b: Array) -> None:
    """Store a thrust that holds from its stamp on; the impulse before is of the previous one."""
    s.counters[fs.CONTROL] += 1
    thrust = s.model[fs.THRUST]
    begin_ns = max(stamp_ns, s.counters[fs.IMPULSE_NS])
    dt = (begin_ns - s.counters[fs.IMPULSE_NS]) * 1e-9
    for k in range(3):
        thrust[fs.IMPULSE + k] += thrust[k] * dt
        thrust[k] = force_b[k]
    s.counters[fs.IMPULSE_NS] = begin_ns
    s.counters[fs.THRUST_NS] = stamp_ns


@kernel
def has_bottom_lock(s: State, c: Settings) -> bool:
    """Whether the last fused ping is recent: bottom lock."""
    age_ns: int = s.counters[fs.STAMP] - s.counters[fs.LOCK_NS]
    return age_ns <= c.aiding.lost_ns


@kernel
def count_good_ping(s: State, c: Settings, passed: bool) -> bool:
    """Count a ping without lock; True for the one with which lock is back."""
    now_ns = s.counters[fs.STAMP]
    if now_ns - s.counters[fs.GOOD_NS] > c.aiding.lost_ns or not passed:
        s.counters[fs.GOOD_PINGS] = 0
    if passed:
        s.counters[fs.GOOD_PINGS] += 1
        s.counters[fs.GOOD_NS] = now_ns
    if s.counters[fs.GOOD_PINGS] < c.aiding.pings:
        return False
    s.counters[fs.GOOD_PINGS] = 0
    return True
