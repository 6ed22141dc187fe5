"""Guesses a mapping from what is in a bag, and says what each guess rests on.

Types say what a topic may be, names which of several it is, and the numbers themselves the axes
and units: gravity shows which way is up and whether forces are in g, its turning whether rates are
in degrees. What the data cannot tell is left to fill in, marked with ``FILL IN``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from polar_nav_core.errors import ConfigError, PolarNavError
from polar_nav_ros.adapters.layouts import IMU, POSITION, VELOCITY
from polar_nav_ros.adapters.mapping import VERSION, Frame, PositionMapping, Stream

from ..bags.reader import Topic
from .candidates import (
    RAW_WORDS,
    STATE_WORDS,
    TRUTH_WORDS,
    best,
    best_position,
    depth_of,
    dvl_of,
    fixes_of,
    near,
    of_vehicle,
    outputs_of,
    twins,
    vehicle,
)
from .definitions import undecodable
from .fixes import packets_in
from .guess_depth import put_depth_unit
from .guess_dvl import put_ping_sigma
from .guess_fixes import put_fixes, put_frame
from .guess_heading import attitude_of, put_heading
from .guess_imu import put_imu
from .guess_noise import Choices, put_noise
from .guess_stamps import TopicTimes, put_stamp, times_of
from .lines import Lines
from .mounting import Mount, Mounts, mounts_of, put_lever
from .read import read_positions
from .sources import Source, field_paths, not_described, read_table

_DOWNWARD_DVL = ('marine_acoustic_msgs/msg/Dvl',)
_WATER_LINKED = ('dvl_msgs/msg/DVL',)


def guess(
    source: Source, choices: Choices | None = None, heard: Sequence[str] | None = None
) -> str:
    """Return a mapping of a bag as YAML with comments.

    Parameters
    ----------
    source : Source
    choices : Choices, optional
        What a person knows of the recording; what nobody said is marked FILL IN.
    heard : sequence of str, optional
        Of a running graph: sentences on its topics.
    """
    out = Lines()
    choices = choices or Choices()
    use = f'polar replay {source.path} --map THIS_FILE'
    kind = f'{source.kind}'
    if heard is not None:
        use, kind = 'follower_node ... -p sources:=THIS_FILE', 'a running graph'
    out.say(f'A mapping for `{use}`, guessed from {kind}.')
    out.say('Every comment says what a guess rests on; what could not be found is marked FILL IN.')
    missing = undecodable(not_described(source))
    if missing is not None:
        out.say(missing)
    for note in heard or ():
        out.say(note)
    out.put()
    out.put(f'version: {VERSION}')
    topics = [t for t in source.topics.values() if t.count]
    imu = best(_imus(topics, choices.vehicle), RAW_WORDS)
    out.put(f'vehicle: {vehicle(imu)}')
    others = twins(imu, topics)
    for name in others:
        out.say(f'{name} is another vehicle by its IMU; `polar map --vehicle {name}` maps it')
    out.put()
    mounts = mounts_of(source)
    outputs = outputs_of(topics)
    theirs = [t for name in others for t in of_vehicle(topics, name)]
    mine = [t for t in topics if (imu is None or near(t, imu)) and t.name not in outputs]
    mine = [t for t in mine if t not in theirs]
    dvl, depth = dvl_of(mine), depth_of(mine)
    local = [t for t in (dvl, depth) if t is not None]
    times = put_imu(out, source, imu, choices, mounts.of_topic(source, imu), local)
    for role, topic in (('dvl', dvl), ('depth', depth)):
        mount = mounts.of_topic(source, topic)
        _sensor(out, source, role, topic, topics, times, choices, mount)
    mine = _with_positions(out, source, mine)
    truth = best_position(mine, TRUTH_WORDS, require=True)
    packets = packets_in(source, mine)
    fixes = fixes_of(mine, truth, topics, list(packets))
    put_fixes(out, source, fixes, topics, times, choices, packets, mounts, deep=depth is not None)
    start = truth or _start_of(source, mine, fixes)
    _start(out, source, start, fixes, imu, mounts, '' if times is None else times.stated)
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
    put_noise(out, choices, has_dvl=dvl is not None)
    out.put('parameters:')
    out.put('configuration: default', 2)
    used = (*fixes, truth, start, dvl, depth)
    rest = [t for t in topics if t not in (*used, *theirs) and t.name not in outputs]
    _unused(out, 'positions', [t for t in rest if t.type in POSITION])
    _unused(out, 'velocities', [t for t in rest if t.type in VELOCITY and t.type not in POSITION])
    if outputs:
        out.put()
        out.say('Estimates of a navigation that ran are no measurements, and are left out.')
    return '\n'.join(out.lines) + '\n'


def _imus(topics: list[Topic], name: str | None) -> list[Topic]:
    """Return the topics of IMUs, of a vehicle where one is named.

    Raises
    ------
    ConfigError
        Where that vehicle has none.
    """
    found = [t for t in topics if t.type in IMU]
    if name is None:
        return found
    own = of_vehicle(found, name)
    if not own:
        names = ', '.join(sorted(t.name for t in found)) or 'none'
        raise ConfigError(f'--vehicle: {name} has no IMU in its namespace; IMUs are {names}')
    return own


def _unused(out: Lines, what: str, topics: list[Topic]) -> None:
    """List topics that could have a role and were given none."""
    if topics:
        out.put()
        out.say(f'Topics with {what} that are not used above:')
        for topic in topics:
            out.say(f'  {topic.name} ({topic.type}, {topic.count})')


def _start_of(source: Source, mine: list[Topic], fixes: list[Topic]) -> Topic | None:
    """Return the topic that the start is from, where no reference is recorded.

    A state whose frame its messages do not tell is passed over where there are fixes: nobody
    else knows where the origin of an odometry is.
    """
    own = next((t for t in fixes if t.type in POSITION), None)
    state = best_position([t for t in mine if t not in fixes], STATE_WORDS)
    if state is None or (own is not None and not _placed(source, state)):
        return own
    return state


def _placed(source: Source, topic: Topic) -> bool:
    """Whether messages tell where on the earth their positions are."""
    try:
        read_positions(source, PositionMapping(Stream(topic.name), Frame(None), np.eye(3)))
    except PolarNavError:
        return False
    return True


def _with_positions(out: Lines, source: Source, topics: list[Topic]) -> list[Topic]:
    """Leave out topics of NavSatFix, or another with latitudes, that never hold a position."""
    kept = []
    for topic in topics:
        if topic.type in POSITION and 'latitude' in field_paths(source, topic.name):
            mapping = PositionMapping(Stream(topic.name), Frame(None), np.eye(3))
            given = read_positions(source, mapping, 0.0).given  # its height may be NaN
            if not given.any():
                out.say(f'{topic.name}: {len(given)} of {len(given)} messages hold no position')
                out.say('(NaN, or a status of no fix): left out')
                out.put()
                continue
        kept.append(topic)
    return kept


def _sensor(
    out: Lines,
    source: Source,
    role: str,
    topic: Topic | None,
    topics: list[Topic],
    reference: TopicTimes | None,
    choices: Choices,
    mount: Mount | None,
) -> None:
    if topic is None:
        out.say(f'{role}: none of {len(topics)} topics looks like one. FILL IN, or leave it out.')
        out.say(f'{role}: {{topic: /FILL/IN}}')
        out.put()
        return
    out.say(f'{topic.type}, {topic.count} messages')
    out.put(f'{role}:')
    out.put(f'topic: {topic.name}', 2)
    out.put(f'type: {topic.type}', 2)
    try:
        put_stamp(out, times_of(source, topic.name), reference, choices.clock)
    except PolarNavError as error:
        out.say(f'not read: {error}', 2)
    if role == 'dvl':
        _reference(out, source, topic, choices)
        name, why = _dvl_axes(source, topic, mount)
        out.say(f'axes of the instrument: {why}', 2)
        out.say('turned by any angle: {rpy_deg: [180, 0, 45]}; `replay` tells if others fit', 2)
        out.put(f'rotation: {name}', 2)
        put_lever(out, mount)
        put_ping_sigma(out, source, topic, choices)
    else:
        put_depth_unit(out, source, topic)
        put_lever(out, mount)
        out.say('sigma: 0.1    # [m], in place of what the messages state', 2)
    out.put()


def _reference(out: Lines, source: Source, topic: Topic, choices: Choices) -> None:
    """Write whether velocities are over ground or through the water."""
    if choices.reference is not None:
        out.put(f'reference: {choices.reference}', 2)
    elif 'velocity_mode' in field_paths(source, topic.name):
        out.say('each message states whether it is over ground; the others are not used', 2)
        out.put('reference: bottom', 2)
    else:
        out.say(f'FILL IN bottom or water: {topic.type} does not state what', 2)
        out.say('the velocity is relative to; one of the water has the current in it', 2)
        out.put('reference: FILL_IN', 2)


def _dvl_axes(source: Source, topic: Topic, mount: Mount | None) -> tuple[str, str]:
    """Axes as a mapping states them, and what says so."""
    looks_down = topic.type in (*_DOWNWARD_DVL, *_WATER_LINKED)
    if mount is not None and (mount.C_s_b[2, 2] < 0.0 or not looks_down):
        return mount.rotation_text, mount.source_text
    if mount is not None:
        # A description of a vehicle often has no turn of an instrument that it draws as a box.
        return 'frd', f"{mount.source_text} z would be up; this type's is down. FILL IN"
    if topic.type in _DOWNWARD_DVL:
        return 'frd', 'z of this type points where the DVL looks, down'
    if topic.type in _WATER_LINKED:
        return 'frd', "the A50's own, its arrow forward; FILL IN if the driver turns them"
    if 'header.frame_id' in field_paths(source, topic.name):
        frame = str(
            read_table(source, topic.name, ['header.frame_id']).columns['header.frame_id'][0]
        )
        for name in ('frd', 'flu'):
            if name in frame.lower().replace('/', '_').split('_'):
                return name, f'the messages name frame {frame}'
    return 'flu', 'not in the data: FILL IN, frd where z points down'


def _position(out: Lines, source: Source, topic: Topic, indent: int) -> None:
    out.put(f'topic: {topic.name}', indent)
    put_frame(out, source, topic, indent)


def _start(
    out: Lines,
    source: Source,
    start: Topic | None,
    fixes: list[Topic],
    imu: Topic | None,
    mounts: Mounts,
    times: str,
) -> None:
    """Write the AHRS, and what the start is from: it and the fixes, else section ``initial``."""
    attitude = None
    if all(t.type in POSITION for t in fixes):  # a leader's packets exclude headings
        attitude = attitude_of(source, imu, mounts.of_topic(source, imu))
    if imu is not None and attitude is not None:
        put_heading(out, imu, attitude, times)
        if [start] == fixes and not _has_attitude(source, start):
            out.say('No section initial: the start is aligned, its place by the fixes, its')
            out.say('heading by the one above, its tilt by gravity (docs/start.md). Stated')
            out.say('instead: `initial: {from: values, heading_deg: ..}` with')
            out.say('initial_latitude_deg, initial_longitude_deg and initial_height among')
            out.say('parameters.')
            out.put()
            return
    if start in fixes and not _has_height(source, start):
        out.say('The fixes hold no height: the start is aligned, its place by them, its height')
        out.say('by the depth, its tilt by gravity (docs/start.md).')
        out.say('FILL IN the true heading at the start [deg]')
        out.put('initial: {from: values, heading_deg: FILL_IN}')
        out.put()
        return
    _initial(out, source, start)
    if start in fixes:
        out.say('The start is where the first fix was; that fix is not used a second time.')
        out.put()


def _has_height(source: Source, topic: Topic | None) -> bool:
    """Whether a topic of latitudes has heights, too; one of other positions has."""
    if topic is None or 'latitude' not in field_paths(source, topic.name):
        return True
    mapping = PositionMapping(Stream(topic.name), Frame(None), np.eye(3))
    return bool(read_positions(source, mapping).given.any())


def _has_attitude(source: Source, topic: Topic | None) -> bool:
    """Whether messages of a topic hold an orientation: not one that never changes."""
    if topic is None or topic.type not in POSITION:
        return False
    layout = POSITION[topic.type]
    paths = layout.get('attitude') or layout.get('attitude_grid_xyzw')
    if paths is None:
        return 'attitude_grid' in layout
    columns = read_table(source, topic.name, list(paths)).columns
    return any(np.ptp(columns[path]) > 0.0 for path in paths)


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
    if not _has_attitude(source, start):
        out.say('no attitude in it: FILL IN the true heading at the start [deg]', 2)
        out.put('heading_deg: FILL_IN', 2)
    out.put()
