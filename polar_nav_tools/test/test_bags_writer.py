"""The writer: what it writes opens elsewhere, says what it should, and fails with a sentence."""

import errno
import json
import os
import shutil
import subprocess
import sys
import textwrap

import pytest
import yaml
from bag_samples import IMU, RUN_INFO, START_NS, TRUTH, TYPES, imu, stamp_ns, truth, write_bag
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from strict_reader import strict_complaints

from polar_nav_tools.bags import BagError, BagWriter, open_bag
from polar_nav_tools.bags import sink as sink_module
from polar_nav_tools.bags.qos import Qos, request_for, to_yaml


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
def test_finished_bag_opens_in_rosbags_directory_and_file(tmp_path, compression):
    file = write_bag(tmp_path / 'b', 50, compression=compression)
    for path in (file.parent, file):
        with AnyReader([path]) as reader:
            found = {}
            for connection, log_time, raw in reader.messages():
                message = reader.deserialize(raw, connection.msgtype)
                found.setdefault(connection.topic, []).append((log_time, message))
    assert {t: len(m) for t, m in found.items()} == {IMU: 50, TRUTH: 50, RUN_INFO: 1}
    assert found[IMU][3][0] == stamp_ns(3) + 1000
    assert found[IMU][3][1].angular_velocity.x == 0.003
    assert found[TRUTH][49][1].sequence == 49


def test_finished_bag_opens_in_mcap_with_ros2_support(tmp_path):
    file = write_bag(tmp_path / 'b', 50)
    with file.open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = list(reader.iter_decoded_messages(topics=[TRUTH]))
        assert reader.get_header().profile == 'ros2'
        channel = decoded[0].channel
    assert [d.decoded_message.sequence for d in decoded] == list(range(50))
    assert decoded[7].message.publish_time == stamp_ns(7)
    assert [d.message.sequence for d in decoded] == list(range(1, 51))
    assert yaml.safe_load(channel.metadata['offered_qos_profiles'])[0]['reliability'] == 'reliable'
    assert channel.metadata['topic_type_hash'].startswith('RIHS01_')


def test_every_checksum_of_the_file_is_right(tmp_path):
    file = write_bag(tmp_path / 'b', 50)
    with file.open('rb') as stream:
        assert list(StreamReader(stream, validate_crcs=True).records)


def test_message_bytes_are_those_that_were_given(tmp_path):
    file = write_bag(tmp_path / 'b', 20)
    bag = open_bag(file.parent)
    assert [d for _, _, d in bag.messages([IMU])] == [imu(k) for k in range(20)]
    order = [topic for topic, _, _ in bag.messages()]
    assert order == [RUN_INFO, *[IMU, TRUTH] * 20]


def test_run_is_described_at_the_start_and_at_the_end(tmp_path):
    file = write_bag(tmp_path / 'b', 5)
    with file.open('rb') as stream:
        records = list(StreamReader(stream).records)
    runs = [r for r in records if type(r).__name__ == 'Metadata' and 'polar_nav' in r.name]
    assert [r.name for r in runs] == ['polar_nav_run', 'polar_nav_run_end']
    assert [r.metadata['written'] for r in runs] == ['start', 'end']
    assert all(json.loads(r.metadata['seed']) == 7 for r in runs)
    assert 'recording' not in runs[0].metadata
    assert json.loads(runs[1].metadata['recording'])['topics'][IMU]['count'] == 5
    kinds = [type(r).__name__ for r in records]
    assert kinds.index('Metadata') < kinds.index('Message')


def test_bags_that_have_both_descriptions_under_one_name_are_read(tmp_path):
    """As recorders before `polar_nav_run_end` wrote them."""
    path = tmp_path / 'old.mcap'
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2', library='')
        writer.add_metadata('polar_nav_run', {'seed': '7', 'phase': '"dawn"', 'written': 'start'})
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data')
        channel = writer.register_channel('/a', 'cdr', schema)
        writer.add_message(channel, 1, b'\0\1\0\0\2\0\0\0a\0', 1)
        writer.add_metadata(
            'polar_nav_run',
            {'phase': '"dusk"', 'recording': '{"topics": {"/a": {"count": 2}}}', 'written': 'end'},
        )
        writer.finish()
    bag = open_bag(path)
    assert (bag.run_info['seed'], bag.run_info['phase']) == (7, 'dusk')
    assert bag.problems == ['/a: the recorder wrote 2 messages, 1 are there']


def test_start_description_is_on_disk_before_any_message(tmp_path):
    writer = BagWriter(tmp_path / 'b', {'seed': 7})
    with writer.path.open('rb') as stream:
        reader = StreamReader(stream).records
        assert next(reader).profile == 'ros2'
        assert next(reader).metadata == {'seed': '7', 'written': 'start'}
    writer.abandon()


