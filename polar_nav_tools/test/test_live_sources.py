"""Live sources of a mapping file: events as offline, replay and verify of what was used."""

import json
import struct
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from foreign_worlds import (
    DVL,
    FIXES,
    IMU,
    PARAMETERS,
    Recorder,
    aiding_columns,
    imu_column,
    mapping,
    rows_of,
    stamps_of,
    truth_of,
    write_columns,
)
from rclpy.serialization import deserialize_message
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg
from std_msgs.msg import String

from polar_nav_core.attitude import euler_from_matrix
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.engine.events import DepthSample, DvlPing, Event, Fix, ImuSample
from polar_nav_core.engine.saved import SavedState, pack
from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.params import from_mapping, to_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_follower.session import Session
from polar_nav_msgs.msg import Command, NavState, Restore
from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.adapters.live import Sources, Taken
from polar_nav_ros.adapters.section import Section
from polar_nav_ros.adapters.stated import parameters_of
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.source_ports import SourcePorts
from polar_nav_ros.stamps import stamp_ns_of_cdr, to_msg
from polar_nav_ros.topics import (
    CLOCK_STEP,
    COMMAND,
    INPUTS,
    RECEIPT,
    RESTORE,
    RUN_INFO,
    STATE,
    TYPES,
)
from polar_nav_ros.topics import DVL as DVL_TOPIC
from polar_nav_ros.topics import IMU as IMU_TOPIC
from polar_nav_tools.bags import BagWriter, open_bag
from polar_nav_tools.bags.errors import BagError
from polar_nav_tools.cli import main
from polar_nav_tools.foreign.definitions import BUNDLED
from polar_nav_tools.foreign.load import load
from polar_nav_tools.foreign.sources import open_source
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.replay.recorded import load_inputs
from polar_nav_tools.replay.runs import load_replays
from polar_nav_tools.replay.verification import verify

pytestmark = pytest.mark.slow

EXTRA = {
    'dvl_msgs/msg/DVLDR': BUNDLED['dvl_msgs/msg/DVL'].replace(
        BUNDLED['dvl_msgs/msg/DVL'].partition('=' * 80)[0],
        """std_msgs/Header header
float64 time
geometry_msgs/Vector3 position
float64 pos_std
float64 roll
float64 pitch
float64 yaw
string type
int64 status
string format
""",
    )
}
"""A definition that no reader of recordings needs: bags of it carry their own."""
KINDS = {
    'imu': 'sensor_msgs/msg/Imu',
    'dvl': 'geometry_msgs/msg/TwistWithCovarianceStamped',
    'depth': 'sensor_msgs/msg/FluidPressure',
}
DVL_KIND = 'marine_acoustic_msgs/msg/Dvl'
PREFIX = '/auv/'
Rows = list[tuple[str, int, bytes]]


def world() -> tuple[Rows, dict[str, Any]]:
    """40 s of a vehicle's foreign messages as they arrive, and its mapping with types."""
    truth, make = truth_of(120.0), Recorder()
    columns = [imu_column(make, truth, stamps_of(truth, 0.0, 40.0, 0.01))]
    columns += aiding_columns(make, truth, 0.0, 40.0)[:-1]  # without the reference
    rows = list(rows_of(make, columns))
    start = truth.state(np.array([truth.start_ns]))
    lat, lon, height = (float(v[0]) for v in geodetic_from_ecef(start.r_e))
    psi, theta, phi = (float(v[0]) for v in euler_from_matrix(start.C_b_G))
    initial = {'from': 'values', 'grid_heading_deg': 90.0 - np.degrees(psi).item()}
    top = mapping() | {'version': 2, 'initial': initial}
    del top['truth']
    for role, kind in KINDS.items():
        top[role]['type'] = kind
    top['fixes'][0] |= {'type': 'sensor_msgs/msg/NavSatFix'}
    top['parameters'] = PARAMETERS | {
        'initial_latitude_deg': np.degrees(lat).item(),
        'initial_longitude_deg': np.degrees(lon).item(),
        'initial_height': height,
        'initial_pitch_deg': np.degrees(theta).item(),
        'initial_roll_deg': np.degrees(phi).item(),
        'initial_v_G': start.v_G[0].tolist(),
        'reorder_window_s': 0.05,
    }
    return rows, top


