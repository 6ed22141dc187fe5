"""Certificates: given for what is equal, checked here and as if elsewhere; damaged ones not."""

import dataclasses
import json
import sys
from pathlib import Path

import pytest

pytest.importorskip('rclpy')

from rclpy.serialization import deserialize_message

from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.errors import ConfigError
from polar_nav_follower import session
from polar_nav_msgs.msg import NavState
from polar_nav_ros import topics
from polar_nav_ros.cdr import to_bytes
from polar_nav_tools.bags import BagWriter, open_bag
from polar_nav_tools.cli import main
from polar_nav_tools.replay import certificate as module
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.replay.certificate import CertificateError, certify, check, read_certificate
from polar_nav_tools.replay.recorded import load_inputs
from polar_nav_tools.replay.verification import verify

REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """The reference bag's inputs with what the engine of today makes of them."""
    path = tmp_path_factory.mktemp('certified') / 'bag'
    source = open_bag(REFERENCE)
    wanted = {'/run_info', *(f'/follower/{topic}' for topic in session.INPUTS)} & set(
        source.topics
    )
    replayed = replay(source)
    with BagWriter(path, {'mission': 'reference', 'seed': 1}) as writer:
        for topic in wanted:
            described = source.definition(topic)
            writer.add_topic(topic, source.channel(topic).type, described=described)
        for topic, kind in ((topics.STATE, 'NavState'), (topics.RECEIPT, 'FixReceipt')):
            writer.add_topic(f'/follower/{topic}', f'polar_nav_msgs/msg/{kind}')
        for record in source.records(wanted):
            writer.write(record.topic, record.data, record.log_time_ns)
        for output in replayed.outputs:
            if output.topic.endswith((topics.STATE, topics.RECEIPT)):
                writer.write(output.topic, output.data, output.stamp_ns)
    return path


@pytest.fixture(scope='module')
def run(bag):
    # The parameters are those recorded, the outputs of today.
    inputs = dataclasses.replace(load_inputs(bag), engine_version=ENGINE_VERSION)
    replayed = replay(inputs)
    return inputs, replayed, verify(inputs, replayed=replayed)


@pytest.fixture(scope='module')
def given(run):
    return certify(*run)


def moved(replayed, metres, at=100):
    """Return the replay with one estimate moved."""
    outputs, seen = list(replayed.outputs), 0
    for i, output in enumerate(outputs):
        if not output.topic.endswith(topics.STATE):
            continue
        if seen == at:
            message = deserialize_message(output.data, NavState)
            message.r_e[0] += metres
            outputs[i] = dataclasses.replace(output, data=to_bytes(message))
        seen += 1
    digests = {**replayed.sha256, topics.STATE: 'another'}
    return dataclasses.replace(replayed, outputs=outputs, sha256=digests)


def elsewhere(given):
    return dataclasses.replace(given, machine={**given.machine, 'cpu': 'abacus'})


def test_it_holds_where_it_was_given(given, run, tmp_path):
    given.write(tmp_path / 'c.json')
    again = read_certificate(tmp_path / 'c.json')
    assert again == given
    found = check(again, *run)
    assert (found.ok, found.same_place, found.failures, found.closeness) == (True, True, (), None)


def test_it_names_what_bits_depend_on(given):
    said = given.to_dict()
    assert said['machine'].keys() == {
        'engine_version',
        'cpu',
        'python',
        'requirements_lock_sha256',
        'versions',
    }
    assert len(said['machine']['requirements_lock_sha256']) == 64
    assert said['machine']['versions']['numba']
    assert said['parameters']['configuration'] == said['run']['configuration']
    assert said['outputs'][topics.STATE]['messages'] > 100
    assert said['run']['seed'] == 1


def test_in_the_same_place_one_bit_is_too_much(given, run):
    inputs, replayed, _ = run
    other = moved(replayed, 1e-9)
    found = check(given, inputs, other, verify(inputs, replayed=other))
    assert not found.ok
    assert found.same_place
    assert any('does not give the certified bytes' in f for f in found.failures)
    assert 'message 100' in found.failures[-1]
    assert 'r_e[0]: live -5' in found.failures[-1]