def test_metadata_yaml_has_what_rosbag2_expects(tmp_path):
    file = write_bag(tmp_path / 'night run', 50)
    content = yaml.safe_load((file.parent / 'metadata.yaml').read_text())
    info = content['rosbag2_bagfile_information']
    assert info['version'] == 9
    assert info['storage_identifier'] == 'mcap'
    assert info['relative_file_paths'] == ['night run_0.mcap']
    assert info['message_count'] == 101
    assert info['starting_time'] == {'nanoseconds_since_epoch': START_NS}
    assert info['duration'] == {'nanoseconds': stamp_ns(49) + 2000 - START_NS}
    assert info['compression_format'] == ''
    assert info['compression_mode'] == ''
    assert info['ros_distro'] == 'jazzy'
    assert info['custom_data'] is None
    assert info['files'][0]['message_count'] == 101
    assert info['files'][0]['path'] == 'night run_0.mcap'
    topics = {t['topic_metadata']['name']: t for t in info['topics_with_message_count']}
    assert topics[IMU]['message_count'] == 50
    about = topics[IMU]['topic_metadata']
    assert about['type'] == 'sensor_msgs/msg/Imu'
    assert about['serialization_format'] == 'cdr'
    assert about['type_description_hash'].startswith('RIHS01_')
    profile = about['offered_qos_profiles'][0]
    assert profile['history'] == 'keep_last'
    assert profile['deadline'] == {'sec': 9223372036, 'nsec': 854775807}
    with Reader(file.parent) as reader:  # rosbags' own check of all fields
        assert reader.message_count == 101


def test_file_alone_carries_the_metadata_for_ros2_bag(tmp_path):
    file = write_bag(tmp_path / 'b', 5)
    with file.open('rb') as stream:
        records = [m for m in make_reader(stream).iter_metadata() if m.name == 'rosbag2']
    info = yaml.safe_load(records[0].metadata['serialized_metadata'])
    assert info['message_count'] == 11


def test_topic_without_messages_is_listed(tmp_path):
    writer = BagWriter(tmp_path / 'b', {})
    for topic in (IMU, TRUTH):
        writer.add_topic(topic, TYPES[topic])
    writer.write(TRUTH, truth(0), START_NS)
    writer.finish()
    assert open_bag(tmp_path / 'b').topics[IMU].count == 0
    assert open_bag(tmp_path / 'b').is_complete


def test_existing_directory_is_never_touched(tmp_path):
    (tmp_path / 'b').mkdir()
    (tmp_path / 'b' / 'precious').write_text('x')
    with pytest.raises(BagError, match='exists already; a bag is never overwritten'):
        BagWriter(tmp_path / 'b', {})
    assert [p.name for p in (tmp_path / 'b').iterdir()] == ['precious']


def test_directory_that_cannot_be_made(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagError, match='cannot make this bag'):
        BagWriter(tmp_path / 'file' / 'b', {})


@pytest.mark.parametrize(
    ('options', 'info', 'sentence'),
    [({'compression': 'brotli'}, {}, "'brotli' is none of"), ({}, {'x': object()}, 'JSON')],
)
def test_wrong_arguments_leave_nothing_behind(tmp_path, options, info, sentence):
    with pytest.raises(BagError, match=sentence):
        BagWriter(tmp_path / 'b', info, **options)
    assert not (tmp_path / 'b').exists()


def test_topic_is_added_once_and_its_type_is_known(tmp_path):
    with BagWriter(tmp_path / 'b', {}) as writer:
        writer.add_topic(IMU, TYPES[IMU])
        with pytest.raises(BagError, match='added before'):
            writer.add_topic(IMU, TYPES[IMU])
        with pytest.raises(BagError, match='package marine_things is not installed'):
            writer.add_topic('/x', 'marine_things/msg/Whale')


def test_exception_in_the_block_abandons_but_keeps(tmp_path):
    def fail(writer):
        writer.add_topic(IMU, TYPES[IMU])
        writer.write(IMU, imu(0), START_NS)
        writer.flush()
        raise RuntimeError('elsewhere')

    with pytest.raises(RuntimeError), BagWriter(tmp_path / 'b', {}) as writer:
        fail(writer)
    assert not (tmp_path / 'b' / 'metadata.yaml').exists()
    assert open_bag(tmp_path / 'b').message_count == 1


def test_flush_follows_the_clock(tmp_path):
    now = [0.0]
    writer = BagWriter(tmp_path / 'b', {}, flush_s=0.5, clock=lambda: now[0])
    writer.add_topic(IMU, TYPES[IMU])

    def readable():
        try:
            return open_bag(writer.path).message_count
        except BagError:
            return 0

    writer.write(IMU, imu(0), stamp_ns(0))
    assert readable() == 0
    now[0] = 0.5
    writer.write(IMU, imu(1), stamp_ns(1))
    assert readable() == 2
    now[0] = 0.9
    writer.write(IMU, imu(2), stamp_ns(2))
    writer.tick()
    assert readable() == 2
    now[0] = 1.0
    writer.tick()  # no message came, the timer did
    assert readable() == 3
    size = writer.size
    now[0] = 2.0
    writer.tick()  # nothing to write: no empty chunk
    assert writer.size == size
    writer.abandon()


class FullDisk:
    """os.write of a disk with little room, which takes part of what it cannot take whole."""

    def __init__(self, room):
        self.room = room
        self.write = os.write

    def __call__(self, fd, data):
        if self.room <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken = self.write(fd, bytes(data[: self.room]))
        self.room -= taken
        return taken