class Wire:
    """What `SourcePorts` asks of a node, without any transport."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.callbacks: dict[str, Any] = {}
        self.blocks: list[tuple[int, bytes]] = []
        self._parameter_overrides: dict[str, Any] = {}

    def subscribe(self, _kind: Any, topic: str, callback: Any, **_options: Any) -> Any:
        self.callbacks[topic] = callback
        return SimpleNamespace(topic_name=topic, get_publisher_count=lambda: 1)

    def resolve_topic_name(self, topic: str) -> str:
        return topic

    def advertise(self, _kind: Any, _topic: str) -> Any:
        def publish(message: Any) -> None:
            self.blocks.append((self.now_ns, to_bytes(message)))

        return SimpleNamespace(publish=publish)

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.now_ns))


def params_of(top: dict[str, Any]) -> FollowerParams:
    stated = parameters_of(mapping_file.parse(yaml.safe_dump(top), 'mapping'), {})
    return from_mapping(FollowerParams, stated)


OUTPUTS = (STATE, RECEIPT, CLOCK_STEP, COMMAND, RESTORE)


class Voyage:
    """Followers with a mapping file, one after another, and what a recorder has of them."""

    def __init__(self, top: dict[str, Any], state_file: str = '') -> None:
        self.text = yaml.safe_dump(top)
        self.params = replace(params_of(top), state_file=state_file)
        self.wire = Wire()
        self.out: list[tuple[str, int, bytes]] = []

    def start(self, log_ns: int, saved: SavedState | None = None) -> None:
        """Start a node, as NavigationPorts do; it goes on from a saved state if there is one."""
        sources = Sources(mapping_file.parse(self.text, 'mapping'), self.params)
        self.ports = SourcePorts(self.wire, sources)
        self.session = Session(self.params, 'auv', sources)
        self.session.marks_starts = True
        self._saved = saved
        info = {
            'node': '/auv/follower_node',
            'package': 'polar_nav_follower',
            'engine_version': ENGINE_VERSION,
            'params': to_mapping(self.params),
            'sources': self.text,
        }
        self.out.append((RUN_INFO, log_ns, to_bytes(String(data=json.dumps(info)))))
        for source in sources:

            def take(taken: Taken, topic: str = source.topic) -> None:
                self._publish(self.session.take(topic, taken))
                if self.session.reorder.start_ns is not None and self._saved is not None:
                    self._restore(self._saved)

            self.ports.subscribe(source.topic, take)

    def feed(self, rows: Rows) -> None:
        """Pass messages as they arrive."""
        for topic, log_ns, data in rows:
            self.wire.now_ns = log_ns + 3_000_000
            self.wire.callbacks[topic](data)

    def end(self) -> None:
        """End the node in order."""
        self._publish(self.session.flush())
        self.ports.flush()
        end = Command(kind=Command.SHUTDOWN)
        end.header.stamp = to_msg(self.wire.now_ns)
        self.out.append((PREFIX + COMMAND, self.wire.now_ns, to_bytes(end)))

    def _restore(self, saved: SavedState) -> None:
        self._saved = None
        message = Restore(data=pack(saved))
        message.header.stamp = to_msg(self.session.reorder.start_ns)
        message.saved_time = to_msg(saved.stamp_ns)
        self.out.append((PREFIX + RESTORE, self.wire.now_ns, to_bytes(message)))
        self._publish(self.session.take(RESTORE, message))

    def _publish(self, published: Iterator[Any]) -> None:
        for p in published:
            self.ports.flush()
            if p.topic in OUTPUTS:
                self.out.append((PREFIX + p.topic, self.wire.now_ns, p.data))

    def write(self, path: Path, rows: Rows, unheard: dict[str, int] | None = None) -> Path:
        """Write the bag of a recorder that got the messages `rows` of the drivers.

        Of a topic in `unheard` it missed so many before it had found the topic.
        """
        left = dict(unheard or {})
        out = [*self.out, *((PREFIX + INPUTS, at_ns, data) for at_ns, data in self.wire.blocks)]
        mapped = Sources(mapping_file.parse(self.text, 'mapping'), self.params)
        kinds = {source.stream.topic: source.stream.type for source in mapped}
        kinds |= {PREFIX + topic: TYPES[topic] for topic in (*OUTPUTS, INPUTS)}
        kinds[RUN_INFO] = TYPES[RUN_INFO]
        counts = Counter[str]()
        with BagWriter(path, {}) as writer:
            for topic, kind in kinds.items():
                writer.add_topic(topic, kind)
            for topic, log_ns, data in sorted([*rows, *out], key=lambda row: row[1]):
                if left.get(topic):
                    left[topic] -= 1
                elif topic in kinds:
                    counts[topic] += 1
                    writer.write(topic, data, log_ns)
            facts = {t: {'count': counts[t], 'unheard': n} for t, n in (unheard or {}).items()}
            writer.finish({'recording': {'topics': facts}})
        return path


def sail(path: Path, rows: Rows, top: dict[str, Any], recorded: Rows | None = None) -> Path:
    """Drive a session live with the messages; write what a recorder would have of it."""
    voyage = Voyage(top)
    voyage.start(rows[0][1])
    voyage.feed(rows)
    voyage.end()
    return voyage.write(path, rows if recorded is None else recorded)


@pytest.fixture(scope='module')
def sailed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Rows, dict[str, Any]]:
    rows, top = world()
    return sail(tmp_path_factory.mktemp('live') / 'bag', rows, top), rows, top


def same(one: Event, other: Event) -> None:
    """Assert that two events are equal in every bit."""
    assert type(one) is type(other)
    for name in getattr(one, '__slots__', None) or vars(one):
        a, b = getattr(one, name), getattr(other, name)
        assert np.array_equal(a, b, equal_nan=isinstance(a, np.ndarray | float)), (name, a, b)


@pytest.mark.parametrize('rotation', ['frd', {'rpy_deg': [178.0, 3.0, 44.0]}])
def test_live_events_are_those_of_the_recording_read_offline(tmp_path: Path, rotation) -> None:
    truth, make = truth_of(120.0), Recorder()
    columns = [imu_column(make, truth, stamps_of(truth, 0.0, 21.0, 0.01))]
    columns += aiding_columns(make, truth, 0.0, 41.0)
    path = write_columns(tmp_path / 'bag', make, columns)
    rows, top = world()
    for role in ('imu', 'dvl'):
        top[role]['rotation'] = rotation
    top['dvl']['clock'] = 'sensor'
    top['fixes'][0] |= {'delay_s': 8.0, 'slow_sigma': 1.5, 'correlation_s': 60.0}
    top['accept'] = ['gravity_sign', 'gravity_direction', 'gyro_units', 'gyro_sign', 'gap']
    parsed = mapping_file.parse(yaml.safe_dump(top), 'mapping')
    inputs = load(open_source(path), parsed).inputs
    offline = {
        ImuSample: [inputs.imu_sample(k) for k in range(len(inputs.imu_stamps_ns))],
        DvlPing: [inputs.dvl_ping(k) for k in range(len(inputs.dvl_stamps_ns))],
        DepthSample: [inputs.depth_sample(k) for k in range(len(inputs.depth_stamps_ns))],
        Fix: list(inputs.fixes),
    }
    sources = Sources(parsed, params_of(top))
    store, found = make.store, {kind: [] for kind in offline}
    counts = dict.fromkeys((s.topic for s in sources), 0)
    for source in sources:
        kind = source.stream.type
        for topic, log_ns, data in rows_of(make, columns):
            if topic == source.stream.topic:
                message = store.deserialize_cdr(data, kind)
                if not source.bound:
                    source.bind(message, {})
                stamp_ns = source.validity_ns(source.own_stamp_ns(message, log_ns), log_ns)
                event = source.event(Taken(message, log_ns, stamp_ns), counts[source.topic])
                counts[source.topic] += 1
                found[type(event)].append(event)
    for kind, events in offline.items():
        assert len(events) > 1
        for one, other in zip(events, found[kind][: len(events)], strict=True):
            same(one, other)
    assert rows


def test_live_equals_replay(sailed: tuple[Path, Rows, dict[str, Any]]) -> None:
    path, rows, _ = sailed
    result = verify(path)
    assert result.ok, result.difference
    assert not result.problems
    assert result.counts[STATE][0] > 300
    replayed = replay(path)
    assert replayed.verdicts == {'FUSED': 2}
    count = sum(topic == IMU for topic, _, _ in rows)
    assert replayed.taken['/auv/imu/data_raw'] == count
    # Scores go by message, too: the arrays have no adapters.
    runs = load_replays(open_bag(path), 'auv').replayed(['default'], lambda _: None, [None])
    assert len(runs['default'].estimates) == result.counts[STATE][0]


def test_a_clock_that_steps_moves_no_other_sensor(
    sailed: tuple[Path, Rows, dict[str, Any]], tmp_path: Path
) -> None:
    """A DVL with a clock of its own, which is set back by an hour on the way."""
    path, rows, top = sailed
    changed, count = [], 0
    for topic, log_ns, data in rows:
        if topic == DVL:
            count += 1
            behind_ns = 514_944_044_432_000 + (3_600_000_000_000 if count > 100 else 0)
            own = to_msg(stamp_ns_of_cdr(data) - behind_ns)
            stamp = struct.pack('<iI', own.sec, own.nanosec)
            data = data[:4] + stamp + data[12:]
        changed.append((topic, log_ns, data))
    mapped = top | {'dvl': top['dvl'] | {'clock': 'sensor'}}
    other = sail(tmp_path / 'bag', changed, mapped)
    result = verify(other)
    assert result.ok, result.difference
    before, after = load_inputs(path), load_inputs(other)
    for role in (IMU_TOPIC, FIXES):
        stamps = [
            [m.stamp_ns for t, m in run.lives[0].messages if t == role] for run in (before, after)
        ]
        assert stamps[0] == stamps[1]
    pings = [
        [m.stamp_ns for t, m in run.lives[0].messages if t == DVL_TOPIC] for run in (before, after)
    ]
    # At the arrival, 3 ms later; the first four after the step are still where the old clock was.
    apart = np.array(pings[1]) - np.array(pings[0])
    assert np.all(np.delete(apart, range(100, 104)) == 3_000_000)
    assert np.all(apart[100:104] == 3_000_000 - 3_600_000_000_000)
    assert replay(other).verdicts['TOO_LATE'] == 4


@pytest.mark.parametrize(
    ('kind', 'role', 'values'),
    [
        (
            'marine_acoustic_msgs/msg/Dvl',
            'dvl',
            {'velocity': (1.0, 0.1, -0.2), 'num_good_beams': 4},
        ),
        ('dvl_msgs/msg/DVL', 'dvl', {'velocity': (1.0, 0.1, -0.2), 'fom': 0.02}),
        ('dvl_msgs/msg/DVLDR', 'fixes', {'position': (4000.0, 3000.0, 3.0), 'pos_std': 0.5}),
        ('sensor_msgs/msg/Range', 'depth', {'range': 3.25}),
        ('geometry_msgs/msg/PointStamped', 'depth', {'point': (0.0, 0.0, 7.5)}),
        ('geometry_msgs/msg/PointStamped', 'fixes', {'point': (10.0, 20.0, 3.0)}),
        ('geometry_msgs/msg/PoseWithCovarianceStamped', 'fixes', {}),
        ('geometry_msgs/msg/TwistStamped', 'dvl', {}),
        ('nav_msgs/msg/Odometry', 'dvl', {}),
        ('nav_msgs/msg/Odometry', 'fixes', {}),
    ],
)
def test_types_that_may_be_in_no_package_here(kind: str, role: str, values: Any) -> None:
    """Messages made of their definitions, as their drivers fill them in."""
    message, constants = made(kind, values)
    top = {'version': 2, 'imu': {'topic': '/imu', 'type': 'sensor_msgs/msg/Imu'}}
    section: dict[str, Any] = {'topic': '/s', 'type': kind}
    if role == 'fixes':
        origin = {'latitude_deg': 70.0, 'longitude_deg': 20.0}
        section |= {'frame': 'enu', 'origin': origin, 'delay_s': 1.0}
    elif role == 'dvl':
        section |= {'rotation': 'frd'}
    source = list(
        Sources(mapping_file.from_section(Section('m', top | {role: section})), FollowerParams())
    )[1]
    source.bind(message, constants)
    own_ns = source.own_stamp_ns(message, 0)
    assert own_ns == 12_000_000_034
    event = source.event(Taken(message, own_ns + 5, source.validity_ns(own_ns, own_ns + 5)), 7)
    assert source.unreadable == 0
    if isinstance(event, DvlPing):
        assert event.valid
        expected = [1.0, -0.1, 0.2] if values else [0.0, 0.0, 0.0]
        np.testing.assert_array_equal(event.v_m, expected)
        assert event.sequence == 7
    elif isinstance(event, DepthSample):
        assert event.depth == (values.get('range') or values['point'][2])
    else:
        assert isinstance(event, Fix)
        assert event.receive_ns == own_ns + 1_000_000_000
        lat, _, _ = geodetic_from_ecef(event.r_e)
        assert (lat > np.radians(70.0)) == bool(values)
        if 'pos_std' in values:
            level = ecef_to_grid(event.r_e) @ event.covariance_e @ ecef_to_grid(event.r_e).T
            np.testing.assert_allclose(np.diagonal(level), [0.25, 0.25, 1e8], rtol=1e-6)


def made(kind: str, values: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Message of a definition, with some fields filled in, and the constants of its type."""
    make = Recorder()
    if kind in BUNDLED or kind in EXTRA:
        text = BUNDLED.get(kind) or EXTRA[kind]
        make.store.register(
            {k: v for k, v in get_types_from_msg(text, kind).items() if k not in make.store.types}
        )
    constants, fields = make.store.fielddefs[kind]

    def value(name: str, what: Any, inner: dict[str, Any]) -> Any:
        node, about = what
        if name == 'stamp':
            return make.make('builtin_interfaces/msg/Time', sec=12, nanosec=34)
        if node == Nodetype.NAME:
            given = inner.get(name)
            parts = dict(zip('xyz', given, strict=True)) if isinstance(given, tuple) else {}
            return filled(about, parts)
        if node == Nodetype.BASE:
            usual = {'string': '', 'bool': True}.get(about[0], 0)
            usual = {'velocity_mode': 1, 'max_range': 50.0}.get(name, usual)
            return inner.get(name, usual)
        if node == Nodetype.ARRAY and about[0][0] == Nodetype.BASE:
            return np.zeros(about[1])
        return [filled(about[0][1], {})] * about[1] if node == Nodetype.ARRAY else []

    def filled(name: str, inner: dict[str, Any]) -> Any:
        parts = make.store.fielddefs[name][1]
        return make.make(name, **{n: value(n, what, inner) for n, what in parts})

    assert fields
    return filled(kind, values), {name: v for name, _, v in constants}


