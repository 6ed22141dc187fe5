"""One pass over a bag to arrays: against mcap's own reader, on bags of all kinds, and on noise."""

import dataclasses
import random
import struct
from pathlib import Path

import numpy as np
import pytest
from bag_samples import IMU, STATE, TRUTH, TYPES, imu, make, stamp, stamp_ns, truth, write_bag
from mcap.reader import make_reader

from polar_nav_tools.bags import BagError, BagWriter, open_bag, scan
from polar_nav_tools.bags.chunks import messages, other, walk
from polar_nav_tools.bags.columns import read_columns
from polar_nav_tools.bags.kernels import records
from polar_nav_tools.bags.schemas import definition
from polar_nav_tools.bags.tables import read_tables

REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'
TIME = ('header.stamp.sec', 'header.stamp.nanosec')
OMEGA = tuple(f'angular_velocity.{a}' for a in 'xyz')
IMU_FIELDS = (TIME, OMEGA, 'linear_acceleration.z', 'angular_velocity_covariance')
TRUTH_FIELDS = (*TIME, 'r_e', 'c_b_g', 'sequence', 'altitude')


def by_mcap(file):
    """Bytes by topic, as mcap's reader has them, in the order of the file."""
    found = {}
    with file.open('rb') as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append(message.data)
    return found


def flat(fields):
    return [n for names in fields for n in ([names] if isinstance(names, str) else names)]


def check(path, wanted, raw=(), file=None):
    """The pass gives what decoding mcap's messages gives."""
    bag = open_bag(path)
    expected = by_mcap(file or bag.files[0].path)
    found = read_tables(bag, wanted, raw)
    for topic, fields in wanted.items():
        if topic not in expected:
            assert topic not in found.columns
            continue
        described = bag.definition(topic)
        slow = read_columns(
            expected[topic], described.type, described.text, flat(fields), max_layouts=0
        )
        for names in fields:
            first = names if isinstance(names, str) else names[0]
            column = found.columns[topic][first]
            if isinstance(names, str):
                other_column = slow[names]
            elif names == TIME:
                seconds = slow[TIME[0]].astype(np.int64)
                other_column = seconds * 1_000_000_000 + slow[TIME[1]]
            else:
                other_column = np.stack([slow[n] for n in names], axis=1)
            assert column.dtype == other_column.dtype
            np.testing.assert_array_equal(column, other_column)
    for topic in raw:
        assert found.payloads[topic] == expected.get(topic, [])
    return found


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
@pytest.mark.parametrize('chunk_bytes', [500, 8 * 1024, 1 << 20])
def test_as_mcap_reads_it(tmp_path, compression, chunk_bytes):
    path = write_bag(tmp_path / 'bag', compression=compression, chunk_bytes=chunk_bytes)
    wanted = {IMU: IMU_FIELDS, TRUTH: TRUTH_FIELDS, STATE: [TIME]}
    found = check(path, wanted, ['/run_info', '/nothing'])
    assert found.odd == {IMU: 0, TRUTH: 0}


def test_the_reference_bag():
    check(REFERENCE, {IMU: IMU_FIELDS, TRUTH: TRUTH_FIELDS}, ['/follower/acomms/rx'])


@pytest.mark.parametrize('every', [1, 2, 7])
def test_layouts_that_change(tmp_path, every):
    """Frames of other names, big-endian messages, and one with a tail."""
    writer = BagWriter(tmp_path / 'bag', {}, chunk_bytes=4096)
    writer.add_topic(IMU, TYPES[IMU])
    for k in range(300):
        data = imu(k)
        if k % every == 0 and k > 100:
            data = make(
                TYPES[IMU],
                **stamp(stamp_ns(k)),
                header__frame_id='x' * (k % 23),
                angular_velocity__x=0.5 * k,
            )
        if k == 50:
            data += b'mo'
        if k == 60:
            data = big_endian(k)
        writer.write(IMU, data, stamp_ns(k))
    writer.finish({})
    found = check(tmp_path / 'bag', {IMU: IMU_FIELDS})
    assert found.odd[IMU] >= 3


def big_endian(k):
    from bag_samples import store

    types = store(TYPES[IMU])
    message = types.deserialize_cdr(imu(k), TYPES[IMU])
    return types.serialize_cdr(message, TYPES[IMU], little_endian=False).tobytes()


