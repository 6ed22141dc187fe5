"""What is what in a foreign bag (docs/your-bags.md explains the keys); `mapping_file` reads it."""

from __future__ import annotations

import math
from collections.abc import Mapping as Names
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from polar_nav_core.arrays import Array

GYRO_UNITS = {'rad/s': 1.0, 'deg/s': np.pi / 180.0}
ACCEL_UNITS = {'m/s^2': 1.0, 'g': 9.80665, 'mg': 9.80665e-3}
SPEED_UNITS = {'m/s': 1.0, 'cm/s': 1e-2, 'mm/s': 1e-3}
ANGLE_UNITS = {'deg': np.pi / 180.0, 'rad': 1.0}
LENGTH_UNITS = {'m': 1.0, 'cm': 1e-2, 'mm': 1e-3}
PRESSURE_UNITS = {'Pa': 1.0, 'hPa': 1e2, 'kPa': 1e3, 'dbar': 1e4, 'bar': 1e5}
POSITION_FRAMES = ('geodetic', 'earth', 'enu', 'ned', 'epsg')
VERSION = 2
"""Of mapping files; it counts up when a key comes to mean something else. Since 2, fixes without
`dimensions` are two-dimensional unless `sigma` states a vertical one."""
REFERENCES = ('bottom', 'water')
STAMPS = ('header', 'log')
WORLDS = ('enu', 'ned')
CLOCKS = ('host', 'sensor', 'log')
ENCODINGS = ('hex', 'base64')


@dataclass(frozen=True)
class Stream:
    """A topic and where its times come from.

    Attributes
    ----------
    topic : str
    stamp : str
        ``header`` (time of validity) or ``log`` (when it was recorded).
    offset_ns : int
        Added to every stamp [ns].
    fields : dict of str to str or list of str
        Paths in the message, for types without an adapter.
    type : str
        Message type, which a node must know at its start; of a bag it may be left out.
    clock : str
        Whose time the stamps are of: ``host``, or ``sensor``, which is mapped to the host's.
    """

    topic: str
    stamp: str = 'header'
    offset_ns: int = 0
    fields: Names[str, Any] = field(default_factory=dict)
    type: str = ''
    clock: str = 'host'


@dataclass(frozen=True)
class ImuMapping:
    """An IMU: C_s_b takes its axes to the body's; lever_b is from base_link to it [m]."""

    stream: Stream
    C_s_b: Array
    gyro_scale: float
    accel_scale: float
    lever_b: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class DvlMapping:
    """A DVL: scale to m/s; sigma replaces what the messages state [m/s].

    With ``water`` its velocities are relative to the water, not to the ground. ``sound_speed`` is
    what the instrument assumed where its messages do not state that, 0: unknown [m/s].
    """

    stream: Stream
    C_s_b: Array
    scale: float
    sigma: float | None
    water: bool = False
    sound_speed: float = 0.0


@dataclass(frozen=True)
class DepthMapping:
    """Depth in metres or as pressure; sigma replaces what the messages state [m]."""

    stream: Stream
    unit: str | None
    sign: float
    sigma: float | None
    atmospheric_pressure: float
    latitude_deg: float | None


@dataclass(frozen=True)
class HeadingMapping:
    """An AHRS or compass: what its headings count from is a parameter of the engine.

    Attributes
    ----------
    stream : Stream
    C_s_b : (3, 3) array
        Axes of the vehicle that an orientation speaks of, to the body's.
    world : str
        Axes of the world that an orientation speaks of: ``enu`` or ``ned``.
    scale : float
        Of a plain heading to radians, negative where it counts counterclockwise.
    """

    stream: Stream
    C_s_b: Array
    world: str = 'enu'
    scale: float = np.pi / 180.0


@dataclass(frozen=True)
class Frame:
    """Coordinates of positions; the origin is geodetic [deg, deg, m]."""

    kind: str | None
    origin: tuple[float, float, float] | None = None
    epsg: int | None = None


