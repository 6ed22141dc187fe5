"""Arrays of station mode's filter: settings by the parameters, rings, scratch, rows of output."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import gammaincinv

from ... import grid
from ...kernels import watch
from ...kernels.station import state as ss
from ...order import ROBUST_FIXES
from ..params import EngineParams
from ..results import FIXES, IMU_PERIOD_S, chi2_gate

SNAPSHOT_EVERY = 20
MAX_STEP_S = 0.02


def densities(p: EngineParams) -> tuple[float, ...]:
    """Densities q_c of the bank's members (B,) [m^2/s^3]."""
    if p.station_filter == 'published':
        return (0.0,)
    return p.current_bank if p.current_method == 'bank' else (p.current_walk,)


def densities_of_motion(p: EngineParams) -> tuple[float, float, float]:
    """Densities of velocity [m^2/s^3], horizontal and vertical position [m^2/s]."""
    return (
        p.model_acceleration_noise**2,
        p.station_position_noise**2,
        p.station_depth_noise**2,
    )


def common_sigmas(p: EngineParams) -> np.ndarray:
    """1-sigma of each common error, shape (COMMON,); none in the published filter."""
    sigma = np.zeros(ss.COMMON)
    if p.station_filter != 'published':
        sigma[ss.RANGE_SCALE] = p.station_range_scale_sigma
        sigma[ss.TURN] = math.radians(p.station_turn_sigma_deg)
        sigma[ss.OFFSET : ss.OFFSET + 2] = p.station_position_sigma
        sigma[ss.DEPTH_ZERO] = p.depth_offset_sigma
    return sigma


def make_settings(p: EngineParams) -> ss.Settings:
    """Settings of the compiled filter from the parameters, constant during a run."""
    c = p.resolved()
    model = p.vehicle_model()
    origin_e = p.station_origin_e()
    published = p.station_filter == 'published'
    smoothing = 0.0 if published else p.station_attitude_smoothing_s
    q_v, q_xy, q_z = p.published_noise if published else densities_of_motion(p)
    common = common_sigmas(p)
    C_e_A = np.ascontiguousarray(grid.ecef_to_grid(origin_e))
    return ss.Settings(
        inertia=model.inertia,
        drag_linear=model.drag_linear,
        drag_quadratic=model.drag_quadratic,
        net_buoyancy=model.net_buoyancy,
        speed=p.model_speed,
        q_v=q_v,
        q_xy=q_xy,
        q_z=q_z,
        q_drag=p.model_drag_walk**2,
        q_heading=p.station_heading_bias_walk**2,
        q_current=np.array(densities(p)),
        station_tau=p.station_heading_tau,
        forgetting=p.station_forgetting,
        robust=ROBUST_FIXES.index(c.robust_fixes),
        robust_threshold=2.0 * float(gammaincinv(1.0, p.station_robust_probability)),
        gates=np.array([math.inf, *(chi2_gate(c.gate_probability, m) for m in (1, 2))]),
        # At the best time constant the rates' noise adds as much as the AHRS' own leaves.
        attitude_variance=(2.0 if smoothing > 0.0 else 1.0)
        * math.radians(p.station_attitude_sigma_deg) ** 2,
        attitude_tau=smoothing,
        published=published,
        shifted=p.published_fifo == 'shifted',
        fix_variance=p.published_fix_variance,
        origin_e=origin_e,
        C_e_A=C_e_A,
        omega_ie_A=np.ascontiguousarray(grid.earth_rate(origin_e)),
        surface=p.sea_surface_height,
        lever_fix_b=np.array(p.transponder_lever_b),
        lever_depth_b=np.array(p.depth_lever_b),
        max_step_s=MAX_STEP_S,
        common=common,
        shares=bool(common.any()),
        reopen_ns=round(p.reopen_after_s * 1e9),
        max_speed=p.max_speed,
        doubt=0.0 if published else p.model_doubt,
        gap_ns=round(p.max_imu_gap_s * 1e9),
        thrust_ns=round(p.thrust_timeout_s * 1e9),
        snapshot_every=SNAPSHOT_EVERY,
        output_ns=round(p.output_period_s * 1e9),
    )


def make_bank(members: int) -> ss.Bank:
    """Empty bank of filters with equal weights."""
    return ss.Bank(
        x=np.zeros((members, ss.N)),
        P=np.zeros((members, ss.N, ss.N)),
        log_weight=np.zeros(members),
        weight=np.full(members, 1.0 / members),
        S=np.zeros((members, ss.N, ss.COMMON)),
        memories=np.zeros((watch.STREAMS, watch.MEMORIES, watch.WIDTH)),
        signatures=np.zeros((members + 1, ss.SIGNATURE_ROWS, ss.KINDS * ss.SLOTS)),
        flat=np.zeros(ss.FLAT),
        loose=np.zeros(ss.LOOSE),
        counters=np.zeros(ss.COUNTERS, dtype=np.int64),
        tally=np.zeros((2, 3)),
        counting=np.ones(1, dtype=np.int64),
    )


