"""Guesses a mapping from what is in a bag, and says what each guess rests on.

Types say what a topic may be, names which of several it is, and the numbers themselves the axes
and units: gravity shows which way is up and whether forces are in g, its turning whether rates are
in degrees. What the data cannot tell is left to fill in, marked with ``FILL IN``.
"""

from __future__ import annotations

import numpy as np

from polar_nav_core.engine.events import Array
from polar_nav_core.errors import PolarNavError

from ..bags.reader import Topic
from . import rotations
from .adapters.layouts import DEPTH, IMU, PACKET, POSITION, USBL, VELOCITY
from .adapters.position import read_positions
from .adapters.sensors import read_imu
from .arrays import finite_rows
from .candidates import (
    LEADER_WORDS,
    RAW_WORDS,
    STATE_WORDS,
    TRUTH_WORDS,
    best,
    best_position,
    depth_of,
    dvl_of,
    fixes_of,
    near,
    vehicle,
    words,
)
from .check_imu import turning_factor
from .lines import Lines
from .mapping import ACCEL_UNITS, Frame, ImuMapping, PositionMapping, Stream
from .sources import Source, Stamps, field_paths, read_table

_GRAVITY = 9.81
_DOWNWARD_DVL = ('marine_acoustic_msgs/msg/Dvl',)


def guess(source: Source) -> str:
    """Return a mapping of a bag as YAML with comments."""
    out = Lines()
    out.say(
        f'A mapping for `polar replay {source.path} --map THIS_FILE`, guessed from {source.kind}.'
    )
    out.say('Every comment says what a guess rests on; what could not be found is marked FILL IN.')
    out.put()
    topics = [t for t in source.topics.values() if t.count]
    imu = best([t for t in topics if t.type in IMU], RAW_WORDS)
    out.put(f'vehicle: {vehicle(imu)}')
    out.put()
    _imu(out, source, imu)
    mine = [t for t in topics if imu is None or near(t, imu)]
    _sensor(out, source, 'dvl', dvl_of(mine), topics)
    _sensor(out, source, 'depth', depth_of(mine), topics)
    truth = best_position(mine, TRUTH_WORDS, require=True)
    fixes = fixes_of(mine, truth, topics)
    _fixes(out, source, fixes, topics)
    start = truth or best_position([t for t in mine if t not in fixes], STATE_WORDS)
    if start is None:
        start = next((t for t in fixes if t.type in POSITION), None)
    _initial(out, source, start)
    if start is not None and start in fixes:
        out.say('The start is where the first fix was; that fix is not used a second time.')
        out.put()
    if start is not None and start is truth:
        out.say(
            'The start is taken from the reference: fine for a trial, not for a test of the start.'
        )
        out.put()
    if truth is None:
        out.say('truth: no topic names itself a reference; with one, estimates are scored.')
        out.say('truth: {topic: /FILL/IN}')
    else:
        out.say(f'{truth.type}: by its name')
        out.put('truth:')
        _position(out, source, truth, 2)
    out.put()
    _parameters(out)
    unused = [t for t in topics if t.type in POSITION and t not in (*fixes, truth, start)]
    if unused:
        out.put()
        out.say('Topics with positions that are not used above:')
        for topic in unused:
            out.say(f'  {topic.name} ({topic.type}, {topic.count})')
    return '\n'.join(out.lines) + '\n'


def _imu(out: Lines, source: Source, imu: Topic | None) -> None:
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
        return
    out.say(f'{imu.type}, {imu.count} messages')
    out.put('imu:')
    out.put(f'topic: {imu.name}', 2)
    try:
        plain = read_imu(source, ImuMapping(Stream(imu.name), np.eye(3), 1.0, 1.0))
    except PolarNavError as error:
        out.say(f'not read: {error}', 2)
        out.put()
        return
    good = finite_rows(plain.f_b) & finite_rows(plain.omega_ib_b)
    f, omega, stamps = plain.f_b[good], plain.omega_ib_b[good], plain.stamps_ns[good]
    if len(f) > 1:
        _accel_unit(out, f)
        _axes(out, f)
        _gyro_unit(out, stamps, omega, f)
    out.say('where it sits from base_link, x forward, y left, z up [m]: FILL IN; zeros where', 2)
    out.say('base_link is the IMU', 2)
    out.put('lever_b: [0.0, 0.0, 0.0]', 2)
    out.say('whether samples are means over the interval before the stamp, or instant: not in', 2)
    out.say('the data; `mean` is what IMUs with increments give', 2)
    out.put('sample: mean', 2)
    out.put()