def test_what_the_recorder_has_in_excess_is_not_used(
    sailed: tuple[Path, Rows, dict[str, Any]], tmp_path: Path
) -> None:
    """Best effort: the follower lost messages that the recorder got."""
    _, rows, top = sailed
    got = [row for k, row in enumerate(rows) if k % 97 != 5]
    result = verify(sail(tmp_path / 'bag', got, top, recorded=rows))
    assert result.ok, result.difference
    assert not result.problems


def state_of(data: bytes) -> NavState:
    message: NavState = deserialize_message(data, NavState)
    return message


@pytest.mark.parametrize('state_file', ['', 'follower.state'])
def test_a_follower_that_is_killed_and_started_again(tmp_path: Path, state_file: str) -> None:
    """Killed at 17 s and, for good, at 33 s; away for 4 s. Each estimate is reproduced."""
    rows, top = world()
    begin_ns = rows[0][1]

    def between(begin_s: float, end_s: float) -> Rows:
        return [row for row in rows if begin_s <= 1e-9 * (row[1] - begin_ns) < end_s]

    voyage = Voyage(top, state_file)
    voyage.start(begin_ns)
    voyage.feed(between(0.0, 17.0))
    saved = voyage.session.engine.saved() if state_file else None
    voyage.start(between(20.0, 21.0)[0][1], saved)
    voyage.feed(between(21.0, 33.0))
    path = voyage.write(tmp_path / 'bag', between(0.0, 40.0))
    result = verify(path)
    assert result.ok, result.difference
    assert not result.problems
    first, second = load_inputs(path).lives
    # The reorder window of 0.05 s waited in the node. From a saved state it begins with the first
    # ping 2 s after its first IMU sample.
    begins_s = 23.1 if state_file else 21.0
    spans = [[1e-9 * (ns - begin_ns) for ns in life.span_ns] for life in (first, second)]
    assert np.allclose(spans, [[0.0, 16.9], [begins_s, 32.9]], atol=0.11)
    # The last ones led to no output.
    assert 1190 <= sum(topic == IMU_TOPIC for topic, _ in second.messages) <= 1200
    # From its state it is where it was; from its parameters where the run began.
    start = state_of(second.live[STATE][0])
    before = state_of(first.live[STATE][-1])
    away_m = float(np.linalg.norm(start.r_e - before.r_e))
    begun_m = float(np.linalg.norm(start.r_e - state_of(first.live[STATE][0]).r_e))
    assert (away_m < begun_m) == bool(state_file)
    assert begun_m < 1.0 or state_file


