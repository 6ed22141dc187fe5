"""Damaged bags of all kinds: no other exception than BagError, no hang, no flood of memory."""

import contextlib
import io
import itertools
import resource
import zlib

import numpy as np
import pytest
from bag_samples import (
    IMU,
    RECEIPT,
    RUN_INFO,
    TRUTH,
    TYPES,
    imu,
    make,
    run_info,
    stamp_ns,
    truth,
    write_bag,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from polar_nav_tools.bags import BagError, arrays, open_bag
from polar_nav_tools.bags.info import bag_info
from polar_nav_tools.bags.recover import recover
from polar_nav_tools.bags.schemas import definition

MOST_MEMORY_KB = 400_000
FUZZ = settings(
    max_examples=150, deadline=20_000, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
ODD_BYTES = st.sampled_from([b'\0', b'\xff', b'\x7f' * 8, b'\0' * 8, b'\x04\0\0\0zstd', b'\x06'])


def unchecked_bag():
    """A bag without checksums, so that damage inside of messages gets through to the decoders."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE, chunk_size=2000, enable_crcs=False)
    writer.start('ros2')
    writer.add_metadata('polar_nav_run', {'seed': '1', 'recording': '{"topics": {}}'})
    channels = {}
    for topic, name in TYPES.items():
        schema = writer.register_schema(name, 'ros2msg', definition(name).text.encode())
        channels[topic] = writer.register_channel(topic, 'cdr', schema)
    receipt = make(TYPES[RECEIPT], reason='late', source='leader')
    for k in range(5):
        for topic, data in (
            (IMU, imu(k)),
            (TRUTH, truth(k)),
            (RECEIPT, receipt),
            (RUN_INFO, run_info('/n')),
        ):
            writer.add_message(channels[topic], stamp_ns(k), data, stamp_ns(k))
    writer.finish()
    return stream.getvalue()


@pytest.fixture(scope='module')
def seeds(tmp_path_factory):
    base = tmp_path_factory.mktemp('seeds')
    bags = [
        write_bag(base / c, 12, compression=c, chunk_bytes=2000).read_bytes()
        for c in ('zstd', 'lz4', 'none')
    ]
    return [*bags, unchecked_bag()]


@st.composite
def damage(draw):
    """A list of changes, each at a relative place: cut, change, remove, repeat, insert."""
    kinds = ['cut', 'change', 'change', 'change', 'remove', 'repeat', 'insert', 'odd']
    return draw(
        st.lists(
            st.tuples(
                st.sampled_from(kinds),
                st.floats(0, 1),
                st.integers(1, 200),
                st.binary(min_size=1, max_size=12),
                ODD_BYTES,
            ),
            min_size=1,
            max_size=5,
        )
    )


def apply(data, changes):
    data = bytearray(data)
    for kind, place, length, some, odd in changes:
        at = int(place * len(data))
        if kind == 'cut':
            del data[at:]
        elif kind == 'change':
            data[at : at + len(some)] = some
        elif kind == 'odd':
            data[at : at + len(odd)] = odd
        elif kind == 'remove':
            del data[at : at + length]
        elif kind == 'repeat':
            data[at:at] = data[at : at + length]
        else:
            data[at:at] = some
    return bytes(data)


def use_everything(path):
    """Whatever a command does with a bag; returns False if it cannot be opened at all."""
    try:
        bag = open_bag(path)
    except BagError:
        return False
    assert sum(1 for _ in bag.messages()) == bag.message_count > 0
    bag_info(bag).to_dict()
    for topic in bag.topics:
        for use in (
            lambda topic=topic: list(itertools.islice(bag.read(topic), 50)),
            lambda topic=topic: bag.definition(topic),
        ):
            attempt(use)
    attempt(lambda: arrays.load_truth(bag, 'follower'))
    attempt(lambda: arrays.load_receipts(bag, 'follower'))
    attempt(lambda: bag.node_params('/n'))
    return True


def attempt(use):
    with contextlib.suppress(BagError):
        use()


def resident_kb():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@FUZZ
@given(which=st.integers(0, 3), changes=damage())
def test_damaged_bags(seeds, tmp_path, which, changes):
    before = resident_kb()
    original = seeds[which]
    data = apply(original, changes)
    path = tmp_path / 'x.mcap'
    path.write_bytes(data)
    if use_everything(path) and data != original and which < 3:
        # These have checksums over everything: a change does not go unnoticed.
        assert open_bag(path).problems
    assert resident_kb() - before < MOST_MEMORY_KB


@FUZZ
@given(data=st.binary(max_size=300), magic=st.booleans())
def test_any_bytes(tmp_path, data, magic):
    path = tmp_path / 'x.mcap'
    path.write_bytes(b'\x89MCAP0\r\n' * magic + data)
    use_everything(path)


@settings(FUZZ, max_examples=40)
@given(which=st.integers(0, 3), changes=damage())
def test_recovered_bags_open(seeds, tmp_path_factory, which, changes):
    folder = tmp_path_factory.mktemp('r')
    path = folder / 'x.mcap'
    path.write_bytes(apply(seeds[which], changes))
    try:
        done = recover(path, folder / 'out')
    except BagError:
        assert not (folder / 'out' / 'metadata.yaml').exists()
        return
    bag = open_bag(folder / 'out')
    assert bag.message_count == done.message_count
    assert bag.is_complete == (not done.problems)


@pytest.mark.slow
@settings(FUZZ, max_examples=60)
@given(text=st.text(max_size=200), tail=st.binary(max_size=60))
def test_any_metadata_yaml(seeds, tmp_path, text, tail):
    folder = tmp_path / 'bag'
    folder.mkdir(exist_ok=True)
    (folder / 'bag_0.mcap').write_bytes(seeds[0])
    path = folder / 'metadata.yaml'
    for content in (
        text.encode(),
        tail,
        b'rosbag2_bagfile_information:\n  ' + text.encode(),
        b'rosbag2_bagfile_information: {storage_identifier: mcap, message_count: ' + tail + b'}',
    ):
        path.write_bytes(content)
        use_everything(folder)


@pytest.mark.parametrize('length', [2**16, 2**31, 2**32 - 1, 2**40, 2**63, 2**64 - 1])
def test_enormous_lengths(seeds, tmp_path, length):
    """Every 8 and 4 byte field of the small bag in turn becomes an enormous number."""
    before = resident_kb()
    data = seeds[3]
    path = tmp_path / 'x.mcap'
    places = np.random.default_rng(zlib.crc32(str(length).encode())).integers(8, len(data) - 8, 60)
    for at in [*range(8, 60), *places]:
        raw = length.to_bytes(8, 'little') if length > 2**32 else length.to_bytes(4, 'little')
        path.write_bytes(data[:at] + raw + data[at + len(raw) :])
        use_everything(path)
    assert resident_kb() - before < MOST_MEMORY_KB
