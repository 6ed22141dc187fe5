"""Inputs of the engine: samples, fixes, commands and steps of clocks.

Stamps are integer nanoseconds. Every event has its place in one total order: (processing stamp,
stream rank, sequence, arrival). Local sensors are processed at their time of validity, acoustic
fixes when they are received. The sequence of a local message is its number on its topic; only
damaged or repeated packets can share a sequence, so their number of arrival breaks the tie.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import ClassVar, TypeAlias, TypeVar

import numpy as np

from .. import order
from ..arrays import Array
from ..identification.polar_fix import PolarFix
from ..link.fields import rewound
from .verdicts import Refusal, Verdict

OrderKey: TypeAlias = tuple[int, int, int, int]


class Rank(IntEnum):
    """Order of the streams within one stamp."""

    IMU = order.IMU_RANK
    CONTROL = order.CONTROL_RANK
    DEPTH = order.DEPTH_RANK
    DVL = order.DVL_RANK
    HEADING = order.HEADING_RANK
    FIX = order.FIX_RANK
    COMMAND = order.COMMAND_RANK


@dataclass(frozen=True)
class InitialState:
    """Initial state of a filter with 1-sigma values per axis, SI units and radians."""

    latitude: float
    longitude: float
    height: float
    v_G: tuple[float, float, float]
    roll: float
    pitch: float
    grid_heading: float
    sigma_position_horizontal: float
    sigma_position_vertical: float
    sigma_velocity: float
    sigma_tilt: float
    sigma_heading: float


class _Local:
    """Message of a sensor of the vehicle itself: its place in the total order of events."""

    RANK: ClassVar[Rank]
    stamp_ns: int
    sequence: int

    @property
    def key(self) -> OrderKey:
        """Sort key in the total order of events."""
        return (self.stamp_ns, self.RANK, self.sequence, 0)


@dataclass(frozen=True)
class ImuSample(_Local):
    """Rate [rad/s] and specific force [m/s^2], body axes.

    Both are means over the interval that ends at the stamp. ``C_b_G`` is the attitude at the stamp
    that an AHRS measured, shape (3, 3); None without one. ``refused`` is what the samples before
    it say against it, where that was found in columns.
    """

    RANK = Rank.IMU
    stamp_ns: int
    sequence: int
    omega_ib_b: Array
    f_b: Array
    C_b_G: Array | None = None
    topic: str = 'imu/data_raw'
    refused: Refusal | None = None


@dataclass(frozen=True)
class ControlSample(_Local):
    """Thrust from the stamp on: force [N] and torque [N m], body axes."""

    RANK = Rank.CONTROL
    stamp_ns: int
    sequence: int
    force_b: Array
    torque_b: Array
    topic: str = 'control/thrust'


LEAST_BEAMS = 3
"""Beams of a DVL that determine a velocity."""


@dataclass(frozen=True)
class DvlPing(_Local):
    """Velocity over ground and covariance, instrument axes.

    ``valid`` is False for a ping without bottom lock, ``water`` True for one whose velocity is
    relative to the water.
    """

    RANK = Rank.DVL
    stamp_ns: int
    sequence: int
    valid: bool
    v_m: Array
    covariance_m: Array
    topic: str = 'dvl/data'
    water: bool = False


@dataclass(frozen=True)
class DepthSample(_Local):
    """Depth below the sea surface [m], positive down, and variance [m^2]."""

    RANK = Rank.DEPTH
    stamp_ns: int
    sequence: int
    depth: float
    variance: float
    topic: str = 'depth/data'


@dataclass(frozen=True)
class HeadingSample(_Local):
    """Heading of the body's x axis [rad], clockwise from its reference, and the vertical.

    ``up_b``, shape (3,), is up by the roll and pitch that an AHRS measured, body axes; NaN of a
    compass that has none.
    """

    RANK = Rank.HEADING
    stamp_ns: int
    sequence: int
    heading: float
    up_b: Array = field(default_factory=lambda: np.full(3, np.nan))
    topic: str = 'heading/data'


PACKETS = 'acomms/rx'
"""Topic of fixes whose validity is of another vehicle's clock."""


