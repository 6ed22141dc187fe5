"""Estimates and receipts of the engine to messages: the same for every vehicle."""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import Quaternion

from polar_nav_core import attitude, earth, grid
from polar_nav_core.engine.events import (
    LOCAL_GATED,
    NIS_SUM,
    UPDATES,
    Array,
    Estimate,
    Receipt,
    Verdict,
)
from polar_nav_core.engine.params import EngineParams
from polar_nav_msgs.msg import FixReceipt, NavState

from .stamps import to_msg, to_ns


def nav_to_msg(
    e: Estimate, params: EngineParams, vehicle: str, frame_id: str = 'earth'
) -> NavState:
    """polar_nav_msgs/NavState of an estimate; ``frame_id`` is that of positions."""
    lat, lon, height = (float(v) for v in earth.geodetic_from_ecef(e.r_e))
    C_e_G = grid.ecef_to_grid(e.r_e)
    sigma = np.sqrt(np.diagonal(e.P))
    position_G = _in_grid(C_e_G, e.P[6:9, 6:9])
    _, pitch, roll = attitude.euler_from_matrix(e.C_b_G)
    grid_heading = float(attitude.grid_heading(e.C_b_G))
    heading = grid.true_heading(
        e.r_e, grid_heading, float(sigma[2]), math.sqrt(_variance_true_east(e.r_e, e.P))
    )
    x, y, z, w = attitude.quaternion_from_matrix(e.C_b_G)
    msg = NavState()
    msg.header.stamp = to_msg(e.stamp_ns)
    msg.header.frame_id = frame_id
    msg.child_frame_id = f'{vehicle}/base_link'
    msg.configuration = params.configuration
    msg.status = NavState.STATUS_NAVIGATING
    msg.r_e = e.r_e
    msg.latitude = lat
    msg.longitude = lon if math.hypot(e.r_e[0], e.r_e[1]) > 0.0 else math.nan
    msg.height = height
    msg.depth = params.sea_surface_height - height
    msg.v_g = e.v_G
    msg.orientation = Quaternion(x=float(x), y=float(y), z=float(z), w=float(w))
    msg.roll = float(roll)
    msg.pitch = float(pitch)
    msg.grid_heading = grid_heading
    msg.true_heading = heading.heading
    msg.true_heading_sigma = heading.sigma
    msg.convergence = heading.convergence
    msg.position_covariance_g = position_G.reshape(9)
    msg.velocity_covariance_g = e.P[3:6, 3:6].reshape(9)
    msg.attitude_covariance_g = e.P[0:3, 0:3].reshape(9)
    msg.gyro_bias_b = e.gyro_bias_b
    msg.gyro_bias_sigma = sigma[9:12]
    msg.accel_bias_b = e.accel_bias_b
    msg.accel_bias_sigma = sigma[12:15]
    msg.dvl_scale_m = e.dvl_scale_m
    msg.dvl_scale_sigma = sigma[15:18]
    msg.dvl_markov_m = e.dvl_markov_m
    msg.dvl_markov_sigma = sigma[18:21]
    msg.usbl_bias_a = e.usbl_bias_a
    msg.usbl_bias_sigma = sigma[21:24]
    msg.fixes_received = e.fixes_received
    msg.fixes_fused = e.fixes_fused
    msg.age_of_last_fix = (e.stamp_ns - e.last_validity_ns) * 1e-9 if e.fixes_fused else math.nan
    dvl, depth = e.local_statistics
    msg.dvl_updates, msg.dvl_gated = int(dvl[UPDATES]), int(dvl[LOCAL_GATED])
    msg.dvl_nis_sum = float(dvl[NIS_SUM])
    msg.depth_updates, msg.depth_gated = int(depth[UPDATES]), int(depth[LOCAL_GATED])
    msg.depth_nis_sum = float(depth[NIS_SUM])
    return msg


def receipt_to_msg(r: Receipt) -> FixReceipt:
    """polar_nav_msgs/FixReceipt of a receipt."""
    msg = FixReceipt()
    msg.header.stamp = to_msg(r.stamp_ns)
    msg.verdict = int(r.verdict)
    msg.verdict_text = r.verdict.name
    msg.reason = r.reason
    msg.topic = r.topic
    msg.source = r.source
    msg.sequence = r.sequence
    msg.revision = r.revision
    msg.validity_time = to_msg(r.validity_ns)
    msg.transmit_time = to_msg(r.transmit_ns)
    msg.receive_time = to_msg(r.receive_ns)
    msg.fused_time = to_msg(r.fused_ns)
    known = r.validity_ns and r.receive_ns
    msg.age = (r.receive_ns - r.validity_ns) * 1e-9 if known else math.nan
    msg.delay_handling = r.delay_handling
    msg.steps_rolled_back = r.steps_rolled_back
    msg.innovation_g = r.innovation_G
    msg.innovation_variance_g = r.innovation_variance_G
    msg.nis = r.nis
    msg.degrees_of_freedom = r.dof
    msg.gate = r.gate
    return msg


def receipt_from_msg(msg: FixReceipt) -> Receipt:
    """Read back the receipt that a recorded message stands for."""
    return Receipt(
        stamp_ns=to_ns(msg.header.stamp),
        verdict=Verdict(msg.verdict),
        reason=msg.reason,
        topic=msg.topic,
        source=msg.source,
        sequence=msg.sequence,
        validity_ns=to_ns(msg.validity_time),
        transmit_ns=to_ns(msg.transmit_time),
        receive_ns=to_ns(msg.receive_time),
        fused_ns=to_ns(msg.fused_time),
        delay_handling=msg.delay_handling,
        steps_rolled_back=msg.steps_rolled_back,
        innovation_G=np.array(msg.innovation_g),
        innovation_variance_G=np.array(msg.innovation_variance_g),
        nis=msg.nis,
        dof=msg.degrees_of_freedom,
        gate=msg.gate,
        revision=msg.revision,
    )


def _in_grid(C_e_G: Array, covariance_e: Array) -> Array:
    return np.asarray(np.einsum('ik,kl,jl->ij', C_e_G, covariance_e, C_e_G))


def _variance_true_east(r_e: Array, P: Array) -> float:
    """Variance of position along true east [m^2]; at a pole, along the y axis of ECEF."""
    x, y = float(r_e[0]), float(r_e[1])
    p = math.hypot(x, y)
    e = np.array([-y / p, x / p, 0.0]) if p > 0.0 else np.array([0.0, 1.0, 0.0])
    return float(max(np.einsum('i,ij,j->', e, P[6:9, 6:9], e), 0.0))