def write_truth(writer, count):
    for k in range(count):
        writer.write(TRUTH, truth(k), stamp_ns(k))


@pytest.mark.parametrize('room', [9_000, 9_500, 20_011, 33_333])
def test_full_disk_gives_one_sentence_and_keeps_what_was_written(tmp_path, monkeypatch, room):
    writer = BagWriter(tmp_path / 'b', {'seed': 1}, compression='none', chunk_bytes=4096)
    writer.add_topic(TRUTH, TYPES[TRUTH])
    monkeypatch.setattr(sink_module.os, 'write', FullDisk(room))
    with pytest.raises(BagError, match=r'No space left on device\); the first \d+ messages') as no:
        write_truth(writer, 1000)
    writer.abandon()
    monkeypatch.undo()
    bag = open_bag(tmp_path / 'b')
    assert f'the first {bag.message_count} messages' in str(no.value)
    assert bag.message_count > 0
    assert [d for _, _, d in bag.messages()] == [truth(k) for k in range(bag.message_count)]
    assert not bag.is_complete
    assert bag.ignored_bytes == 0  # the half-written chunk was taken back


def test_file_size_limit_of_the_system(tmp_path):
    """The same with a real limit of the operating system, in a process of its own."""
    script = """
        import resource, signal, sys
        from pathlib import Path
        sys.path.insert(0, sys.argv[2])
        from bag_samples import *
        from polar_nav_tools.bags import BagError
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))
        try:
            write_bag(Path(sys.argv[1]), 1000, compression='none')
        except BagError as error:
            print(error)
    """
    here = os.path.dirname(__file__)  # noqa: PTH120 - handed on as text
    done = subprocess.run(
        [sys.executable, '-c', textwrap.dedent(script), str(tmp_path / 'b'), here],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    bag = open_bag(tmp_path / 'b')
    assert f'the first {bag.message_count} messages are in it' in done.stdout
    assert 20 < bag.message_count < 100


@pytest.mark.parametrize('sync', [True, False])
def test_disk_is_waited_for_when_asked(tmp_path, monkeypatch, sync):
    calls = []
    monkeypatch.setattr(sink_module.os, 'fdatasync', calls.append)
    writer = BagWriter(tmp_path / 'b', {}, sync=sync)
    writer.add_topic(IMU, TYPES[IMU])
    assert len(calls) == 1
    writer.write(IMU, imu(0), START_NS)
    writer.flush()
    assert len(calls) == (2 if sync else 1)
    writer.finish()
    assert len(calls) == (3 if sync else 2)


@pytest.mark.parametrize('last_step', ['write', 'tick', 'finish'])
@pytest.mark.parametrize('loss', ['folder', 'file', 'moved', 'replaced'])
def test_bag_that_vanishes_is_noticed_at_the_next_flush(tmp_path, loss, last_step):
    now = [0.0]
    writer = BagWriter(tmp_path / 'b', {}, clock=lambda: now[0])
    writer.add_topic(IMU, TYPES[IMU])
    writer.write(IMU, imu(0), START_NS)
    if loss == 'folder':
        shutil.rmtree(tmp_path / 'b')
    elif loss == 'moved':
        (tmp_path / 'b').rename(tmp_path / 'c')
    else:
        writer.path.unlink()
    if loss == 'replaced':
        writer.path.write_bytes(b'')
    now[0] = 1.0
    steps = {
        'write': lambda: writer.write(IMU, imu(1), START_NS + 1),
        'tick': writer.tick,
        'finish': writer.finish,
    }
    with pytest.raises(BagError, match='was removed or moved while it was being written'):
        steps[last_step]()
    writer.abandon()
    if loss == 'moved':  # what was written before is in it
        assert b'polar_nav_run' in (tmp_path / 'c' / 'b_0.mcap').read_bytes()


def test_qos_that_every_offer_satisfies():
    reliable, latched = Qos(), Qos(durability='transient_local')
    assert request_for([reliable]) == (True, False)
    assert request_for([latched, latched]) == (True, True)
    assert request_for([latched, reliable]) == (True, False)
    assert request_for([reliable, Qos(reliability='best_effort')]) == (False, False)
    assert request_for([]) == (True, False)
    assert to_yaml([]) == ''


def test_a_strict_reader_finds_nothing_to_complain_of(tmp_path):
    """An index of no attachments, or a topic declared in the summary only, would be an error."""
    writer = BagWriter(tmp_path / 'b', {'mission': 'line'}, chunk_bytes=4096)
    writer.add_topic(TRUTH, TYPES[TRUTH])
    for k in range(100):
        writer.write(TRUTH, truth(k), stamp_ns(k), stamp_ns(k))
    writer.flush()
    writer.add_topic('/silent', TYPES[IMU])  # declared behind the last message
    writer.add_topic('/silent_too', TYPES[IMU])
    writer.add_topic('/silent_truth', TYPES[TRUTH])  # its type stands among the data already
    writer.finish()
    assert strict_complaints(writer.path) == []
