"""Recorded inputs of a follower as arrays, and the inputs of the engine that are made of them.

The same rules as in `recorded`, for whole columns: each topic numbered in the order of the bag, in
the order of its stamps, without what was refused. `arrays_from_bag` reads them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import spilled
from polar_nav_core.arrays import Array, Ints
from polar_nav_core.dvl import sound_speed_factors
from polar_nav_core.engine.events import Command, Fix
from polar_nav_core.engine.inputs import Inputs, Stamps, StationInputs
from polar_nav_core.engine.outputs import Receipt
from polar_nav_follower.measurements.fix import Packet, fixes_from_packets
from polar_nav_follower.measurements.station_fix import StationNumbers, station_fix_from_packet
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import Dvl
from polar_nav_ros import topics
from polar_nav_ros.readers import attitudes, depth_variances, dvl_pings

from ..bags import arrays
from ..bags.columns import Columns
from ..bags.errors import BagError
from ..bags.reader import Bag
from ..series.vehicle import TruthSeries
from .life import event_key, refusal_key

STAMP = arrays.STAMP[0]
RATE = tuple(f'angular_velocity.{axis}' for axis in 'xyz')
SPECIFIC_FORCE = tuple(f'linear_acceleration.{axis}' for axis in 'xyz')
ORIENTATION = tuple(f'orientation.{axis}' for axis in 'xyzw')
VELOCITY = tuple(f'velocity.{axis}' for axis in 'xyz')
THRUST = tuple(f'wrench.force.{axis}' for axis in 'xyz')
TORQUE = tuple(f'wrench.torque.{axis}' for axis in 'xyz')
"""Columns of vectors go by the path of their first component."""


@dataclass(frozen=True)
class RecordedArrays:
    """Recorded inputs of one follower.

    Attributes
    ----------
    bag, vehicle, params
        As in `recorded.RecordedInputs`.
    columns : mapping of str to mapping of str to ndarray
        Local sensors by topic, in the order of the mode: fields, as the bag has them.
    packets : list of Packet
        Received packets.
    commands : list of Command
        Without the one that ended the run.
    refused : list of Receipt
        What the live node refused because it came too late.
    truth : TruthSeries or None
        From the same pass over the bag, where it was asked for and is there.
    """

    bag: Bag
    vehicle: str
    params: Mapping[str, Any]
    columns: Mapping[str, Columns]
    packets: list[Packet]
    commands: list[Command]
    refused: list[Receipt]
    truth: TruthSeries | None = None

    @property
    def taken(self) -> dict[str, int]:
        """Number of messages used per full topic name."""
        counts = {topic: len(columns[STAMP]) for topic, columns in self.columns.items()}
        counts |= {topics.RX: len(self.packets), topics.COMMAND: len(self.commands)}
        return {f'/{self.vehicle}/{topic}': count for topic, count in counts.items() if count}


class SinsArrays(RecordedArrays):
    """Recorded inputs of a follower in SINS mode: IMU, DVL, depth and a leader's packets."""

    def inputs(self, params: FollowerParams) -> NumberedInputs:
        """Inputs of the engine with these parameters."""
        refused = Counter(refusal_key(r) for r in self.refused)
        streams = {topic: self._stream(topic, refused) for topic in self.columns}
        imu, dvl, depth = streams.values()
        v_m, covariance_m, valid = _pings(dvl.columns, params)
        inputs = Inputs(
            imu_stamps_ns=imu.stamps_ns,
            omega_ib_b=imu.columns[RATE[0]],
            f_b=imu.columns[SPECIFIC_FORCE[0]],
            dvl_stamps_ns=dvl.stamps_ns,
            dvl_v_m=v_m,
            dvl_covariance_m=covariance_m,
            dvl_valid=valid,
            depth_stamps_ns=depth.stamps_ns,
            depth=depth.columns['depth'],
            depth_variance=depth_variances(depth.columns['variance'], params.depth_sigma),
            fixes=tuple(self._fixes(params, refused)),
        )
        return NumberedInputs(inputs, {t: s.numbers for t, s in streams.items()})

    def _stream(self, topic: str, refused: Counter[Any]) -> _Stream:
        """Messages of a topic in the order of their stamps, without those that were refused."""
        columns = dict(self.columns[topic])
        stamps_ns = columns[STAMP]
        keep = None
        for _, _, number, stamp_ns in [key for key in refused if key[0] == topic]:
            if 0 <= number < len(stamps_ns) and stamps_ns[number] == stamp_ns:
                keep = np.ones(len(stamps_ns), dtype=bool) if keep is None else keep
                keep[number] = False
        in_order = spilled.ascending(stamps_ns)
        if keep is None and in_order:
            return _Stream(stamps_ns, columns, None)
        rows = np.arange(len(stamps_ns)) if keep is None else np.flatnonzero(keep)
        rows = rows[np.argsort(stamps_ns[rows], kind='stable')]
        moved = {n: spilled.chosen(c, rows) for n, c in columns.items()}
        return _Stream(moved[STAMP], moved, rows)

    def _fixes(self, params: FollowerParams, refused: Counter[Any]) -> list[Fix]:
        try:
            found = fixes_from_packets(self.packets, params)
        except ValueError as error:
            where = f'{self.bag.path}: a message on /{self.vehicle}/{topics.RX}'
            raise BagError(f'{where} makes no sense: {error}') from error
        fixes = []
        for fix in found:
            key = event_key(fix) if refused else None
            if key is not None and refused[key]:
                refused[key] -= 1
            else:
                fixes.append(fix)
        return fixes


