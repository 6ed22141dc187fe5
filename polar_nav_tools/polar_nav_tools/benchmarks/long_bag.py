"""Synthetic long bag of one follower, for timing replays.

The straight run of the experiments at 3 m/s: IMU at 100 Hz, DVL at 5 Hz, depth and truth at 1 Hz,
a packet every 2 s that is 5 to 15 s old, in chunks of 256 KiB compressed with zstd, like a bag of
`./polar record`. The packets state the leader at the position of the fix.
"""

from __future__ import annotations

import hashlib
import heapq
import json
import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Imu

from polar_nav_core.engine.params import NO_COMMON_ERRORS, NO_RESERVE, EngineParams
from polar_nav_core.params import to_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import Depth, Dvl, VehicleTruth
from polar_nav_ros import topics
from polar_nav_ros.cdr import to_bytes
from polar_nav_sim.trajectory import Truth

from ..bags import BagWriter
from ..bags.decode import store_of
from ..bags.layout import layout_of
from ..bags.schemas import definition
from ..experiments.received import VEHICLE, description_of, packet_of
from ..experiments.schedule import FixSpec
from ..experiments.world import World, make_world
from ..experiments.world_spec import WorldSpec

RATES_HZ = {topics.IMU: 100.0, topics.DVL: 5.0, topics.DEPTH: 1.0, topics.TRUTH: 1.0}
PACKETS_HZ = 0.5
CONFIGURATION = 'default'
_SEED = 1
_BLOCK = 20_000
_VERSION = 3

Progress = Callable[[float], None]
Stream = Iterator[tuple[int, int, str, bytes]]


class Template:
    """Template of messages of one type that differ in some numbers only.

    Parameters
    ----------
    message : message
        A message with the values, and the lengths of strings and sequences, of all others.
    """

    def __init__(self, message: Any) -> None:  # noqa: ANN401 - any ROS message
        package, _, name = type(message).__module__.split('.')[0], '', type(message).__name__
        kind = f'{package}/msg/{name}'
        self._example = np.frombuffer(to_bytes(message), dtype=np.uint8)
        self._leaves = layout_of(
            store_of(definition(kind).text, kind), kind, self._example.tobytes()
        ).leaves

    def messages(self, fields: dict[str, NDArray[Any]]) -> Iterator[bytes]:
        """Bytes of messages with these numbers, arrays of shape (n,) or (n, k)."""
        count = len(next(iter(fields.values())))
        rows = np.tile(self._example, (count, 1))
        for name, values in fields.items():
            leaf = self._leaves[name]
            raw = np.ascontiguousarray(values.astype(f'<{leaf.format}')).view(np.uint8)
            raw = raw.reshape(count, -1)
            rows[:, leaf.offset : leaf.offset + raw.shape[1]] = raw
        size = rows.shape[1]
        joined = rows.tobytes()
        for i in range(count):
            yield joined[i * size : (i + 1) * size]


def long_bag(
    hours: float, *, folder: Path | None = None, progress: Progress | None = None
) -> Path:
    """Path of a bag of some hours; it is made once and stored among temporary files.

    Parameters
    ----------
    hours : float
    folder : Path, optional
        Folder of the bags, by default one of this user among temporary files.
    progress : callable, optional
        Called with the written share.
    """
    base = folder or Path(tempfile.gettempdir()) / f'polar_nav_bench_{os.getuid()}'
    base.mkdir(mode=0o700, parents=True, exist_ok=True)
    what = json.dumps([_VERSION, hours, RATES_HZ, PACKETS_HZ, _SEED, _definitions()])
    path = base / f'replay_{hours:g}h_{hashlib.sha256(what.encode()).hexdigest()[:12]}'
    if path.exists():
        return path
    with tempfile.TemporaryDirectory(dir=base, prefix='unfinished_') as unfinished:
        target = Path(unfinished) / path.name
        _write(target, hours, progress)
        target.rename(path)
    return path


def _definitions() -> list[str]:
    names = ('AcousticPacket', 'Depth', 'Dvl', 'VehicleTruth')
    return [definition(f'polar_nav_msgs/msg/{name}').text for name in names]


def _write(target: Path, hours: float, progress: Progress | None) -> None:
    world = long_world(hours)
    streams = [
        _stamped(0, topics.IMU, _imu(world)),
        _stamped(1, topics.DVL, _dvl(world)),
        _stamped(2, topics.DEPTH, _depth(world)),
        _stamped(3, topics.TRUTH, _truth(world)),
        _packets(4, world),
    ]
    total = len(world.inputs.imu_stamps_ns)
    run = {'mission': 'straight', 'made_by': 'polar bench replay', 'seed': _SEED}
    with BagWriter(target, run, flush_s=1e9) as writer:
        writer.add_topic(topics.RUN_INFO, topics.TYPES[topics.RUN_INFO])
        for name, type_name in topics.of_vehicle(VEHICLE, _TOPICS).items():
            writer.add_topic(name, type_name)
        start_ns = int(world.inputs.imu_stamps_ns[0])
        writer.write(topics.RUN_INFO, _run_info(world), start_ns)
        written = 0
        for stamp_ns, _, name, data in heapq.merge(*streams):
            writer.write(f'/{VEHICLE}/{name}', data, stamp_ns)
            written += name == topics.IMU
            if progress is not None and written % 100_000 == 0:
                progress(written / total)


