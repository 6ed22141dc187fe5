"""Sources of a vehicle by a mapping file: each message to the engine's event, live and in replay.

The rules are those that read whole recordings (`sensors`, `position`, `fixes`), on rows of one
message. Messages need their fields as attributes only: a node gives ROS messages, a replay what
the definitions in its bag make of the recorded bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.engine.events import (
    Command,
    DepthSample,
    DvlPing,
    Event,
    Fix,
    HeadingSample,
    ImuSample,
)
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError

from ..topics import DEPTH, DVL, HEADING, IMU, RX
from . import mapping as m
from .fixes import fixes_of, level_height, reception_ns
from .headings import headings_of
from .layouts import USBL
from .messages import Fields, get, stamp_ns_of
from .packets import PacketRow, carries_packets, packet_of, require_room
from .position import positions_of
from .rows import Places, Rows, places_of
from .sensor_clock import SensorClock
from .sensors import IN_THE_AIR, depths_of, imu_of, pings_of

CONSTANTS = ('DVL_MODE_BOTTOM', 'DVL_MODE_WATER', 'DVL_TYPE_PHASED_ARRAY')
"""Constants of message types that adapters ask for."""
_SOURCE_BITS = 32
"""Messages of one source are numbered below this; fixes of several differ by it."""

Read = Callable[[Rows], Event | None]


class Taken(NamedTuple):
    """Message that a source took.

    Attributes
    ----------
    message : object
    arrival_ns : int
        When it came, by the node's clock [ns].
    stamp_ns : int
        Time of validity with which it counts [ns].
    """

    message: Any
    arrival_ns: int
    stamp_ns: int


class Source:
    """One topic of a mapping file.

    Parameters
    ----------
    index : int
        Its number among the fixes of the file, or among the sensors of its role.
    topic : str
        Topic of the session that it stands for; of a fix its own.
    stream : Stream
    role : str
        Role of the adapter, ``packet`` for an acoustic packet.
    read : callable or None
        Converts rows of one message to an event; None for a packet.
    fix : FixMapping, optional
        Of packets.
    """

    def __init__(
        self,
        index: int,
        topic: str,
        stream: m.Stream,
        role: str,
        read: Read | None,
        fix: m.FixMapping | None = None,
    ) -> None:
        self.index = index
        self.alike = 1
        """Sensors of its role."""
        self.topic = topic
        self.stream = stream
        self.role = role
        self.unreadable = 0
        """Messages whose numbers are not as their type says."""
        self.read = 0
        """Messages that could be read."""
        self.empty = 0
        """Those of them that hold nothing: NaN, a status of no fix, no lock of a DVL."""
        self.unsure = 0
        """Those of them without a variance above zero: the engine refuses them."""
        self.aloft = 0
        """Depths that are above the surface by more than any weather makes."""
        self.clock = SensorClock() if stream.clock == 'sensor' else None
        self._read = read
        self._fix = fix
        self._places: Places | None = None
        self._constants: Mapping[str, Any] = {}

    def bind(self, sample: object, constants: Mapping[str, Any], place: str = 'sources') -> None:
        """Find the fields in a message of the topic; ``place`` begins sentences.

        Raises
        ------
        ConfigError
            When its type has no adapter for the role, or lacks a field that the mapping names.
        """
        self._constants = constants
        kind = self.stream.type
        self._places = places_of(self.stream, self.role, kind, Fields(sample), place)

    @property
    def bound(self) -> bool:
        """Whether the fields were found."""
        return self._places is not None

    def own_stamp_ns(self, message: Any, arrival_ns: int) -> int:  # noqa: ANN401 - any type
        """Stamp that a message has, by the clock of its sender [ns]; arrival if it has none."""
        stamp = () if self._places is None else self._places.stamp
        return stamp_ns_of(message, stamp, arrival_ns)

    def validity_ns(self, stamp_ns: int, arrival_ns: int) -> int:
        """Time of validity [ns] of a message, by the host's clock, from its own stamp.

        With ``clock: sensor`` it depends on the messages before it: each is asked about once.
        """
        if self.clock is not None:
            stamp_ns = self.clock.host_ns(stamp_ns, arrival_ns)
        return stamp_ns + self.stream.offset_ns

    def received_ns(self, validity_ns: int, arrival_ns: int) -> int:
        """Time of reception [ns] of a message that came at a time of the node's clock."""
        if self.role != 'position':
            return arrival_ns
        return int(reception_ns(np.array([validity_ns]), np.array([arrival_ns]))[0])

    def arrival(self, number: int) -> int:
        """Number of a fix, different from those of all other sources."""
        return (self.index << _SOURCE_BITS) + number

    def packet(self, taken: Taken, number: int) -> PacketRow | None:
        """Acoustic packet in a message of a modem; None for one that cannot be read."""
        if self._fix is None or self._places is None:
            raise TypeError(f'{self.stream.topic} carries no packets')
        places = self._places.quantities
        try:
            row = packet_of(taken.message, places, self._fix, taken.stamp_ns, number)
        except (ValueError, IndexError, TypeError):
            self.unreadable += 1
            return None
        self.read += 1
        return row

    def rows(self, taken: Taken) -> Rows:
        """Quantities of one message; ValueError, IndexError, TypeError where it has others."""
        places = {} if self._places is None else self._places.quantities
        return Rows(
            self.stream.topic,
            self.stream.type,
            np.array([taken.stamp_ns], dtype=np.int64),
            np.array([taken.arrival_ns], dtype=np.int64),
            {name: _row(taken.message, paths) for name, paths in places.items()},
            self._constants,
        )

    def event(self, taken: Taken, number: int) -> Event | None:
        """Event of a message; None for one that holds no position, or cannot be read."""
        if self._read is None or self._places is None:
            raise TypeError(f'{self.stream.topic} is not read by an adapter')
        try:
            rows = self.rows(taken)
            with np.errstate(over='ignore', invalid='ignore'):  # numbers of any size
                found = self._read(rows)
        except (ConfigError, ValueError, IndexError, TypeError):
            self.unreadable += 1
            return None
        self.read += 1
        self.empty += _is_empty(found)
        self.unsure += _is_unsure(found)
        self.aloft += isinstance(found, DepthSample) and found.depth < IN_THE_AIR
        if isinstance(found, Fix):
            arrival = self.arrival(number)
            return replace(found, sequence=number, order=number, arrival=arrival)
        if found is None or isinstance(found, Command):
            return found
        # Several of a role: each message has a number of its own, and the topic of its sensor.
        number = number * self.alike + self.index
        if self.index:
            return replace(found, sequence=number, topic=self.topic)
        return replace(found, sequence=number)


