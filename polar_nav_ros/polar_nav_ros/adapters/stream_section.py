"""Keys that sections of a mapping file share: topic, type and stamps; the frame of positions."""

from __future__ import annotations

from .mapping import CLOCKS, POSITION_FRAMES, STAMPS, Frame, PositionMapping, Stream
from .section import Section


def stream_of(s: Section) -> Stream:
    """Topic of a section, with its type, stamps and fields; errors as `mapping_file.load`."""
    offset_s = s.number('time_offset_s', 0.0, -1e9, 1e9, 's')
    stamp = s.choice('stamp', STAMPS, 'header')
    clock = s.choice('clock', CLOCKS, 'log' if stamp == 'log' else 'host')
    if stamp == 'log' and clock != 'log':
        raise s.fail('clock', f'{clock} does not go with `stamp: log`, which leaves stamps unread')
    return Stream(
        topic=s.text('topic'),
        stamp='log' if clock == 'log' else stamp,
        offset_ns=round(offset_s * 1e9),
        fields=s.texts('fields'),
        type=_type(s),
        clock=clock,
    )


def _type(s: Section) -> str:
    """Message type, as ``sensor_msgs/msg/Imu`` or ``sensor_msgs/Imu``."""
    name = s.text('type', '') if 'type' in s else ''
    s.raw('type')
    parts = name.split('/')
    if name and not (
        len(parts) in (2, 3) and all(parts) and (len(parts) == 2 or parts[1] == 'msg')
    ):
        raise s.fail('type', f'{name!r} is no message type, as in sensor_msgs/msg/Imu')
    return f'{parts[0]}/msg/{parts[-1]}' if name else ''


def position_of(s: Section, *, finished: bool = True) -> PositionMapping:
    """Position of a section: stream, frame, mounting; all keys of it are read where finished."""
    mapping = PositionMapping(stream_of(s), frame_of(s), s.rotation())
    if finished:
        s.done()
    return mapping


def frame_of(s: Section) -> Frame:
    """Frame of positions that a section states, with ``origin`` or ``epsg`` where it needs one."""
    kind = None
    if 'frame' in s:
        kind = s.choice('frame', POSITION_FRAMES)
    s.raw('frame')
    origin = s.section('origin')
    code = s.optional('epsg', 1024, 999999, '')
    place = None
    if origin is not None:
        place = (
            origin.number('latitude_deg', None, -90.0, 90.0, 'deg'),
            origin.number('longitude_deg', None, -360.0, 360.0, 'deg'),
            origin.number('height', 0.0, -12000.0, 10000.0, 'm'),
        )
        origin.done()
    if kind in ('enu', 'ned') and place is None:
        raise s.fail('origin', f'frame {kind} needs latitude_deg, longitude_deg and height')
    if kind == 'epsg' and code is None:
        raise s.fail('epsg', 'frame epsg needs the code of the projection, as in epsg: 3413')
    return Frame(kind, place, None if code is None else int(code))
