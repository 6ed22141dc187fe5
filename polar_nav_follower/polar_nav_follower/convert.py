"""Messages to events and results to messages.

But for the node and `standard_outputs`, this is the only place of the package that knows both
worlds.
"""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import Quaternion
from sensor_msgs.msg import Imu

from polar_nav_core import attitude, earth, grid
from polar_nav_core.engine.events import (
    Array,
    Command,
    CommandKind,
    DepthSample,
    DvlPing,
    Estimate,
    Fix,
    ImuSample,
    InitialState,
    Receipt,
    Verdict,
)
from polar_nav_core.packet import Broadcast
from polar_nav_msgs.msg import AcousticPacket, Depth, Dvl, FixReceipt, NavState
from polar_nav_msgs.msg import Command as CommandMsg
from polar_nav_msgs.msg import InitialState as InitialStateMsg
from polar_nav_ros.broadcasts import broadcast_to_msg
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.stamps import to_msg, to_ns

from .measurements.fix import fix_from_packet
from .params import FollowerParams

__all__ = [
    'broadcast_to_msg',
    'command_from_msg',
    'depth_from_msg',
    'dvl_from_msg',
    'fix_from_msg',
    'imu_from_msg',
    'initial_from_msg',
    'initial_problem',
    'initial_to_msg',
    'nav_to_msg',
    'receipt_from_msg',
    'receipt_to_msg',
    'to_bytes',
]


def imu_from_msg(msg: Imu, number: int) -> ImuSample:
    """sensor_msgs/Imu as an event; orientation is not used."""
    w, f = msg.angular_velocity, msg.linear_acceleration
    return ImuSample(
        to_ns(msg.header.stamp), number, np.array([w.x, w.y, w.z]), np.array([f.x, f.y, f.z])
    )


def dvl_from_msg(msg: Dvl, number: int, default_sigma: float) -> DvlPing:
    """polar_nav_msgs/Dvl as an event.

    Pings without bottom lock are marked, an unknown covariance gets the default.
    """
    v_m = np.array([msg.velocity.x, msg.velocity.y, msg.velocity.z])
    covariance = np.array(msg.velocity_covar, dtype=np.float64).reshape(3, 3)
    enough_beams = msg.num_good_beams >= 3
    valid = (
        msg.velocity_mode == Dvl.DVL_MODE_BOTTOM and enough_beams and bool(np.isfinite(v_m).all())
    )
    if covariance[0, 0] == -1.0:
        covariance = default_sigma**2 * np.eye(3)
    return DvlPing(to_ns(msg.header.stamp), number, valid, v_m, covariance)


def depth_from_msg(msg: Depth, number: int, default_sigma: float) -> DepthSample:
    """polar_nav_msgs/Depth as an event."""
    variance = default_sigma**2 if msg.variance == -1.0 else msg.variance
    return DepthSample(to_ns(msg.header.stamp), number, msg.depth, variance)


def fix_from_msg(
    msg: AcousticPacket, number: int, params: FollowerParams
) -> tuple[Fix, Broadcast | None]:
    """polar_nav_msgs/AcousticPacket as an event and, when its bytes can be read, their content."""
    return fix_from_packet(
        bytes(msg.data),
        msg.source,
        msg.sequence,
        number,
        to_ns(msg.transmit_time),
        to_ns(msg.receive_time),
        params,
    )


def command_from_msg(msg: CommandMsg, _number: int) -> Command:
    """polar_nav_msgs/Command as an event."""
    kind = CommandKind(msg.kind)
    initial = None if kind is CommandKind.SHUTDOWN else initial_from_msg(msg.initial_state)
    return Command(to_ns(msg.header.stamp), msg.sequence, kind, initial)


def initial_from_msg(msg: InitialStateMsg) -> InitialState | None:
    """polar_nav_msgs/InitialState; None for one without uncertainty, which stands for none."""
    if msg.sigma_position_horizontal <= 0.0:
        return None
    return InitialState(
        latitude=msg.latitude,
        longitude=msg.longitude,
        height=msg.height,
        v_G=(float(msg.v_g[0]), float(msg.v_g[1]), float(msg.v_g[2])),
        roll=msg.roll,
        pitch=msg.pitch,
        grid_heading=msg.grid_heading,
        sigma_position_horizontal=msg.sigma_position_horizontal,
        sigma_position_vertical=msg.sigma_position_vertical,
        sigma_velocity=msg.sigma_velocity,
        sigma_tilt=msg.sigma_tilt,
        sigma_heading=msg.sigma_heading,
    )


def initial_to_msg(s: InitialState) -> InitialStateMsg:
    """polar_nav_msgs/InitialState of an initial state."""
    return InitialStateMsg(
        latitude=s.latitude,
        longitude=s.longitude,
        height=s.height,
        v_g=np.array(s.v_G),
        roll=s.roll,
        pitch=s.pitch,
        grid_heading=s.grid_heading,
        sigma_position_horizontal=s.sigma_position_horizontal,
        sigma_position_vertical=s.sigma_position_vertical,
        sigma_velocity=s.sigma_velocity,
        sigma_tilt=s.sigma_tilt,
        sigma_heading=s.sigma_heading,
    )


def initial_problem(s: InitialState) -> str:
    """Why an initial state cannot be used, in a sentence; empty when it can."""
    sigmas = {
        'sigma_position_horizontal': s.sigma_position_horizontal,
        'sigma_position_vertical': s.sigma_position_vertical,
        'sigma_velocity': s.sigma_velocity,
        'sigma_tilt': s.sigma_tilt,
        'sigma_heading': s.sigma_heading,
    }
    values = [
        s.latitude,
        s.longitude,
        s.height,
        *s.v_G,
        s.roll,
        s.pitch,
        s.grid_heading,
        *sigmas.values(),
    ]
    if not all(math.isfinite(v) for v in values):
        return 'a value of the initial state is not finite'
    for name, value in sigmas.items():
        if value <= 0.0:
            return f'{name} is {value}: it must be positive'
    if abs(s.latitude) > 0.5 * math.pi:
        return f'latitude is {s.latitude} rad: it must lie in [-pi/2, pi/2]'
    return ''


def nav_to_msg(e: Estimate, params: FollowerParams, vehicle: str) -> NavState:
    """polar_nav_msgs/NavState of an estimate."""
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
    msg.header.frame_id = params.frame_id
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
