"""Small bags for the tests of bags: messages made without ROS, times and content foreseeable."""

import json
import struct

import numpy as np

from polar_nav_tools.bags import BagWriter, open_bag
from polar_nav_tools.bags.decode import store_of
from polar_nav_tools.bags.files import MAGIC
from polar_nav_tools.bags.schemas import definition

START_NS = 1_600_000_000_000_000_000
STEP_NS = 10_000_000
IMU, TRUTH = '/follower/imu/data_raw', '/follower/truth'
STATE, RECEIPT, RUN_INFO = '/follower/nav/state', '/follower/nav/receipt', '/run_info'
TYPES = {
    IMU: 'sensor_msgs/msg/Imu',
    TRUTH: 'polar_nav_msgs/msg/VehicleTruth',
    STATE: 'polar_nav_msgs/msg/NavState',
    RECEIPT: 'polar_nav_msgs/msg/FixReceipt',
    RUN_INFO: 'std_msgs/msg/String',
}


def store(type_name):
    """rosbags' type store of an installed type."""
    return store_of(definition(type_name).text, type_name)


def make(type_name, **given):
    """Message with given fields and zeros elsewhere; keys with '__' go deeper."""
    types = store(type_name)
    message = _zero(types, type_name)
    for key, value in given.items():
        target = message
        *path, last = key.split('__')
        for name in path:
            target = getattr(target, name)
        object.__setattr__(target, last, value)
    return types.serialize_cdr(message, type_name).tobytes()


def _zero(types, type_name):
    values = {}
    for name, (kind, what) in types.fielddefs[type_name][1]:
        if kind.name == 'BASE':
            values[name] = '' if what[0] == 'string' else 0.0 if 'float' in what[0] else 0
            if what[0] == 'bool':
                values[name] = False
        elif kind.name == 'NAME':
            values[name] = _zero(types, what)
        else:
            (inner_kind, inner), count = what
            count = count if kind.name == 'ARRAY' else 0
            if inner_kind.name == 'NAME':
                values[name] = [_zero(types, inner) for _ in range(count)]
            elif inner[0] == 'string':
                values[name] = []
            else:
                values[name] = np.zeros(count, np.dtype(inner[0]))
    return types.types[type_name](**values)


def stamp(ns):
    """Fields that set a header stamp."""
    return {'header__stamp__sec': ns // 10**9, 'header__stamp__nanosec': ns % 10**9}


def stamp_ns(k):
    """Stamp of sample k."""
    return START_NS + k * STEP_NS


def imu(k):
    return make(
        TYPES[IMU],
        **stamp(stamp_ns(k)),
        header__frame_id='follower/base_link',
        angular_velocity__x=0.001 * k,
        linear_acceleration__z=9.8,
    )


def truth(k):
    rng = np.random.default_rng(k)
    return make(
        TYPES[TRUTH],
        **stamp(stamp_ns(k)),
        header__frame_id='earth',
        sequence=k,
        r_e=rng.normal(size=3) * 6e6,
        latitude=1.5,
        v_g=rng.normal(size=3),
        c_b_g=np.eye(3).ravel() + k,
        altitude=np.nan,
    )


def run_info(node='/follower/follower_node', **params):
    said = {'node': node, 'package': 'polar_nav_follower', 'version': '0.1.0', 'params': params}
    return make(TYPES[RUN_INFO], data=json.dumps(said))


def write_bag(directory, count=200, *, finish=True, chunk_bytes=8 * 1024, **options):
    """Bag with `count` IMU and truth messages and one run info; returns the .mcap file."""
    options = {'flush_s': 1e9, **options}
    writer = BagWriter(
        directory, {'seed': 7, 'mission': 'line'}, chunk_bytes=chunk_bytes, **options
    )
    for topic in (RUN_INFO, IMU, TRUTH):
        writer.add_topic(topic, TYPES[topic])
    writer.write(RUN_INFO, run_info(window=0.05), START_NS, START_NS)
    for k in range(count):
        writer.write(IMU, imu(k), stamp_ns(k) + 1000, stamp_ns(k))
        writer.write(TRUTH, truth(k), stamp_ns(k) + 2000, stamp_ns(k))
    if finish:
        counts = {t: {'count': n, 'lost': 0} for t, n in writer.counts.items()}
        writer.finish({'recording': {'state': 'finished', 'topics': counts}})
    else:
        writer.flush()
        writer.abandon()
    return writer.path


def contents(path):
    """Topic, log time, number and bytes of each message."""
    return [(r.topic, r.log_time_ns, r.sequence, r.data) for r in open_bag(path).records()]


def records_of(data):
    """Offset, opcode and length with header of each record of a finished file."""
    at, found = len(MAGIC), []
    while at < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from('<BQ', data, at)
        found.append((at, opcode, 9 + length))
        at += 9 + length
    return found