def _unknown(out: Lines, source: Source) -> None:
    """Show the fields of the most frequent topic of a type without an adapter."""
    known = {*IMU, *VELOCITY, *DEPTH, *POSITION}
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


def _axes(out: Lines, f: Array) -> None:
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
    share = abs(float(unit[axis]))
    out.say(
        f'gravity shows that up is {sign}{up} ({share:.2f} of it); where forward is, the data', 2
    )
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


def _sensor(
    out: Lines, source: Source, role: str, topic: Topic | None, topics: list[Topic]
) -> None:
    if topic is None:
        out.say(f'{role}: none of {len(topics)} topics looks like one. FILL IN, or leave it out.')
        out.say(f'{role}: {{topic: /FILL/IN}}')
        out.put()
        return
    out.say(f'{topic.type}, {topic.count} messages')
    out.put(f'{role}:')
    out.put(f'topic: {topic.name}', 2)
    if role == 'dvl':
        name, why = _dvl_axes(source, topic)
        out.say(f'axes of the instrument: {why}', 2)
        out.say('turned by any angle: {rpy_deg: [180, 0, 45]}; `replay` tells if others fit', 2)
        out.put(f'rotation: {name}', 2)
        out.say('where it sits from base_link, x forward, y left, z up [m]: FILL IN', 2)
        out.put('lever_b: [0.0, 0.0, 0.0]', 2)
        out.say('sigma: 0.01   # [m/s], in place of what the messages state', 2)
    else:
        if topic.type == 'sensor_msgs/msg/FluidPressure':
            out.say('absolute pressure in Pa, as the type says', 2)
            out.put('unit: Pa', 2)
        out.say('where it sits from base_link, x forward, y left, z up [m]: FILL IN', 2)
        out.put('lever_b: [0.0, 0.0, 0.0]', 2)
        out.say('sigma: 0.1    # [m], in place of what the messages state', 2)
    out.put()


def _dvl_axes(source: Source, topic: Topic) -> tuple[str, str]:
    """Name of the axes, and what says so."""
    if topic.type in _DOWNWARD_DVL:
        return 'frd', 'z of this type points where the DVL looks, down'
    if 'header.frame_id' in field_paths(source, topic.name):
        frame = str(
            read_table(source, topic.name, ['header.frame_id']).columns['header.frame_id'][0]
        )
        for name in ('frd', 'flu'):
            if name in frame.lower().replace('/', '_').split('_'):
                return name, f'the messages name frame {frame}'
    return 'flu', 'not in the data: FILL IN, frd where z points down'


def _fixes(out: Lines, source: Source, fixes: list[Topic], topics: list[Topic]) -> None:
    if not fixes:
        out.say('No topic looks like position fixes. FILL IN, or leave it out: the run drifts.')
        out.say('fixes: [{topic: /FILL/IN, delay_s: 5.0}]')
        out.put()
        return
    out.put('fixes:')
    for topic in fixes:
        out.say(f'{topic.type}, {topic.count} messages', 2)
        out.put(f'- topic: {topic.name}', 2)
        if topic.type == PACKET:
            out.say('numbers of the vehicles in the packets', 4)
            out.put('leader_id: 1', 4)
            out.put('own_id: 2', 4)
            continue
        if topic.type == USBL:
            leader = best_position([t for t in topics if words(t, LEADER_WORDS)], STATE_WORDS)
            name = '/FILL/IN' if leader is None else leader.name
            out.say('position and attitude of the vehicle with the array', 4)
            out.put(f'leader: {{topic: {name}}}', 4)
        else:
            _frame(out, source, topic, 4)
        _delay(out, source, topic)
        out.say("sigma: [5.0, 5.0]   # horizontal, vertical [m], in place of the messages'", 4)
    out.put()


