"""Readings: what a follower receives, in the form that all faults change, bag or not.

The messages of a bag, or of a simulated run, become readings (`messages`), pass through the
faults, and become messages again. What no fault has changed is passed on as it was.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

IMU, DVL, DEPTH, THRUST, FIX = 'imu', 'dvl', 'depth', 'thrust', 'packet'
STREAMS = (IMU, DVL, DEPTH, THRUST, FIX)
NS = 1_000_000_000

VECTORS = {IMU: ('omega_ib_b', 'f_b'), DVL: ('v_m',), DEPTH: ('depth',), THRUST: ('force_b',)}
"""Measured values of each local stream, by name: SI units, body or instrument axes."""


@dataclass(frozen=True)
class Reading:
    """One message as a follower receives it.

    Attributes
    ----------
    stream : str
        One of `STREAMS`.
    number : int
        Of its original among all readings, by which it is found again.
    true_ns, arrival_ns : int
        True time of its stamp, which no fault changes; when it arrives, by a clock that no fault
        changes [ns].
    stamp_ns : int
        Its stamp: validity of a local measurement, reception of a packet [ns].
    values : mapping
        `VECTORS` of its stream; ``covariance_m`` (3, 3) and ``valid`` of a ping; ``variance`` of a
        depth. Of a packet `PACKET`.
    """

    stream: str
    number: int
    true_ns: int
    arrival_ns: int
    stamp_ns: int
    values: Mapping[str, Any]

    def with_values(self, **values: Any) -> Reading:  # noqa: ANN401 - numbers and arrays
        """The same reading with other values."""
        return replace(self, values={**self.values, **values})

    def delayed(self, delay_ns: int) -> Reading:
        """The same reading with a later arrival; a packet's reception is stamped on arrival."""
        later = replace(self, arrival_ns=self.arrival_ns + delay_ns)
        return replace(later, stamp_ns=self.stamp_ns + delay_ns) if self.stream == FIX else later


PACKET: dict[str, Any] = {
    'moved_G': np.zeros(3),
    'sigma': None,
    'indefinite': False,
    'flipped_bit': None,
    'ahead': 0,
    'forged': 0,
}
"""Changes of a packet, as none of them.

``moved_G``: position moved by, grid axes [m]; ``sigma``: stated 1-sigma on every axis [m], or None
for its own; ``indefinite``: a correlation of no covariance; ``flipped_bit``: number of a bit
flipped on the way; ``ahead``: added to its number; ``forged``: number of the forgery, 0 for none.
"""

Readings: TypeAlias = Sequence[Reading]
Apply: TypeAlias = Callable[[Readings, 'Setting'], list[Reading]]


@dataclass(frozen=True)
class Setting:
    """Size and start of a fault.

    Attributes
    ----------
    at_ns : int
        True time of its start [ns].
    size : float
        In the fault's unit.
    rng : numpy.random.Generator
    """

    at_ns: int
    size: float
    rng: np.random.Generator

    def since_s(self, reading: Reading) -> float:
        """Time of a reading since the start of the fault [s]."""
        return (reading.true_ns - self.at_ns) / NS

    def within(self, reading: Reading, length_s: float) -> bool:
        """Whether a reading is of the first so many seconds of the fault."""
        return 0.0 <= self.since_s(reading) < length_s


def in_order(readings: Readings) -> list[Reading]:
    """Readings as they arrive; those that arrive at once stay in their order."""
    return sorted(readings, key=lambda r: r.arrival_ns)