def test_verify_names_what_the_bag_lacks(
    sailed: tuple[Path, Rows, dict[str, Any]], tmp_path: Path
) -> None:
    _, rows, top = sailed
    of_imu = [k for k, row in enumerate(rows) if row[0] == IMU]
    lost = {of_imu[k] for k in range(1000, 1012)} | {
        next(k for k, row in enumerate(rows) if row[0] == FIXES)
    }
    left = [row for k, row in enumerate(rows) if k not in lost]
    result = verify(sail(tmp_path / 'bag', rows, top, recorded=left))
    assert not result.ok
    n = len(of_imu)
    assert result.problems == [
        f'12 of {n:,} messages of {IMU} that the follower used are not in the bag',
        f'1 of 2 messages of {FIXES} that the follower used are not in the bag',
    ]


def test_blocks_that_a_recorder_heard_twice_count_once(
    sailed: tuple[Path, Rows, dict[str, Any]], tmp_path: Path
) -> None:
    _, rows, top = sailed
    voyage = Voyage(top)
    voyage.start(rows[0][1])
    voyage.feed(rows)
    voyage.end()
    blocks = voyage.wire.blocks
    # A recorder that is started again hears what the follower still holds.
    again = [(blocks[20][0] + 1, data) for _, data in blocks[:20]]
    voyage.wire.blocks = sorted([*blocks, *again], key=lambda block: block[0])
    result = verify(voyage.write(tmp_path / 'bag', rows))
    assert result.ok, result.difference
    assert not result.problems


