"""The reader on bags that are cut off, damaged, or made to hurt."""

import io
import json
import os
import struct

import numpy as np
import pytest
import yaml
import zstandard
from bag_samples import (
    IMU,
    RUN_INFO,
    START_NS,
    TRUTH,
    TYPES,
    contents,
    imu,
    make,
    records_of,
    stamp_ns,
    write_bag,
)
from mcap.writer import CompressionType, Writer

from polar_nav_tools.bags import BagError, BagWriter, open_bag, scan, window
from polar_nav_tools.bags import chunks as chunks_module
from polar_nav_tools.bags.files import MAGIC


def small_bag(directory):
    """A bag of few bytes with everything in it that a bag has, for tests that try every byte."""
    writer = BagWriter(directory, {'seed': 7}, chunk_bytes=150)
    writer.add_topic('/a', TYPES[RUN_INFO])
    writer.add_topic('/b', TYPES[RUN_INFO])
    for k in range(8):
        for topic in ('/a', '/b'):
            writer.write(topic, make(TYPES[RUN_INFO], data=f'{topic} {k}'), START_NS + k)
    counts = {t: {'count': n, 'lost': 0} for t, n in writer.counts.items()}
    writer.finish({'recording': {'state': 'finished', 'topics': counts}})
    return writer.path


# -- cut off and damaged bags


def test_killed_recording(tmp_path):
    file = write_bag(tmp_path / 'b', 60, finish=False)
    bag = open_bag(file.parent)
    assert bag.message_count == 121
    assert not bag.is_complete
    (problem,) = bag.problems
    assert 'was not finished; the last message is of 1600000000.590 s (2020-09-13T12:26' in problem
    assert bag.run_info == {'seed': 7, 'mission': 'line'}


@pytest.mark.slow
def test_cut_anywhere(tmp_path):
    """Every length of a small bag: never another exception, never more or other messages."""
    data = small_bag(tmp_path / 'b').read_bytes()
    whole = contents(tmp_path / 'b')
    records = records_of(data)
    chunk_ends = [at + size for at, opcode, size in records if opcode == 6]
    assert len(chunk_ends) > 4
    cut, counts = tmp_path / 'cut.mcap', []
    cut.write_bytes(data)
    for length in reversed(range(len(data))):
        os.truncate(cut, length)
        try:
            bag = open_bag(cut)
        except BagError:
            counts.append(0)
            continue
        assert bag.problems, length
        got = [(r.topic, r.log_time_ns, r.sequence, r.data) for r in bag.records()]
        assert got == whole[: len(got)]
        counts.append(len(got))
        # No whole chunk is given up, and what is ignored is an incomplete record.
        begun = max(at for at, _, _ in records if at <= length)
        assert bag.ignored_bytes in (0, length - begun, length - len(data) + len(MAGIC))
    counts.reverse()
    assert counts == sorted(counts)
    for end in chunk_ends:
        assert counts[end] > counts[end - 1]


@pytest.mark.slow
@pytest.mark.parametrize('flip', [0x01, 0xFF])
def test_every_changed_byte_is_noticed(tmp_path, flip):
    """Checksums cover everything: no bag with a changed byte looks whole."""
    data = bytearray(small_bag(tmp_path / 'b').read_bytes())
    whole = contents(tmp_path / 'b')
    changed = tmp_path / 'changed.mcap'
    changed.write_bytes(data)
    stream = changed.open('r+b', buffering=0)
    for at in range(len(data)):
        if at:
            os.pwrite(stream.fileno(), data[at - 1 : at], at - 1)
        os.pwrite(stream.fileno(), bytes([data[at] ^ flip]), at)
        try:
            bag = open_bag(changed)
        except BagError:
            continue
        assert bag.problems, f'byte {at}'
        got = [(r.topic, r.log_time_ns, r.sequence, r.data) for r in bag.records()]
        assert set(got) <= set(whole), f'byte {at}'
    stream.close()


