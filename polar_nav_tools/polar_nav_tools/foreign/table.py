"""`polar import csv`: columns of CSV files to a bag of this project, and the mapping for it.

Numbers are turned into SI units and the body's axes on the way, so the mapping that is written
needs neither; fixes stand in the bag when they were received.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import Imu

from polar_nav_core.arrays import Array
from polar_nav_core.attitude import matrix_from_euler
from polar_nav_core.depth import STANDARD_ATMOSPHERE, depth_from_pressure
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.grid import convergence, ecef_to_grid
from polar_nav_msgs.msg import Depth, Dvl
from polar_nav_ros import topics
from polar_nav_ros.adapters import section as sections
from polar_nav_ros.adapters.arrays import finite_rows
from polar_nav_ros.adapters.fixes import sigma_covariance
from polar_nav_ros.adapters.frames import to_earth
from polar_nav_ros.adapters.mapping import (
    ACCEL_UNITS,
    ANGLE_UNITS,
    GYRO_UNITS,
    LENGTH_UNITS,
    PRESSURE_UNITS,
    SPEED_UNITS,
    VERSION,
    Frame,
)
from polar_nav_ros.adapters.position import PositionRows
from polar_nav_ros.adapters.section import Section
from polar_nav_ros.adapters.stream_section import frame_of
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.stamps import to_msg

from ..bags import BagWriter
from ..series.vehicle import TruthSeries
from . import csv_columns as columns
from .reference import truth_of
from .replay import truth_messages
from .sources import Stamps

Row = tuple[int, str, bytes]
_FIX_TYPE = 'geometry_msgs/msg/PoseWithCovarianceStamped'


@dataclass
class Imported:
    """What was written: bag, mapping, and messages per topic."""

    bag: Path
    mapping: Path
    counts: dict[str, int] = field(default_factory=dict)

    def to_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return {'path': str(self.bag), 'mapping': str(self.mapping), 'counts': dict(self.counts)}


def import_csv(path: Path, out: Path) -> Imported:
    """Write the CSV files that a YAML file describes to a bag.

    Parameters
    ----------
    path : Path
        Names files, columns and units; files are looked for beside it.
    out : Path
        Folder of the new bag; the mapping is written into it.

    Raises
    ------
    ConfigError
        Naming file, key or column.
    BagError
        When the bag exists or cannot be written.
    """
    top = sections.load(path)
    folder = path.parent
    vehicle = top.text('vehicle', 'follower')
    mapping: dict[str, Any] = {'version': VERSION, 'vehicle': vehicle}
    streams: dict[str, tuple[str, list[Row]]] = {}

    def add(topic: str, kind: str, rows: Iterable[Row]) -> dict[str, Any]:
        name = f'/{vehicle}/{topic}'
        found = [(stamp_ns, name, data) for stamp_ns, _, data in rows]
        streams[name] = (kind, sorted(found, key=lambda row: row[0]))
        return {'topic': name}

    for key, topic, read in (
        ('imu', topics.IMU, _imu),
        ('dvl', topics.DVL, _dvl),
        ('depth', topics.DEPTH, _depth),
    ):
        given = top.section(key)
        if given is not None:
            mapping[key] = add(topic, topics.TYPES[topic], read(given, folder))
            given.done()
    fixes = []
    for i, given in enumerate(top.sections('fixes')):
        name = given.text('source', f'source{i}')
        fixes.append(add(f'fixes/{name}', _FIX_TYPE, _fixes(given, folder)))
        fixes[-1] |= {'source': name, 'frame': 'earth', 'dimensions': 3}
        given.done()
    if fixes:
        mapping['fixes'] = fixes
    given = top.section('truth')
    if given is not None:
        truth = _truth(given, folder, vehicle)
        mapping['truth'] = add(topics.TRUTH, topics.TYPES[topics.TRUTH], truth_messages(truth))
        given.done()
    for key in ('initial', 'noise', 'parameters', 'accept'):
        value = top.raw(key)
        if value is not None:
            mapping[key] = value
    top.done()
    if 'initial' not in mapping and 'truth' in mapping:
        mapping['initial'] = {'from': 'topic', **mapping['truth']}
    return _write(out, path, mapping, streams)


def _write(
    out: Path, path: Path, mapping: dict[str, Any], streams: dict[str, tuple[str, list[Row]]]
) -> Imported:
    with BagWriter(out, {'imported_from': str(path)}) as writer:
        for name, (kind, _) in streams.items():
            writer.add_topic(name, kind)
        rows = heapq.merge(*(rows for _, rows in streams.values()), key=lambda row: row[0])
        for stamp_ns, name, data in rows:
            writer.write(name, data, stamp_ns)
    text = f'# Written by `polar import csv {path}`; for `polar replay {out} --map THIS_FILE`.\n'
    file = out / 'mapping.yaml'
    file.write_text(text + yaml.safe_dump(mapping, sort_keys=False), encoding='utf-8')
    return Imported(out, file, {name: len(rows) for name, (_, rows) in streams.items()})


def _imu(s: Section, folder: Path) -> Iterator[Row]:
    file = columns.open_file(s, folder)
    stamps = columns.times(s, file)
    gyro = GYRO_UNITS[s.choice('gyro_unit', tuple(GYRO_UNITS), 'rad/s')]
    accel = ACCEL_UNITS[s.choice('accel_unit', tuple(ACCEL_UNITS), 'm/s^2')]
    C_s_b = s.rotation()
    omega = columns.vectors(s, file, 'rate') * gyro @ C_s_b.T
    f = columns.vectors(s, file, 'force') * accel @ C_s_b.T
    columns.same_length(s, [stamps, omega, f])
    message = Imu()
    message.orientation_covariance[0] = -1.0
    for k, stamp_ns in enumerate(stamps.tolist()):
        message.header.stamp = to_msg(stamp_ns)
        w, a = message.angular_velocity, message.linear_acceleration
        w.x, w.y, w.z = omega[k].tolist()
        a.x, a.y, a.z = f[k].tolist()
        yield stamp_ns, '', to_bytes(message)


def _dvl(s: Section, folder: Path) -> Iterator[Row]:
    file = columns.open_file(s, folder)
    stamps = columns.times(s, file)
    scale = SPEED_UNITS[s.choice('unit', tuple(SPEED_UNITS), 'm/s')]
    C_s_b = s.rotation()
    v = columns.vectors(s, file, 'velocity') * scale @ C_s_b.T
    valid = columns.optional(s, file, 'valid')
    sigma = s.optional('sigma', 1e-6, 10.0, 'm/s')
    columns.same_length(s, [stamps, v, valid])
    good = finite_rows(v) & (True if valid is None else valid != 0.0)
    for k, stamp_ns in enumerate(stamps.tolist()):
        message = Dvl()
        message.header.stamp = to_msg(stamp_ns)
        message.velocity_mode = Dvl.DVL_MODE_BOTTOM
        message.velocity.x, message.velocity.y, message.velocity.z = v[k].tolist()
        message.num_good_beams = 4 if good[k] else 0
        covariance = np.full(9, -1.0) if sigma is None else sigma**2 * np.eye(3).ravel()
        message.velocity_covar = covariance
        yield stamp_ns, '', to_bytes(message)


def _depth(s: Section, folder: Path) -> Iterator[Row]:
    file = columns.open_file(s, folder)
    stamps = columns.times(s, file)
    unit = s.choice('unit', (*LENGTH_UNITS, *PRESSURE_UNITS), 'm')
    sign = 1.0 if s.choice('positive', ('down', 'up'), 'down') == 'down' else -1.0
    raw = file.column(s, 'depth', s.text('depth'))
    if unit in PRESSURE_UNITS:
        at = np.radians(s.number('latitude_deg', None, -90.0, 90.0, 'deg'))
        air = s.number('atmospheric_pressure', STANDARD_ATMOSPHERE, 0.0, 120000.0, 'Pa')
        depth = np.asarray(depth_from_pressure(raw * PRESSURE_UNITS[unit], at, air))
    else:
        depth = raw * LENGTH_UNITS[unit] * sign
    sigma = s.optional('sigma', 1e-6, 100.0, 'm')
    columns.same_length(s, [stamps, depth])
    message = Depth()
    message.variance = -1.0 if sigma is None else sigma**2
    for stamp_ns, value in zip(stamps.tolist(), depth.tolist(), strict=True):
        message.header.stamp = to_msg(stamp_ns)
        message.depth = value
        yield stamp_ns, '', to_bytes(message)


def _places(s: Section, file: columns.CsvFile, to_radians: float) -> tuple[Stamps, Array]:
    stamps = columns.times(s, file)
    values = columns.vectors(s, file, 'position')
    columns.same_length(s, [stamps, values])
    frame = frame_of(s)
    if frame.kind is None:
        raise s.fail('frame', 'is missing: geodetic, earth, enu, ned or epsg')
    if frame.kind == 'geodetic':
        values[:, :2] = np.degrees(values[:, :2] * to_radians)
        if np.nanmax(np.abs(values[:, 0])) > 90.0 + 1e-9:
            raise s.fail('position', f'{file.path}: latitudes beyond 90 deg; see angle_unit')
    return stamps, to_earth(frame, values).r_e


def _angle_unit(s: Section) -> float:
    """Radians per unit of the angles of a section."""
    return ANGLE_UNITS[s.choice('angle_unit', tuple(ANGLE_UNITS), 'deg')]


def _fixes(s: Section, folder: Path) -> Iterator[Row]:
    """Fixes under the time of their reception."""
    file = columns.open_file(s, folder)
    stamps, r_e = _places(s, file, _angle_unit(s))
    delay_s = s.optional('delay_s', 0.0, 3600.0, 's')
    if 'receive' in s:
        received = columns.times(s, file, 'receive')
    elif delay_s is not None:
        received = stamps + round(delay_s * 1e9)
    else:
        raise s.fail('receive', 'is missing: a column with the times of reception, or delay_s')
    s.raw('receive')
    horizontal = s.number('sigma_horizontal', None, 1e-3, 1e6, 'm')
    vertical = s.number('sigma_vertical', None, 1e-3, 1e6, 'm')
    covariance = sigma_covariance((horizontal, vertical), r_e)
    for k, stamp_ns in enumerate(stamps.tolist()):
        message = PoseWithCovarianceStamped()
        message.header.stamp = to_msg(stamp_ns)
        message.header.frame_id = 'earth'
        p = message.pose.pose.position
        p.x, p.y, p.z = r_e[k].tolist()
        P = np.zeros((6, 6))
        P[:3, :3] = covariance[k]
        message.pose.covariance = P.ravel()
        yield int(received[k]), '', to_bytes(message)


def _truth(s: Section, folder: Path, vehicle: str) -> TruthSeries:
    """Reference positions, with attitude where heading, pitch and roll are given."""
    file = columns.open_file(s, folder)
    to_radians = _angle_unit(s)
    stamps, r_e = _places(s, file, to_radians)
    n = len(stamps)
    C_b_G = np.full((n, 3, 3), np.nan)
    heading, pitch, roll = (columns.optional(s, file, key) for key in ('heading', 'pitch', 'roll'))
    if heading is not None:
        lat, lon, _ = geodetic_from_ecef(r_e)
        psi = 0.5 * np.pi - (heading * to_radians - convergence(lat, lon))
        zero = np.zeros(n)
        # Pitch of a file is nose up, that of the body (x forward, y left, z up) nose down.
        theta = zero if pitch is None else -pitch * to_radians
        phi = zero if roll is None else roll * to_radians
        C_b_G = np.asarray(matrix_from_euler(psi, theta, phi))
    v_G = np.full((n, 3), np.nan)
    enu = _velocity_enu(s, file)
    if enu is not None:
        lat, lon, _ = geodetic_from_ecef(r_e)
        axes = to_earth(Frame('geodetic'), np.degrees(np.column_stack([lat, lon, lat * 0.0])))
        v_G = np.einsum('nij,njk,nk->ni', ecef_to_grid(r_e), axes.axes_e, enu)
    yes = np.ones(n, dtype=bool)
    rows = PositionRows(
        topic='truth',
        type='csv',
        stamps_ns=stamps,
        log_ns=stamps,
        r_e=r_e,
        covariance_e=np.full((n, 3, 3), np.nan),
        v_G=v_G,
        C_b_G=C_b_G,
        given=finite_rows(r_e),
        plausible=yes,
        stated=False,
    )
    truth = truth_of(rows.sorted(), vehicle)
    if truth is None:
        raise s.fail('file', f'{file.path} has fewer than two positions')
    return truth


def _velocity_enu(s: Section, file: columns.CsvFile) -> Array | None:
    """Velocity as east, north, up, also of columns of north, east, down; None where none is."""
    given = [key for key in ('velocity_enu', 'velocity_ned') if key in s]
    found = [columns.vectors(s, file, key) for key in given]
    for key in ('velocity_enu', 'velocity_ned'):
        s.raw(key)
    if len(found) > 1:
        raise s.fail('velocity_ned', 'is given beside velocity_enu: name one')
    if not found:
        return None
    return found[0] if given == ['velocity_enu'] else found[0][:, [1, 0, 2]] * (1.0, 1.0, -1.0)
