"""The vehicle's model beside the inertial navigation: settings, initial state, estimates.

The filter itself is compiled (kernels.sins.aiding); purpose and limits: docs/model-aiding.md.
"""

from __future__ import annotations

import numpy as np

from ... import attitude
from ...arrays import Array
from ...error_model import X
from ...kernels.sins import model as fm
from ...kernels.sins import settings
from ...kernels.sins import state as fs
from ...kernels.sins.settings import Aiding
from ...kernels.sins.update import N
from ..outputs import ModelEstimate
from ..params import EngineParams

_THRUST_UNKNOWN_S = 1.0
"""Time constant of an unknown thrust as large as the drag at `model_speed`."""

# Columns of a row of values: what a ModelEstimate says, as numbers.
_V_R, _V_R_COVARIANCE = slice(0, 3), slice(3, 12)
_CURRENT, _CURRENT_COVARIANCE = slice(12, 15), slice(15, 24)
_D1, _D1_SIGMA, _D2, _D2_SIGMA, _CORRELATION, _WALK, _LOCK = range(24, 31)
WIDTH = 31


def make_aiding(p: EngineParams) -> Aiding:
    """Settings of the vehicle's model for the compiled filter."""
    model = p.vehicle_model()
    strongest = model.total_drag(p.model_speed) / float(model.inertia[0])
    return Aiding(
        on=p.model_aiding,
        numbers=np.array(
            [
                model.inertia,
                model.drag_linear,
                model.drag_quadratic,
                [p.model_acceleration_noise**2, p.current_walk, p.model_drag_walk**2],
                [p.model_velocity_sigma**2, p.model_vertical_sigma**2, p.model_velocity_tau],
                [model.net_buoyancy, p.model_speed, 2.0 * _THRUST_UNKNOWN_S * strongest**2],
                [p.water_track_sigma**2, p.water_track_tau, 0.0],
            ]
        ),
        thrust_ns=round(p.thrust_timeout_s * 1e9),
        lost_ns=round(p.bottom_lock_timeout_s * 1e9),
        pings=p.bottom_lock_pings,
    )


def start(state: fs.State, p: EngineParams) -> None:
    """Initialise the model's states in place: still water, the stated drag, v_r = C_b_G^T v_G.

    The velocity through the water is as uncertain as that over ground and the current together,
    and correlated with both.
    """
    if not p.model_aiding:
        return
    C_G_b, v_G, P = state.C_b_G.T, state.v_G, state.P
    e = state.model[fs.MEAN]
    e[:3] = np.einsum('ij,j->i', C_G_b, v_G)
    e[fm.LOG_DRAG], e[fm.SHARE] = p.vehicle_model().logarithmic_drag(p.model_speed)
    of_x = np.zeros((3, N))
    of_x[:, X.phi_G] = -np.einsum('ij,jk->ik', C_G_b, attitude.skew(v_G))
    of_x[:, X.dv_G] = C_G_b
    current = np.array([p.current_sigma**2] * 2 + [p.model_vertical_sigma**2])
    P_xe, P_ee = state.model[fs.P_XE : fs.P_EE], state.model[fs.P_EE : fs.MEAN]
    P_xe[:, :3] = np.einsum('ij,aj->ia', P, of_x)
    P_ee[:3, :3] = np.einsum('ai,ib->ab', of_x, P_xe[:, :3])
    P_ee[:3, :3] += np.einsum('ij,j,kj->ik', C_G_b, current, C_G_b)
    P_ee[:3, :3] = 0.5 * (P_ee[:3, :3] + P_ee[:3, :3].T)
    P_ee[:3, fm.CURRENT : fm.LOG_DRAG] = -C_G_b[:, :2] * current[:2]
    P_ee[fm.CURRENT : fm.LOG_DRAG, :3] = P_ee[:3, fm.CURRENT : fm.LOG_DRAG].T
    for k, variance in enumerate(
        (p.current_sigma**2, p.current_sigma**2, p.model_drag_sigma**2, p.model_share_sigma**2)
    ):
        P_ee[fm.CURRENT + k, fm.CURRENT + k] = variance