def live_streams(length_s: float, members: int) -> ss.Streams:
    """Empty rings for ``seconds`` of sensors at up to 250 Hz each."""
    n = int(length_s / IMU_PERIOD_S) + 16
    return ss.Streams(
        counts=np.zeros(4, dtype=np.int64),
        imu_stamps=np.zeros(n, dtype=np.int64),
        omega_ib_b=np.zeros((n, 3)),
        C_b_G=np.zeros((n, 3, 3)),
        unexplained=np.zeros(n),
        control_stamps=np.zeros(n, dtype=np.int64),
        force_b=np.zeros((n, 3)),
        depth_stamps=np.zeros(n, dtype=np.int64),
        depth=np.zeros(n),
        depth_variance=np.zeros(n),
        **fix_columns(members),
    )


def fix_columns(members: int) -> dict[str, np.ndarray]:
    """Empty columns of `Streams` for fixes."""
    return {
        'fix_stamps': np.zeros(FIXES, dtype=np.int64),
        'fixes': np.zeros((FIXES, ss.FIX_COLUMNS)),
        'outcomes': np.zeros((FIXES, ss.OUTCOME)),
        'fix_points': np.zeros((FIXES, members, ss.N)),
        'fix_inflations': np.ones((FIXES, members)),
    }


def make_tape(members: int) -> ss.Tape:
    """Empty record for a smoother, at a node; without members nothing is recorded."""
    return ss.Tape(
        Psi=np.tile(np.eye(ss.N), (members, 1, 1)),
        vector=np.zeros((members, ss.N, 1 + ss.COMMON)),
        information=np.zeros((members, ss.N, ss.N)),
        H=np.zeros((members, 2, ss.N)),
    )


def make_log(length_s: float, members: int, *, snapshots: bool, jumps: bool) -> ss.Log:
    """Empty log of ``seconds``: snapshots for `rewind`, jumps for the forward strategies."""
    n = int(length_s / IMU_PERIOD_S) + 16
    kept = n // SNAPSHOT_EVERY + 2 if snapshots else 0
    return ss.Log(
        counts=np.zeros(1, dtype=np.int64),
        points=np.zeros((n, members, ss.N)),
        jumps=np.zeros((n if jumps else 0, members, ss.N)),
        x=np.zeros((kept, members, ss.N)),
        P=np.zeros((kept, members, ss.N, ss.N)),
        log_weight=np.zeros((kept, members)),
        weight=np.zeros((kept, members)),
        S=np.zeros((kept, members, ss.N, ss.COMMON)),
        memories=np.zeros((kept, watch.STREAMS, watch.MEMORIES, watch.WIDTH)),
        signatures=np.zeros((kept, members + 1, ss.SIGNATURE_ROWS, ss.KINDS * ss.SLOTS)),
        flat=np.zeros((kept, ss.FLAT)),
        loose=np.zeros((kept, ss.LOOSE)),
        counters=np.zeros((kept, ss.COUNTERS), dtype=np.int64),
        good=make_bank(members),
        tape=make_tape(0),
    )


def make_rows(n: int, members: int) -> ss.Rows:
    """Empty output rows for n estimates."""
    return ss.Rows(
        io=np.array([-1, 0], dtype=np.int64),
        stamps=np.zeros(n, dtype=np.int64),
        r_e=np.zeros((n, 3)),
        v_G=np.zeros((n, 3)),
        C_b_G=np.zeros((n, 3, 3)),
        P=np.zeros((n, 9, 9)),
        x=np.zeros((n, ss.N)),
        P_x=np.zeros((n, ss.N, ss.N)),
        walk=np.zeros(n),
        weight=np.zeros((n, members)),
        tally=np.zeros((n, 2, 3)),
    )


def make_work(members: int) -> ss.Work:
    """Empty scratch arrays."""
    shapes: dict[str, tuple[int, ...]] = {
        'a': (3,),
        'F': (3, 3),
        'd1': (3,),
        'd2': (3,),
        'R': (3, 3),
        'C_A': (3, 3),
        'C_G': (3, 3),
        'omega': (3,),
        'up': (3,),
        'lever': (3,),
        'v3': (3,),
        'g': (3,),
        'M': (6, ss.N),
        'point': (ss.N,),
        'd': (ss.N,),
        'H': (2, ss.N),
        'T': (6, ss.N),
        'TP': (6, ss.N),
        'Phi': (ss.N, ss.N + 1),
        'A': (ss.N, ss.N + 2),
        'L': (ss.N, ss.N),
        'z': (members, 2),
        'S': (members, 3),
        'wide': (members, 3),
        'J': (members, 2, ss.COMMON),
        'common': (ss.N, ss.COMMON),
        'z3': (3,),
        'S3': (3, 3),
        'PHt': (members, 2, ss.N),
        'inflation': (members,),
        'change': (2, ss.KINDS * ss.SLOTS),
        'nis': (4,),
    }
    return ss.Work(**{name: np.zeros(shape) for name, shape in shapes.items()})
