"""Settings of the compiled filter, constant during a run."""

from __future__ import annotations

import math

import numpy as np

from ... import attitude
from ...arrays import Array
from ...kernels.sins import consider
from ...kernels.sins import update as kf
from ...kernels.sins.settings import Settings
from ...order import ROBUST_FIXES
from ..events import InitialState
from ..params import EngineParams
from ..results import chi2_gate
from . import aiding
from .compass import bias_walk, make_heading
from .robust import THRESHOLDS


def make_settings(
    p: EngineParams, initial: InitialState | None = None, stamp_ns: int = 0
) -> Settings:
    """Settings of the compiled filter from the parameters.

    ``initial`` and ``stamp_ns`` [ns] are where and when it begins: the magnetic field is of there.
    """
    c = p.resolved()
    heading = make_heading(p, initial, stamp_ns)
    roll, pitch, yaw = (math.radians(a) for a in p.dvl_rpy_deg)
    # Three states hold one of both.
    shares_leader = p.leader_error_tau > 0.0 and not (p.usbl_bias_sigma > 0.0 or heading.on)
    estimated = shares_leader or p.usbl_bias_sigma > 0.0
    last = [p.usbl_bias_sigma**2, p.usbl_bias_tau]  # variance and time of the last three states
    if heading.on:
        last = bias_walk(p, heading)
    elif shares_leader:
        last = [1.0, p.leader_error_tau]
    sigmas = common_sigmas(p)
    considers = bool(sigmas.any())
    if shares_leader:
        sigmas[consider.LEADER :] = p.leader_drift_sigma
    adapts_Q = c.noise_adaptation not in ('none', 'adaptive_r')
    densities = (
        p.gyro_noise_density,
        p.accel_noise_density,
        p.gyro_bias_walk,
        p.accel_bias_walk,
    )
    return Settings(
        step_ns=round(p.filter_period_s * 1e9),
        steps_per_snapshot=steps_per_snapshot(p.filter_period_s),
        output_ns=round(p.output_period_s * 1e9),
        instant=p.imu_sample == 'instant',
        # Where Q is adapted it is added in Python, which then checks.
        active=0 if adapts_Q else kf.N if estimated or heading.on else kf.USBL,
        estimates_usbl_bias=estimated,
        shares_leader=shares_leader,
        adaptive=c.noise_adaptation == 'adaptive_r',
        # Where the noise is adapted, a share by the stated one means nothing: those filters, the
        # readings of the papers, have the measured velocity, and for a scale the predicted one.
        knows_turn=p.dvl_turn_velocity != 'measured' and c.noise_adaptation == 'none',
        carries_heading=p.dvl_turn_velocity == 'carried' and c.noise_adaptation == 'none',
        steadies_scale=p.dvl_scale_velocity == 'steady' and c.noise_adaptation == 'none',
        back_propagates=c.delay_handling == 'back_propagate',
        forgetting=p.forgetting,
        floor=p.adaptive_floor,
        ceiling=p.adaptive_ceiling,
        robust=ROBUST_FIXES.index(c.robust_fixes),
        robust_thresholds=np.array([math.inf, *(THRESHOLDS[m] for m in (1, 2, 3))]),
        gates=np.array([math.inf, *(chi2_gate(c.gate_probability, m) for m in (1, 2, 3))]),
        far_nis=far_nis(p),
        max_speed=p.max_speed,
        densities=np.array([d**2 for d in densities]),
        markov=np.array([p.dvl_markov_sigma**2, p.dvl_markov_tau]),
        usbl=np.array(last),
        sea_surface_height=p.sea_surface_height,
        C_m_b=np.ascontiguousarray(attitude.matrix_from_euler(yaw, pitch, roll), dtype=np.float64),
        lever_point_b=np.array(p.transponder_lever_b),
        lever_dvl_b=np.array(p.dvl_lever_b),
        lever_depth_b=np.array(p.depth_lever_b),
        # Where Q is adapted, Python adds it after each step: that has no way over a gap.
        gap_ns=0 if adapts_Q else round(p.imu_gap_s * 1e9),
        fills=not adapts_Q and p.imu_gap_s > 0.0 and p.imu_missing == 'interpolated',
        shock=0.0 if adapts_Q else p.imu_shock,
        gap_variances=np.array(
            [math.radians(p.gap_attitude_sigma_deg) ** 2, p.gap_velocity_sigma**2]
        ),
        reopen_ns=round(p.reopen_after_s * 1e9),
        most_excess=p.max_imu_noise_factor**2 - 1.0 if p.reopen_after_s else 0.0,
        considers=considers,
        common=sigmas,
        aiding=aiding.make_aiding(p),
        heading=heading,
    )


def far_nis(p: EngineParams) -> float:
    """NIS from which on a fix may be implausible; infinite where a gate judges."""
    gated = p.resolved().gate_probability < 1.0
    return math.inf if gated or not p.max_fix_sigma else p.max_fix_sigma**2


def common_sigmas(p: EngineParams) -> Array:
    """Sigmas of the common errors, (COLUMNS,) in the units of `kernels.sins.consider`."""
    sigmas = np.zeros(consider.COLUMNS)
    sigmas[consider.RANGE_SCALE] = p.fix_range_scale_sigma
    sigmas[consider.ARRAY_TURN] = math.radians(p.fix_heading_sigma_deg)
    sigmas[consider.CLOCK] = p.fix_clock_sigma
    sigmas[consider.OFFSET : consider.OFFSET + 3] = p.fix_offset_sigma
    misalignment = math.radians(p.dvl_misalignment_sigma_deg)
    sigmas[[consider.DVL_YAW, consider.DVL_PITCH]] = misalignment
    sigmas[[consider.DVL_LEVER_X, consider.DVL_LEVER_Y]] = p.dvl_lever_sigma
    sigmas[consider.DVL_LATENCY] = p.dvl_latency_sigma
    sigmas[consider.DEPTH_ZERO] = p.depth_offset_sigma
    return sigmas


_SNAPSHOT_S = 0.5
"""Between snapshots: taking one costs as much as filtering 30 ms again."""


def steps_per_snapshot(filter_period_s: float) -> int:
    """Number of covariance steps from one snapshot to the next."""
    return max(1, round(_SNAPSHOT_S / filter_period_s))
