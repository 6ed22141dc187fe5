"""What is read while a bag is opened is what reading it afterwards gives, or nothing at all."""

import gc
import shutil
import weakref
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_samples import IMU, TRUTH, TYPES, imu, make, records_of, stamp, stamp_ns, truth, write_bag
from mcap.writer import CompressionType, IndexType, Writer
from read_ahead import (
    OMEGA,
    RAW,
    TIME,
    WANTED,
    both,
    equal,
    small,
    usual,
    wants,
    without_checksum_of_the_index,
    written,
)

from polar_nav_tools.bags import BagError, ahead, claims, open_bag, opening, scan, tables
from polar_nav_tools.bags.request import Request
from polar_nav_tools.bags.schemas import definition
from polar_nav_tools.bags.tables import read_tables


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
@pytest.mark.parametrize('chunk_bytes', [500, 8 * 1024, 1 << 20])
@pytest.mark.parametrize('compiled', [True, False])
def test_whole_bags(tmp_path, monkeypatch, compression, chunk_bytes, compiled):
    monkeypatch.setattr(scan, 'COMPILED_FROM', 0 if compiled else 1 << 40)
    assert both(write_bag(tmp_path / 'bag', compression=compression, chunk_bytes=chunk_bytes))
    assert both(tmp_path / 'bag')


def test_only_the_scan_reads_blocks(tmp_path, monkeypatch):
    """One pass: nothing but the first messages of each topic is decompressed twice."""
    path = write_bag(tmp_path / 'bag', 400, chunk_bytes=2000)
    open_bag(path)  # what every test does with a new bag is done (against_mcap.py)
    inflate, done = claims.chunks.inflate, []

    def counting(*args):
        done.append(args)
        return inflate(*args)

    monkeypatch.setattr(claims.chunks, 'inflate', counting)
    bag = open_bag(path, ahead=wants)
    blocks = len(bag.files[0].blocks)
    assert blocks > 50
    assert blocks < len(done) <= blocks + 5
    read_tables(bag, WANTED, RAW)
    assert len(done) <= blocks + 5


def test_the_arrays_are_given_once_and_only_for_the_same_request(tmp_path):
    path = write_bag(tmp_path / 'bag')
    bag = open_bag(path, ahead=wants)
    first = read_tables(bag, WANTED, RAW)
    again = read_tables(bag, WANTED, RAW)
    assert first.columns[IMU][OMEGA[0]] is not again.columns[IMU][OMEGA[0]]
    equal(first, again)
    bag = open_bag(path, ahead=wants)
    fewer = read_tables(bag, {IMU: (TIME,)})
    assert fewer.columns.keys() == {IMU}
    assert fewer.columns[IMU].keys() == {TIME[0]}
    assert bag.read_ahead is None


def test_what_is_not_used_is_not_kept(tmp_path, monkeypatch):
    """Its memory is free before another pass takes as much."""
    bag = open_bag(write_bag(tmp_path / 'bag'), ahead=wants)
    column = weakref.ref(bag.read_ahead.tables.columns[IMU][OMEGA[0]].base)
    monkeypatch.setattr(tables, '_passed', lambda *_: column())
    gc.disable()  # no cycle keeps it
    try:
        assert column() is not None
        assert read_tables(bag, {IMU: (TIME,)}) is None
    finally:
        gc.enable()


def test_progress_is_told(tmp_path):
    path = write_bag(tmp_path / 'bag')
    told = []
    bag = open_bag(path, told.append, ahead=wants)
    assert told[-1] == 1.0
    read_tables(bag, WANTED, RAW, progress=told.append)
    assert told[-2:] == [1.0, 1.0]


def test_bags_of_several_files(tmp_path):
    """Rows go on from file to file; a file that is damaged makes the whole bag wait."""
    folder = tmp_path / 'bag'
    folder.mkdir()
    for k, count in enumerate((100, 30, 250)):
        shutil.copy(write_bag(tmp_path / f'{k}', count, chunk_bytes=3000), folder / f'b_{k}.mcap')
    assert both(folder)
    file = folder / 'b_1.mcap'
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    assert not both(folder)


