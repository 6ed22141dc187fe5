"""What a follower took from its topics in a recorded run, as arrays; the fast way of a replay.

The same rules as in `recorded`, for whole columns: each topic numbered in the order of the
bag, up to where the node ended, without what it refused. A run with commands, or with messages of
another definition than the installed one, is left to `recorded`; one in station mode to
`station_arrays`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.engine.events import CommandKind, Fix, Receipt, Verdict
from polar_nav_core.engine.inputs import Inputs, Stamps
from polar_nav_core.params import from_mapping
from polar_nav_follower import session
from polar_nav_follower.measurements.fix import Packet, fixes_from_packets
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import AcousticPacket, Command, FixReceipt
from polar_nav_ros import topics
from polar_nav_ros.navigation_outputs import receipt_from_msg
from polar_nav_ros.readers import depth_variances, dvl_pings
from polar_nav_ros.stamps import to_ns

from ..bags import arrays
from ..bags.columns import Columns, read_columns, time_fields
from ..bags.columns import stamps as stamps_of
from ..bags.decode import is_installed
from ..bags.errors import BagError
from ..bags.reader import Bag
from ..bags.request import Fields, Request, Tables
from ..bags.tables import read_tables
from ..series.vehicle import TruthSeries
from .constants import mode_table, require_same
from .recorded import choose_follower, decoded, event_key, refusal_key

Progress = Callable[[float], None]

_STAMP = arrays.STAMP[0]
_OMEGA = tuple(f'angular_velocity.{axis}' for axis in 'xyz')
_F = tuple(f'linear_acceleration.{axis}' for axis in 'xyz')
_V = tuple(f'velocity.{axis}' for axis in 'xyz')
_FIELDS = {
    topics.IMU: (arrays.STAMP, _OMEGA, _F),
    topics.DVL: (arrays.STAMP, _V, 'velocity_covar', 'velocity_mode', 'num_good_beams'),
    topics.DEPTH: (arrays.STAMP, 'depth', 'variance'),
}
_PACKET_FIELDS = (
    *time_fields('transmit_time'),
    *time_fields('receive_time'),
    'data',
    'sequence',
    'source',
    # Not needed: whether they are texts decides whether this is a message.
    'destination',
    'header.frame_id',
)
_LOCAL = tuple(_FIELDS)


@dataclass(frozen=True)
class RecordedArrays:
    """One follower's part of a bag.

    Attributes
    ----------
    bag, vehicle, params
        As in `recorded_inputs.RecordedInputs`.
    columns : mapping of str to mapping of str to ndarray
        Local sensors by topic: fields, as the bag has them.
    packets : list of Packet
        Received packets.
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
    refused: list[Receipt]
    truth: TruthSeries | None = None

    @property
    def taken(self) -> dict[str, int]:
        """Messages taken per full topic name."""
        counts = {topic: len(columns[_STAMP]) for topic, columns in self.columns.items()}
        counts[topics.RX] = len(self.packets)
        return {f'/{self.vehicle}/{topic}': count for topic, count in counts.items() if count}

    def inputs(self, params: FollowerParams) -> NumberedInputs:
        """What the engine takes with these parameters."""
        refused = Counter(refusal_key(r) for r in self.refused)
        streams = {topic: self._stream(topic, refused) for topic in _LOCAL}
        imu, dvl, depth = (streams[topic] for topic in _LOCAL)
        ping = dvl.columns
        covariance_m, valid = dvl_pings(
            ping[_V[0]],
            ping['velocity_covar'],
            ping['velocity_mode'],
            ping['num_good_beams'],
            params.dvl_sigma,
        )
        inputs = Inputs(
            imu_stamps_ns=imu.stamps_ns,
            omega_ib_b=imu.columns[_OMEGA[0]],
            f_b=imu.columns[_F[0]],
            dvl_stamps_ns=dvl.stamps_ns,
            dvl_v_m=ping[_V[0]],
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
        in_order = bool(np.all(stamps_ns[1:] >= stamps_ns[:-1]))
        if keep is None and in_order:
            return _Stream(stamps_ns, columns, None)
        rows = np.arange(len(stamps_ns)) if keep is None else np.flatnonzero(keep)
        rows = rows[np.argsort(stamps_ns[rows], kind='stable')]
        return _Stream(stamps_ns[rows], {n: c[rows] for n, c in columns.items()}, rows)

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


@dataclass(frozen=True)
class NumberedInputs:
    """Inputs, and the number of each local message on its topic; None where it is the row."""

    inputs: Inputs
    numbers: Mapping[str, NDArray[np.intp] | None]

    def renumbered(self, receipt: Receipt) -> Receipt:
        """Give the receipt of a local message the number that the message has on its topic."""
        numbers = self.numbers.get(receipt.topic)
        if numbers is None:
            return receipt
        return replace(receipt, sequence=int(numbers[receipt.sequence]))


@dataclass(frozen=True)
class _Stream:
    stamps_ns: Stamps
    columns: Columns
    numbers: NDArray[np.intp] | None


def arrays_request(bag: Bag, vehicle: str | None = None, *, truth: bool = False) -> Request | None:
    """Say what `load_arrays` is going to read; None for a run to be taken by message.

    Raises
    ------
    BagError
        When there is no such follower, or it took no IMU data.
    """
    name, params = choose_follower(bag, vehicle)
    if session.inputs_of(from_mapping(FollowerParams, params)) != session.INPUTS:
        return None
    bag.require([f'/{name}/{topics.IMU}'])
    if not all(_plain(bag, f'/{name}/{topic}') for topic in session.INPUTS):
        return None
    require_same(bag, (f'/{name}/{topic}' for topic in (*session.INPUTS, topics.RECEIPT)))
    return request_of(bag, name, _FIELDS, truth=truth)


def request_of(bag: Bag, vehicle: str, fields: Mapping[str, Fields], *, truth: bool) -> Request:
    """Fields of a follower's topics, its packets, commands and receipts, and its truth."""
    wanted = {f'/{vehicle}/{topic}': names for topic, names in fields.items()}
    topic = f'/{vehicle}/{topics.TRUTH}'
    if truth and topic in bag.topics and bag.channel(topic).type == arrays.TRUTH_TYPE:
        wanted[topic] = arrays.TRUTH_FIELDS
    raw = (topics.RX, topics.COMMAND, topics.RECEIPT)
    return Request(wanted, tuple(f'/{vehicle}/{topic}' for topic in raw))


def load_arrays(
    bag: Bag, vehicle: str | None = None, *, truth: bool = False, progress: Progress | None = None
) -> RecordedArrays | None:
    """Read what a follower took, in one pass; None for a run that has to be taken by message.

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
    packet, command, receipt = request.raw
    try:
        tables = read_tables(bag, *request, progress=progress)
        commands = [decoded(bag, command, d, Command) for d in tables.payloads[command]]
        packets = packets_of(bag, packet, tables.payloads[packet])
        refused = refusals_of(bag, receipt, tables.payloads[receipt])
    except BagError:
        return None  # decoding by message says what is wrong, or does not need it
    if any(m.kind != CommandKind.SHUTDOWN for m in commands):
        return None
    limits: dict[str, int] = {}
    if commands:
        last = commands[-1]
        limits = dict(zip(last.taken_topics, map(int, last.taken_counts), strict=True))
    columns = {
        topic: _up_to(tables, f'/{name}/{topic}', fields, limits)
        for topic, fields in _FIELDS.items()
    }
    modes = mode_table(bag, f'/{name}/{topics.DVL}')
    if modes is not None:
        recorded = columns[topics.DVL]['velocity_mode'].astype(np.intp)
        columns[topics.DVL]['velocity_mode'] = modes[recorded]
    found = tables.columns.get(f'/{name}/{topics.TRUTH}')
    return RecordedArrays(
        bag=bag,
        vehicle=name,
        params=params,
        columns=columns,
        packets=packets[: limits.get(packet)],
        refused=refused,
        truth=None if found is None else arrays.truth_of(found, name),
    )


def _plain(bag: Bag, topic: str) -> bool:
    """Whether a topic is absent, or has the messages that the node takes."""
    return topic not in bag.topics or is_installed(bag.channel(topic))


def _up_to(
    tables: Tables, topic: str, fields: tuple[str | tuple[str, ...], ...], limits: dict[str, int]
) -> Columns:
    """Columns of a topic up to what the node had taken; empty ones of a topic without messages."""
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


def packets_of(bag: Bag, topic: str, messages: list[bytes]) -> list[Packet]:
    """Packets of messages: as columns where their data have one length, else one by one."""
    if not messages:
        return []
    described = bag.definition(topic)
    try:
        c = read_columns(messages, described.type, described.text, _PACKET_FIELDS)
    except BagError:
        found = (decoded(bag, topic, data, AcousticPacket) for data in messages)
        return [
            Packet(
                bytes(m.data),
                m.source,
                m.sequence,
                to_ns(m.transmit_time),
                to_ns(m.receive_time),
            )
            for m in found
        ]
    times = (stamps_of(c, f'{end}_time').tolist() for end in ('transmit', 'receive'))
    data = (row.tobytes() for row in c['data'])
    columns = (data, c['source'].tolist(), c['sequence'].tolist(), *times)
    return [Packet(*values) for values in zip(*columns, strict=True)]


def refusals_of(bag: Bag, topic: str, messages: list[bytes]) -> list[Receipt]:
    """Receipts of what came too late; only those are decoded whole."""
    if not messages:
        return []
    described = bag.definition(topic)
    verdicts = read_columns(messages, described.type, described.text, ['verdict'])['verdict']
    late = np.flatnonzero(verdicts == Verdict.TOO_LATE)
    return [receipt_from_msg(decoded(bag, topic, messages[i], FixReceipt)) for i in late]
