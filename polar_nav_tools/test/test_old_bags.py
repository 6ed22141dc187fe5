"""Bags of other engines: read with their own values, and compared in sigma instead of bits."""

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy')

from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from polar_nav_core.engine.params import NO_CEILING, EngineParams
from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.errors import ConfigError
from polar_nav_follower import defaults
from polar_nav_msgs.msg import FixReceipt, NavState
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.topics import RECEIPT, STATE
from polar_nav_tools.bags import BagError, BagWriter, open_bag
from polar_nav_tools.cli import main
from polar_nav_tools.replay import certificate, described, verification
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.replay.certificate import CertificateError, certify, check
from polar_nav_tools.replay.described import describe
from polar_nav_tools.replay.output import replay_summary
from polar_nav_tools.replay.recorded import choose_follower, followers_of, load_inputs
from polar_nav_tools.replay.verification import (
    compare,
    load_comparable,
    require_comparable,
    verify,
)

REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'
NODE = '/follower/follower_node'
OF_THE_MISSION = {'lockstep', 'reorder_window_s'}
NEXT = ENGINE_VERSION + 1


def described_again(target, change):
    """The reference bag with another description of the follower on /run_info."""
    source = open_bag(REFERENCE)
    with BagWriter(target, source.run_info) as writer:
        for topic in source.topics:
            described = source.definition(topic)
            writer.add_topic(topic, described.type, described=described, counted=False)
        for m in source.records():
            data = m.data
            if m.topic == '/run_info':
                info = json.loads(deserialize_message(data, String).data)
                if info['node'] == NODE:
                    change(info)
                    data = to_bytes(String(data=json.dumps(info)))
            writer.write(m.topic, data, m.log_time_ns, m.publish_time_ns)
    return target


@pytest.fixture(scope='module')
def run():
    inputs = load_inputs(open_bag(REFERENCE))
    return inputs, replay(inputs)


@pytest.fixture
def newer(run, monkeypatch):
    """The same run, replayed by an engine that counted up since."""
    for module in (verification, certificate):
        monkeypatch.setattr(module, 'ENGINE_VERSION', NEXT)
    return run


def moved(replayed, topic, change, at=5):
    """The replay with one message changed."""
    outputs, seen = list(replayed.outputs), 0
    for i, output in enumerate(outputs):
        if not output.topic.endswith(topic):
            continue
        if seen == at:
            message = deserialize_message(
                output.data, {STATE: NavState, RECEIPT: FixReceipt}[topic]
            )
            change(message)
            outputs[i] = dataclasses.replace(output, data=to_bytes(message))
        seen += 1
    return dataclasses.replace(replayed, outputs=outputs)


# -- descriptions


def test_a_bag_without_a_version_is_of_the_first_engine():
    assert describe({}).engine_version == 1
    assert describe({'engine_version': 3}).engine_version == 3
    for damaged in (None, True, 0, -2, '2', 1.5, [2]):
        assert describe({'engine_version': damaged}).engine_version == 1
    assert describe({'params': [1]}).params == describe({}).params


def test_the_old_bag_was_recorded_with_the_frozen_values():
    """The bag cannot be edited along with the table."""
    (params,) = followers_of(open_bag(REFERENCE)).values()
    for name, value in defaults.defaults_of(1).items():
        recorded = tuple(params[name]) if isinstance(params[name], list) else params[name]
        of_the_run = name.startswith('initial_') or name in OF_THE_MISSION
        assert of_the_run or recorded == value, name


def test_what_a_bag_does_not_state_is_that_of_its_engine(monkeypatch):
    monkeypatch.setattr(defaults, '_SINCE', {2: {'dvl_sigma': 0.25}})
    stated = {'params': {'depth_sigma': 0.5}}
    old, new = (describe({**stated, 'engine_version': v}).params for v in (1, 2))
    assert (old['dvl_sigma'], new['dvl_sigma']) == (0.005, 0.25)
    assert (old['depth_sigma'], new['depth_sigma']) == (0.5, 0.5)
    assert describe({'params': {'dvl_sigma': 0.5}, 'engine_version': 2}).params['dvl_sigma'] == 0.5