def test_files_that_number_their_channels_otherwise(tmp_path):
    folder = tmp_path / 'bag'
    folder.mkdir()
    other = ('/words', 'std_msgs/msg/String', b'\0\1\0\0\2\0\0\0x\0')
    mixed = [m for one in usual(30) for m in (other, one)]
    for k, messages in enumerate(([*usual(40)], mixed, [*usual(20)][::-1])):
        written(folder / f'b_{k}.mcap', messages)
    assert both(folder)
    numbers = [{n: c.topic for n, c in f.channels.items()} for f in open_bag(folder).files]
    assert numbers[0] != numbers[1] != numbers[2] != numbers[0]


def test_a_bag_that_metadata_yaml_counts_otherwise(tmp_path):
    """A problem of the bag, not of what is in its files: it stays a problem."""
    path = write_bag(tmp_path / 'bag', 5).parent / 'metadata.yaml'
    content = yaml.safe_load(path.read_text())
    content['rosbag2_bagfile_information']['message_count'] = 99
    path.write_text(yaml.safe_dump(content))
    assert both(path.parent)
    assert open_bag(path.parent, ahead=wants).problems


# -- bags that others write


OPTIONS = {
    'chunks': ({}, True),
    'lz4': ({'compression': CompressionType.LZ4}, True),
    'plain': ({'compression': CompressionType.NONE}, True),
    'no checksums': ({'enable_crcs': False}, True),
    'data checksum': ({'enable_data_crcs': True}, True),
    'no chunks': ({'use_chunking': False}, False),
    'no statistics': ({'use_statistics': False}, False),
    'no summary offsets': ({'use_summary_offsets': False}, True),
    'no index of chunks': ({'index_types': IndexType.MESSAGE}, False),
    'no index of messages': ({'index_types': IndexType.CHUNK}, False),
    'no index': ({'index_types': IndexType.NONE}, False),
    'topics not repeated': ({'repeat_channels': False}, False),
    'types not repeated': ({'repeat_schemas': False}, False),
}


@pytest.mark.parametrize('name', OPTIONS)
def test_what_mcap_can_be_told_to_write(tmp_path, name):
    options, in_one_pass = OPTIONS[name]
    assert both(written(tmp_path / 'x.mcap', usual(), **options)) == in_one_pass


def test_one_topic_with_two_types(tmp_path):
    """The first type counts, whichever the index names first."""
    messages = [*usual(20), *((IMU, TYPES[TRUTH], truth(k)) for k in range(20))]
    for order in (messages, messages[::-1]):
        path = written(tmp_path / 'x.mcap', order)
        both(path)
        assert 'messages of the latter are ignored' in open_bag(path).problems[0]


def test_an_index_that_names_another_type_first(tmp_path, monkeypatch):
    """Nothing in the file is damaged; what the topic is, depends on the order in the index."""
    monkeypatch.setattr(opening, 'scan_file', scan.scan_file)
    path = written(
        tmp_path / 'x.mcap', [*usual(20), *((IMU, TYPES[TRUTH], truth(k)) for k in range(25))]
    )
    request = Request({IMU: (TIME,)})  # fields that both have
    assert both(path, request)
    data = without_checksum_of_the_index(bytearray(path.read_bytes()))
    end = next(at for at, opcode, _ in records_of(data) if opcode == 0x0F)
    places = [(at, n) for at, opcode, n in records_of(data) if opcode == 0x04 and at > end]
    a, b = [(at, n) for at, n in places if IMU.encode() in data[at : at + n]]
    assert a[1] == b[1]
    first, second = (bytes(data[at : at + n]) for at, n in (a, b))
    data[a[0] : sum(a)], data[b[0] : sum(b)] = second, first
    path.write_bytes(data)
    assert both(path, request) is False


def test_a_topic_on_two_channels(tmp_path):
    path = tmp_path / 'x.mcap'
    with path.open('wb') as stream:
        writer = Writer(stream, chunk_size=2000)
        writer.start('ros2')
        text = definition(TYPES[IMU]).text.encode()
        schema = writer.register_schema(TYPES[IMU], 'ros2msg', text)
        channels = [writer.register_channel(IMU, 'cdr', schema, {'n': n}) for n in 'ab']
        for k in range(100):
            writer.add_message(channels[k % 3 == 0], stamp_ns(k), imu(k), stamp_ns(k))
        writer.finish()
    assert both(path)
    assert len(read_tables(open_bag(path, ahead=wants), WANTED, RAW).columns[IMU][TIME[0]]) == 100


