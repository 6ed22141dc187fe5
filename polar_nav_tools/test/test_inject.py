"""Each fault changes what it names and nothing else, in a bag as in a run of the engine."""

import copy
import json
import sys
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from inject_events import events_of
from rclpy.serialization import deserialize_message

from polar_nav_core.engine.events import Fix
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import from_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_follower.session import Session
from polar_nav_tools.bags import open_bag
from polar_nav_tools.bags.errors import BagError
from polar_nav_tools.cli import main
from polar_nav_tools.inject.bag import _OUTPUTS, inject_bag
from polar_nav_tools.inject.faults import FAULTS, STATION, inject, parse
from polar_nav_tools.inject.files import FILE_FAULTS, parse_file
from polar_nav_tools.inject.messages import STREAM_OF, change, reading_of
from polar_nav_tools.inject.readings import FIX, IMU, NS, VECTORS
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.replay.recorded import _TYPES, choose_description
from polar_nav_tools.replay.verification import load_comparable

BAGS = Path(__file__).parents[2] / 'bags'
AT_S = 6.0
SINS_FAULTS = [name for name, f in FAULTS.items() if 'sins' in f.modes]
STATION_FAULTS = [name for name, f in FAULTS.items() if STATION in f.modes]
SMALLER = {'packet_jump': 500.0, 'packet_burnt': 20.0}
"""Sizes that fit into a packet of a station, and into a second."""


class Recorded:
    """Inputs of a reference bag as messages, readings and events."""

    def __init__(self, name):
        bag = open_bag(BAGS / name)
        self.vehicle, described = choose_description(bag, None)
        run = Session(from_mapping(FollowerParams, described.params), self.vehicle)
        streams = {f'/{self.vehicle}/{t}': t for t in (*run.sensors, 'acomms/rx')}
        self.messages, self.readings, self.events = [], [], []
        records = list(bag.records(streams))
        until_ns = records[0].log_time_ns + 15 * NS  # enough, and quick
        for number, record in enumerate(r for r in records if r.log_time_ns < until_ns):
            topic = streams[record.topic]
            message = deserialize_message(record.data, _TYPES[topic])
            self.messages.append(message)
            stream = STREAM_OF[topic]
            self.readings.append(reading_of(stream, number, message, record.log_time_ns))
            self.events.append(run.event_of(topic, message))
        self.run = run
        self.topics = {STREAM_OF[t]: t for t in streams.values()}

    def inject(self, *texts, seed=1):
        return inject(self.readings, [parse(t) for t in texts], seed)


@pytest.fixture(scope='module')
def sins():
    return Recorded('reference')


@pytest.fixture(scope='module')
def station():
    return Recorded('station')


def text_of(name):
    size = SMALLER.get(name)
    return f'{name}@{AT_S}' if size is None else f'{name}:{size}@{AT_S}'


def same(a, b):
    return np.array_equal(np.asarray(a, float), np.asarray(b, float), equal_nan=True)


def check_fault(recorded, name):
    """What is common to all faults: their streams, their time, order, messages, purity."""
    fault, before = FAULTS[name], recorded.readings
    after = recorded.inject(text_of(name))
    start_ns = next(r.true_ns for r in before if r.stream == IMU) + round(AT_S * NS)
    touched = [r for r in after if r is not before[r.number]]
    kept = {r.number for r in after}
    gone = [r for r in before if r.number not in kept]
    copies = len(after) - len(kept)
    assert touched or gone or copies
    for r in (*touched, *gone):
        assert r.stream in fault.streams
        assert r.true_ns >= start_ns
    others = [r.number for r in after if r.stream not in fault.streams]
    assert others == [r.number for r in before if r.stream not in fault.streams]
    for r in touched:  # what is written into a message is read from it again, and nothing else
        message = copy.deepcopy(recorded.messages[r.number])
        change(message, before[r.number], r)
        read = reading_of(r.stream, r.number, message, r.arrival_ns)
        assert read.stamp_ns == r.stamp_ns
        if r.stream != FIX:
            assert all(same(read.values[n], r.values[n]) for n in VECTORS[r.stream])
    again = recorded.inject(text_of(name))
    assert [(r.number, r.stamp_ns, r.arrival_ns) for r in again] == [
        (r.number, r.stamp_ns, r.arrival_ns) for r in after
    ]
    # The form for the engine has an event for each of them.
    assert sum(1 for _ in events_of(after, recorded.events)) == len(after)