def test_a_configuration_keeps_what_it_stood_for():
    """In bags of engine 1 `default` was another filter, and the follower's default another."""
    old, new = (
        EngineParams(**engine_of(describe({'params': stated, 'engine_version': version}).params))
        for stated, version in (({'configuration': 'default'}, 1), ({}, 2))
    )
    was, now = old.resolved(), new.resolved()
    assert (was.delay_handling, was.gate_probability, was.robust_fixes) == (
        'back_propagate',
        0.9999,
        'none',
    )
    assert (now.delay_handling, now.robust_fixes) == ('clone', 'mahalanobis')
    assert (old.adaptive_ceiling, new.adaptive_ceiling) == (NO_CEILING, 25.0)
    assert describe({}).params['configuration'] == 'modified_akf'
    station = describe({'params': {'configuration': 'default', 'mode': 'station'}})
    assert station.params['configuration'] == 'default'
    again = described.read_parameters(describe({'params': {'configuration': 'default'}}).params, 1)
    assert again.params['configuration'] == 'custom'


def engine_of(params):
    return {f.name: params[f.name] for f in dataclasses.fields(EngineParams)}


def test_retired_parameters_are_accepted_and_named():
    bag = open_bag(REFERENCE)
    assert 'publish_decoded' in bag.node_params(NODE)
    assert 'publish_decoded' not in choose_follower(bag, None)[1]
    described = describe(bag.node_infos[NODE])
    assert described.retired == {'publish_decoded': True, 'published_depth_variance': 1e-3}
    assert described.retired_texts()[0].startswith(
        'parameter publish_decoded = True was retired with engine 1: it had no effect; '
    )


@pytest.mark.parametrize(
    ('version', 'error', 'sentence'),
    [
        (ENGINE_VERSION, ConfigError, 'with a parameter that is not known here: unknown'),
        (
            NEXT,
            BagError,
            f'with engine {NEXT}, not comparable with engine .*unknown parameter zor',
        ),
    ],
)
def test_an_unknown_parameter_is_refused(tmp_path, version, error, sentence):
    def change(info):
        info['params']['zork'] = 3
        info['engine_version'] = version

    path = described_again(tmp_path / 'b', change)
    with pytest.raises(error, match=sentence):
        load_comparable(open_bag(path))
    with pytest.raises(ConfigError, match=f'recorded with engine {version}, this is engine'):
        choose_follower(open_bag(path), None)


def test_a_replay_names_the_engine_and_what_was_retired(run):
    inputs, replayed = run
    described = describe(inputs.bag.node_infos[NODE])
    said = replay_summary(replayed, described)
    assert said['engine_version'] == {'recorded': 1, 'replayed': ENGINE_VERSION}
    assert said['retired_parameters'] == inputs.retired == described.retired_texts()
    assert len(inputs.retired) == 2


# -- comparison


@pytest.mark.parametrize(('metres', 'ok'), [(0.0, True), (1e-9, True), (1e-3, False)])
def test_another_engine_is_compared_in_sigma(newer, metres, ok):
    inputs, replayed = newer

    def change(message):
        message.r_e[0] += metres

    result = verify(inputs, replayed=moved(replayed, STATE, change))
    assert (result.engine_version, result.difference) == (1, None)
    assert result.ok is result.comparison.ok is ok
    assert bool(result.comparison.problems()) is not ok
    if not ok:
        assert 'sigma off in position at' in result.comparison.problems()[0]
        assert result.comparison.problems()[0].endswith('the limit is 1e-6 sigma')
    json.dumps(result.comparison.to_dict(), allow_nan=False)


def test_another_verdict_is_not_within(newer):
    inputs, replayed = newer

    def change(message):
        message.verdict, message.verdict_text = FixReceipt.GATED, 'GATED'

    result = verify(inputs, replayed=moved(replayed, RECEIPT, change))
    assert not result.ok
    (failure,) = result.comparison.failures
    assert failure.startswith('nav/receipt, message 5: fix ')
    assert ' was FUSED, replayed fix ' in failure
    assert failure.endswith(' GATED')


def test_runs_that_cannot_be_paired_are_not_comparable(newer):
    inputs, replayed = newer
    last = max(i for i, o in enumerate(replayed.outputs) if o.topic.endswith(STATE))
    outputs = [o for i, o in enumerate(replayed.outputs) if i != last]
    result = verify(inputs, replayed=dataclasses.replace(replayed, outputs=outputs))
    assert not result.ok
    assert result.comparison.problems() == [f'not comparable: {result.comparison.impossible}']
    assert '301 estimates against 300' in result.comparison.impossible