@dataclass(frozen=True, slots=True)
class Fix:
    """One acoustic packet: delayed position of the follower's transponder, or why there is none.

    Attributes
    ----------
    validity_ns, transmit_ns, receive_ns : int
        Time of validity (0 when the bytes could not be read), first bit sent, packet complete.
    sequence : int
        Number of the fix as the leader counts.
    order, arrival : int
        Number of the packet as its sender's modem counts, and as it came in on the topic: place in
        the order of events.
    r_e, covariance_e : (3,), (3, 3) arrays
        Position, ECEF [m], and covariance; NaN when there is none.
    refusal : Verdict or None
        Why the packet holds no fix for this vehicle.
    reason : str
        The same in a sentence.
    array_heading : float
        Grid heading of the leader's array [rad].
    relative_e : (3,) array
        From the leader's array to the transponder, ECEF [m]; zero for an absolute fix.
    leader_sigma, leader_heading_sigma : float
        1-sigma of the leader's position per horizontal axis [m], and of its heading [rad], both in
        ``covariance_e``; zero where they are not known or nothing is shared with other fixes.
    polar : PolarFix or None
        What a station measured, where the fix comes from one; then ``r_e`` is NaN.
    delay_sigma : float
        1-sigma of a time of validity that nobody states and that is another one each time [s].
    surface_depth : float
        Of an antenna: none of its fixes can come from deeper [m]; infinite for a transponder.
    stated_e : (3, 3) array or None
        Covariance as it was stated, of a fix that is believed less since; None: ``covariance_e``.
    """

    validity_ns: int
    transmit_ns: int
    receive_ns: int
    source: str
    sequence: int
    order: int
    arrival: int
    r_e: Array
    covariance_e: Array
    refusal: Verdict | None = None
    reason: str = ''
    array_heading: float = float('nan')
    relative_e: Array = field(default_factory=lambda: np.zeros(3))
    leader_sigma: float = 0.0
    leader_heading_sigma: float = 0.0
    polar: PolarFix | None = None
    topic: str = PACKETS
    delay_sigma: float = 0.0
    surface_depth: float = math.inf
    stated_e: Array | None = None

    @property
    def stamp_ns(self) -> int:
        """Stamp of reception [ns], at which the fix is processed."""
        return self.receive_ns

    @property
    def key(self) -> OrderKey:
        """Sort key in the total order of events."""
        return (self.receive_ns, Rank.FIX, self.order, self.arrival)

    @property
    def stated_covariance_e(self) -> Array:
        """Covariance as it was stated, (3, 3): it says what was measured."""
        return self.covariance_e if self.stated_e is None else self.stated_e

    def believed_to(self, covariance_e: Array) -> Fix:
        """The same fix, believed to another covariance than the stated one."""
        return replace(self, covariance_e=covariance_e, stated_e=self.stated_covariance_e)


class CommandKind(IntEnum):
    """Kinds of polar_nav_msgs/Command, and RESTORE."""

    RESET = 0
    SET_INITIAL_STATE = 1
    SHUTDOWN = 2
    IDENTIFY = 3
    RESTORE = 4
    """Of a message of its own (`saved.SavedState`), which no service sends."""
    SENSOR_OFF = 5
    SENSOR_ON = 6


@dataclass(frozen=True)
class Command:
    """A service call as a stamped event; `sensor` is the topic that it switches off or on."""

    stamp_ns: int
    sequence: int
    kind: CommandKind
    initial_state: InitialState | None = None
    topic: str = 'nav/command'
    arrival: int = 0
    sensor: str = ''

    @property
    def key(self) -> OrderKey:
        """Sort key in the total order of events."""
        return (self.stamp_ns, Rank.COMMAND, self.sequence, self.arrival)


Local: TypeAlias = DvlPing | DepthSample | HeadingSample
"""Measurement of a sensor of the vehicle itself, valid at its stamp."""
Event: TypeAlias = ImuSample | ControlSample | Local | Fix | Command


@dataclass(frozen=True)
class ClockStep:
    """Step of a clock: from a message on, the stamps of a topic have another offset.

    Attributes
    ----------
    topic : str
    number : int
        Of that message on its topic.
    stamp_ns, own_ns : int
        Engine time of that message; its stamp by the clock of its topic.
    was_ns : int
        Engine time less stamp before.
    """

    topic: str
    number: int
    stamp_ns: int
    own_ns: int
    was_ns: int = 0

    @property
    def is_start(self) -> bool:
        """Whether it is no step, but names the first message that a node took of a topic."""
        return self.number == 0 and self.stamp_ns == self.own_ns

    @property
    def offset_ns(self) -> int:
        """Engine time less stamp from that message on."""
        return self.stamp_ns - self.own_ns

    @property
    def step_ns(self) -> int:
        """By how much the clock was set forward; negative for back."""
        return self.was_ns - self.offset_ns


_E = TypeVar('_E', bound=Event)


def shifted(event: _E, offset_ns: int) -> _E:
    """The same event with its stamps moved to the engine's time.

    A packet's validity stays: it is of its sender's clock. It wraps, and was read as the time
    nearest to a reception by a clock that was wrong: it becomes the nearest to the right one.
    """
    if offset_ns == 0:
        return event
    if isinstance(event, Fix):
        validity_ns = event.validity_ns
        if event.topic != PACKETS:
            validity_ns += offset_ns
        elif validity_ns:  # 0: not read
            validity_ns = rewound(validity_ns, event.receive_ns + offset_ns)
        return replace(
            event,
            validity_ns=validity_ns,
            receive_ns=event.receive_ns + offset_ns,
            transmit_ns=event.transmit_ns + offset_ns,
        )
    return replace(event, stamp_ns=event.stamp_ns + offset_ns)


def number_of(event: Event) -> int:
    """Number of a message on its topic, as it came."""
    return event.arrival if isinstance(event, Fix | Command) else event.sequence


def kind_of(event: Local) -> str:
    """Name that a measurement is counted by: a sensor, or what of a DVL came."""
    if isinstance(event, DvlPing):
        if event.water:
            return 'dvl_water'
        return 'dvl' if event.valid else 'dvl_invalid'
    return 'depth' if isinstance(event, DepthSample) else 'heading'