@pytest.mark.parametrize('name', SINS_FAULTS)
def test_fault_changes_what_it_names(sins, name):
    check_fault(sins, name)


@pytest.mark.parametrize('name', STATION_FAULTS)
def test_fault_in_station_mode(station, name):
    check_fault(station, name)


@pytest.mark.parametrize(
    'text', ['packet_jump:500@6', 'packet_indefinite@6', 'packet_sigma:20@6', 'packet_drift:5@6']
)
def test_packet_is_the_same_in_a_bag_and_in_the_engine(sins, text):
    after = sins.inject(text)
    pairs = [(r, e) for r, e in events_of(after, sins.events) if isinstance(e, Fix)]
    numbers = count()
    differ = 0
    for r, event in pairs:
        message = copy.deepcopy(sins.messages[r.number])
        change(message, sins.readings[r.number], r)
        fix, _ = sins.run._fix_from_msg(message, next(numbers)), None
        assert fix.sequence == event.sequence
        np.testing.assert_allclose(fix.r_e, event.r_e, atol=0.1)  # the leader's grid axes
        differ += r is not sins.readings[r.number]
    assert differ


def test_single_faults(sins):
    one = [r for r in sins.inject('imu_force:1000@6') if r.stream == IMU]
    assert [r.values['f_b'][0] for r in one].count(1000.0) == 1
    gap = sins.inject('imu_silent:1@6')
    assert len(sins.readings) - len(gap) == 100
    late = [r for r in sins.inject('packet_late:5@6') if r.stream == FIX]
    assert {r.arrival_ns - sins.readings[r.number].arrival_ns for r in late} == {0, 5 * NS}
    assert {r.stamp_ns - sins.readings[r.number].stamp_ns for r in late} == {0, 5 * NS}
    both = sins.inject('imu_nan:3@6', 'depth_2038@7')
    changed = [r.stream for r in both if r is not sins.readings[r.number]]
    assert changed == ['imu'] * 3 + ['depth']


def test_parts_of_an_imu(sins):
    """One instrument that hangs, both with an axis of the wrong sign, a bias on every axis."""
    before = [r.values for r in sins.readings if r.stream == IMU]
    after = [r.values for r in sins.inject('imu_gyro_stuck:1@6') if r.stream == IMU]
    stuck = [k for k, values in enumerate(after) if values is not before[k]]
    assert len(stuck) == 100
    for k in stuck:
        assert same(after[k]['omega_ib_b'], before[stuck[0] - 1]['omega_ib_b'])
        assert same(after[k]['f_b'], before[k]['f_b'])
    last = [r.values for r in sins.inject('imu_mirrored@6') if r.stream == IMU][-1]
    for name in VECTORS[IMU]:
        assert same(last[name], before[-1][name] * [1.0, -1.0, 1.0])
    after = [r.values for r in sins.inject('imu_gyro_axis_stuck:1@6') if r.stream == IMU]
    for k in stuck:
        x, *others = after[k]['omega_ib_b']
        assert x == before[stuck[0] - 1]['omega_ib_b'][0]
        assert same(others, before[k]['omega_ib_b'][1:])
    assert sum(values is not before[k] for k, values in enumerate(after)) == 100
    after = [r.values for r in sins.inject('imu_gyro_degrees:1@6') if r.stream == IMU]
    assert same(after[stuck[5]]['omega_ib_b'], np.degrees(before[stuck[5]]['omega_ib_b']))
    after = [r.values for r in sins.inject('imu_yaw:30@6') if r.stream == IMU]
    more = [a['omega_ib_b'] - b['omega_ib_b'] for a, b in zip(after, before, strict=True)]
    np.testing.assert_allclose(0.01 * np.sum(more, axis=0), [0.0, 0.0, np.radians(30.0)])
    last = [r.values for r in sins.inject('imu_gyro_step:0.5@6') if r.stream == IMU][-1]
    assert same(last['omega_ib_b'], before[-1]['omega_ib_b'] + 0.5)
    assert same(last['f_b'], before[-1]['f_b'])


def test_a_misspelled_fault_is_answered_with_what_was_meant():
    with pytest.raises(ConfigError, match='did you mean imu_yaw'):
        parse('imu_yawn:20@10')
    with pytest.raises(ConfigError, match='no such fault; there are'):
        parse('@')