def test_reading_goes_on_behind_damage(tmp_path):
    """A changed byte costs the chunk it is in, and the reader tells how many messages that is."""
    data = bytearray(write_bag(tmp_path / 'b', 100, chunk_bytes=2000).read_bytes())
    chunks = [(at, size) for at, opcode, size in records_of(data) if opcode == 6]
    at, size = chunks[len(chunks) // 2]
    data[at + size // 2] ^= 0xFF
    (tmp_path / 'x.mcap').write_bytes(data)
    bag = open_bag(tmp_path / 'x.mcap')
    lost = 201 - bag.message_count
    assert 0 < lost < 15
    text = ' '.join(bag.problems)
    missing = 100 - bag.topics[IMU].count, 100 - bag.topics[TRUTH].count
    assert sum(missing) == lost
    assert f'{missing[0]} messages of {IMU} are missing' in text
    assert bag.ignored_bytes == size - 9
    assert max(t for _, t, _ in bag.messages()) == stamp_ns(99) + 2000


def test_topics_are_found_in_the_index_when_their_declaration_is_damaged(tmp_path):
    data = bytearray(write_bag(tmp_path / 'b', 100, chunk_bytes=2000).read_bytes())
    at, size = next((at, size) for at, opcode, size in records_of(data) if opcode == 6)
    data[at + size // 2] ^= 0xFF
    (tmp_path / 'x.mcap').write_bytes(data)
    bag = open_bag(tmp_path / 'x.mcap')
    assert 180 < bag.message_count < 201
    assert list(bag.read(TRUTH))[-1][1].sequence == 99


def test_damaged_index_is_not_called_an_unfinished_recording(tmp_path):
    data = write_bag(tmp_path / 'b', 20).read_bytes()
    (tmp_path / 'x.mcap').write_bytes(data[:-100])
    bag = open_bag(tmp_path / 'x.mcap')
    assert bag.message_count == 41
    assert 'x.mcap: the index behind all messages is damaged or cut off' in bag.problems


def test_search_behind_a_broken_length(tmp_path):
    data = bytearray(write_bag(tmp_path / 'b', 100, chunk_bytes=2000).read_bytes())
    chunks = [(at, size) for at, opcode, size in records_of(data) if opcode == 6]
    at, size = chunks[2]
    data[at + 8] = 0x7F  # a length of many exabytes
    hole = 3000
    data[chunks[6][0] : chunks[6][0] + hole] = bytes(hole)  # and a hole of zeros, as disks leave
    (tmp_path / 'x.mcap').write_bytes(data)
    bag = open_bag(tmp_path / 'x.mcap')
    assert 130 < bag.message_count < 201
    assert max(t for _, t, _ in bag.messages()) == stamp_ns(99) + 2000
    assert size < bag.ignored_bytes < len(data) // 2


def test_trailing_zeros_after_a_power_cut(tmp_path):
    file = write_bag(tmp_path / 'b', 60, finish=False)
    with file.open('ab') as stream:
        stream.write(bytes(5000))
    bag = open_bag(file)
    assert bag.message_count == 121
    assert bag.ignored_bytes == 5000


def test_bytes_behind_the_end(tmp_path):
    file = write_bag(tmp_path / 'b', 5)
    with file.open('ab') as stream:
        stream.write(b'x')
    assert 'behind the end mark' in open_bag(file).problems[0]


def test_recorder_counts_are_compared(tmp_path):
    writer = BagWriter(tmp_path / 'b', {})
    writer.add_topic(IMU, TYPES[IMU])
    writer.write(IMU, imu(0), START_NS)
    counts = {IMU: {'count': 2, 'lost': 3}, '/gone': {'count': 1, 'lost': None}}
    writer.finish({'recording': {'topics': counts}})
    assert open_bag(tmp_path / 'b').problems == [
        f'{IMU}: the recorder wrote 2 messages, 1 are there',
        f'{IMU}: 3 messages were lost on the way to the recorder',
        '/gone: the recorder wrote 1 messages, 0 are there',
    ]


def test_metadata_yaml_is_compared(tmp_path):
    file = write_bag(tmp_path / 'b', 5)
    path = file.parent / 'metadata.yaml'
    content = yaml.safe_load(path.read_text())
    content['rosbag2_bagfile_information']['message_count'] = 99
    path.write_text(yaml.safe_dump(content))
    assert open_bag(file.parent).problems == ['metadata.yaml counts 99 messages, 11 can be read']
    content['rosbag2_bagfile_information']['relative_file_paths'].append('b_1.mcap')
    path.write_text(yaml.safe_dump(content))
    assert 'b_1.mcap, which metadata.yaml names, does not exist' in open_bag(file.parent).problems
    path.write_text('a: [')
    assert 'not YAML' in open_bag(file.parent).problems[0]
    assert open_bag(file.parent).message_count == 11


def test_one_topic_with_two_types(tmp_path):
    file = tmp_path / 'two.mcap'
    with file.open('wb') as stream:
        writer = Writer(stream)
        writer.start('ros2')
        for name in ('a/msg/A', 'a/msg/B'):
            schema = writer.register_schema(name, 'ros2msg', b'uint8 x\n')
            channel = writer.register_channel('/t', 'cdr', schema)
            writer.add_message(channel, 1, b'\0\1\0\0\7', 1)
        writer.finish()
    bag = open_bag(file)
    assert bag.message_count == 1
    assert 'is a a/msg/A and a a/msg/B; 1 messages of the latter are ignored' in bag.problems[0]


# -- bytes that want too much memory


def chunk_record(compression, data, size, crc=0):
    name = compression.encode()
    body = struct.pack('<QQQII', 1, 1, size, crc, len(name)) + name
    body += struct.pack('<Q', len(data)) + data
    return b'\x06' + struct.pack('<Q', len(body)) + body


def bomb(tmp_path, compression, data, size):
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE, use_chunking=False)
    writer.start('ros2')
    channel = writer.register_channel('/raw', 'cdr', 0)
    writer.add_message(channel, 1, b'x', 1)
    file = tmp_path / 'bomb.mcap'
    file.write_bytes(stream.getvalue() + chunk_record(compression, data, size))
    return open_bag(file)


def test_compressed_bombs_are_not_blown_up(tmp_path):
    huge = 1 << 33
    compressed = zstandard.ZstdCompressor().compress(bytes(1 << 24))
    assert 'claims' in bomb(tmp_path, 'zstd', compressed, huge).problems[0]
    assert (
        'claims 16777216 instead of 1000' in bomb(tmp_path, 'zstd', compressed, 1000).problems[0]
    )
    stream = zstandard.ZstdCompressor(write_content_size=False).compressobj()
    unknown = stream.compress(bytes(1 << 24)) + stream.flush()
    assert 'cannot be decompressed' in bomb(tmp_path, 'zstd', unknown, 1000).problems[0]
    lz4 = chunks_module.lz4.frame.compress(bytes(1 << 24))
    bag = bomb(tmp_path, 'lz4', lz4, 1000)
    assert 'records that are not whole' in bag.problems[0]
    assert bag.message_count == 1


def test_run_description_that_is_damaged(tmp_path):
    stream = (tmp_path / 'x.mcap').open('wb')
    writer = Writer(stream)
    writer.start('ros2')
    writer.add_metadata('polar_nav_run', {'seed': '{{', 'recording': '[]', 'mission': 'null'})
    channel = writer.register_channel('/raw', 'cdr', 0)
    writer.add_message(channel, 1, b'x', 1)
    writer.finish()
    stream.close()
    bag = open_bag(tmp_path / 'x.mcap')
    assert bag.problems == ['seed in a polar_nav_run record is not JSON']
    assert bag.run_info == {'seed': None, 'recording': [], 'mission': None}
    assert json.dumps(bag.run_info)


# -- how a file is gone through


def test_a_window_gives_the_bytes_of_the_file(tmp_path):
    data = np.random.default_rng(7).bytes(40_000)
    (tmp_path / 'x').write_bytes(data)
    rng = np.random.default_rng(8)
    with (tmp_path / 'x').open('rb') as file, pytest.MonkeyPatch.context() as patch:
        patch.setattr(window, 'PIECE', 1000)
        one = window.Window(file, len(data))
        for _ in range(2000):  # forwards, backwards, behind the end
            at, size = int(rng.integers(0, 41_000)), int(rng.integers(0, 3000))
            assert one.get(at, size) == data[at : at + size]
            assert one.held(at)[:size] == data[at : at + size]


@pytest.mark.parametrize('number', [0, 1])
@pytest.mark.parametrize('longer', [True, False])
def test_message_indices_of_a_wrong_length(tmp_path, number, longer):
    """Without checksums only their lengths tell; the first of several, and one behind it."""
    path = tmp_path / 'x.mcap'
    with path.open('wb') as stream:
        writer = Writer(stream, chunk_size=2000, enable_crcs=False)
        writer.start('ros2')
        channels = [writer.register_channel(t, 'cdr', 0) for t in ('/a', '/b')]
        for k in range(200):
            writer.add_message(channels[k % 2], k, bytes(40), k)
        writer.finish()
    data = bytearray(path.read_bytes())
    indices = [(at, size) for at, opcode, size in records_of(data) if opcode == 7]
    at, size = indices[4 + number]
    length = struct.unpack_from('<I', data, at + 11)[0]
    struct.pack_into('<I', data, at + 11, length + 1)
    if longer:  # the record is as long as it says, but no whole number of entries
        struct.pack_into('<Q', data, at + 1, size - 9 + 1)
        data[at + size : at + size] = b'x'
    path.write_bytes(data)
    problems = open_bag(path).problems
    assert any(f'a message index has a wrong length (byte {at})' in p for p in problems)


def test_channels_are_told_in_the_order_of_the_file(tmp_path, monkeypatch):
    """And so are sentences on them, whoever counts."""
    path = tmp_path / 'x.mcap'
    with path.open('wb') as stream:
        writer = Writer(stream, chunk_size=500)
        writer.start('ros2')
        channels = [writer.register_channel(t, 'cdr', 0) for t in ('/a', '/b', '/c')]
        for k in range(90):
            writer.add_message(channels[2 - k // 30], k, bytes(40), k)
        writer.finish()
    for least in (0, 1 << 40):
        monkeypatch.setattr(scan, 'COMPILED_FROM', least)
        assert list(open_bag(path).files[0].tallies) == channels[::-1]