def _is_empty(found: Event | None) -> bool:
    """Whether there is nothing in an event that could be used."""
    if isinstance(found, DvlPing):
        return not (found.valid or found.water)
    if isinstance(found, DepthSample):
        return not math.isfinite(found.depth)
    return found is None


def _is_unsure(found: Event | None) -> bool:
    """Whether a measurement says with its variances that it is no measurement."""
    if isinstance(found, DepthSample):
        return not found.variance > 0.0
    if isinstance(found, DvlPing):
        return not (np.diagonal(found.covariance_m) > 0.0).all()
    if isinstance(found, Fix):
        return not (np.diagonal(found.covariance_e) > 0.0).all()
    return False


class Sources:
    """All sources of a mapping file, for one set of parameters.

    Parameters
    ----------
    mapping : Mapping
    params : EngineParams
        Of the vehicle's navigation.

    Attributes
    ----------
    imu_lever_b : tuple of float
        IMU from base_link, body axes [m].
    place : str
        Where the mapping stands, for sentences.

    Raises
    ------
    ConfigError
        For what a mapping can state of a recording and not of a running vehicle.
    """

    def __init__(self, mapping: m.Mapping, params: EngineParams) -> None:
        if getattr(params, 'mode', 'sins') != 'sins':
            raise _not_live(mapping, 'parameter mode', 'sources are of a SINS, mode sins')
        self.imu_lever_b = mapping.imu.lever_b
        self.place = mapping.place
        self._all: list[Source] = []
        self._add(IMU, mapping.imu.stream, 'imu', partial(_sample, mapping=mapping.imu))
        for dvl in mapping.dvls:
            self._add_one_of(
                DVL, dvl.stream, 'velocity', partial(_ping, mapping=dvl, params=params)
            )
        for depth in mapping.depths:
            read = partial(_depth, mapping=depth, params=params)
            self._add_one_of(DEPTH, depth.stream, 'depth', read)
        self._count_alike()
        heading = mapping.heading
        if heading is not None:
            self._add(HEADING, heading.stream, 'heading', partial(_heading, mapping=heading))
        for fix in mapping.fixes:
            self._add_fix(mapping, fix, params)
        topics = [s.topic for s in self._all]
        twice = next((t for t in topics if topics.count(t) > 1), None)
        if twice is not None:
            raise _not_live(mapping, 'fixes', f'{twice} stands in it twice')

    def __iter__(self) -> Iterator[Source]:
        """Sources in the order of the file."""
        return iter(self._all)

    def of(self, topic: str) -> Source | None:
        """Source that stands for a topic of the session."""
        return next((s for s in self._all if s.topic == topic), None)

    @property
    def beside(self) -> tuple[str, ...]:
        """Topics of the session that only a mapping brings: heading, positions, second sensors."""
        return tuple(s.topic for s in self._all if s.topic not in (IMU, DVL, DEPTH, RX))

    def sensors(self, topics: tuple[str, ...]) -> tuple[str, ...]:
        """Those of a session's sensor topics that come from here or are not of these roles."""
        return tuple(t for t in topics if t not in (DVL, DEPTH) or self.of(t) is not None)

    def _add_one_of(self, topic: str, stream: m.Stream, role: str, read: Read) -> None:
        """Add a sensor; the first of its role stands for the topic, others for their own."""
        first = all(s.role != role for s in self._all)
        self._add(topic if first else stream.topic, stream, role, read)

    def _count_alike(self) -> None:
        for source in self._all:
            alike = [s for s in self._all if s.role == source.role]
            source.index, source.alike = alike.index(source), len(alike)

    def _add(
        self,
        topic: str,
        stream: m.Stream,
        role: str,
        read: Read | None,
        fix: m.FixMapping | None = None,
    ) -> None:
        fixes = sum(s.role in ('position', 'packet') for s in self._all)
        index = fixes if role in ('position', 'packet') else 0
        self._all.append(Source(index, topic, stream, role, read, fix))

    def _add_fix(self, mapping: m.Mapping, fix: m.FixMapping, params: EngineParams) -> None:
        stream = fix.position.stream
        if stream.type == USBL:
            raise _not_live(mapping, stream.topic, 'a UsblFix needs the track of its leader')
        if carries_packets(stream):
            if fix.slow_sigma:
                raise _not_live(mapping, stream.topic, 'slow_sigma: packets come with their own')
            require_room(stream, stream.type, mapping.place)
            self._add(RX, stream, 'packet', None, fix)
            return
        level = level_height(fix, params.sea_surface_height)
        self._add(stream.topic, stream, 'position', _Fixes(fix, level))


