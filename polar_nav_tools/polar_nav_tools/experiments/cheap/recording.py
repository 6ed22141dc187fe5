"""Messages of the vehicle's drivers, of the drivers' own types, and a bag of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ...bags.layout import layout_of
from ...foreign.definitions import BUNDLED
from . import vehicle

IMU, DVL, PRESSURE, FIX = '/ahrs/imu', '/dvl/data', '/bar30/pressure', '/ugps/fix'
DVL_TYPE = 'dvl_msgs/msg/DVL'
START_NS = 1_760_000_000_000_000_000
"""Stamp of the start: a host's clock."""
_S = 1_000_000_000
_FLIGHT_NS = 2_000_000
"""From the stamp to the recorder."""

Row = tuple[str, int, bytes]
"""Topic, log time [ns] and bytes of a message."""


@dataclass(frozen=True)
class Readings:
    """Everything that the vehicle's sensors say in one run, and the motion behind it."""

    motion: vehicle.Motion
    imu: vehicle.Imu
    dvl: vehicle.Dvl
    pressure: tuple[vehicle.Floats, vehicle.Floats]
    fixes: vehicle.Fixes


def readings(
    seed: int,
    duration_s: float,
    sensors: vehicle.Sensors | None = None,
    ugps: vehicle.Ugps | None = None,
) -> Readings:
    """Run of a seed."""
    sensors = sensors or vehicle.Sensors()
    motion = vehicle.motion(seed, duration_s)
    return Readings(
        motion,
        vehicle.imu(motion, seed, sensors),
        vehicle.dvl(motion, seed, sensors),
        vehicle.pressure(motion, seed, sensors),
        vehicle.fixes(motion, seed, ugps or vehicle.Ugps()),
    )


def typestore() -> Typestore:
    """Types of ROS 2 Jazzy and of the DVL's driver."""
    store = get_typestore(Stores.ROS2_JAZZY)
    known = get_types_from_msg(BUNDLED[DVL_TYPE], DVL_TYPE)
    store.register({k: v for k, v in known.items() if k not in store.types})
    return store


@dataclass(frozen=True)
class _Column:
    """Messages of one topic: a template, and the numbers that differ, by field path."""

    topic: str
    kind: str
    stamps_ns: NDArray[np.int64]
    template: Any
    values: dict[str, NDArray[Any]]


class _Maker:
    def __init__(self, store: Typestore) -> None:
        self._store = store

    def make(self, kind: str, **values: Any) -> Any:  # noqa: ANN401 - of any type
        return self._store.types[kind](**values)

    def header(self, frame_id: str) -> Any:  # noqa: ANN401
        stamp = self.make('builtin_interfaces/msg/Time', sec=0, nanosec=0)
        return self.make('std_msgs/msg/Header', stamp=stamp, frame_id=frame_id)

    def vector(self) -> Any:  # noqa: ANN401
        return self.make('geometry_msgs/msg/Vector3', x=0.0, y=0.0, z=0.0)

    def serialize(self, c: _Column) -> list[bytes]:
        """All messages of a topic: the template with other numbers in their places."""
        data = bytes(self._store.serialize_cdr(c.template, c.kind))
        layout = layout_of(self._store, c.kind, data)
        out = np.tile(np.frombuffer(data, np.uint8), (len(c.stamps_ns), 1))
        stamps = {
            'header.stamp.sec': c.stamps_ns // _S,
            'header.stamp.nanosec': c.stamps_ns % _S,
        }
        for path, values in {**stamps, **c.values}.items():
            leaf = layout.leaves[path]
            raw = np.ascontiguousarray(values, dtype=layout.order + leaf.format)
            flat = raw.view(np.uint8).reshape(len(raw), -1)
            out[:, leaf.offset : leaf.offset + flat.shape[1]] = flat
        return [row.tobytes() for row in out]


def _stamps(time_s: vehicle.Floats, start_ns: int) -> NDArray[np.int64]:
    return start_ns + np.round(time_s * 1e9).astype(np.int64)


