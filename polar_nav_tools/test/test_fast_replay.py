"""The fast way of a replay gives the numbers of the way through messages, bit for bit."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy')

from bag_samples import make, stamp

from polar_nav_core import attitude, earth
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.methods import CONFIGURATIONS
from polar_nav_core.engine.outputs import Estimate
from polar_nav_follower.params import FollowerParams
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.navigation_outputs import nav_to_msg
from polar_nav_tools.bags import BagError, BagWriter, open_bag, tables
from polar_nav_tools.bags.arrays import estimates_from_cdr, load_truth, receipts_from_cdr
from polar_nav_tools.cli import main
from polar_nav_tools.replay.arrays_from_bag import arrays_request, load_arrays
from polar_nav_tools.replay.by_array import replay_arrays, replay_estimates
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.replay.recorded import load_inputs
from polar_nav_tools.series.estimates import EstimateRows

REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'
PREFIX = '/follower/'
INPUTS = ('/run_info', *(PREFIX + t for t in ('imu/data_raw', 'dvl/data', 'depth/data')))
PACKET, COMMAND, RECEIPT = (PREFIX + t for t in ('acomms/rx', 'nav/command', 'nav/receipt'))


def assert_same_series(a, b):
    for f in dataclasses.fields(b):
        x, y = getattr(a, f.name), getattr(b, f.name)
        if isinstance(y, np.ndarray):
            assert x.dtype == y.dtype, f.name
            np.testing.assert_array_equal(x, y, f.name)
        else:
            assert x == y, f.name


def compare(bag, **options):
    """Both ways; the fast result."""
    bag = open_bag(bag)
    inputs, arrays = load_inputs(bag), load_arrays(bag, truth=True)
    slow = replay(inputs, **options)
    fast = replay_arrays(arrays, **options)
    assert_same_series(fast.estimates, estimates_from_cdr(slow.of('nav/state'), 'follower'))
    expected = receipts_from_cdr(slow.of('nav/receipt'))
    assert [repr(r) for r in fast.receipts] == [repr(r) for r in expected]
    assert fast.verdicts == slow.verdicts
    assert fast.divergence == slow.divergence
    assert fast.params == slow.params
    assert arrays.taken == slow.taken
    return fast


@pytest.mark.parametrize('configuration', [None, *CONFIGURATIONS])
def test_the_reference_bag(configuration):
    result = compare(REFERENCE, configuration=configuration)
    assert len(result.estimates) > 20


def test_truth_of_the_same_pass():
    bag = open_bag(REFERENCE)
    assert_same_series(load_arrays(bag, truth=True).truth, load_truth(bag, 'follower'))
    assert load_arrays(bag).truth is None


def copied(target, change, *, skip=(), more=()):
    """Reference bag with messages changed: change(record, number on its topic) -> records."""
    source = open_bag(REFERENCE)
    counts = {}
    with BagWriter(target, {}) as writer:
        wanted = [t for t in (*INPUTS, PACKET) if t not in skip]
        for topic in wanted:
            described = source.definition(topic)
            writer.add_topic(topic, source.channel(topic).type, described=described)
        for topic, type_name, _ in more:
            if topic not in wanted:
                writer.add_topic(topic, type_name)
                wanted.append(topic)
        last = 0
        for record in source.records([t for t in wanted if t in source.topics]):
            number = counts.get(record.topic, 0)
            counts[record.topic] = number + 1
            for one in change(record, number):
                writer.write(one.topic, one.data, one.log_time_ns)
            last = record.log_time_ns
        for topic, _, data in more:
            writer.write(topic, data, last)
    return target


def test_odd_messages_of_all_kinds(tmp_path):
    """Layouts that change, stamps out of order and twice, numbers that make no sense."""
    nan = np.array([np.nan]).tobytes()
    back = []

    def change(record, number):
        data = record.data
        if record.topic.endswith('imu/data_raw'):
            if number == 300:
                back.append(record)
                return  # comes one too late
            if number % 97 == 3:
                data = renamed(data)  # another frame_id, so another layout
            if number == 500:
                data = data[:-304] + nan + data[-296:]  # in front: covariances and vectors
            yield record._replace(data=data)
            if number == 301:
                yield back.pop()
            if number == 700:
                yield record  # a stamp twice
        else:
            if record.topic.endswith('depth/data') and number == 9:
                data = data[:-8] + np.array([-1.0]).tobytes()  # unknown variance
            if record.topic.endswith('depth/data') and number == 10:
                data = data[:-16] + nan + data[-8:]
            yield record._replace(data=data)

    path = copied(tmp_path / 'odd', change)
    result = compare(path)
    assert result.verdicts['DUPLICATE'] >= 1
    assert result.verdicts['NOT_FINITE'] >= 1
    compare(path, configuration='conventional_akf', changes={'depth_sigma': 0.2})


def renamed(data):
    """The same IMU message with a longer frame_id."""
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import Imu

    message = deserialize_message(data, Imu)
    message.header.frame_id += '_of_a_longer_name'
    return serialize_message(message)


def test_pings_without_lock_and_unknown_covariance(tmp_path):
    from rclpy.serialization import deserialize_message, serialize_message

    from polar_nav_msgs.msg import Dvl

    def change(record, number):
        if record.topic.endswith('dvl/data'):
            message = deserialize_message(record.data, Dvl)
            if number % 5 == 1:
                message.num_good_beams = 2
            if number % 5 == 2:
                message.velocity_covar[0] = -1.0
            if number % 5 == 3:
                message.velocity_mode = Dvl.DVL_MODE_WATER
            if number % 5 == 4:
                message.velocity.x = np.nan
            if number % 5 == 0:
                message.dvl_type = Dvl.DVL_TYPE_PHASED_ARRAY
                message.sound_speed = 1500.0
            record = record._replace(data=serialize_message(message))
        yield record

    path = copied(tmp_path / 'dvl', change)
    compare(path, changes={'dvl_sigma': 0.03, 'water_sound_speed': 1439.0})


@pytest.mark.slow
def test_a_long_dvl_with_both_sound_speeds_navigates_as_the_right_one(tmp_path):
    from rclpy.serialization import deserialize_message, serialize_message

    from polar_nav_msgs.msg import Dvl

    long = 1500.0 / 1440.0  # 4.2 %

    def change(record, _):
        if record.topic.endswith('dvl/data'):
            message = deserialize_message(record.data, Dvl)
            for axis in 'xyz':
                setattr(message.velocity, axis, long * getattr(message.velocity, axis))
            if message.velocity_covar[0] != -1.0:
                message.velocity_covar = long**2 * message.velocity_covar
            message.sound_speed = 1500.0
            record = record._replace(data=serialize_message(message))
        yield record

    path = copied(tmp_path / 'long', change)
    right = compare(REFERENCE).estimates
    found = compare(path, changes={'water_sound_speed': 1440.0}).estimates
    sigma = np.sqrt(np.trace(right.P_position_G, axis1=1, axis2=2))
    assert (np.linalg.norm(found.r_e - right.r_e, axis=1) / sigma).max() < 1e-6
    np.testing.assert_allclose(found.P_position_G, right.P_position_G, rtol=1e-6)
    wrong = compare(path).estimates
    assert (np.linalg.norm(wrong.r_e - right.r_e, axis=1) / sigma).max() > 0.01


def test_what_the_node_refused_and_where_it_ended(tmp_path):
    late = open_bag(REFERENCE)
    packets = [m for _, m in late.read(PACKET)]
    imu = [m for _, m in late.read(INPUTS[1])]
    at = imu[1000].header.stamp.sec * 10**9 + imu[1000].header.stamp.nanosec
    receipt_type = 'polar_nav_msgs/msg/FixReceipt'
    refused = {'verdict': 4, 'verdict_text': 'TOO_LATE', **stamp(at + 5 * 10**9)}
    when = {'validity_time__sec': at // 10**9, 'validity_time__nanosec': at % 10**9}
    more = [
        (
            RECEIPT,
            receipt_type,
            make(receipt_type, topic='imu/data_raw', sequence=1000, **refused, **when),
        ),
        (
            COMMAND,
            'polar_nav_msgs/msg/Command',
            command(2, [INPUTS[1], PACKET], [2000, len(packets)]),
        ),
    ]
    path = copied(tmp_path / 'end', lambda r, _: [r], more=more)
    assert len(open_bag(path).topics) == 7
    result = compare(path)
    assert result.verdicts['TOO_LATE'] == 1
    end = imu[1999].header.stamp
    assert result.estimates.stamp_ns[-1] <= end.sec * 10**9 + end.nanosec


def test_inputs_that_the_recorded_run_did_not_take_are_left_to_the_other_way():
    def replayed(changes):
        return replay_estimates(open_bag(REFERENCE), None, None, changes, lambda _: None)

    assert replayed({'gate_probability': 0.999}) is not None
    assert replayed({'model_aiding': True}) is None


def command(kind, topics=(), counts=()):
    from rclpy.serialization import serialize_message

    from polar_nav_msgs.msg import Command

    return serialize_message(Command(kind=kind, taken_topics=topics, taken_counts=counts))


def test_a_reset_is_left_to_the_other_way(tmp_path):
    more = [(COMMAND, 'polar_nav_msgs/msg/Command', command(0))]
    assert load_arrays(open_bag(copied(tmp_path / 'reset', lambda r, _: [r], more=more))) is None


@pytest.mark.parametrize('topic', [PACKET, INPUTS[2], INPUTS[3]])
def test_a_topic_that_is_not_there(tmp_path, topic):
    compare(copied(tmp_path / 'less', lambda r, _: [r], skip=(topic,)))


def test_packets_of_other_lengths_and_with_bit_errors(tmp_path):
    from rclpy.serialization import deserialize_message, serialize_message

    from polar_nav_msgs.msg import AcousticPacket

    def change(record, number):
        if record.topic == PACKET and number in (2, 5):
            message = deserialize_message(record.data, AcousticPacket)
            data = bytearray(bytes(message.data))
            if number == 2:
                data[7] ^= 16
            else:
                data += b'more'
            message.data = bytes(data)
            record = record._replace(data=serialize_message(message))
        yield record

    result = compare(copied(tmp_path / 'packets', change))
    assert result.verdicts['BAD_CRC'] == 1
    assert result.verdicts['BAD_FORMAT'] == 1


def test_each_field_of_any_estimate_is_that_of_the_message():
    """Anywhere on earth, at the pole too, with any attitude and covariance."""
    count = 3000
    rng = np.random.default_rng(3)
    lat = np.pi / 2 - 10.0 ** rng.uniform(-9.0, 0.1, count) * rng.choice([-1.0, 1.0], count)
    lat = np.where(lat > np.pi / 2, lat - np.pi, lat)
    r_e = earth.ecef_from_geodetic(lat, rng.uniform(-np.pi, np.pi, count), rng.normal(size=count))
    r_e[7] = [0.0, 0.0, 6356752.0]
    spread = rng.normal(size=(count, 24, 24)) * 10.0 ** rng.uniform(-4.0, 2.0, (count, 1, 24))
    fixes = rng.integers(0, 3, (count, 3)).cumsum(axis=0)
    fixes[:20, 1] = 0
    track = engine_run.Track(
        stamps_ns=10**18 + np.arange(count) * 10**8,
        r_e=r_e,
        v_G=rng.normal(size=(count, 3)),
        C_b_G=attitude.exp(rng.normal(size=(count, 3)) * 2.0),
        P=np.swapaxes(spread, 1, 2) @ spread,
        sensor_errors=rng.normal(size=(count, 15)),
        local_statistics=np.floor(rng.uniform(0, 9, (count, 2, 3))) + np.array([0.0, 0.0, 0.1]),
        fixes=fixes,
    )
    params = FollowerParams(sea_surface_height=3.7)
    rows = EstimateRows(params, 10)
    for i in range(0, count, 700):  # more than was expected, in several parts
        part = {f.name: getattr(track, f.name)[i : i + 700] for f in dataclasses.fields(track)}
        rows.append(engine_run.Track(**part))
    data = [to_bytes(nav_to_msg(estimate(track, i), params, 'follower')) for i in range(count)]
    assert_same_series(rows.series('follower'), estimates_from_cdr(data, 'follower'))


def estimate(track, i):
    errors = track.sensor_errors[i].reshape(5, 3)
    received, fused, newest = track.fixes[i].tolist()
    return Estimate(
        int(track.stamps_ns[i]), track.r_e[i], track.v_G[i], track.C_b_G[i], track.P[i], *errors,
        received, fused, newest, track.local_statistics[i],
    )  # fmt: skip


@pytest.fixture
def no_second_pass(monkeypatch):
    """Everything has to be read while the bag is opened."""

    open_bag(REFERENCE)  # compared with mcap, which is no part of the matter (against_mcap.py)

    def passed(bag, request, _):
        raise AssertionError(f'{bag.path} is read a second time for {request}')

    monkeypatch.setattr(tables, '_passed', passed)


@pytest.mark.usefixtures('no_second_pass')
def test_read_while_it_is_opened(monkeypatch):
    bag = open_bag(REFERENCE, ahead=lambda bag: arrays_request(bag, truth=True))
    ahead = load_arrays(bag, truth=True)
    monkeypatch.undo()
    arrays = load_arrays(open_bag(REFERENCE), truth=True)
    for topic, columns in arrays.columns.items():
        assert_same_columns(ahead.columns[topic], columns)
    assert_same_series(ahead.truth, arrays.truth)
    assert ahead.packets == arrays.packets
    assert ahead.refused == arrays.refused
    assert ahead.taken == arrays.taken


def assert_same_columns(mine, others):
    assert mine.keys() == others.keys()
    for name, column in others.items():
        assert mine[name].dtype == column.dtype
        assert mine[name].tobytes() == column.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize('command', ['replay', 'score', 'report'])
@pytest.mark.usefixtures('no_second_pass')
def test_commands_read_a_bag_once(command, monkeypatch, capsys, tmp_path):
    options = ['--out', str(tmp_path / 'r.html')] if command == 'report' else []
    monkeypatch.setattr(sys, 'argv', ['polar', command, str(REFERENCE), '--json', *options])
    status = main()
    assert status == 0, capsys.readouterr().err


@pytest.mark.slow
def test_recorded_steps_of_clocks_are_replayed_by_message(tmp_path):
    """Stamps of all topics leap back by 10 s in the middle, as nav/clock states: nothing else."""
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import Imu

    from polar_nav_core.engine.events import ClockStep
    from polar_nav_msgs.msg import AcousticPacket, Depth, Dvl
    from polar_nav_ros.navigation_outputs import clock_step_to_msg
    from polar_nav_ros.stamps import to_msg, to_ns

    types = dict(zip((*INPUTS[1:], PACKET), (Imu, Dvl, Depth, AcousticPacket), strict=True))
    by_ns, first = 10 * 10**9, {}
    imu = [to_ns(m.header.stamp) for _, m in open_bag(REFERENCE).read(INPUTS[1])]
    at_ns = imu[len(imu) // 2]

    def change(record, number):
        if record.topic in types:
            message = deserialize_message(record.data, types[record.topic])
            packet = record.topic == PACKET
            stamp_ns = to_ns(message.receive_time if packet else message.header.stamp)
            if stamp_ns >= at_ns:
                first.setdefault(record.topic, (number, stamp_ns))
                moved = to_msg(stamp_ns - by_ns)
                if packet:
                    message.receive_time = moved
                    message.transmit_time = to_msg(to_ns(message.transmit_time) - by_ns)
                else:
                    message.header.stamp = moved
                record = record._replace(data=serialize_message(message))
        yield record

    copied(tmp_path / 'first', change)
    steps = [
        ClockStep(topic.removeprefix(PREFIX), number, stamp_ns, stamp_ns - by_ns)
        for topic, (number, stamp_ns) in first.items()
    ]
    assert len(steps) == 4
    kind = 'sensor_msgs/msg/TimeReference'
    more = [
        (f'{PREFIX}nav/clock', kind, serialize_message(clock_step_to_msg(step))) for step in steps
    ]
    bag = open_bag(copied(tmp_path / 'stepped', change, more=more))
    assert load_arrays(bag) is None
    found = replay(load_inputs(bag))
    usual = replay(load_inputs(open_bag(copied(tmp_path / 'usual', lambda r, _: [r]))))
    assert len(found.of('nav/state')) > 100
    assert found.of('nav/state') == usual.of('nav/state')
    damaged = [(f'{PREFIX}nav/clock', kind, make(kind, source='imu/data_raw'))]
    with pytest.raises(BagError, match='nav/clock is damaged'):
        load_inputs(open_bag(copied(tmp_path / 'damaged', change, more=damaged)))
