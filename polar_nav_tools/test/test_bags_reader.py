"""The reader: whole bags of all kinds, and things that are no bags."""

import sqlite3
import struct

import numpy as np
import pytest
import yaml
from against_mcap import compare
from bag_samples import (
    IMU,
    RECEIPT,
    RUN_INFO,
    START_NS,
    TRUTH,
    TYPES,
    contents,
    imu,
    make,
    records_of,
    run_info,
    stamp_ns,
    truth,
    write_bag,
)
from mcap.writer import Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from polar_nav_tools.bags import BagError, BagWriter, open_bag, scan
from polar_nav_tools.bags.errors import WrongRequestError
from polar_nav_tools.bags.files import MAGIC

# -- whole bags


def test_whole_bag(tmp_path):
    file = write_bag(tmp_path / 'b', 60)
    for path in (file, file.parent, file.parent / 'metadata.yaml', str(file)):
        bag = open_bag(path)
        assert bag.problems == []
        assert bag.is_complete
        assert bag.message_count == 121
        assert {t.name: (t.type, t.count) for t in bag.topics.values()} == {
            IMU: (TYPES[IMU], 60),
            TRUTH: (TYPES[TRUTH], 60),
            RUN_INFO: (TYPES[RUN_INFO], 1),
        }
    assert len(bag.files[0].blocks) > 3
    assert contents(file)[1] == (IMU, START_NS + 1000, 1, imu(0))
    assert bag.run_info['seed'] == 7
    assert bag.run_info['recording']['state'] == 'finished'


def test_topics_are_selected(tmp_path):
    bag = open_bag(write_bag(tmp_path / 'b', 40))
    only = list(bag.messages([IMU, '/not/there']))
    assert len(only) == 40
    assert {t for t, _, _ in only} == {IMU}
    assert [m for m in bag.messages() if m[0] == IMU] == only


def test_typed_messages(tmp_path):
    bag = open_bag(write_bag(tmp_path / 'b', 5))
    got = list(bag.read(TRUTH))
    assert [t for t, _ in got] == [stamp_ns(k) + 2000 for k in range(5)]
    assert [m.sequence for _, m in got] == [0, 1, 2, 3, 4]
    assert np.array_equal(got[2][1].c_b_g, np.eye(3).ravel() + 2)


def test_typed_messages_by_the_definition_in_the_bag(tmp_path):
    """A type that nobody installed, and one that means something else here."""
    old = 'std_msgs/Header header\nfloat32 gone\n'
    header = '=' * 80 + '\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n'
    time = '=' * 80 + '\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n'
    file = tmp_path / 'foreign.mcap'
    with file.open('wb') as stream:
        writer = Writer(stream)
        writer.start('ros2', 'elsewhere')
        payload = b'\0\1\0\0' + struct.pack('<iII', 5, 6, 1) + b'\0\0\0\0' + struct.pack('<f', 2.5)
        for name in ('/whale', '/depth'):
            kind = {'/whale': 'sea/msg/Whale', '/depth': 'polar_nav_msgs/msg/Depth'}[name]
            schema = writer.register_schema(kind, 'ros2msg', (old + header + time).encode())
            channel = writer.register_channel(name, 'cdr', schema)
            writer.add_message(channel, 5, payload, 5)
        writer.finish()
    bag = open_bag(file)
    assert bag.is_complete
    assert bag.run_info == {}
    for name in ('/whale', '/depth'):
        assert bag.definition(name).has_header
        ((log_time, message),) = bag.read(name)
        assert (log_time, message.header.stamp.sec, message.gone) == (5, 5, 2.5)


def test_node_params(tmp_path):
    bag = open_bag(write_bag(tmp_path / 'b', 5))
    assert bag.node_params('/follower/follower_node') == {'window': 0.05}
    assert bag.node_infos['/follower/follower_node']['version'] == '0.1.0'
    with pytest.raises(BagError, match=r'node /x were recorded on /run_info; nodes there: /follo'):
        bag.node_params('/x')


def test_newest_run_info_of_a_node_counts(tmp_path):
    with BagWriter(tmp_path / 'b', {}) as writer:
        writer.add_topic(RUN_INFO, TYPES[RUN_INFO])
        for window in (1, 2):
            writer.write(RUN_INFO, run_info('/n', window=window), START_NS)
        writer.write(RUN_INFO, make(TYPES[RUN_INFO], data='no JSON'), START_NS)
    assert open_bag(tmp_path / 'b').node_params('/n') == {'window': 2}


