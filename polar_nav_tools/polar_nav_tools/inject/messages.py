"""Readings of a bag's messages, and messages with the changes of faults.

Only what a fault has changed is written into a message: the rest, and every other message, keeps
its bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from polar_nav_core.link import packet, station_packet
from polar_nav_core.link.fields import Layout, PacketError, kind_of
from polar_nav_ros import topics
from polar_nav_ros.readers import control_from_msg, depth_from_msg, dvl_from_msg, imu_from_msg
from polar_nav_ros.stamps import to_msg, to_ns

from .readings import DEPTH, DVL, FIX, IMU, PACKET, THRUST, Reading

STREAM_OF = {
    topics.IMU: IMU,
    topics.AHRS: IMU,
    topics.DVL: DVL,
    topics.DEPTH: DEPTH,
    topics.CONTROL: THRUST,
    topics.RX: FIX,
}
"""Streams of a follower's topics."""
_LAYOUTS: dict[int, Layout] = {
    packet.VERSION: packet.LAYOUT,
    station_packet.VERSION: station_packet.LAYOUT,
}
_PLACE = {packet.VERSION: 'r_lf_G', station_packet.VERSION: 'station_position'}
"""Field that moves the stated position."""
_NUMBERS = {packet.VERSION: 1 << 16, station_packet.VERSION: 1 << 8}
"""Numbers after which a packet's own number wraps."""
_MODEM_NUMBERS = 1 << 32
_NO_SIGMA = 1.0
"""Stands for an unknown covariance while it is read; written only where a fault changes it."""


def reading_of(stream: str, number: int, message: Any, arrival_ns: int) -> Reading:  # noqa: ANN401 - of the topic
    """Reading of a message that arrived at a log time [ns]."""
    stamp = message.receive_time if stream == FIX else message.header.stamp
    stamp_ns = to_ns(stamp)
    return Reading(stream, number, stamp_ns, arrival_ns, stamp_ns, _values(stream, message))


def _values(stream: str, m: Any) -> dict[str, Any]:  # noqa: ANN401
    if stream == IMU:
        imu = imu_from_msg(m, 0)
        return {'omega_ib_b': imu.omega_ib_b, 'f_b': imu.f_b}
    if stream == DVL:
        ping = dvl_from_msg(m, 0, _NO_SIGMA)
        return {'v_m': ping.v_m, 'covariance_m': ping.covariance_m, 'valid': ping.valid}
    if stream == DEPTH:
        depth = depth_from_msg(m, 0, _NO_SIGMA)
        return {'depth': depth.depth, 'variance': depth.variance}
    if stream == THRUST:
        return {'force_b': control_from_msg(m, 0).force_b}
    return dict(PACKET)


def change(message: Any, before: Reading, after: Reading) -> None:  # noqa: ANN401
    """Write into a message what differs between its reading before and after the faults."""
    if after.stream == FIX:
        _change_packet(message, before, after)
        return
    if after.stamp_ns != before.stamp_ns:
        message.header.stamp = to_msg(after.stamp_ns)
    for name, value in after.values.items():
        if value is not before.values[name]:
            _WRITE[name](message, value)


def _vector(part: Callable[[Any], Any]) -> Callable[[Any, Any], None]:
    """Writer of a geometry_msgs/Vector3."""

    def write(message: Any, value: Any) -> None:  # noqa: ANN401
        vector = part(message)
        vector.x, vector.y, vector.z = (float(v) for v in value)

    return write


def _covariance(message: Any, value: Any) -> None:  # noqa: ANN401
    message.velocity_covar = np.asarray(value, dtype=np.float64).reshape(9)


def _lock(message: Any, value: Any) -> None:  # noqa: ANN401
    if not value:
        message.num_good_beams = 0


def _depth(message: Any, value: Any) -> None:  # noqa: ANN401
    message.depth = float(value)


def _variance(message: Any, value: Any) -> None:  # noqa: ANN401
    message.variance = float(value)


_WRITE: dict[str, Callable[[Any, Any], None]] = {
    'omega_ib_b': _vector(lambda m: m.angular_velocity),
    'f_b': _vector(lambda m: m.linear_acceleration),
    'v_m': _vector(lambda m: m.velocity),
    'covariance_m': _covariance,
    'valid': _lock,
    'depth': _depth,
    'variance': _variance,
    'force_b': _vector(lambda m: m.wrench.force),
}


def _change_packet(message: Any, before: Reading, after: Reading) -> None:  # noqa: ANN401
    shift_ns = after.stamp_ns - before.stamp_ns
    if shift_ns:
        message.receive_time = to_msg(after.stamp_ns)
        sent_ns = to_ns(message.transmit_time)
        message.transmit_time = message.header.stamp = to_msg(max(0, sent_ns + shift_ns))
    if after.values is before.values:
        return
    v = after.values
    message.sequence = (message.sequence + v['ahead']) % _MODEM_NUMBERS
    data = bytes(message.data)
    with suppress(PacketError):  # damaged on the way already: nobody can forge from it
        data = _changed_bytes(data, v)
    if v['flipped_bit'] is not None:
        place, bit = divmod(v['flipped_bit'] % (8 * len(data)), 8)
        data = data[:place] + bytes([data[place] ^ 1 << bit]) + data[place + 1 :]
    message.data = data


def _changed_bytes(data: bytes, v: Any) -> bytes:  # noqa: ANN401
    """Packet with the changes of its content."""
    version = kind_of(data)
    if version not in _LAYOUTS:
        return data
    layout = _LAYOUTS[version]
    now = layout.unpack(data)
    new: dict[str, list[float]] = {}
    if v['ahead']:
        new['sequence'] = [(int(now['sequence'][0]) + v['ahead']) % _NUMBERS[version]]
    if v['moved_G'].any():
        new[_PLACE[version]] = list(np.array(now[_PLACE[version]]) + v['moved_G'])
    if version == packet.VERSION and v['sigma'] is not None:
        new['r_lf_sigma_G'] = [v['sigma']] * 3
        new['r_lf_correlation'] = [0.0] * 3
    if version == packet.VERSION and v['indefinite']:
        new['r_lf_correlation'] = [1.0, 1.0, -1.0]
    return layout.changed(data, new)