def test_many_odd_messages_in_one_block(tmp_path):
    """More of them than the scanner can hand over at once."""
    writer = BagWriter(tmp_path / 'bag', {}, chunk_bytes=64 << 20)
    name = 'std_msgs/msg/String'
    writer.add_topic('/words', name)
    words = [make(name, data=str(k)) for k in range(10_000)]
    for k, data in enumerate(words):
        writer.write('/words', data, stamp_ns(k))
    writer.finish({})
    assert read_tables(open_bag(tmp_path / 'bag'), {}, ['/words']).payloads['/words'] == words


def test_a_message_that_is_none_of_its_type(tmp_path):
    writer = BagWriter(tmp_path / 'bag', {})
    writer.add_topic(IMU, TYPES[IMU])
    for k in range(9):
        writer.write(IMU, imu(k)[: 40 if k == 5 else None], stamp_ns(k))
    writer.finish({})
    with pytest.raises(BagError, match=r'imu/data_raw.*ends before'):
        read_tables(open_bag(tmp_path / 'bag'), {IMU: IMU_FIELDS})


@pytest.mark.parametrize(
    ('fields', 'text'),
    [
        (['nix'], 'no field nix'),
        (['header.frame_id'], 'no field header.frame_id'),
        ([(OMEGA[0], OMEGA[2])], 'side by side'),
    ],
)
def test_fields_that_cannot_be(tmp_path, fields, text):
    bag = open_bag(write_bag(tmp_path / 'bag', 5))
    with pytest.raises(BagError, match=text):
        read_tables(bag, {IMU: fields})


def test_a_file_that_was_changed_after_it_was_opened(tmp_path):
    path = write_bag(tmp_path / 'bag', compression='none')
    bag = open_bag(path)
    content = bytearray(path.read_bytes())
    at = content.index(truth(7)) + 40
    content[at] ^= 1
    path.write_bytes(content)
    with pytest.raises(BagError, match='was changed while it was read'):
        read_tables(bag, {IMU: IMU_FIELDS})


def test_a_damaged_bag_gives_what_the_messages_give(tmp_path):
    path = write_bag(tmp_path / 'bag', 400, chunk_bytes=4096)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(content)
    bag = open_bag(path)
    assert bag.problems
    found = read_tables(bag, {IMU: IMU_FIELDS})
    described = definition(TYPES[IMU])
    slow = read_columns(bag.payloads(IMU), described.type, described.text, [OMEGA[0]])
    np.testing.assert_array_equal(found.columns[IMU][OMEGA[0]][:, 0], slow[OMEGA[0]])
    assert 0 < len(slow[OMEGA[0]]) < 400


