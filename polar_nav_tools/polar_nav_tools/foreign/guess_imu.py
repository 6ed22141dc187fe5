"""The IMU of a guessed mapping: units and axes by gravity, and by its turning."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.errors import PolarNavError
from polar_nav_ros.adapters import rotations
from polar_nav_ros.adapters.arrays import finite_rows
from polar_nav_ros.adapters.layouts import DEPTH, IMU, POSITION, VELOCITY
from polar_nav_ros.adapters.mapping import ACCEL_UNITS, ImuMapping, Stream

from ..bags.reader import Topic
from .check_imu import turning_factor
from .check_stamps import seconds_text
from .guess_noise import Choices
from .guess_stamps import TopicTimes, is_alone, put_stamp, times_of
from .lines import Lines
from .mounting import Mount, put_lever
from .read import read_imu
from .sources import Source, Stamps, field_paths, not_described

_GRAVITY = 9.81
_LEVEL = 0.9
"""Share of the specific force along base_link's vertical, of axes that are right (25 degrees)."""


def put_imu(
    out: Lines,
    source: Source,
    imu: Topic | None,
    choices: Choices,
    mount: Mount | None = None,
    others: Sequence[Topic] = (),
) -> TopicTimes | None:
    """Write the IMU; its times, where there are any.

    Parameters
    ----------
    out : Lines
    source : Source
    imu : Topic or None
    choices : Choices
    mount : Mount, optional
        Of the IMU.
    others : sequence of Topic
        Other sensors of the vehicle, whose stamps show what the clock of the vehicle is.
    """
    if imu is None:
        out.say(
            'No topic is a sensor_msgs/msg/Imu. FILL IN the topic and where the numbers stand.'
        )
        _unknown(out, source)
        out.put('imu:')
        out.put('topic: /FILL/IN', 2)
        out.put('fields: {rate: [FILL, IN, xyz], force: [FILL, IN, xyz]}', 2)
        out.put('rotation: flu', 2)
        out.put()
        return None
    out.say(f'{imu.type}, {imu.count} messages')
    out.put('imu:')
    out.put(f'topic: {imu.name}', 2)
    out.put(f'type: {imu.type}', 2)
    try:
        times = times_of(source, imu.name)
        plain = read_imu(source, ImuMapping(Stream(imu.name), np.eye(3), 1.0, 1.0))
    except PolarNavError as error:
        out.say(f'not read: {error}', 2)
        out.put()
        return None
    logged = put_stamp(out, times, None, choices.clock)
    if logged:
        times = TopicTimes(imu.name, None, plain.log_ns, 'stamp: log')
    elif choices.clock is None and is_alone(times, _times_of_others(source, others)):
        behind = seconds_text(times.behind_log_ns)
        out.say(f'stamps are {behind} s behind the recording, and those of the other sensors', 2)
        out.say(
            'are not: the clock of this sensor, fitted to that of the others (docs/live.md)', 2
        )
        out.put('clock: sensor', 2)
        times = TopicTimes(imu.name, None, plain.log_ns, 'clock: sensor')
    good = finite_rows(plain.f_b) & finite_rows(plain.omega_ib_b)
    f, omega = plain.f_b[good], plain.omega_ib_b[good]
    stamps = (plain.log_ns if logged else plain.stamps_ns)[good]
    if not f.any() or not omega.any():
        what = 'specific force' if omega.any() else 'rate' if f.any() else 'whole message'
        out.say(f'FILL IN: the {what} is zero in all {len(f)} messages, this IMU measured', 2)
        out.say('nothing; name another topic, or the axes if they are known', 2)
        out.put('rotation: FILL_IN', 2)
    elif len(f) > 1 and _without_gravity(f):
        size = float(np.median(np.linalg.norm(f, axis=1)))
        out.say(
            f'FILL IN: the median of the specific force is {size:.3g}: gravity was taken out', 2
        )
        out.say('of it, and nobody can navigate by that. Drivers with such a topic mostly have', 2)
        out.say('another one of raw data: name that', 2)
        out.put('rotation: FILL_IN', 2)
        _gyro_unit(out, stamps, omega, f)
    elif len(f) > 1:
        _accel_unit(out, f)
        _axes(out, f, mount)
        _gyro_unit(out, stamps, omega, f)
    put_lever(out, mount, '; zeros where base_link is the IMU')
    out.say('whether samples are means over the interval before the stamp, or instant: not in', 2)
    out.say('the data; `mean` is what IMUs with increments give', 2)
    out.put('sample: mean', 2)
    out.put()
    return times


