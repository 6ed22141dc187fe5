"""Trajectory of a bag by name: truth, estimates, a replay, another vehicle, a topic."""

from __future__ import annotations

import numpy as np

from polar_nav_core.attitude import matrix_from_quaternion
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.errors import ConfigError
from polar_nav_ros.topics import STATE

from ..analysis.opening import follower_of
from ..analysis.report_input import leader_of
from ..bags import Bag, BagError
from ..bags.arrays import estimates_from_cdr, load_estimates, load_truth, places
from ..series.vehicle import Floats
from .formats import Trajectory, trajectory

WHATS = ('truth', 'estimate', 'estimate:CONFIGURATION', 'leader')
_EARTH = 'earth'


def exported(bag: Bag, what: str, vehicle: str | None) -> Trajectory:
    """Trajectory of a bag by its name.

    Parameters
    ----------
    bag : Bag
    what : str
        ``truth``, ``estimate`` (as recorded), ``estimate:<configuration>`` (replayed) or
        ``leader`` (truth of the other vehicle).
    vehicle : str, optional
        The follower, if there are several.

    Raises
    ------
    ConfigError
        For another name.
    BagError
        If the bag does not have it.
    """
    kind, _, configuration = what.partition(':')
    if kind not in ('truth', 'estimate', 'leader') or (configuration and kind != 'estimate'):
        raise ConfigError(f'{what!r} is none of {", ".join(WHATS)}')
    name = vehicle or follower_of(bag)
    if kind == 'truth':
        return trajectory(load_truth(bag, name))
    if kind == 'leader':
        leader = leader_of(bag, name)
        if leader is None:
            raise BagError(f'{bag.path} has no truth of another vehicle than {name}')
        return trajectory(leader)
    if not configuration:
        return trajectory(load_estimates(bag, name))
    from ..replay.by_message import replay

    result = replay(bag, configuration=configuration, vehicle=name)
    return trajectory(estimates_from_cdr(result.of(STATE), name))


def origin_of(bag: Bag, vehicle: str | None) -> Floats | None:
    """First true position of the follower, the common origin of a bag's files; or None."""
    try:
        return np.asarray(load_truth(bag, vehicle or follower_of(bag)).r_e[0])
    except BagError:
        return None


def from_topic(bag: Bag, topic: str) -> Trajectory:
    """Trajectory of a topic: VehicleTruth, NavState, or Odometry in the frame `earth`.

    Raises
    ------
    BagError
        Without such a message, or if it is of another type or frame.
    """
    bag.require([topic], named=True)
    kind, vehicle = bag.channel(topic).type, topic.strip('/').split('/')[0]
    if kind == 'polar_nav_msgs/msg/VehicleTruth' and topic == f'/{vehicle}/truth':
        return trajectory(load_truth(bag, vehicle))
    if kind == 'polar_nav_msgs/msg/NavState' and topic == f'/{vehicle}/{STATE}':
        return trajectory(load_estimates(bag, vehicle))
    if kind != 'nav_msgs/msg/Odometry':
        raise BagError(
            f'{bag.path}: {topic} is a {kind}; VehicleTruth, NavState and nav_msgs/Odometry '
            'can be exported'
        )
    return _odometry(bag, topic)


def _odometry(bag: Bag, topic: str) -> Trajectory:
    stamps, rows = [], []
    for _, message in bag.read(topic):
        frame = message.header.frame_id
        if frame != _EARTH:
            raise BagError(
                f'{bag.path}: {topic} is in frame {frame!r}; only poses in {_EARTH!r} (ECEF) can '
                'be exported'
            )
        p, q = message.pose.pose.position, message.pose.pose.orientation
        v = message.twist.twist.linear
        rows.append((p.x, p.y, p.z, q.x, q.y, q.z, q.w, v.x, v.y, v.z))
        stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
    values, stamp_ns = np.array(rows, dtype=np.float64), np.array(stamps, dtype=np.int64)
    values[:, :3] = places(values[:, :3])
    known = np.isfinite(values[:, :7]).all(1)
    order = np.flatnonzero(known)[np.argsort(stamp_ns[known], kind='stable')]
    r_e, C_b_e = values[order, :3], matrix_from_quaternion(values[order, 3:7])
    latitude, longitude, height = geodetic_from_ecef(r_e)
    return Trajectory(
        stamp_ns=stamp_ns[order],
        r_e=r_e,
        C_b_e=C_b_e,
        v_e=np.einsum('nij,nj->ni', C_b_e, values[order, 7:]),
        sigma_G=None,
        latitude=latitude,
        longitude=longitude,
        height=height,
        left_out=len(values) - len(order),
    )