@pytest.mark.parametrize('params', ['[1]', '5', '"x"', 'null'])
def test_parameters_that_are_no_mapping_are_ignored(tmp_path, params):
    with BagWriter(tmp_path / 'b', {}) as writer:
        writer.add_topic(RUN_INFO, TYPES[RUN_INFO])
        data = f'{{"node": "/n", "package": "p", "params": {params}}}'
        writer.write(RUN_INFO, make(TYPES[RUN_INFO], data=data), START_NS)
    assert open_bag(tmp_path / 'b').node_infos == {'/n': {'node': '/n', 'package': 'p'}}


def test_bags_of_other_writers(tmp_path):
    """rosbags' own MCAP, and MCAP without chunks, without checksums, without an index."""
    with RosbagsWriter(tmp_path / 'r', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        described = open_bag(write_bag(tmp_path / 'b', 2)).definition(IMU)
        connection = writer.add_connection(
            IMU, TYPES[IMU], msgdef=described.text, rihs01=described.type_hash
        )
        for k in range(300):
            writer.write(connection, stamp_ns(k), imu(k))
    bag = open_bag(tmp_path / 'r')
    assert bag.problems == []
    assert [d for _, _, d in bag.messages()] == [imu(k) for k in range(300)]

    bare = tmp_path / 'bare.mcap'
    with bare.open('wb') as stream:
        plain = Writer(
            stream,
            use_chunking=False,
            enable_crcs=False,
            repeat_channels=False,
            repeat_schemas=False,
            use_statistics=False,
            use_summary_offsets=False,
        )
        plain.start('ros2')
        schema = plain.register_schema(TYPES[IMU], 'ros2msg', described.text.encode())
        channel = plain.register_channel(IMU, 'cdr', schema)
        for k in range(300):
            plain.add_message(channel, stamp_ns(k), imu(k), stamp_ns(k))
            if k == 100:
                plain.add_attachment(1, 1, 'photo', 'image/png', bytes(5000))
        plain.finish()
    bag = open_bag(bare)
    assert bag.problems == []
    assert [d for _, _, d in bag.messages()] == [imu(k) for k in range(300)]
    assert len(bag.files[0].blocks) == 2


def test_large_unchunked_file_is_read_in_blocks(tmp_path):
    file = tmp_path / 'bare.mcap'
    with file.open('wb') as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start('ros2')
        channel = writer.register_channel('/raw', 'cdr', 0)
        for k in range(40):
            writer.add_message(channel, k, bytes([k]) * 100_000, k)
        writer.finish()
    bag = open_bag(file)
    assert [d[0] for _, _, d in bag.messages()] == list(range(40))
    assert max(b.size for b in bag.files[0].blocks) < 2_000_000


def test_split_bag(tmp_path):
    first, second = write_bag(tmp_path / 'x', 20), write_bag(tmp_path / 'y', 30)
    both = tmp_path / 'both'
    both.mkdir()
    first.rename(both / 'both_9.mcap')
    second.rename(both / 'both_10.mcap')
    bag = open_bag(both)  # without metadata.yaml, in order of number
    assert [f.path.name for f in bag.files] == ['both_9.mcap', 'both_10.mcap']
    assert bag.message_count == 41 + 61
    assert bag.topics[IMU].count == 50


# -- no bags


def test_things_that_are_no_bags(tmp_path):
    def refused(path, sentence):
        with pytest.raises(BagError, match=sentence) as error:
            open_bag(path)
        assert str(path) in str(error.value)
        assert '\n' not in str(error.value)

    refused(tmp_path / 'nothing', 'does not exist')
    refused(tmp_path, r'has no bag in it \(neither an .mcap file nor metadata.yaml\)')
    file = tmp_path / 'x.mcap'
    file.write_bytes(b'')
    refused(file, r'is empty \(0 bytes\)')
    file.write_bytes(MAGIC[:5])
    refused(file, 'ends within the first 8 bytes')
    file.write_bytes(b'GIF89a and so on')
    refused(file, 'not an MCAP file .it begins with b.GIF89a')
    file.write_bytes(b'#ROSBAG V2.0\n')
    refused(file, 'ROS 1 bag')
    file.write_bytes(MAGIC)
    refused(file, 'holds no message')
    file.write_bytes(MAGIC + bytes(100))
    refused(file, 'holds no message .*100 bytes are ignored')
    BagWriter(tmp_path / 'none', {}).finish()
    refused(tmp_path / 'none', 'holds no message$')
    other = tmp_path / 'sqlite'
    other.mkdir()
    with sqlite3.connect(other / 'a.db3') as base:
        base.execute('create table t (x)')
    refused(other, 'sqlite3 bag, not MCAP')
    refused(other / 'a.db3', 'sqlite3 bag, not MCAP')


@pytest.mark.parametrize(
    ('change', 'sentence'),
    [
        ({'storage_identifier': 'sqlite3'}, "stored as 'sqlite3', not MCAP"),
        ({'compression_mode': 'FILE'}, "compression mode 'file' of rosbag2 is not known"),
        ({'relative_file_paths': ['gone.mcap']}, 'names gone.mcap, not there'),
    ],
)
def test_directories_of_other_kinds(tmp_path, change, sentence):
    file = write_bag(tmp_path / 'b', 2)
    path = file.parent / 'metadata.yaml'
    content = yaml.safe_load(path.read_text())
    content['rosbag2_bagfile_information'] |= change
    path.write_text(yaml.safe_dump(content))
    if 'relative_file_paths' in change:
        file.unlink()
    with pytest.raises(BagError, match=sentence):
        open_bag(file.parent)


def test_unknown_compression(tmp_path):
    data = write_bag(tmp_path / 'b', 20, finish=False).read_bytes()
    file = tmp_path / 'x.mcap'
    file.write_bytes(data.replace(b'\4\0\0\0zstd', b'\4\0\0\0brot'))
    with pytest.raises(BagError, match='compressed with brot, which is not known here; zstd and'):
        open_bag(file)


def test_needed_topics(tmp_path):
    bag = open_bag(write_bag(tmp_path / 'b', 2))
    bag.require([IMU, TRUTH])
    with pytest.raises(BagError, match=f'no message on {RECEIPT}, /x; it has {IMU}, {TRUTH}'):
        bag.require([IMU, RECEIPT, '/x'])
    with pytest.raises(WrongRequestError, match=f'no message on /x; it has {IMU}, {TRUTH}'):
        bag.require(['/x'], named=True)
    with pytest.raises(BagError, match=f'has no topic {RECEIPT}; it has'):
        bag.definition(RECEIPT)
    with pytest.raises(BagError, match='no message on'):
        next(bag.read(RECEIPT))


def test_messages_that_are_none(tmp_path):
    with BagWriter(tmp_path / 'b', {}) as writer:
        writer.add_topic(TRUTH, TYPES[TRUTH])
        writer.write(TRUTH, truth(0)[:100], 1)
        writer.add_topic('/json', TYPES[IMU], encoding='json')
        writer.write('/json', b'{}', 1)
    bag = open_bag(tmp_path / 'b')
    with pytest.raises(BagError, match=f'a message on {TRUTH} is no {TYPES[TRUTH]}'):
        list(bag.read(TRUTH))
    for use in (bag.read, bag.payloads):
        with pytest.raises(BagError, match="/json is encoded as 'json', not as cdr"):
            list(use('/json'))


def test_file_that_changes_while_it_is_read(tmp_path):
    file = write_bag(tmp_path / 'b', 60, compression='none')
    bag = open_bag(file)
    data = bytearray(file.read_bytes())
    for at, opcode, size in records_of(data):
        if opcode == 6:
            data[at + size - 5] ^= 1
    file.write_bytes(data)
    with pytest.raises(BagError, match='was changed while it was read: the checksum of a chunk'):
        list(bag.messages())
    file.unlink()
    with pytest.raises(BagError, match='was changed while it was read'):
        list(bag.messages())


def test_progress_of_the_opening_goes_through_all_files(tmp_path, monkeypatch):
    monkeypatch.setattr(scan, '_REPORT_EVERY_BYTES', 2000)
    whole = write_bag(tmp_path / 'b', 60, chunk_bytes=1024)
    (tmp_path / 'b' / 'b_1.mcap').write_bytes(whole.read_bytes())
    (tmp_path / 'b' / 'metadata.yaml').unlink()
    shares = []
    bag = open_bag(tmp_path / 'b', shares.append)
    assert bag.message_count == open_bag(tmp_path / 'b').message_count
    assert len(shares) > 8
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert any(0.5 < s < 0.6 for s in shares)  # the second file follows on the first


@pytest.mark.parametrize(
    'harm',
    [
        lambda f: f.blocks.pop(),
        lambda f: f.blocks.reverse(),
        lambda f: next(iter(f.tallies.values())).__setattr__('last_ns', 1),
        lambda f: f.metadata.pop(),
        lambda f: f.channels.popitem(),
    ],
)
def test_the_comparison_with_mcap_sees_what_is_wrong(tmp_path, bags_also_read_by_mcap, harm):
    """conftest.py compares every bag that a test opens."""
    count = len(bags_also_read_by_mcap)
    file = open_bag(write_bag(tmp_path / 'b', 37, chunk_bytes=1024, compression='none')).files[0]
    assert len(bags_also_read_by_mcap) <= count + 1
    assert compare(file) == 37 * 2 + 1
    harm(file)
    with pytest.raises(AssertionError):
        compare(file)