def values_of(blocks: Array, aiding: Aiding) -> Array:
    """Model estimates as rows (n, `WIDTH`) from blocks of the filter (n, MODEL_ROWS, 7)."""
    e, P_ee = blocks[:, fs.MEAN], blocks[:, fs.P_EE : fs.MEAN]
    v = np.zeros((len(blocks), WIDTH))
    v[:, _V_R] = e[:, :3]
    # What the model leaves out is no error of V_c or of v_G, so it is one of v_r.
    left_out = aiding.numbers[settings.DIFFERENCE, [0, 0, 1]]
    v[:, _V_R_COVARIANCE] = (P_ee[:, :3, :3] + np.diag(left_out)).reshape(-1, 9)
    c = slice(fm.CURRENT, fm.LOG_DRAG)
    v[:, _CURRENT][:, :2] = e[:, c]
    covariance = np.zeros((len(blocks), 3, 3))
    covariance[:, :2, :2] = P_ee[:, c, c]
    covariance[:, 2, 2] = aiding.numbers[settings.DIFFERENCE, 1]
    v[:, _CURRENT_COVARIANCE] = covariance.reshape(-1, 9)
    total, share, U = np.exp(e[:, fm.LOG_DRAG]), e[:, fm.SHARE], aiding.numbers[settings.OTHER, 1]
    p_ll, p_lf, p_ff = (
        P_ee[:, i, j]
        for i, j in ((fm.LOG_DRAG, fm.LOG_DRAG), (fm.LOG_DRAG, fm.SHARE), (fm.SHARE, fm.SHARE))
    )
    # d1 = (1 - f) Dt / U, d2 = f Dt / U^2 and their slopes with ln Dt and f
    d1, d2 = (1.0 - share) * total / U, share * total / U**2
    f1, f2 = -total / U, total / U**2
    v_11 = d1 * d1 * p_ll + 2.0 * d1 * f1 * p_lf + f1 * f1 * p_ff
    v_22 = d2 * d2 * p_ll + 2.0 * d2 * f2 * p_lf + f2 * f2 * p_ff
    v_12 = d1 * d2 * p_ll + (d1 * f2 + d2 * f1) * p_lf + f1 * f2 * p_ff
    v[:, _D1], v[:, _D1_SIGMA] = d1, np.sqrt(v_11)
    v[:, _D2], v[:, _D2_SIGMA] = d2, np.sqrt(v_22)
    v[:, _CORRELATION] = v_12 / np.sqrt(v_11 * v_22)
    v[:, _WALK] = aiding.numbers[settings.WALKS, 1]
    v[:, _LOCK] = blocks[:, fs.THRUST, fs.LOCKED]
    return v


def estimate_of(values: Array) -> ModelEstimate:
    """Model estimate of a row of values (`WIDTH`,); no heading bias: attitude is a state."""
    return ModelEstimate(
        v_r_b=values[_V_R],
        v_r_covariance_b=values[_V_R_COVARIANCE].reshape(3, 3),
        current_G=values[_CURRENT],
        current_covariance_G=values[_CURRENT_COVARIANCE].reshape(3, 3),
        drag_linear=float(values[_D1]),
        drag_linear_sigma=float(values[_D1_SIGMA]),
        drag_quadratic=float(values[_D2]),
        drag_quadratic_sigma=float(values[_D2_SIGMA]),
        drag_correlation=float(values[_CORRELATION]),
        heading_bias=float('nan'),
        heading_bias_sigma=float('nan'),
        current_walk=float(values[_WALK]),
        bottom_lock=bool(values[_LOCK]),
    )


def row_of(m: ModelEstimate | None) -> Array:
    """Row of values (`WIDTH`,) of a model estimate; empty without one."""
    if m is None:
        return np.zeros(0)
    return np.concatenate(
        [
            m.v_r_b,
            m.v_r_covariance_b.ravel(),
            m.current_G,
            m.current_covariance_G.ravel(),
            [
                m.drag_linear,
                m.drag_linear_sigma,
                m.drag_quadratic,
                m.drag_quadratic_sigma,
                m.drag_correlation,
                m.current_walk,
                float(m.bottom_lock),
            ],
        ]
    )
