"""What a follower receives in a simulated run: messages of its topics, and its description."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import Quaternion, Vector3, WrenchStamped
from sensor_msgs.msg import Imu
from std_msgs.msg import Header, String

from polar_nav_core import attitude, grid
from polar_nav_core.arrays import Array
from polar_nav_core.engine.events import ControlSample, DepthSample, DvlPing, Event, Fix, ImuSample
from polar_nav_core.engine.inputs import Inputs, StationInputs
from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.identification.polar_fix import PolarFix
from polar_nav_core.link import packet, station_packet
from polar_nav_core.params import to_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import AcousticPacket, Depth, Dvl
from polar_nav_ros import topics
from polar_nav_ros.stamps import to_msg

VEHICLE = 'follower'
_GOOD_BEAMS = 4
_SOUND_SPEED = 1450.0
"""Of an instrument whose parameter `water_sound_speed` is 0: it corrects nothing [m/s]."""


class Received(NamedTuple):
    """A message on a topic of the follower, and when it arrives [ns]."""

    topic: str
    message: Any
    arrival_ns: int


def received(inputs: Inputs | StationInputs) -> list[Received]:
    """Messages of a run as they arrive: sensors at their stamps, packets at their reception."""
    return [Received(_topic(e), message_of(e), e.stamp_ns) for e in inputs.events()]


def _topic(event: Event) -> str:
    ahrs = isinstance(event, ImuSample) and event.C_b_G is not None
    return topics.AHRS if ahrs else event.topic


def message_of(event: Event) -> Any:  # noqa: ANN401 - of its topic
    """Message that a follower reads as this event.

    Raises
    ------
    TypeError
        For an event that no message of the follower's own topics holds.
    """
    if isinstance(event, Fix):
        return packet_of(event)
    header = Header(stamp=to_msg(event.stamp_ns), frame_id=f'{VEHICLE}/base_link')
    if isinstance(event, ImuSample):
        return _imu(event, header)
    if isinstance(event, DvlPing):
        return Dvl(
            header=header,
            velocity=_vector(event.v_m),
            velocity_covar=event.covariance_m.ravel(),
            velocity_mode=Dvl.DVL_MODE_BOTTOM,
            num_good_beams=_GOOD_BEAMS if event.valid else 0,
            sound_speed=_SOUND_SPEED,
        )
    if isinstance(event, DepthSample):
        return Depth(header=header, depth=event.depth, variance=event.variance)
    if isinstance(event, ControlSample):
        message = WrenchStamped(header=header)
        message.wrench.force = _vector(event.force_b)
        message.wrench.torque = _vector(event.torque_b)
        return message
    raise TypeError(f'no message holds a {type(event).__name__}')


def _imu(sample: ImuSample, header: Header) -> Imu:
    message = Imu(
        header=header,
        angular_velocity=_vector(sample.omega_ib_b),
        linear_acceleration=_vector(sample.f_b),
    )
    if sample.C_b_G is None:
        message.orientation_covariance[0] = -1.0
    else:
        x, y, z, w = attitude.quaternion_from_matrix(sample.C_b_G).tolist()
        message.orientation = Quaternion(x=x, y=y, z=z, w=w)
    return message


def _vector(values: Array) -> Vector3:
    x, y, z = values.tolist()
    return Vector3(x=x, y=y, z=z)


def packet_of(fix: Fix, covariance_G: Array | None = None) -> AcousticPacket:
    """Packet of a fix as it was received, of the format of a leader's or a station's.

    ``covariance_G`` (3, 3) is written in place of the fix's own; the leader's part included [m^2].
    """
    params = FollowerParams()
    if fix.polar is None:
        data = packet.encode(_broadcast(fix, params, covariance_G))
    else:
        data = station_packet.encode(_report(fix, fix.polar, params))
    message = AcousticPacket(
        source=fix.source,
        destination=VEHICLE,
        sequence=fix.order,
        transmit_time=to_msg(fix.transmit_ns),
        receive_time=to_msg(fix.receive_ns),
        data=data,
    )
    message.header.stamp = message.transmit_time
    return message


def _broadcast(fix: Fix, params: FollowerParams, covariance_G: Array | None) -> packet.Broadcast:
    leader_r_e = fix.r_e - fix.relative_e
    C_e_G = np.asarray(grid.ecef_to_grid(leader_r_e))
    if covariance_G is None:
        covariance_G = C_e_G @ fix.covariance_e @ C_e_G.T
    return packet.Broadcast(
        source=params.leader_id,
        target=params.own_id,
        sequence=fix.sequence,
        validity_ns=fix.validity_ns,
        return_ns=fix.validity_ns,
        leader_r_e=leader_r_e,
        leader_sigma_horizontal=fix.leader_sigma,
        leader_sigma_vertical=0.0,
        leader_v_G=np.zeros(3),
        leader_sigma_velocity=0.0,
        leader_grid_heading=0.0,
        leader_sigma_heading=fix.leader_heading_sigma,
        r_lf_G=C_e_G @ fix.relative_e,
        r_lf_covariance_G=covariance_G - fix.leader_sigma**2 * np.diag([1.0, 1.0, 0.0]),
        sound_speed=_SOUND_SPEED,
    )


def _report(fix: Fix, polar: PolarFix, params: FollowerParams) -> station_packet.StationReport:
    return station_packet.StationReport(
        source=params.leader_id,
        target=params.own_id,
        sequence=fix.sequence,
        validity_ns=fix.validity_ns,
        station_position=polar.station,
        station_heading=polar.station_heading,
        station_heading_sigma=polar.station_heading_sigma,
        range=polar.range,
        bearing=polar.bearing,
        sound_speed=polar.sound_speed,
    )


def description_of(params: FollowerParams) -> String:
    """Message on /run_info of the follower's node with these parameters."""
    described = {
        'node': f'/{VEHICLE}/follower_node',
        'package': 'polar_nav_follower',
        'version': '',
        'engine_version': ENGINE_VERSION,
        'params': to_mapping(params),
    }
    return String(data=json.dumps(described))