def _pings(ping: Columns, params: FollowerParams) -> tuple[NDArray[Any], ...]:
    """Velocities, covariances and validity of a DVL's pings."""

    def some(
        v_m: Array, covariance: Array, mode: Ints, beams: Ints, speed: Array, kind: Ints
    ) -> tuple[NDArray[Any], ...]:
        phased = kind == Dvl.DVL_TYPE_PHASED_ARRAY
        factors = sound_speed_factors(speed, params.water_sound_speed, phased)
        return dvl_pings(v_m, covariance, mode, beams, params.dvl_sigma, factors)

    names = (
        VELOCITY[0],
        'velocity_covar',
        'velocity_mode',
        'num_good_beams',
        'sound_speed',
        'dvl_type',
    )
    return spilled.several_by_rows(some, *(ping[name] for name in names))


class StationArrays(RecordedArrays):
    """Recorded inputs of a follower in station mode: AHRS, thrust, depth, station's packets."""

    def inputs(self, params: FollowerParams) -> StationInputs:
        """Inputs of the engine with these parameters."""
        imu, control, depth = self.columns.values()
        return StationInputs(
            imu_stamps_ns=imu[STAMP],
            omega_ib_b=imu[RATE[0]],
            C_b_G=attitudes(imu[ORIENTATION[0]], imu['orientation_covariance'][:, 0]),
            control_stamps_ns=control[STAMP],
            force_b=control[THRUST[0]],
            depth_stamps_ns=depth[STAMP],
            depth=depth['depth'],
            depth_variance=depth_variances(depth['variance'], params.depth_sigma),
            fixes=tuple(self._fixes(params)),
        )

    def _fixes(self, params: FollowerParams) -> list[Fix]:
        numbers = StationNumbers()
        return [
            station_fix_from_packet(*packet[:3], number, *packet[3:], params, numbers)[0]
            for number, packet in enumerate(self.packets)
        ]


@dataclass(frozen=True)
class NumberedInputs:
    """Inputs, and the number of each local message on its topic; None if equal to the row."""

    inputs: Inputs
    numbers: Mapping[str, NDArray[np.intp] | None]

    @property
    def any_moved(self) -> bool:
        """Whether a receipt may have to be renumbered."""
        return any(numbers is not None for numbers in self.numbers.values())

    def renumbered(self, receipt: Receipt) -> Receipt:
        """Receipt of a local message with the number of the message on its topic."""
        numbers = self.numbers.get(receipt.topic)
        if numbers is None:
            return receipt
        return replace(receipt, sequence=int(numbers[receipt.sequence]))


@dataclass(frozen=True)
class _Stream:
    stamps_ns: Stamps
    columns: Columns
    numbers: NDArray[np.intp] | None
