"""Errors of a real IMU, from a bag recorded at rest, for simulated truth.

The paper's semi-physical experiment (its section 6.2) with the reader's own IMU: the readings of a
resting IMU, less the Earth's rate and gravity, are its errors, which do not depend on the place.
Without heading and exact level only part of the true readings is known: gravity is assumed in the
direction of the mean specific force, so a constant accelerometer error across it equals a tilt and
is not stored; a constant gyro error differs from the Earth's rate only if latitude and heading are
known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from polar_nav_core import earth
from polar_nav_core.arrays import Array
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import choice, param, text
from polar_nav_sim.section import Spec

from ..bags import Bag, BagError, open_bag
from ..bags.columns import read_columns, stamps, time_fields

_IMU = 'sensor_msgs/msg/Imu'
_LEAST = 100
_MOST_JITTER = 0.05
_FIELDS = (
    *time_fields('header.stamp'),
    *(f'{what}.{axis}' for what in ('angular_velocity', 'linear_acceleration') for axis in 'xyz'),
)


@dataclass(frozen=True)
class RecordedImu:
    """Errors of an IMU, sample by sample; a longer run starts again at the first.

    Attributes
    ----------
    rate_hz : float
        Samples per second.
    omega_b, f_b : (m, 3) arrays
        Errors [rad/s], [m/s^2].
    """

    rate_hz: float
    omega_b: Array
    f_b: Array

    @property
    def duration_s(self) -> float:
        """Duration [s]."""
        return len(self.omega_b) / self.rate_hz

    def noise_density(self) -> tuple[float, float]:
        """White noise of gyro and accelerometer, per triad [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].

        From differences of neighbours, which slow errors hardly enter; root mean square over the
        axes.
        """

        def density(x: Array) -> float:
            variance = 0.5 * np.mean(np.diff(x, axis=0) ** 2)
            return float(math.sqrt(variance / self.rate_hz))

        return density(self.omega_b), density(self.f_b)

    def largest_mean(self) -> tuple[float, float]:
        """Largest mean error of an axis, gyro [rad/s] and accelerometer [m/s^2]."""
        return (
            float(np.max(np.abs(self.omega_b.mean(axis=0)))),
            float(np.max(np.abs(self.f_b.mean(axis=0)))),
        )


@dataclass(frozen=True)
class RestSpec(Spec):
    """Options for reading a recording at rest."""

    topic: str = text('', 'Topic of the IMU; empty: the only one of its type')
    mean: str = choice(
        'remove',
        ('remove', 'keep'),
        'remove: the mean is removed, constants are the stated ones; keep: the constants are those'
        ' of the recording',
    )
    earth_rate: str = choice(
        'remove', ('remove', 'keep'), "Of a kept mean: whether the earth's rate is subtracted"
    )
    latitude_deg: float = param(45.0, 'deg', -90.0, 90.0, 'Latitude of the resting IMU')
    heading_deg: float = param(0.0, 'deg', -360.0, 360.0, 'True heading of its x axis')


def read_rest(path: Path, spec: RestSpec) -> RecordedImu:
    """Errors of a resting IMU, read from a bag.

    Raises
    ------
    ConfigError, BagError
        Without such a topic, with too few samples, or with irregular ones.
    """
    bag = open_bag(path)
    topic = spec.topic or _only_imu(bag)
    bag.require([topic], named=True)
    found = bag.channel(topic).type
    if found != _IMU:
        raise BagError(f'{bag.path}: {topic} is a {found}, not a {_IMU}')
    columns = read_columns(bag.payloads(topic), _IMU, bag.definition(topic).text, _FIELDS)
    stamp_ns = stamps(columns, 'header.stamp')
    omega_b = np.stack([columns[f'angular_velocity.{a}'] for a in 'xyz'], axis=1)
    f_b = np.stack([columns[f'linear_acceleration.{a}'] for a in 'xyz'], axis=1)
    where = f'{bag.path}: {topic}'
    rate_hz = _rate(stamp_ns, where)
    if not (np.isfinite(omega_b).all() and np.isfinite(f_b).all()):
        raise BagError(f'{where}: samples that are not finite')
    if spec.mean == 'remove':
        return RecordedImu(rate_hz, omega_b - omega_b.mean(axis=0), f_b - f_b.mean(axis=0))
    return RecordedImu(rate_hz, *_less_the_earth(omega_b, f_b, spec, where))


def _only_imu(bag: Bag) -> str:
    names = [t.name for t in bag.topics.values() if t.type == _IMU and t.count]
    if len(names) != 1:
        have = ', '.join(names) or 'none'
        raise ConfigError(f'--topic: {bag.path} has not one topic of {_IMU} but: {have}')
    return names[0]


def _rate(stamp_ns: np.ndarray, where: str) -> float:
    if len(stamp_ns) < _LEAST:
        raise BagError(f'{where}: {len(stamp_ns)} samples are too few, want {_LEAST}')
    steps = np.diff(stamp_ns) * 1e-9
    step = float(np.median(steps))
    if step <= 0.0 or abs(float(np.mean(steps)) / step - 1.0) > _MOST_JITTER:
        raise BagError(f'{where}: samples do not come evenly (gaps, or stamps out of order)')
    return float(round(1.0 / float(np.mean(steps))))


def _less_the_earth(omega_b: Array, f_b: Array, spec: RestSpec, where: str) -> tuple[Array, Array]:
    """Readings less gravity along the mean specific force, by option less the Earth's rate."""
    mean_f = f_b.mean(axis=0)
    size = float(np.linalg.norm(mean_f))
    if not 9.0 < size < 11.0:
        raise BagError(f'{where}: a mean specific force of {size:.2f} m/s^2 is not that of rest')
    up_b = mean_f / size
    lat = math.radians(spec.latitude_deg)
    r_e = np.asarray(earth.ecef_from_geodetic(lat, 0.0, 0.0), dtype=np.float64)
    f_error = f_b - float(earth.gravity(r_e)) * up_b
    if spec.earth_rate == 'keep':
        return omega_b, f_error
    ahead_b = np.array([1.0, 0.0, 0.0])
    ahead_b = ahead_b - (ahead_b @ up_b) * up_b
    ahead_b /= np.linalg.norm(ahead_b)
    left_b = np.cross(up_b, ahead_b)
    heading = math.radians(spec.heading_deg)
    north_b = math.cos(heading) * ahead_b + math.sin(heading) * left_b
    return omega_b - earth.OMEGA_IE * (math.cos(lat) * north_b + math.sin(lat) * up_b), f_error


def save_recorded(recorded: RecordedImu, path: Path) -> Path:
    """Save errors to a file for worker processes."""
    np.savez(path, rate_hz=recorded.rate_hz, omega_b=recorded.omega_b, f_b=recorded.f_b)
    return path


@lru_cache(maxsize=1)
def load_recorded(path: Path) -> RecordedImu:
    """Errors from a file of `save_recorded`."""
    with np.load(path) as data:
        return RecordedImu(float(data['rate_hz']), data['omega_b'], data['f_b'])
