"""Recovery makes a bag that others open and that says what it lacks; info tells what is in it."""

import json

import pytest
from bag_samples import IMU, RUN_INFO, START_NS, TRUTH, TYPES, stamp_ns, write_bag
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from polar_nav_tools.bags import BagError, open_bag
from polar_nav_tools.bags.info import bag_info
from polar_nav_tools.bags.recover import recover


def broken(tmp_path, count=100):
    data = bytearray(write_bag(tmp_path / 'b', count, chunk_bytes=2000).read_bytes())
    middle = data.index(b'zstd', len(data) // 2) + 100  # within the data of a chunk
    data[middle : middle + 50] = bytes(50)
    path = tmp_path / 'broken.mcap'
    path.write_bytes(data[: len(data) * 3 // 4])
    return path


def test_recovered_bag_is_read_by_others_and_knows_what_it_lacks(tmp_path):
    path = broken(tmp_path)
    before = open_bag(path)
    done = recover(path, tmp_path / 'r')
    assert done.message_count == before.message_count > 100
    assert done.ignored_bytes == before.ignored_bytes > 0
    assert done.problems == tuple(before.problems)
    assert json.dumps(done.to_dict())

    after = open_bag(tmp_path / 'r')
    assert list(after.records()) == list(before.records())
    assert after.run_info == before.run_info
    assert {t: x.type for t, x in after.topics.items()} == {
        IMU: TYPES[IMU],
        TRUTH: TYPES[TRUTH],
        RUN_INFO: TYPES[RUN_INFO],
    }
    assert not after.is_complete
    assert any('recovered from a broken bag' in p for p in after.problems)
    assert any(f'messages of {IMU} are missing' in p for p in after.problems)
    assert after.channel(IMU).metadata == before.channel(IMU).metadata
    with AnyReader([tmp_path / 'r']) as reader:
        count = 0
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
            count += 1
    assert count == done.message_count

    again = recover(tmp_path / 'r', tmp_path / 'rr')
    assert again.message_count == done.message_count
    assert not open_bag(tmp_path / 'rr').is_complete


def test_whole_bag_stays_whole(tmp_path):
    write_bag(tmp_path / 'b', 20)
    assert recover(tmp_path / 'b', tmp_path / 'r').problems == ()
    bag = open_bag(tmp_path / 'r')
    assert bag.is_complete
    assert bag.run_info == open_bag(tmp_path / 'b').run_info


def test_foreign_bag_without_definitions_or_qos(tmp_path):
    with (tmp_path / 'x.mcap').open('wb') as stream:
        writer = Writer(stream)
        writer.start('ros2')
        channel = writer.register_channel('/raw', 'cbor', 0, {'offered_qos_profiles': '[{'})
        writer.add_message(channel, 5, b'abc', 6, 77)
        writer.flush()
    recover(tmp_path / 'x.mcap', tmp_path / 'r')
    (record,) = open_bag(tmp_path / 'r').records()
    assert record == ('/raw', 5, 6, 77, b'abc')
    assert open_bag(tmp_path / 'r').channel('/raw').encoding == 'cbor'


def test_what_recover_refuses(tmp_path):
    path = broken(tmp_path)
    with pytest.raises(BagError, match='exists already'):
        recover(path, tmp_path / 'b')
    path.write_bytes(b'not a bag')
    with pytest.raises(BagError, match='not an MCAP file'):
        recover(path, tmp_path / 'r')
    assert not (tmp_path / 'r').exists()


def test_info_of_a_whole_bag(tmp_path):
    file = write_bag(tmp_path / 'b', 101, compression='lz4')
    info = bag_info(tmp_path / 'b')
    assert info.files == ('b_0.mcap',)
    assert info.size_bytes == file.stat().st_size
    assert info.uncompressed_bytes > info.size_bytes
    assert info.compression == 'lz4'
    assert info.library == 'polar_nav_tools'
    assert info.message_count == 203
    assert (info.start_ns, info.stop_ns) == (START_NS, stamp_ns(100) + 2000)
    assert info.duration_s == pytest.approx(1.000002)
    topics = {t.name: t for t in info.topics}
    assert topics[IMU].rate_hz == pytest.approx(100.0)
    assert topics[IMU].first_ns == START_NS + 1000
    assert topics[RUN_INFO].rate_hz is None
    assert info.nodes == {
        '/follower/follower_node': {'package': 'polar_nav_follower', 'version': '0.1.0'}
    }
    assert info.run_info['mission'] == 'line'
    assert info.is_complete
    assert json.loads(json.dumps(info.to_dict()))['topics'][0]['name'] == IMU


def test_info_of_a_broken_bag(tmp_path):
    info = bag_info(broken(tmp_path))
    assert not info.is_complete
    assert info.problems
    assert info.ignored_bytes > 0
    assert bag_info(open_bag(tmp_path / 'broken.mcap')) == info