@pytest.mark.parametrize(('metres', 'holds'), [(1e-9, True), (1e-3, False)])
def test_elsewhere_rounding_passes(given, run, metres, holds):
    inputs, replayed, _ = run
    other = moved(replayed, metres)
    found = check(elsewhere(given), inputs, other, verify(inputs, replayed=other))
    assert not found.same_place
    assert any('abacus' in note for note in found.notes)
    assert found.closeness is not None
    assert found.closeness.what == 'position'
    assert found.ok is holds, (found.closeness, found.failures)
    json.dumps(found.to_dict(), allow_nan=False)


def test_another_lock_file_is_elsewhere(given, run, monkeypatch):
    monkeypatch.setattr(module, 'lock_sha256', lambda: '')
    found = check(given, *run)
    assert (found.ok, found.same_place) == (True, False)
    assert any('requirements.lock' in note for note in found.notes)


def test_other_parameters_are_named(given, run):
    inputs, _, result = run
    other = replay(inputs, changes={'max_delay_s': 10.0})
    failures = check(given, inputs, other, result).failures
    assert any(f.startswith('parameter max_delay_s: certified') for f in failures)


def test_another_bag_is_not_this_one(given, run):
    other = dataclasses.replace(given, bag_sha256='0' * 64)
    assert any('not the bag' in f for f in check(other, *run).failures)


def test_none_is_given_for_a_difference(run):
    inputs, replayed, _ = run
    other = moved(replayed, 1.0)
    with pytest.raises(CertificateError, match=r'live and replay differ.*r_e\[0\]'):
        certify(inputs, other, verify(inputs, replayed=other))


@pytest.mark.parametrize(
    ('change', 'sentence'),
    [
        (lambda _: 'no JSON', 'not a certificate'),
        (lambda _: json.dumps([]), 'not a certificate'),
        (lambda said: json.dumps({**said, 'format': 'x'}), 'format is not'),
        (lambda said: json.dumps({**said, 'version': 9}), 'version 9'),
        (lambda said: json.dumps({k: said[k] for k in said if k != 'machine'}), 'lacks machine'),
        (lambda said: json.dumps({**said, 'outputs': {'nav/state': 3}}), 'damaged: nav/state'),
    ],
)
def test_damaged_certificates(given, tmp_path, change, sentence):
    path = tmp_path / 'c.json'
    path.write_text(change(given.to_dict()))
    with pytest.raises(CertificateError, match=sentence):
        read_certificate(path)


def test_a_certificate_that_is_not_there_is_a_wrong_call(tmp_path):
    with pytest.raises(ConfigError, match=r'nothing\.json: No such file'):
        read_certificate(tmp_path / 'nothing.json')


@pytest.mark.slow
def test_the_command(bag, tmp_path, monkeypatch, capsys):
    def polar(*arguments):
        monkeypatch.setattr(sys, 'argv', ['polar', *map(str, arguments)])
        status = main()
        said = capsys.readouterr()
        return status, said.out, said.err

    file = tmp_path / 'c.json'
    status, out, _ = polar('verify', bag, '--write-certificate', file, '--json')
    said = json.loads(out)
    assert (status, said['ok'], said['certificate_written']) == (0, True, str(file))
    status, out, _ = polar('verify', bag, '--certificate', file)
    assert status == 0
    assert 'the certificate holds' in out
    status, _, err = polar('verify', bag, '--write-certificate', file)
    assert (status, 'already' in err) == (2, True)
    content = json.loads(file.read_text())
    content['bag_sha256'] = '0' * 64
    file.write_text(json.dumps(content))
    status, out, err = polar('verify', bag, '--certificate', file, '--json')
    assert (status, json.loads(out)['ok']) == (1, False)
    assert 'not the bag' in err
