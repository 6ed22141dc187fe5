"""What the index of a file claims, whether true or not, changes nothing of what is read."""

import dataclasses
import struct

import pytest
from bag_samples import records_of
from mcap.writer import CompressionType
from read_ahead import (
    both,
    small,
    usual,
    wants,
    without_checksum_of_the_index,
    written,
)

from polar_nav_tools.bags import chunks, claims, open_bag, opening, scan
from polar_nav_tools.bags.files import MAGIC


@pytest.mark.parametrize('more', [-1, 1, 1000, 1 << 40])
@pytest.mark.parametrize('number', range(3))
def test_statistics_that_lie(tmp_path, more, number):
    path = small(tmp_path)
    data = without_checksum_of_the_index(bytearray(path.read_bytes()))
    at = next(at for at, opcode, _ in records_of(data) if opcode == 0x0B)
    at += 9 + 42 + 4 + 10 * number + 2
    count = struct.unpack_from('<Q', data, at)[0]
    struct.pack_into('<Q', data, at, max(0, count + more))
    path.write_bytes(data)
    assert both(path) is False


def test_an_index_with_a_wrong_number_of_messages(tmp_path):
    path = small(tmp_path)
    data = without_checksum_of_the_index(bytearray(path.read_bytes()))
    at = next(at for at, opcode, _ in records_of(data) if opcode == 0x0B) + 9
    data[at] ^= 1
    path.write_bytes(data)
    assert both(path) is False
    assert 'the index counts' in ' '.join(open_bag(path, ahead=wants).problems)


UNUSED = {*range(16), *range(38, 46), *range(48, 64)}
"""Bytes of an entry for a chunk with two topics: times, places and size of message indices."""


@pytest.mark.parametrize('field', range(0, 88, 2))
def test_an_index_of_chunks_that_lies(tmp_path, monkeypatch, field):
    monkeypatch.setattr(opening, 'scan_file', scan.scan_file)  # mcap does not read such files
    path = small(tmp_path)
    data = without_checksum_of_the_index(bytearray(path.read_bytes()))
    entries = [(at, size) for at, opcode, size in records_of(data) if opcode == 0x08]
    at, size = entries[len(entries) // 2]
    assert field < size - 9
    data[at + 9 + field] ^= 0x41
    path.write_bytes(data)
    assert both(path) == (field in UNUSED)


def test_channels_that_the_index_names_otherwise(tmp_path):
    """Another type in the index than in front of the messages: a problem, in one pass and two."""
    path = small(tmp_path)
    data = without_checksum_of_the_index(bytearray(path.read_bytes()))
    places = [at for at, opcode, _ in records_of(data) if opcode == 0x04]
    for at in places:
        assert data[at + 9 : at + 11] != b'\0\0'
        changed = data.copy()
        changed[at + 9 + 8] = ord('~')  # first letter of the topic
        path.write_bytes(changed)
        assert both(path) is False
        assert 'and something else' in ' '.join(open_bag(path).problems)


def test_the_smallest_difference_between_index_and_file_is_one(tmp_path):
    path = small(tmp_path)
    claimed, found = claims.claimed_by_index(path), open_bag(path).files[0]
    assert claims.agrees(claimed, found)
    channels = dict(list(found.channels.items())[:-1])
    tallies = {n: dataclasses.replace(t, count=t.count + 1) for n, t in found.tallies.items()}
    for change in (
        {'finished': False},
        {'problems': ['something']},
        {'size': found.size + 1},
        {'modified_ns': found.modified_ns + 1},
        {'channels': channels},
        {'tallies': tallies},
        {'blocks': found.blocks[1:]},
        {'blocks': found.blocks[::-1]},
    ):
        assert not claims.agrees(claimed, dataclasses.replace(found, **change)), change


def test_an_index_that_is_damaged_or_contradicts_itself_claims_nothing(tmp_path):
    path = small(tmp_path)
    whole = path.read_bytes()
    records = list(records_of(whole))
    start = next(at for at, opcode, _ in records if opcode == 0x0F) + 13
    for at in range(start, len(whole), 7):
        data = bytearray(whole)
        data[at] ^= 1
        path.write_bytes(data)
        assert claims.claimed_by_index(path) is None, at
    channel, size = next((at, n) for at, opcode, n in records if opcode == 0x04)
    twice = bytearray(whole[channel : channel + size])
    twice[17] = ord('~')  # first letter of the topic
    end = len(whole) - len(MAGIC) - 29
    path.write_bytes(without_checksum_of_the_index(bytearray(whole[:end] + twice + whole[end:])))
    assert claims.claimed_by_index(path) is None
    statistics = next(at for at, opcode, _ in records if opcode == 0x0B) + 9 + 42 + 4 + 2
    data = without_checksum_of_the_index(bytearray(whole))
    struct.pack_into('<Q', data, statistics, 1 << 40)  # more than all chunks can hold
    path.write_bytes(data)
    assert claims.claimed_by_index(path) is None


def test_chunks_that_are_looked_at_early_are_verified(tmp_path):
    path = written(tmp_path / 'x.mcap', usual(), compression=CompressionType.NONE)
    block = claims.claimed_by_index(path).blocks[1]
    with path.open('rb') as stream:
        assert block.load(stream) == open_bag(path).files[0].blocks[1].load(stream)
        changes = {'offset': 1, 'stored': 1, 'size': 1, 'compression': 'zstd'}
        for name, change in changes.items():
            value = change if name == 'compression' else getattr(block, name) + change
            with pytest.raises(chunks.Damage):
                block._replace(**{name: value}).load(stream)
    content = bytearray(path.read_bytes())
    content[block.offset + 1] ^= 1  # length of the first message
    path.write_bytes(content)
    with path.open('rb') as stream, pytest.raises(chunks.Damage, match='checksum'):
        block.load(stream)
    crc_at = block.offset - 8 - 4 - 4  # in front of two lengths, that of a text without letters
    content[crc_at : crc_at + 4] = bytes(4)
    path.write_bytes(content)
    with path.open('rb') as stream, pytest.raises(chunks.Damage, match='not whole'):
        block.load(stream)