@dataclass(frozen=True)
class PositionMapping:
    """A topic of positions.

    ``C_s_b`` is of the vehicle axes that its attitude speaks of.
    """

    stream: Stream
    frame: Frame
    C_s_b: Array


@dataclass(frozen=True)
class FixMapping:
    """Delayed positions: when each was received, and how good it is.

    Attributes
    ----------
    position : PositionMapping
        Topic and frame; for AcousticPacket and UsblFix, the topic alone.
    source : str
        Who is named in receipts.
    delay_ns : int or None
        From validity to reception; None: the log time is that of reception.
    sigma : (2,) or None
        Horizontal and vertical, replaces what the messages state [m].
    leader : PositionMapping or None
        Position and attitude of the array's vehicle, for UsblFix.
    C_a_b, lever_b : arrays
        Mounting of the array on its vehicle.
    leader_id, own_id : int
        Numbers in acoustic packets.
    dimensions : int
        2: its heights are not used.
    encoding : str
        Of a payload that is a text: ``hex`` or ``base64``.
    correlation_s : float
        Time over which errors of positions resemble one another, those of a filter [s]; 0: each
        is measured anew.
    delay_sigma_s : float
        1-sigma of a delay that varies and that nobody states [s].
    slow_sigma : float
        1-sigma per horizontal axis of an error that fixes share with those before, besides
        ``sigma`` [m]; how long they do is the engine's ``leader_error_tau``.
    offset_b : (3,) tuple
        Of the antenna from the one point that the filter knows fixes to locate, body axes [m].
    surface_depth : float
        An antenna works above this depth of the vehicle only [m]; infinite for a transponder.
    """

    position: PositionMapping
    source: str
    delay_ns: int | None
    sigma: tuple[float, float] | None
    leader: PositionMapping | None
    C_a_b: Array
    lever_b: tuple[float, float, float]
    leader_id: int
    own_id: int
    dimensions: int = 3
    encoding: str = ''
    correlation_s: float = 0.0
    delay_sigma_s: float = 0.0
    slow_sigma: float = 0.0
    offset_b: tuple[float, float, float] = (0.0, 0.0, 0.0)
    surface_depth: float = math.inf

    @classmethod
    def of_packets(cls, stream: Stream, source: str = 'modem', encoding: str = '') -> FixMapping:
        """Mapping of a topic of packets, whoever sent them."""
        return cls(
            position=PositionMapping(stream, Frame(None), np.eye(3)),
            source=source,
            delay_ns=None,
            sigma=None,
            leader=None,
            C_a_b=np.eye(3),
            lever_b=(0.0, 0.0, 0.0),
            leader_id=0,
            own_id=0,
            encoding=encoding,
        )


@dataclass(frozen=True)
class InitialMapping:
    """Where the initial state comes from: ``topic``, ``values`` or ``alignment``.

    ``heading_deg`` is clockwise from true north; ``grid_heading_deg`` from grid north. Values that
    are None are left to the parameters ``initial_*``.
    """

    kind: str
    position: PositionMapping | None
    heading_deg: float | None
    grid_heading_deg: float | None
    rest_s: float
    heading_from: str


@dataclass(frozen=True)
class Mapping:
    """Everything that a mapping file says."""

    place: str
    vehicle: str
    imu: ImuMapping
    dvls: tuple[DvlMapping, ...]
    depths: tuple[DepthMapping, ...]
    fixes: tuple[FixMapping, ...]
    initial: InitialMapping
    truth: PositionMapping | None
    accept: tuple[str, ...]
    params: Names[str, Any]
    heading: HeadingMapping | None = None

    @property
    def dvl(self) -> DvlMapping | None:
        """The first DVL, whose place and reference all of them share; None without one."""
        return self.dvls[0] if self.dvls else None

    @property
    def depth(self) -> DepthMapping | None:
        """The first depth sensor, whose place all of them share; None without one."""
        return self.depths[0] if self.depths else None


def with_parameters(mapping: Mapping, changes: Names[str, Any]) -> Mapping:
    """Return the mapping with other parameters, such as those of the command line."""
    return replace(mapping, params={**mapping.params, **changes})