def _times_of_others(source: Source, topics: Sequence[Topic]) -> list[TopicTimes]:
    found = []
    for topic in topics:
        with suppress(PolarNavError):  # what cannot be read is named where it is mapped
            found.append(times_of(source, topic.name))
    return found


def _without_gravity(f: Array) -> bool:
    """Whether forces are too small for gravity in any unit, and point nowhere in particular."""
    size = np.linalg.norm(f, axis=1)
    steady = float(np.linalg.norm(np.median(f, axis=0)))
    return float(np.median(size)) < 0.5 or steady < 0.5 * float(np.median(size))


def _unknown(out: Lines, source: Source) -> None:
    """Show the fields of the most frequent topic of a type without an adapter."""
    known = {*IMU, *VELOCITY, *DEPTH, *POSITION}
    known |= set(not_described(source))
    others = [t for t in source.topics.values() if t.count and t.type not in known]
    if not others:
        return
    topic = max(others, key=lambda t: t.count)
    out.say(f'{topic.name} ({topic.type}, {topic.count} messages) has the fields')
    for path in field_paths(source, topic.name)[:24]:
        out.say(f'  {path}')


def _accel_unit(out: Lines, f: Array) -> None:
    size = float(np.median(np.linalg.norm(f, axis=1)))
    fits = [u for u, s in ACCEL_UNITS.items() if abs(size * s / _GRAVITY - 1.0) < 0.1]
    if fits:
        out.say(f'the median of the specific force is {size:.4g}', 2)
        out.put(f'accel_unit: {fits[0]}', 2)
    else:
        out.say(f'FILL IN: the median of the specific force is {size:.4g}, gravity in no unit', 2)
        out.put('accel_unit: m/s^2', 2)


def axes_of(f: Array) -> tuple[str, str, float]:
    """Return a name of axes by gravity, which of them points up, and its share of the force.

    Parameters
    ----------
    f : (n, 3) array
        Specific force, axes of the sensor, any unit.
    """
    mean = np.median(f, axis=0)
    unit = mean / max(float(np.linalg.norm(mean)), 1e-12)
    axis = int(np.argmax(np.abs(unit)))
    up = 'xyz'[axis]
    sign = '+' if unit[axis] > 0.0 else '-'
    names = {('z', '+'): 'flu', ('z', '-'): 'frd'}
    name = names.get((up, sign))
    if name is None:
        wanted = 'u' if sign == '+' else 'd'
        name = next(n for n in rotations.all_named() if n[axis] == wanted)
    return name, f'{sign}{up}', abs(float(unit[axis]))


def rotation_by(mount: Mount | None, f: Array) -> str | None:
    """Axes of an IMU by the transforms, for a mapping; None where gravity contradicts them.

    Parameters
    ----------
    mount : Mount or None
    f : (n, 3) array
        Specific force, axes of the sensor, any unit.
    """
    if mount is None:
        return None
    mean = np.median(f, axis=0)
    up_b = mount.C_s_b @ mean / max(float(np.linalg.norm(mean)), 1e-12)
    return mount.rotation_text if up_b[2] > _LEVEL else None


def _axes(out: Lines, f: Array, mount: Mount | None) -> None:
    name, up, share = axes_of(f)
    stated = rotation_by(mount, f)
    if mount is not None and stated is not None:
        out.say(f'{mount.source_text}; gravity agrees, up is {up} ({share:.2f} of it)', 2)
        out.put(f'rotation: {stated}', 2)
        return
    if mount is not None:
        out.say(f'{mount.source_text} it would be {mount.rotation_text}, which gravity', 2)
        out.say('contradicts:', 2)
    out.say(f'gravity shows that up is {up} ({share:.2f} of it); where forward is, the data', 2)
    out.say('of gravity cannot tell: FILL IN another name if x does not point forward', 2)
    out.put(f'rotation: {name}', 2)


def _gyro_unit(out: Lines, stamps: Stamps, omega: Array, f: Array) -> None:
    factor, correlation, turn = turning_factor(stamps, omega, f)
    if np.isfinite(factor) and abs(correlation) > 0.6 and turn > 2e-3:
        degrees = 1 / 100 < abs(factor) < 1 / 30
        said = f'gravity turns {1 / factor:.3g} times as much by the gyros (correlation '
        out.say(f'{said}{correlation:.2f})', 2)
        out.put(f'gyro_unit: {"deg/s" if degrees else "rad/s"}', 2)
        return
    top = float(np.quantile(np.linalg.norm(omega, axis=1), 0.99))
    out.say(f'too little turning to tell; 99 % of the rates are below {top:.3g}', 2)
    out.put(f'gyro_unit: {"deg/s" if top > 3.5 else "rad/s"}', 2)
