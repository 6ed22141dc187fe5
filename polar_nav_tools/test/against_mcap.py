"""Reads a file with this project's scanners and with mcap's own reader: the same comes out.

conftest.py has every bag that a test opens go through here, once per content.
"""

import hashlib
import struct

import pytest
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from polar_nav_tools.bags import Bag, BagError, chunks, opening
from polar_nav_tools.bags.tables import read_tables
from polar_nav_tools.bags.walk import CompiledWalk

LARGEST = 32 << 20
"""Bytes of a file that is still compared: mcap needs a second for 10 MB."""
TIME = ('header.stamp.sec', 'header.stamp.nanosec')
_STAMP = {0: struct.Struct('>iI'), 1: struct.Struct('<iI')}


class Comparison:
    """What stands in for `scan_file`: scans, and compares what the scan calls whole."""

    def __init__(self):
        self.compared = {}
        self._scan = opening.scan_file

    def __call__(self, path, progress=None, take=None):
        found = self._scan(path, progress, take)
        if found.finished and not found.problems and found.size <= LARGEST:
            key = hashlib.sha256(path.read_bytes()).digest()
            if key not in self.compared:
                self.compared[key] = compare(found)
        return found


@pytest.fixture(scope='session', autouse=True)
def bags_also_read_by_mcap():
    """Messages compared so far, by the hash of the file."""
    if isinstance(opening.scan_file, Comparison):  # two conftest.py ask for it
        yield opening.scan_file.compared
        return
    comparison = Comparison()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(opening, 'scan_file', comparison)
        yield comparison.compared


def compare(file):
    """Insist that a scanned file is what mcap makes of it; how many messages were compared."""
    schemas, channels, messages, metadata = by_mcap(file.path)
    assert file.channels.keys() == channels.keys()
    for number, channel in channels.items():
        mine, schema = file.channels[number], schemas.get(channel.schema_id)
        assert (mine.topic, mine.encoding) == (channel.topic, channel.message_encoding)
        assert mine.metadata == channel.metadata
        if schema is not None:
            assert (mine.type, mine.schema_encoding) == (schema.name, schema.encoding)
            assert mine.schema_text.encode() == schema.data
    assert file.metadata == metadata
    tallies = {number: tally(messages, number) for number in {m[0] for m in messages}}
    assert {n: vars(t) for n, t in file.tallies.items()} == tallies
    mine, payloads = [], []
    compiled = CompiledWalk()
    with file.path.open('rb') as stream:
        for block in file.blocks:
            content = block.load(stream)
            assert compiled.walk(content, lambda *_: None) == (block.usable, block.channels)
            mine += chunks.messages(content, block.usable)
            payloads += chunks.payloads(content, block.usable, block.channels)
    assert {n: vars(t) for n, t in compiled.tallies().items()} == tallies
    assert mine == messages
    assert payloads == [m[-1] for m in messages]
    compare_tables(file, messages)
    return len(messages)


def compare_tables(file, messages):
    """The pass that makes arrays: bytes of every topic, and the stamps where there are some."""
    bag = Bag(file.path, [file], [])
    one_channel = {c.topic: n for n, c in file.channels.items()}
    plain = [
        topic
        for topic, number in one_channel.items()
        if number in file.tallies
        and file.channels[number].encoding == 'cdr'
        and sum(c.topic == topic for c in file.channels.values()) == 1
    ]
    sent = {t: [m[-1] for m in messages if m[0] == one_channel[t]] for t in plain}
    assert read_tables(bag, {}, plain).payloads == sent
    for topic in plain:
        if not bag.definition(topic).has_header:
            continue
        try:
            stamps = read_tables(bag, {topic: [TIME]}).columns[topic][TIME[0]]
        except BagError:
            continue  # a test's message that is none of its type
        parts = [_STAMP[data[1] & 1].unpack_from(data, 4) for data in sent[topic]]
        assert stamps.tolist() == [s * 10**9 + ns for s, ns in parts]


def by_mcap(path):
    """Schemas, channels, messages and metadata in the order of the file, checksums compared."""
    schemas, channels, messages, metadata = {}, {}, [], []
    with path.open('rb') as stream:
        for record in StreamReader(stream, validate_crcs=True).records:
            match record:
                case Schema():
                    schemas[record.id] = record
                case Channel():
                    channels[record.id] = record
                case Metadata():
                    metadata.append((record.name, record.metadata))
                case Message():
                    r = record
                    m = (r.channel_id, r.sequence, r.log_time, r.publish_time, r.data)
                    messages.append(m)
    return schemas, channels, messages, metadata


def tally(messages, number):
    """What a scan counts of one channel."""
    own = [m for m in messages if m[0] == number]
    times = [m[2] for m in own]
    return {
        'count': len(own),
        'first_ns': min(times),
        'last_ns': max(times),
        'first_sequence': own[0][1],
        'last_sequence': own[-1][1],
    }
