"""Settings of the compiled filter, constant during a run."""

from __future__ import annotations

import math

import numpy as np

from ... import attitude
from ...kernels.sins import state as fs
from ...kernels.sins import update as kf
from ...order import ROBUST_FIXES
from ..params import EngineParams
from ..results import chi2_gate
from . import aiding
from .robust import THRESHOLDS


def make_settings(p: EngineParams) -> fs.Settings:
    """Settings of the compiled filter from the parameters."""
    c = p.resolved()
    roll, pitch, yaw = (math.radians(a) for a in p.dvl_rpy_deg)
    estimated = p.usbl_bias_sigma > 0.0
    adapts_Q = c.noise_adaptation not in ('none', 'adaptive_r')
    densities = (
        p.gyro_noise_density,
        p.accel_noise_density,
        p.gyro_bias_walk,
        p.accel_bias_walk,
    )
    return fs.Settings(
        step_ns=round(p.filter_period_s * 1e9),
        steps_per_snapshot=steps_per_snapshot(p.filter_period_s),
        output_ns=round(p.output_period_s * 1e9),
        instant=p.imu_sample == 'instant',
        # Where Q is adapted it is added in Python, which then checks.
        active=0 if adapts_Q else kf.N if estimated else kf.USBL,
        estimates_usbl_bias=estimated,
        adaptive=c.noise_adaptation == 'adaptive_r',
        back_propagates=c.delay_handling == 'back_propagate',
        forgetting=p.forgetting,
        floor=p.adaptive_floor,
        ceiling=p.adaptive_ceiling,
        robust=ROBUST_FIXES.index(c.robust_fixes),
        robust_threshold=THRESHOLDS[3],
        gates=np.array([math.inf, *(chi2_gate(c.gate_probability, m) for m in (1, 2, 3))]),
        densities=np.array([d**2 for d in densities]),
        markov=np.array([p.dvl_markov_sigma**2, p.dvl_markov_tau]),
        usbl=np.array([p.usbl_bias_sigma**2, p.usbl_bias_tau]),
        sea_surface_height=p.sea_surface_height,
        C_m_b=np.ascontiguousarray(attitude.matrix_from_euler(yaw, pitch, roll), dtype=np.float64),
        lever_point_b=np.array(p.transponder_lever_b),
        lever_dvl_b=np.array(p.dvl_lever_b),
        lever_depth_b=np.array(p.depth_lever_b),
        aiding=aiding.make_aiding(p),
    )


_SNAPSHOT_S = 0.5
"""Between snapshots: taking one costs as much as filtering 30 ms again."""


def steps_per_snapshot(filter_period_s: float) -> int:
    """Number of covariance steps from one snapshot to the next."""
    return max(1, round(_SNAPSHOT_S / filter_period_s))