def _delay(out: Lines, source: Source, topic: Topic) -> None:
    try:
        table = read_table(source, topic.name, ('header.stamp.sec', 'header.stamp.nanosec'))
    except PolarNavError as error:
        out.say(f'not read: {error}', 4)
        return
    stamps = table.columns['header.stamp.sec'].astype(np.int64) * 10**9
    lag = (table.log_ns - stamps - table.columns['header.stamp.nanosec'].astype(np.int64)) * 1e-9
    median = float(np.median(lag))
    if abs(median) < 0.05:
        out.say(f'recorded {median:.3g} s after their stamps: either the stamps are those of', 4)
        out.say('arrival (then FILL IN time_offset_s: -DELAY), or there is no delay', 4)
        return
    out.say(
        f'recorded {median:.3g} s after their stamps ({lag.min():.3g} to {lag.max():.3g} s):', 4
    )
    out.say('taken as the delay; `delay_s` states one instead', 4)


def _frame(out: Lines, source: Source, topic: Topic, indent: int) -> None:
    if 'latitude' in field_paths(source, topic.name):
        return
    try:
        read_positions(source, PositionMapping(Stream(topic.name), Frame(None), np.eye(3)))
    except PolarNavError as error:
        why = str(error)
    else:
        return
    try:
        rows = read_positions(
            source, PositionMapping(Stream(topic.name), Frame('earth'), np.eye(3))
        )
    except PolarNavError as error:
        out.say(f'not read: {error}', indent)
        return
    if (rows.given & rows.plausible).any():
        out.say(
            'distances from zero are those of the surface from the centre of the earth', indent
        )
        out.put('frame: earth', indent)
        return
    out.say(f'FILL IN {why.partition("frame is missing: ")[2]}', indent)
    out.put('frame: FILL_IN', indent)
    out.say('for enu and ned:', indent)
    out.say('origin: {latitude_deg: .., longitude_deg: .., height: ..}', indent)


def _position(out: Lines, source: Source, topic: Topic, indent: int) -> None:
    out.put(f'topic: {topic.name}', indent)
    _frame(out, source, topic, indent)


def _initial(out: Lines, source: Source, start: Topic | None) -> None:
    if start is None:
        out.say('No topic tells where the vehicle is at the start. FILL IN:')
        out.put('initial: {from: values, heading_deg: FILL_IN}')
        out.say('and initial_latitude_deg, initial_longitude_deg, initial_height among parameters')
        out.put()
        return
    out.say(f'{start.type}, {start.count} messages')
    out.put('initial:')
    out.put('from: topic', 2)
    _position(out, source, start, 2)
    paths = field_paths(source, start.name)
    if not any('orientation' in p or 'c_b_g' in p for p in paths):
        out.say('no attitude in it: FILL IN the true heading at the start [deg]', 2)
        out.put('heading_deg: FILL_IN', 2)
    out.put()


def _parameters(out: Lines) -> None:
    out.say('Noise of the IMU from its data sheet: FILL IN; docs/parameters.md has all names.')
    out.say('These are of a tactical IMU: 1 deg/h, 0.1 deg/sqrt(h), 1 mg, 0.05 m/s/sqrt(h).')
    out.put('parameters:')
    out.put('configuration: default', 2)
    out.put('gyro_bias_sigma: 4.8e-6       # rad/s', 2)
    out.put('gyro_noise_density: 2.9e-5    # rad/s/sqrt(Hz)', 2)
    out.put('accel_bias_sigma: 0.01        # m/s^2', 2)
    out.put('accel_noise_density: 8.3e-4   # m/s^2/sqrt(Hz)', 2)