def _not_live(mapping: m.Mapping, what: str, why: str) -> ConfigError:
    return ConfigError(f'{mapping.place}: {what}: not for a running vehicle: {why}')


def _row(message: Any, paths: tuple[str, ...]) -> NDArray[Any]:  # noqa: ANN401
    """Quantity of one message as a row: shape (1,) or (1, k)."""
    if len(paths) > 1:
        return np.array([[get(message, path) for path in paths]], dtype=np.float64)
    value = get(message, paths[0])
    if isinstance(value, str):
        return np.array([value], dtype=object)
    return np.asarray(value)[None]


def _sample(rows: Rows, mapping: m.ImuMapping) -> ImuSample:
    imu = imu_of(rows, mapping)
    return ImuSample(int(rows.stamps_ns[0]), 0, imu.omega_ib_b[0], imu.f_b[0])


def _ping(rows: Rows, mapping: m.DvlMapping, params: EngineParams) -> DvlPing:
    p = pings_of(rows, mapping, params.dvl_sigma, params.water_sound_speed)
    stamp_ns = int(rows.stamps_ns[0])
    water = bool(p.water[0])
    return DvlPing(stamp_ns, 0, bool(p.valid[0]), p.velocity[0], p.covariance[0], water=water)


def _depth(rows: Rows, mapping: m.DepthMapping, params: EngineParams) -> DepthSample:
    d = depths_of(rows, mapping, params.depth_sigma, params.initial_latitude_deg)
    return DepthSample(int(rows.stamps_ns[0]), 0, float(d.depth[0]), float(d.variance[0]))


def _heading(rows: Rows, mapping: m.HeadingMapping) -> HeadingSample | None:
    h = headings_of(rows, mapping)
    if not math.isfinite(h.heading[0]):
        return None
    return HeadingSample(int(rows.stamps_ns[0]), 0, float(h.heading[0]), h.up_b[0])


class _Fixes:
    """Fixes of a source, one after the other."""

    def __init__(self, mapping: m.FixMapping, level: float | None) -> None:
        self._mapping, self._level = mapping, level
        self._before_ns: int | None = None

    def __call__(self, rows: Rows) -> Fix | None:
        positions = positions_of(rows, self._mapping.position, self._level)
        found = fixes_of(self._mapping, positions, before_ns=self._before_ns)
        if not found:
            return None
        self._before_ns = found[0].validity_ns
        return found[0]