def test_a_clock_that_runs_fast_is_ahead_by_more_and_more(sins):
    after = [r for r in sins.inject('dvl_clock_rate:1000@6') if r.stream != FIX]
    start_ns = next(r.true_ns for r in sins.readings if r.stream == IMU) + 6 * NS
    for r in after:
        since_ns = max(0, r.true_ns - start_ns) if r.stream == 'dvl' else 0
        assert abs(r.stamp_ns - r.true_ns - 1e-3 * since_ns) <= 1.0


def test_seed_draws(sins):
    def lost(seed):
        return [r.number for r in sins.inject('packet_lost@2', seed=seed)]

    assert lost(1) == lost(1)
    assert any(lost(1) != lost(seed) for seed in range(2, 6))


def test_forms():
    assert parse('imu_silent:inf@3').end_s == float('inf')
    assert parse('dvl_outage@3').text == 'dvl_outage:60@3'
    assert parse('imu_2038@3').text == 'imu_2038@3'
    for bad in (
        'imu',
        'imu_silent',
        'imu_silent:x@3',
        'imu_2038:1@3',
        'imu_nan@-1',
        'imu_nan@inf',
    ):
        with pytest.raises(ConfigError, match='--fault'):
            parse(bad)
    for bad in ('file_flipped@3', 'file_truncated:2', 'file_flipped:x', 'imu_nan'):
        with pytest.raises(ConfigError, match='--fault'):
            parse_file(bad)
    assert parse_file('file_truncated')[1] == 0.5


def test_fault_without_messages(sins):
    with pytest.raises(ConfigError, match='no message of thrust'):
        sins.inject('thrust_nan@1')
    with pytest.raises(ConfigError, match='no message of dvl'):
        sins.inject('dvl_nan@10000')


@pytest.mark.slow
def test_injected_bag(tmp_path):
    source = open_bag(BAGS / 'reference')
    faults = [parse('imu_silent:1@6'), parse('packet_repeated@6')]
    inject_bag(source, faults, tmp_path / 'one', 1)
    inject_bag(source, faults, tmp_path / 'two', 1)
    found, again = open_bag(tmp_path / 'one'), open_bag(tmp_path / 'two')
    assert list(found.records()) == list(again.records())
    assert not found.problems
    assert found.injected == 'imu_silent:1@6, packet_repeated:1@6, seed 1'
    assert not source.injected
    touched = {'/follower/imu/data_raw', '/follower/acomms/rx'}
    gone = {f'/follower/{t}' for t in _OUTPUTS}
    kept = [r for r in source.records() if r.topic not in touched | gone]
    assert [r for r in found.records() if r.topic not in touched] == kept
    assert not gone & set(found.topics)
    with pytest.raises(BagError, match=r'an injected bag \(imu_silent:1@6'):
        load_comparable(found)
    with pytest.raises(BagError, match='has injected faults already'):
        inject_bag(found, faults, tmp_path / 'three', 1)
    # The replay takes messages as they arrive, so that the copies are there and are refused.
    result = replay(found)
    assert result.verdicts['DUPLICATE'] > 0
    assert result.taken['/follower/imu/data_raw'] == 2900


@pytest.mark.slow
def test_stamps_ahead_go_through_the_reorder_window(tmp_path):
    inject_bag(open_bag(BAGS / 'reference'), [parse('imu_2038@6')], tmp_path / 'bag', 1)
    verdicts = replay(open_bag(tmp_path / 'bag')).verdicts
    assert verdicts['FROM_FUTURE'] == 1
    assert 'TOO_LATE' not in verdicts


@pytest.mark.slow
def test_command(tmp_path, monkeypatch, capsys):
    def polar(*words):
        monkeypatch.setattr(sys, 'argv', ['polar', 'inject', *map(str, words)])
        status = main()
        return status, capsys.readouterr()

    status, printed = polar('--list', '--json')
    names = {f['name'] for f in json.loads(printed.out)['faults']}
    assert status == 0
    assert names == {*FAULTS, *FILE_FAULTS}
    reference = BAGS / 'reference'
    status, printed = polar(reference, '--fault', 'dvl_nan@5', '-o', tmp_path / 'a', '--json')
    assert (status, json.loads(printed.out)['changed']) == (0, 1)
    status, printed = polar(reference, '--fault', 'file_truncated:0.3', '-o', tmp_path / 'b')
    assert status == 0
    assert open_bag(tmp_path / 'b').problems
    status, printed = polar(reference, '--fault', 'thrust_nan@5', '-o', tmp_path / 'c')
    assert status == 2
    assert 'mode station' in printed.err
    assert polar(reference, '--fault', 'dvl_nan@5')[0] == 2