def test_messages_that_are_none_of_their_type(tmp_path):
    messages = [(IMU, TYPES[IMU], imu(k)[: 40 if k == 50 else None]) for k in range(100)]
    path = written(tmp_path / 'x.mcap', messages)
    assert both(path) is False
    with pytest.raises(BagError, match='ends before'):
        read_tables(open_bag(path, ahead=wants), WANTED, RAW)


def test_layouts_that_change(tmp_path):
    def frame(k):
        return make(TYPES[IMU], **stamp(stamp_ns(k)), header__frame_id='x' * (k % 7))

    assert both(written(tmp_path / 'x.mcap', ((IMU, TYPES[IMU], frame(k)) for k in range(200))))


# -- damage


def test_a_record_of_each_kind_damaged(tmp_path):
    """First, middle and last byte of one record of each kind, and of its header."""
    path = small(tmp_path)
    whole = path.read_bytes()
    kinds = {}
    for at, opcode, size in records_of(whole):
        kinds.setdefault(opcode, []).append((at, size))
    assert {0x01, 0x02, 0x03, 0x04, 0x06, 0x07, 0x08, 0x0B, 0x0C, 0x0E, 0x0F} <= kinds.keys()
    path = tmp_path / 'x.mcap'
    for records in kinds.values():
        at, size = records[len(records) // 2]
        for place in {at, at + 1, at + 8, at + 9, at + 9 + (size - 9) // 2, at + size - 1}:
            data = bytearray(whole)
            data[place] ^= 0x10
            path.write_bytes(data)
            assert not both(path), place


@pytest.mark.slow
def test_every_byte_damaged_and_every_length(tmp_path):
    path = write_bag(tmp_path / 'bag', 3, chunk_bytes=1000)
    whole = path.read_bytes()
    path = tmp_path / 'x.mcap'
    for at in range(0, len(whole), 17):
        data = bytearray(whole)
        data[at] ^= 0xFF
        path.write_bytes(data)
        assert not both(path), at
        path.write_bytes(whole[:at])
        assert not both(path), at


def test_cut_off_at_many_places(tmp_path):
    path = small(tmp_path)
    whole = path.read_bytes()
    path = tmp_path / 'x.mcap'
    ends = {at for at, _, _ in records_of(whole)}
    for length in sorted({*ends, *(e + 5 for e in ends), *range(0, len(whole), 997)}):
        path.write_bytes(whole[:length])
        assert not both(path), length
    path.write_bytes(whole)
    assert both(path)


def test_bytes_behind_the_end_and_recordings_that_were_not_finished(tmp_path):
    path = small(tmp_path)
    path.write_bytes(path.read_bytes() + b'x')
    assert both(path) is False
    assert both(write_bag(tmp_path / 'open', 50, finish=False)) is False


def test_a_file_that_changes_while_it_is_opened(tmp_path, monkeypatch):
    """The index is of one recording, the messages are of another one."""
    path, other = small(tmp_path), write_bag(tmp_path / 'other', 31, chunk_bytes=2000)
    start = ahead.begin

    def exchanged(*args):
        prepared = start(*args)
        path.write_bytes(other.read_bytes())
        return prepared

    monkeypatch.setattr(ahead, 'begin', exchanged)
    bag = open_bag(path, ahead=wants)
    assert bag.read_ahead is None
    assert len(read_tables(bag, WANTED, RAW).columns[IMU][TIME[0]]) == 31


@pytest.mark.parametrize('error', [BagError('no'), MemoryError()])
def test_wishes_that_cannot_be_told(tmp_path, error):
    def fails(_):
        raise error

    path = small(tmp_path)
    assert open_bag(path, ahead=fails).read_ahead is None
    assert open_bag(path, ahead=lambda _: None).read_ahead is None
    assert both(path, Request({IMU: ('nix',)})) is False


def test_damage_is_told_before_anything_is_read(tmp_path):
    """What `open_bag` gives is verified to its end, with and without arrays."""
    path = small(tmp_path)
    data = bytearray(path.read_bytes())
    last = [(at, size) for at, opcode, size in records_of(data) if opcode == 0x06][-1]
    data[last[0] + last[1] - 3] ^= 1
    path.write_bytes(data)
    bag = open_bag(path, ahead=wants)
    assert bag.problems
    assert bag.read_ahead is None


def test_arrays_need_no_compiler_where_none_are_wanted():
    """A small bag is opened in less time than it takes to load it."""
    text = Path(opening.__file__).read_text()
    assert '\nfrom .ahead' not in text
    assert np.__name__ not in text
