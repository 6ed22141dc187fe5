"""Inputs of a follower in a recorded run as arrays, for the fast replay.

The same rules as in `recorded`, for whole columns: each topic numbered in the order of the
bag, up to where the node ended, without what it refused. One reader serves both modes of the
follower; `MODES` has what differs. A run with messages of another definition than the installed
one, or with anything else that a mode does not read as arrays, is left to `recorded`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import spilled
from polar_nav_core.arrays import Array, Ints
from polar_nav_core.dvl import sound_speed_factors
from polar_nav_core.engine.events import Command, CommandKind, Fix, Receipt
from polar_nav_core.engine.inputs import Inputs, Stamps, StationInputs
from polar_nav_core.params import from_mapping
from polar_nav_follower import session
from polar_nav_follower.measurements.fix import Packet, fixes_from_packets
from polar_nav_follower.measurements.station_fix import StationNumbers, station_fix_from_packet
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import Command as CommandMsg
from polar_nav_msgs.msg import Dvl
from polar_nav_ros import topics
from polar_nav_ros.readers import attitudes, command_from_msg, depth_variances, dvl_pings

from ..bags import arrays
from ..bags.columns import Columns
from ..bags.decode import is_installed
from ..bags.errors import BagError
from ..bags.reader import Bag
from ..bags.request import Request, Tables
from ..bags.tables import read_tables
from ..series.vehicle import TruthSeries
from .constants import mode_table, require_same
from .fix_columns import packets_of, refusals_of
from .lives import event_key, refusal_key, taken_counts
from .recorded import choose_follower, decoded

Progress = Callable[[float], None]

_STAMP = arrays.STAMP[0]
_OMEGA = tuple(f'angular_velocity.{axis}' for axis in 'xyz')
_F = tuple(f'linear_acceleration.{axis}' for axis in 'xyz')
_Q = tuple(f'orientation.{axis}' for axis in 'xyzw')
_V = tuple(f'velocity.{axis}' for axis in 'xyz')
_FORCE = tuple(f'wrench.force.{axis}' for axis in 'xyz')
_TORQUE = tuple(f'wrench.torque.{axis}' for axis in 'xyz')


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
        counts = {topic: len(columns[_STAMP]) for topic, columns in self.columns.items()}
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
            omega_ib_b=imu.columns[_OMEGA[0]],
            f_b=imu.columns[_F[0]],
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
        stamps_ns = columns[_STAMP]
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
        return _Stream(moved[_STAMP], moved, rows)

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

    names = (_V[0], 'velocity_covar', 'velocity_mode', 'num_good_beams', 'sound_speed', 'dvl_type')
    return spilled.several_by_rows(some, *(ping[name] for name in names))


class StationArrays(RecordedArrays):
    """Recorded inputs of a follower in station mode: AHRS, thrust, depth, station's packets."""

    def inputs(self, params: FollowerParams) -> StationInputs:
        """Inputs of the engine with these parameters."""
        imu, control, depth = self.columns.values()
        return StationInputs(
            imu_stamps_ns=imu[_STAMP],
            omega_ib_b=imu[_OMEGA[0]],
            C_b_G=attitudes(imu[_Q[0]], imu['orientation_covariance'][:, 0]),
            control_stamps_ns=control[_STAMP],
            force_b=control[_FORCE[0]],
            depth_stamps_ns=depth[_STAMP],
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


@dataclass(frozen=True)
class Mode:
    """Rules to read runs of one mode of the follower as arrays.

    Attributes
    ----------
    kind : type
        Makes the engine's inputs of the columns.
    fields : mapping of str to fields
        Local sensors, the IMU first, and what becomes a column of them.
    commands : tuple of CommandKind
        What the arrays can have besides the end of the run.
    any_order : bool
        Whether topics may be absent, stamps run backwards, and messages have been refused because
        they came too late.
    unread : tuple of str
        Columns that the engine's arrays have no place for: they must be finite, as an event whose
        numbers are not gets a receipt.
    """

    kind: type[SinsArrays | StationArrays]
    fields: Mapping[str, tuple[str | tuple[str, ...], ...]]
    commands: tuple[CommandKind, ...] = ()
    any_order: bool = True
    unread: tuple[str, ...] = ()

    def takes(self, found: Sequence[Columns], refused: Sequence[Receipt]) -> bool:
        """Whether a run with these columns can be replayed from arrays."""
        if self.any_order:
            return True
        return not refused and all(
            spilled.ascending(c[_STAMP])
            and all(bool(np.isfinite(c[n]).all()) for n in self.unread if n in c)
            for c in found
        )


MODES = {
    'sins': Mode(
        SinsArrays,
        {
            topics.IMU: (arrays.STAMP, _OMEGA, _F),
            topics.DVL: (
                arrays.STAMP,
                _V,
                'velocity_covar',
                'velocity_mode',
                'num_good_beams',
                'dvl_type',
                'sound_speed',
            ),
            topics.DEPTH: (arrays.STAMP, 'depth', 'variance'),
        },
    ),
    'station': Mode(
        StationArrays,
        {
            topics.AHRS: (arrays.STAMP, _OMEGA, _F, _Q, 'orientation_covariance'),
            topics.CONTROL: (arrays.STAMP, _FORCE, _TORQUE),
            topics.DEPTH: (arrays.STAMP, 'depth', 'variance'),
        },
        commands=(CommandKind.IDENTIFY,),
        any_order=False,
        unread=(_F[0], _TORQUE[0]),
    ),
}
"""By the follower's parameter ``mode``."""


def arrays_request(bag: Bag, vehicle: str | None = None, *, truth: bool = False) -> Request | None:
    """Topics and fields that `load_arrays` reads; None for a run that must be replayed by message.

    Raises
    ------
    BagError
        When there is no such follower, or it took no IMU data.
    """
    name, recorded = choose_follower(bag, vehicle)
    params = from_mapping(FollowerParams, recorded)
    inputs = bag.topics.get(f'/{name}/{topics.INPUTS}')
    if inputs is not None and inputs.count:
        return None  # of mapped sources, which are adapted one by one
    if bag.injected:
        return None  # nobody has sorted its messages or refused late ones
    mode = MODES[params.mode]
    taken = (*mode.fields, topics.RX, topics.COMMAND)
    if f'/{name}/{topics.RESTORE}' in bag.topics:
        return None  # the start is a message
    steps = bag.topics.get(f'/{name}/{topics.CLOCK_STEP}')
    if steps is not None and steps.count:
        return None  # of clocks that stepped, or of a node that may have been started again
    if tuple(t for t in session.inputs_of(params) if t != topics.RESTORE) != taken:
        return None  # with thrust beside a DVL
    bag.require([f'/{name}/{taken[0]}'])
    if not all(_plain(bag, f'/{name}/{topic}') for topic in taken):
        return None
    require_same(bag, (f'/{name}/{topic}' for topic in (*taken, topics.RECEIPT)))
    wanted = {f'/{name}/{topic}': names for topic, names in mode.fields.items()}
    topic = f'/{name}/{topics.TRUTH}'
    if truth and topic in bag.topics and bag.channel(topic).type == arrays.TRUTH_TYPE:
        wanted[topic] = arrays.TRUTH_FIELDS
    raw = (topics.RX, topics.COMMAND, topics.RECEIPT)
    return Request(wanted, tuple(f'/{name}/{topic}' for topic in raw))


def load_arrays(
    bag: Bag, vehicle: str | None = None, *, truth: bool = False, progress: Progress | None = None
) -> SinsArrays | StationArrays | None:
    """Inputs of a follower, read in one pass; None for a run that must be replayed by message.

    A bag that was opened with `arrays_request` ahead was read then.

    Parameters
    ----------
    bag : Bag
    vehicle : str, optional
        Which follower, when there are several.
    truth : bool
        Read its truth on the way.
    progress : callable, optional

    Raises
    ------
    BagError
        When there is no such follower, or it took no IMU data.
    """
    name, params = choose_follower(bag, vehicle)
    request = arrays_request(bag, vehicle, truth=truth)
    if request is None:
        return None
    mode = MODES[from_mapping(FollowerParams, params).mode]
    packet, command, receipt = request.raw
    try:
        tables = read_tables(bag, *request, progress=progress)
        commands = [decoded(bag, command, d, CommandMsg) for d in tables.payloads[command]]
        packets = packets_of(bag, packet, tables.payloads[packet])
        refused = refusals_of(bag, receipt, tables.payloads[receipt])
    except BagError:
        return None  # decoding by message says what is wrong, or does not need it
    asked = [c for c in commands if c.kind != CommandKind.SHUTDOWN]
    if any(c.kind not in mode.commands for c in asked):
        return None
    if not mode.any_order and any(f'/{name}/{t}' not in tables.columns for t in mode.fields):
        return None
    limits = _limits([c for c in commands if c.kind == CommandKind.SHUTDOWN])
    columns = {
        topic: _up_to(tables, f'/{name}/{topic}', fields, limits)
        for topic, fields in mode.fields.items()
    }
    if not mode.takes(list(columns.values()), refused):
        return None
    if topics.DVL in columns:
        _renumber_modes(columns[topics.DVL], bag, f'/{name}/{topics.DVL}')
    found = tables.columns.get(f'/{name}/{topics.TRUTH}')
    return mode.kind(
        bag=bag,
        vehicle=name,
        params=params,
        columns=columns,
        packets=packets[: limits.get(packet)],
        commands=[command_from_msg(c, k) for k, c in enumerate(asked)],
        refused=refused,
        truth=None if found is None else arrays.truth_of(found, name),
    )


def _limits(ends: Sequence[Any]) -> dict[str, int]:
    """Number of messages per full topic name received by the node at its end; empty without."""
    if not ends:
        return {}
    return taken_counts(ends[-1])


def _renumber_modes(dvl: Columns, bag: Bag, topic: str) -> None:
    """Convert DVL modes from the constants of the bag to the installed ones, in place."""
    modes = mode_table(bag, topic)
    if modes is not None:
        dvl['velocity_mode'] = modes[dvl['velocity_mode'].astype(np.intp)]


def _plain(bag: Bag, topic: str) -> bool:
    """Whether a topic is absent, or has messages of the installed definition."""
    return topic not in bag.topics or is_installed(bag.channel(topic))


def _up_to(
    tables: Tables, topic: str, fields: tuple[str | tuple[str, ...], ...], limits: dict[str, int]
) -> Columns:
    """Columns of a topic up to the last message that the node received; empty without messages."""
    found = tables.columns.get(topic)
    if found is not None:
        return {name: column[: limits.get(topic)] for name, column in found.items()}
    empty: Columns = {}
    for names in fields:
        name = names if isinstance(names, str) else names[0]
        width = {_V[0]: (3,), 'velocity_covar': (9,)}.get(name, ())
        dtype = np.int64 if name == _STAMP else np.float64
        empty[name] = np.zeros((0, *width), dtype=dtype)
    return empty