@pytest.mark.parametrize('finish', [True, False])
def test_counted_by_compiled_code(tmp_path, monkeypatch, finish):
    path = write_bag(tmp_path / 'bag', 300, finish=finish)
    content = path.read_bytes()
    for end in (len(content), len(content) - 2000, len(content) // 2):
        path.write_bytes(content[:end])
        slow = open_bag(path)
        monkeypatch.setattr(scan, 'COMPILED_FROM', 0)
        fast = open_bag(path)
        monkeypatch.undo()
        assert fast.problems == slow.problems
        for a, b in zip(fast.files, slow.files, strict=True):
            assert dataclasses.asdict(a) == dataclasses.asdict(b)


# -- the kernels on blocks of noise ---------------------------------------------------------------

LAYOUT = struct.pack('<HH', 256, 0), struct.pack('<IB', 5, 97) + b'bcd\0'
SIZE = 48
GUARD = 512


def record(opcode, body):
    return struct.pack('<BQ', opcode, len(body)) + body


def block_of(rnd):
    """Records, some of which are damaged: bytes changed, cut off, lengths that lie."""
    out = []
    for k in range(rnd.randrange(30)):
        if rnd.random() < 0.7:
            data = bytearray(LAYOUT[0] + struct.pack('<iI', k, 7) + LAYOUT[1])
            data += bytes(3) + struct.pack('<3d', k, 2, 3)
            if rnd.random() < 0.3:
                data[rnd.randrange(len(data))] = rnd.randrange(256)
            if rnd.random() < 0.2:
                data = data[: rnd.randrange(len(data) + 1)]
            front = struct.pack('<HIQQ', rnd.choice((1, 2, 65535)), k, rnd.randrange(1 << 64), 0)
            out.append(record(5, front + data))
        else:
            opcode = rnd.randrange(1, 16) if rnd.random() < 0.9 else 5
            out.append(record(opcode, rnd.randbytes(rnd.randrange(40))))
    block = bytearray(b''.join(out))
    if block and rnd.random() < 0.5:
        for _ in range(rnd.randrange(1, 4)):
            block[rnd.randrange(len(block))] = rnd.randrange(256)
    return bytes(block[: rnd.randrange(len(block) + 1)] if rnd.random() < 0.3 else block)


def taken(block, capacity):
    """Run the kernel with guards around its memory; where it ended, odd ones, rows, buffer."""
    slots = np.full(65536, -1, dtype=np.int16)
    slots[1], slots[65535] = 0, 1
    parts = [[4, 8, 0], [24, 24, 8 * capacity]]
    tables = np.array(
        [[0, capacity, capacity, SIZE, 0, 2, 0, 2], [0, capacity, capacity, -1, 2, 2, 2, 2]]
    )
    guarded = np.full(32 * capacity + 2 * GUARD, 0xAB, dtype=np.uint8)
    buffer = guarded[GUARD : GUARD + 32 * capacity]
    odd, io, found, at = np.zeros((3, 4), np.int64), np.zeros(1, np.int64), [], 0
    content = np.frombuffer(block, np.uint8)
    template = np.frombuffer(LAYOUT[0][:2] + LAYOUT[1], np.uint8)
    checks = np.array([[0, 2, 0], [12, 9, 2]])
    while at not in (len(block), records.BROKEN):
        at = int(
            records.take(
                content, at, len(block), slots, tables, checks, template, np.array(parts),
                buffer, buffer.view(np.int64), odd, io,
            )
        )  # fmt: skip
        found += [tuple(row) for row in odd[: io[0]].tolist()]
        io[0] = 0
    assert (guarded[:GUARD] == 0xAB).all()
    assert (guarded[-GUARD:] == 0xAB).all()
    return at, found, tables[:, records.ROWS].tolist(), buffer.tobytes()


@pytest.mark.parametrize('seed', range(4))
def test_blocks_that_may_be_anything(seed):
    rnd = random.Random(seed)
    broken = whole = 0
    for _ in range(400):
        block = block_of(rnd)
        end = counted(block)
        at, odd, rows, buffer = taken(block, 40)
        assert (at == records.BROKEN) == (end != len(block))
        taken(block, 2)  # too few rows: it stops
        taken(rnd.randbytes(rnd.randrange(200)), 5)
        if end != len(block):
            broken += 1
            continue
        whole += 1
        for slot, channel in enumerate((1, 65535)):
            mine = [m.data for m in messages(block, end) if m.channel == channel]
            assert rows[slot] == len(mine)
            left = {row: block[a : a + n] for s, row, a, n in odd if s == slot}
            for row, data in enumerate(mine):
                same = data[:2] == LAYOUT[0][:2] and data[12:21] == LAYOUT[1]
                if slot == 0 and len(data) == SIZE and same:
                    assert row not in left
                    assert buffer[8 * row : 8 * row + 8] == data[4:12]
                    assert buffer[320 + 24 * row : 344 + 24 * row] == data[24:48]
                else:
                    assert left[row] == data
    assert min(broken, whole) > 20


def counted(block):
    """Where the records end, the same by both ways of counting."""
    seen = {}
    end = walk(
        block, lambda c, s, t: seen.setdefault(c, []).append((t, s)), lambda _op, _body: None
    )
    tallies, channels = np.zeros((65536, 5), np.uint64), np.zeros(65536, bool)
    content, at = np.frombuffer(block, np.uint8), 0
    while True:
        at = int(records.tally(content, at, len(block), tallies, channels))
        following = None
        if at < len(block) and block[at] != records.OP_MESSAGE:
            following = other(block, at, lambda _op, _body: None)
        if following is None:
            break
        at = following
    assert at == end
    assert np.flatnonzero(channels).tolist() == sorted(seen)
    for channel, found in seen.items():
        times = [t for t, _ in found]
        expected = [len(found), min(times), max(times), found[0][1], found[-1][1]]
        assert tallies[channel].tolist() == expected
    return end