def test_a_recording_that_began_late_is_not_comparable(newer):
    inputs, replayed = newer
    (life,) = inputs.lives
    life = dataclasses.replace(life, messages=life.messages[1500:])
    late = dataclasses.replace(inputs, lives=(life,))
    comparison = compare(late, replayed)
    assert 'already navigating' in comparison.impossible


def test_messages_with_other_fields(run, monkeypatch):
    """Estimates of another engine are read by the definition in the bag, receipts cannot be."""
    inputs, replayed = run
    for topic, refused in ((STATE, False), (RECEIPT, True)):

        def installed(channel, topic=topic):
            return not channel.topic.endswith(topic)

        monkeypatch.setattr(verification, 'is_installed', installed)
        with pytest.raises(BagError, match=r'not comparable: .* has other fields'):
            require_comparable(dataclasses.replace(inputs, engine_version=ENGINE_VERSION))
        other = dataclasses.replace(inputs, engine_version=NEXT)
        if refused:
            with pytest.raises(BagError, match='not comparable'):
                require_comparable(other)
        else:
            result = verify(other, replayed=replayed)
            assert result.ok
            assert result.comparison.closeness.sigmas < 1e-6


def test_certificates_name_the_engine(run, monkeypatch):
    inputs, replayed = run
    result = verify(inputs, replayed=replayed)
    result = dataclasses.replace(result, equal=True, difference=None)
    given = certify(inputs, replayed, result)
    assert given.machine['engine_version'] == ENGINE_VERSION
    before = {k: v for k, v in given.machine.items() if k != 'engine_version'}
    older = dataclasses.replace(given, machine=before)
    named = [n for n in check(older, inputs, replayed, result).notes if 'engine' in n]
    assert named == [f'engine: certified with 1, here {ENGINE_VERSION}']
    stated = {**given.parameters, 'publish_decoded': True}
    older = dataclasses.replace(
        older, parameters=stated, parameters_sha256=certificate.parameters_sha256(stated)
    )
    assert not [f for f in check(older, inputs, replayed, result).failures if 'parameter' in f]
    monkeypatch.setattr(certificate, 'ENGINE_VERSION', NEXT)
    found = check(given, inputs, replayed, result)
    assert f'engine: certified with {ENGINE_VERSION}, here {NEXT}' in found.notes
    assert not found.same_place
    assert found.closeness.close
    other = dataclasses.replace(result, equal=False, comparison=compare(inputs, replayed))
    with pytest.raises(CertificateError, match=f'engine {NEXT} gives other bits'):
        certify(inputs, replayed, other)


def test_the_command(newer, monkeypatch, capsys):
    inputs, replayed = newer
    monkeypatch.setattr(verification, 'load_comparable', lambda *_: inputs)

    def polar(result, *arguments):
        from polar_nav_tools.replay import by_message

        monkeypatch.setattr(by_message, 'replay', lambda *_, **__: result)
        monkeypatch.setattr(sys, 'argv', ['polar', 'verify', str(REFERENCE), *arguments])
        status = main()
        said = capsys.readouterr()
        assert 'differ:' not in said.out + said.err
        return status, said.out, said.err

    def round_otherwise(message):
        message.r_e[0] += 1e-9

    near = moved(replayed, STATE, round_otherwise)
    status, out, _ = polar(near)
    assert status == 0
    assert 'recorded with engine 1: compared to 1e-6 sigma\n' in out
    assert 'parameter publish_decoded = True was retired with engine 1' in out

    def change(message):
        message.v_g = message.v_g + np.array([1.0, 0.0, 0.0])

    far = moved(replayed, STATE, change)
    status, _, err = polar(far)
    assert status == 1
    assert 'sigma off in velocity' in err
    status, out, _ = polar(far, '--json')
    said = json.loads(out)
    assert (status, said['ok'], said['first_difference']) == (1, False, None)
    assert said['engine_version'] == {'recorded': 1, 'replayed': ENGINE_VERSION}
    assert said['comparison']['largest_difference']['what'] == 'velocity'
    assert len(said['retired_parameters']) == 2