def _xyz(path: str, values: vehicle.Floats, names: str = 'xyz') -> dict[str, NDArray[Any]]:
    return {f'{path}.{name}': values[:, i] for i, name in enumerate(names)}


def _columns(r: Readings, make: _Maker, start_ns: int) -> list[_Column]:
    unknown = np.zeros(9)
    imu = make.make(
        'sensor_msgs/msg/Imu',
        header=make.header('ahrs_link'),
        orientation=make.make('geometry_msgs/msg/Quaternion', x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=unknown,
        angular_velocity=make.vector(),
        angular_velocity_covariance=unknown,
        linear_acceleration=make.vector(),
        linear_acceleration_covariance=unknown,
    )
    beam = {'velocity': 0.0, 'distance': 0.0, 'rssi': -40.0, 'nsd': -100.0, 'valid': True}
    dvl = make.make(
        DVL_TYPE,
        header=make.header('dvl_link'),
        time=125.0,
        velocity=make.vector(),
        fom=0.0,
        altitude=0.0,
        beams=[make.make('dvl_msgs/msg/DVLBeam', id=k, **beam) for k in range(4)],
        velocity_valid=True,
        status=0,
        form='json_v3.1',
    )
    pressure = make.make(
        'sensor_msgs/msg/FluidPressure',
        header=make.header('bar30_link'),
        fluid_pressure=0.0,
        variance=0.0,
    )
    fix = make.make(
        'sensor_msgs/msg/NavSatFix',
        header=make.header('ugps'),
        status=make.make('sensor_msgs/msg/NavSatStatus', status=0, service=1),
        latitude=0.0,
        longitude=0.0,
        altitude=0.0,
        position_covariance=unknown,
        position_covariance_type=0,
    )
    times, absolute = r.pressure
    return [
        _Column(
            IMU,
            'sensor_msgs/msg/Imu',
            _stamps(r.imu.time_s, start_ns),
            imu,
            _xyz('orientation', r.imu.quaternion_xyzw, 'xyzw')
            | _xyz('angular_velocity', r.imu.rate_b)
            | _xyz('linear_acceleration', r.imu.force_b),
        ),
        _Column(
            DVL,
            DVL_TYPE,
            _stamps(r.dvl.time_s, start_ns),
            dvl,
            _xyz('velocity', r.dvl.velocity_b)
            | {
                'fom': r.dvl.figure_of_merit,
                'altitude': r.dvl.altitude,
                'velocity_valid': r.dvl.valid,
            },
        ),
        _Column(
            PRESSURE,
            'sensor_msgs/msg/FluidPressure',
            _stamps(times, start_ns),
            pressure,
            {'fluid_pressure': absolute},
        ),
        _Column(
            FIX,
            'sensor_msgs/msg/NavSatFix',
            _stamps(r.fixes.time_s, start_ns),
            fix,
            {'latitude': r.fixes.latitude_deg, 'longitude': r.fixes.longitude_deg},
        ),
    ]


def messages(r: Readings, start_ns: int = START_NS) -> Iterator[Row]:
    """Messages of a run in the order of their log times; stamps count from ``start_ns``."""
    make = _Maker(typestore())
    columns = _columns(r, make, start_ns)
    data = [(c.topic, message) for c in columns for message in make.serialize(c)]
    log_ns = np.concatenate([c.stamps_ns for c in columns]) + _FLIGHT_NS
    for k in np.argsort(log_ns, kind='stable'):
        topic, message = data[k]
        yield topic, int(log_ns[k]), message


def write(path: Path, r: Readings) -> Path:
    """Write a bag of a run, which must not exist."""
    store = typestore()
    kinds = {c.topic: c.kind for c in _columns(r, _Maker(store), START_NS)}
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        links = {t: writer.add_connection(t, kind, typestore=store) for t, kind in kinds.items()}
        for topic, log_ns, message in messages(r):
            writer.write(links[topic], log_ns, message)
    return path