_TOPICS = (
    topics.IMU,
    topics.DVL,
    topics.DEPTH,
    topics.TRUTH,
    topics.RX,
)


def long_world(hours: float) -> World:
    """World of the bag: the run whose sensors and late packets it holds."""
    spec = WorldSpec(
        duration_s=3600.0 * hours,
        imu='paper_6_2',
        imu_rate_hz=RATES_HZ[topics.IMU],
        dvl_rate_hz=RATES_HZ[topics.DVL],
        depth_rate_hz=RATES_HZ[topics.DEPTH],
    )
    fixes = FixSpec(
        period_s=1.0 / PACKETS_HZ,
        first_s=1.0 / PACKETS_HZ,
        delay_kind='uniform',
        delay_s=15.0,
        delay_least_s=5.0,
    )
    return make_world(spec, fixes, _SEED)


def long_params(world: World) -> EngineParams:
    """Parameters of its filter: what `default` states of common errors and slow biases, too.

    The world has none of them, and a filter that is told so does less.
    """
    told = world.params(configuration=CONFIGURATION)
    unknown = {*NO_COMMON_ERRORS, *NO_RESERVE}
    usual: dict[str, Any] = {f.name: f.default for f in fields(told) if f.name in unknown}
    return replace(told, **usual)


def _run_info(world: World) -> bytes:
    params = FollowerParams(**to_mapping(long_params(world)))
    return to_bytes(description_of(params))


Blocks = Iterator[tuple[NDArray[np.int64], Iterator[bytes]]]


def _stamped(order: int, name: str, blocks: Blocks) -> Stream:
    """Messages with their stamps, in their order."""
    for stamps_ns, messages in blocks:
        for stamp_ns, data in zip(stamps_ns.tolist(), messages, strict=True):
            yield stamp_ns, order, name, data


def _time(stamps_ns: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    return {
        'header.stamp.sec': stamps_ns // 1_000_000_000,
        'header.stamp.nanosec': stamps_ns % 1_000_000_000,
    }


def _axes(name: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    return {f'{name}.{axis}': values[:, i] for i, axis in enumerate('xyz')}


def _parts(count: int) -> Iterator[slice]:
    return (slice(i, min(i + _BLOCK, count)) for i in range(0, count, _BLOCK))


def _imu(world: World) -> Blocks:
    message = Imu()
    message.header.frame_id = f'{VEHICLE}/base_link'
    message.orientation_covariance[0] = -1.0
    template, x = Template(message), world.inputs
    for rows in _parts(len(x.imu_stamps_ns)):
        stamps_ns = x.imu_stamps_ns[rows]
        yield (
            stamps_ns,
            template.messages(
                {
                    **_time(stamps_ns),
                    **_axes('angular_velocity', x.omega_ib_b[rows]),
                    **_axes('linear_acceleration', x.f_b[rows]),
                }
            ),
        )


def _dvl(world: World) -> Blocks:
    message = Dvl(num_good_beams=4, velocity_mode=Dvl.DVL_MODE_BOTTOM, sound_speed=1450.0)
    message.header.frame_id = f'{VEHICLE}/dvl_link'
    template, x = Template(message), world.inputs
    for rows in _parts(len(x.dvl_stamps_ns)):
        stamps_ns = x.dvl_stamps_ns[rows]
        covariances = x.dvl_covariance_m[rows].reshape(-1, 9)
        numbers = {**_time(stamps_ns), **_axes('velocity', x.dvl_v_m[rows])}
        yield stamps_ns, template.messages({**numbers, 'velocity_covar': covariances})


def _depth(world: World) -> Blocks:
    message = Depth()
    message.header.frame_id = f'{VEHICLE}/depth_link'
    template, x = Template(message), world.inputs
    for rows in _parts(len(x.depth_stamps_ns)):
        stamps_ns = x.depth_stamps_ns[rows]
        numbers = {'depth': x.depth[rows], 'variance': x.depth_variance[rows]}
        yield stamps_ns, template.messages({**_time(stamps_ns), **numbers})


def _truth(world: World) -> Blocks:
    message = VehicleTruth()
    message.header.frame_id = 'earth'
    template = Template(message)
    stride = round(RATES_HZ[topics.IMU] / RATES_HZ[topics.TRUTH])
    stamps = world.inputs.imu_stamps_ns[stride - 1 :: stride]
    for rows in _parts(len(stamps)):
        yield stamps[rows], template.messages(_truth_numbers(world.truth, stamps[rows], rows))


def _truth_numbers(
    truth: Truth, stamps_ns: NDArray[np.int64], rows: slice
) -> dict[str, NDArray[Any]]:
    state = truth.state(stamps_ns)
    count = len(stamps_ns)
    return {
        **_time(stamps_ns),
        'sequence': np.arange(rows.start, rows.start + count),
        'r_e': state.r_e,
        'height': state.h,
        'depth': -state.h,
        'v_g': state.v_G,
        'c_b_g': state.C_b_G.reshape(count, 9),
    }


def _packets(order: int, world: World) -> Stream:
    for number, fix in enumerate(sorted(world.inputs.fixes, key=lambda f: f.key)):
        message = packet_of(fix, np.diag(np.diagonal(fix.covariance_e)))
        message.sequence = number
        yield fix.receive_ns, order, topics.RX, to_bytes(message)