def test_verify_names_blocks_from_before_the_recording(
    sailed: tuple[Path, Rows, dict[str, Any]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, rows, top = sailed
    voyage = Voyage(top)
    voyage.start(rows[0][1])
    voyage.feed(rows)
    voyage.end()
    blocks = voyage.wire.blocks
    voyage.wire.blocks = blocks[3:30] + blocks[31:]
    result = verify(voyage.write(tmp_path / 'bag', rows))
    assert not result.ok
    assert result.problems == [
        f'4 of {len(blocks)} messages of {PREFIX}{INPUTS} are not in the bag; 3 of them are from'
        ' before the recording began'
    ]
    monkeypatch.setattr(sys, 'argv', ['polar', 'verify', str(tmp_path / 'bag')])
    assert main() == 1
    assert '3 of them are from before the recording began' in capsys.readouterr().err


@pytest.mark.parametrize('output', [RECEIPT, STATE])
def test_outputs_from_before_the_recorder_found_them_are_named_and_no_difference(
    sailed: tuple[Path, Rows, dict[str, Any]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    output: str,
) -> None:
    _, rows, top = sailed
    voyage = Voyage(top)
    voyage.start(rows[0][1])
    voyage.feed(rows)
    voyage.end()
    result = verify(voyage.write(tmp_path / 'bag', rows, {PREFIX + output: 1}))
    assert result.ok, result.difference
    assert not result.problems
    missed = (
        f'1 messages of {PREFIX}{output} are not in the bag: they were published before the '
        'recorder had found the topic'
    )
    assert result.unheard == [f'{missed}; the others are equal']
    monkeypatch.setattr(sys, 'argv', ['polar', 'verify', str(tmp_path / 'bag')])
    assert main() == 0
    assert f'{missed}; the others are equal\n' in capsys.readouterr().out
    # One that a late recorder does not explain is a difference.
    voyage.out.remove(next(row for row in reversed(voyage.out) if row[0] == PREFIX + output))
    result = verify(voyage.write(tmp_path / 'other', rows, {PREFIX + output: 1}))
    assert not result.ok
    assert result.unheard == [missed]


def test_a_bag_without_the_record_is_refused(
    sailed: tuple[Path, Rows, dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, rows, top = sailed
    monkeypatch.setattr(SourcePorts, 'flush', lambda _: None)
    path = sail(tmp_path / 'bag', rows[:500], top)
    with pytest.raises(BagError, match='no message on /auv/nav/inputs'):
        verify(path)


def test_other_parameters_reach_the_adapters(
    sailed: tuple[Path, Rows, dict[str, Any]],
) -> None:
    path, _, _ = sailed
    one = replay(path, changes={'water_sound_speed': 1440.0})
    assert one.sha256 == replay(path).sha256  # this DVL states no sound speed
    assert replay(path, changes={'dvl_lever_b': [0.0, 0.0, 0.0]}).sha256 != one.sha256
    assert DVL in {s.stream.topic for s in Sources(_mapping(path), FollowerParams())}


def _mapping(path: Path) -> Any:
    info = open_bag(path).node_infos['/auv/follower_node']
    return mapping_file.parse(info['sources'], 'bag')
