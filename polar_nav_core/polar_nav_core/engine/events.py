"""What goes into the follower engine and what comes out; stamps are integer nanoseconds.

Every event has its place in one total order: (processing stamp, stream rank, sequence, arrival).
Local sensors are processed at their time of validity, acoustic fixes when they are received. The
sequence of a local message is its number on its topic; only damaged or repeated packets can share
a sequence, so their number of arrival breaks the tie.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
OrderKey: TypeAlias = tuple[int, int, int, int]


class Rank(IntEnum):
    """Order of the streams within one stamp."""

    IMU = 0
    CONTROL = 1
    DEPTH = 2
    DVL = 3
    FIX = 4
    COMMAND = 5


class Verdict(IntEnum):
    """What became of a message; the numbers are those of polar_nav_msgs/FixReceipt."""

    FUSED = 0
    GATED = 1
    DUPLICATE = 2
    TOO_OLD = 3
    TOO_LATE = 4
    FROM_FUTURE = 5
    NOT_FINITE = 6
    BAD_CRC = 7
    BAD_MAC = 8
    UNKNOWN_SOURCE = 9
    IN_FLIGHT = 10
    NOT_READY = 11
    BAD_FORMAT = 12


@dataclass(frozen=True)
class InitialState:
    """Where a filter starts; 1-sigma values per axis, SI units and radians."""

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


@dataclass(frozen=True)
class ImuSample:
    """Rate [rad/s] and specific force [m/s^2], body axes.

    Both are means over the interval that ends at the stamp.
    """

    stamp_ns: int
    sequence: int
    omega_ib_b: Array
    f_b: Array
    topic: str = 'imu/data_raw'

    @property
    def key(self) -> OrderKey:
        """Place in the order of events."""
        return (self.stamp_ns, Rank.IMU, self.sequence, 0)


@dataclass(frozen=True)
class DvlPing:
    """Velocity over ground and covariance, instrument axes.

    ``valid`` is False for a ping without bottom lock.
    """

    stamp_ns: int
    sequence: int
    valid: bool
    v_m: Array
    covariance_m: Array
    topic: str = 'dvl/data'

    @property
    def key(self) -> OrderKey:
        """Place in the order of events."""
        return (self.stamp_ns, Rank.DVL, self.sequence, 0)


@dataclass(frozen=True)
class DepthSample:
    """Depth below the sea surface [m], positive down, and variance [m^2]."""

    stamp_ns: int
    sequence: int
    depth: float
    variance: float
    topic: str = 'depth/data'

    @property
    def key(self) -> OrderKey:
        """Place in the order of events."""
        return (self.stamp_ns, Rank.DEPTH, self.sequence, 0)


@dataclass(frozen=True)
class Fix:
    """One acoustic packet: a delayed position of the follower's transponder, or why it is none.

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
    topic: str = 'acomms/rx'

    @property
    def stamp_ns(self) -> int:
        """Processing stamp: when it was received."""
        return self.receive_ns

    @property
    def key(self) -> OrderKey:
        """Place in the order of events."""
        return (self.receive_ns, Rank.FIX, self.order, self.arrival)


class CommandKind(IntEnum):
    """Kinds of polar_nav_msgs/Command."""

    RESET = 0
    SET_INITIAL_STATE = 1
    SHUTDOWN = 2


@dataclass(frozen=True)
class Command:
    """A service call as a stamped event."""

    stamp_ns: int
    sequence: int
    kind: CommandKind
    initial_state: InitialState | None = None
    topic: str = 'nav/command'

    @property
    def key(self) -> OrderKey:
        """Place in the order of events."""
        return (self.stamp_ns, Rank.COMMAND, self.sequence, 0)


Event: TypeAlias = ImuSample | DvlPing | DepthSample | Fix | Command


def _nan3() -> Array:
    return np.full(3, np.nan)


@dataclass(frozen=True)
class Receipt:
    """What became of one fix, or of a refused local message."""

    stamp_ns: int
    verdict: Verdict
    reason: str
    topic: str
    source: str
    sequence: int
    validity_ns: int
    transmit_ns: int = 0
    receive_ns: int = 0
    fused_ns: int = 0
    delay_handling: str = ''
    steps_rolled_back: int = 0
    innovation_G: Array = field(default_factory=_nan3)
    innovation_variance_G: Array = field(default_factory=_nan3)
    nis: float = float('nan')
    dof: int = 0
    gate: float = float('inf')
    revision: int = 0


LOCAL_DOF = {'dvl': 3, 'depth': 1}
"""Local sources and the degrees of freedom of one measurement; rows of local statistics."""
UPDATES, LOCAL_GATED, NIS_SUM = range(3)
"""Columns of local statistics: used, refused by the gate, sum of the NIS of those used."""


def no_local_statistics() -> Array:
    """Local statistics of no measurement: zeros, one row per `LOCAL_DOF`."""
    return np.zeros((len(LOCAL_DOF), 3))


@dataclass(frozen=True)
class Estimate:
    """State at a stamp: r_e ECEF [m], v_G [m/s], C_b_G, P (24, 24) and estimated sensor errors.

    ``local_statistics``, shape (2, 3), is of the local measurements since the estimate before:
    rows dvl and depth, columns `UPDATES`, `LOCAL_GATED`, `NIS_SUM`.
    """

    stamp_ns: int
    r_e: Array
    v_G: Array
    C_b_G: Array
    P: Array
    gyro_bias_b: Array
    accel_bias_b: Array
    dvl_scale_m: Array
    dvl_markov_m: Array
    usbl_bias_a: Array
    fixes_received: int
    fixes_fused: int
    last_validity_ns: int
    local_statistics: Array = field(default_factory=no_local_statistics)


Output: TypeAlias = Estimate | Receipt
