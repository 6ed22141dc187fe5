"""Bags at an address: few requests, what is read is verified, and everything else as on a disk.

The storage is fsspec's own, in memory; storages on loopback are in test_fleet_storage.py.
"""

import gc
import pickle
from itertools import pairwise
from pathlib import Path

import fsspec
import pytest
from bag_samples import IMU, TRUTH, TYPES, imu, records_of, stamp_ns, write_bag
from fsspec.implementations.memory import MemoryFileSystem
from test_bags_large_topics import CAMERA, SONAR, write_with_images

from polar_nav_tools.bags import BagError, BagWriter, open_bag
from polar_nav_tools.bags.errors import WrongRequestError
from polar_nav_tools.bags.info import bag_info
from polar_nav_tools.bags.recover import recover
from polar_nav_tools.bags.remote import copy as remote_copy
from polar_nav_tools.bags.remote.address import bag_path, is_remote
from polar_nav_tools.bags.remote.copy import joined
from polar_nav_tools.bags.request import Request
from polar_nav_tools.bags.tables import read_tables
from polar_nav_tools.foreign.sources import open_source

FIELDS = {IMU: ['linear_acceleration.z']}


class Memory:
    """Storage in memory that remembers which ranges were asked for."""

    def __init__(self):
        self.fs = fsspec.filesystem('memory')
        self.ranges = []

    def put(self, source, name='a.mcap'):
        data = source if isinstance(source, bytes | bytearray) else Path(source).read_bytes()
        self.fs.pipe_file(f'/fleet/{name}', bytes(data))
        return f'memory://fleet/{name}'

    @property
    def bytes(self):
        return sum(end - start for start, end in self.ranges)


@pytest.fixture
def memory(monkeypatch):
    memory = Memory()
    memory.fs.store.clear()
    cat = MemoryFileSystem.cat_file

    def counted(self, path, start=None, end=None, **more):
        memory.ranges.append((start, end))
        return cat(self, path, start=start, end=end, **more)

    monkeypatch.setattr(MemoryFileSystem, 'cat_file', counted)
    yield memory
    memory.fs.store.clear()


# -- paths ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ('said', 'read'),
    [
        ('s3://fleet/2026/a.mcap', 's3://fleet/2026/a.mcap'),
        (Path('s3://fleet/2026/a.mcap'), 's3://fleet/2026/a.mcap'),
        ('https://host:8080/b/a.mcap?key=x', 'https://host:8080/b/a.mcap?key=x'),
    ],
)
def test_an_address_stays_one(said, read):
    path = bag_path(said)
    assert is_remote(path)
    assert (str(path), f'{path}', path.url) == (read, read, read)
    assert bag_path(path) is path
    assert pickle.loads(pickle.dumps(path)) == path
    assert str(path.parent / 'b.mcap') == read.rpartition('/')[0] + '/b.mcap'
    assert path.resolve() == path.absolute() == path


@pytest.mark.parametrize(
    'said', ['a.mcap', '/s3/a.mcap', 'c:/a.mcap', './s3:/x', 'file:///data/x']
)
def test_other_paths_are_of_this_machine(said):
    path = bag_path(said)
    assert not is_remote(path)
    assert str(path) == ('/data/x' if said.startswith('file') else str(Path(said)))


def test_an_address_is_not_written_to(memory):
    path = bag_path(memory.put(b'text', 'note.txt'))
    assert path.read_text() == 'text'
    with pytest.raises(OSError, match='can only be read'):
        path.write_text('other')
    assert path.is_file()
    assert path.stat().st_size == 4
    assert not (path.parent / 'none').exists()
    assert path.parent.is_dir()
    with pytest.raises(IsADirectoryError):
        path.parent.open()


# -- the same as on a disk ------------------------------------------------------------------------


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
def test_everything_is_as_on_a_disk(tmp_path, memory, compression):
    file = write_bag(tmp_path / 'b', 300, compression=compression)
    here, there = open_bag(file), open_bag(memory.put(file))
    assert (there.is_verified, here.is_verified) == (False, True)
    assert there.topics == here.topics
    assert there.run_info == here.run_info
    assert there.node_infos == here.node_infos
    assert there.problems == here.problems == []
    assert list(there.records()) == list(here.records())
    assert list(there.payloads(IMU)) == list(here.payloads(IMU))
    mine, other = read_tables(here, FIELDS), read_tables(there, FIELDS)
    assert mine.columns[IMU]['linear_acceleration.z'].tolist() == (
        other.columns[IMU]['linear_acceleration.z'].tolist()
    )
    a, b = bag_info(here).to_dict(), bag_info(there).to_dict()
    assert {k for k in a if a[k] != b[k]} == {'path', 'files', 'is_verified'}


def test_times_of_topics_that_chunks_do_not_tell(tmp_path, memory):
    with BagWriter(tmp_path / 'b', {}, chunk_bytes=4096, flush_s=1e9) as writer:
        for topic in (IMU, TRUTH):
            writer.add_topic(topic, TYPES[IMU])
        for k in range(200):
            at = stamp_ns(k + (30 if k % 7 == 0 else 0))  # chunks overlap
            writer.write(IMU, imu(k), at)
            if 60 < k < 130:
                writer.write(TRUTH, imu(k), at + 5)
    here, there = bag_info(open_bag(writer.path)), bag_info(open_bag(memory.put(writer.path)))
    assert there.topics == here.topics


def test_a_folder_is_found_with_its_files(tmp_path, memory):
    file = write_bag(tmp_path / 'run', 50)
    memory.put(file, 'run/run_0.mcap')
    assert open_bag('memory://fleet/run').message_count == 101  # without metadata.yaml
    metadata = (file.parent / 'metadata.yaml').read_bytes()
    memory.put(metadata, 'run/metadata.yaml')
    bag = open_bag('memory://fleet/run')
    assert bag.problems == []
    assert bag.message_count == 101
    assert [f.path.name for f in bag.files] == ['run_0.mcap']


# -- few requests ---------------------------------------------------------------------------------


def test_what_is_in_a_bag_is_known_by_its_end_and_its_front(tmp_path, memory):
    path, _ = write_with_images(tmp_path / 'b', 200, 1 << 20)
    url = memory.put(path)
    bag = open_bag(url)
    assert len(memory.ranges) == 2
    assert memory.bytes < 200 << 10 < path.stat().st_size / 50
    assert bag.topics[CAMERA].count == 40
    bag_info(bag)
    assert len(memory.ranges) < 8
    assert memory.bytes < path.stat().st_size / 20


def test_only_chunks_with_wanted_topics_are_fetched(tmp_path, memory):
    path, said = write_with_images(tmp_path / 'b', 200, 1 << 20, every=50)
    bag = open_bag(memory.put(path))
    memory.ranges.clear()
    assert list(bag.payloads(IMU)) == [data for topic, data in said if topic == IMU]
    assert len(memory.ranges) <= 4  # one for each stretch between images
    assert memory.bytes < 1 << 20
    assert list(bag.payloads(IMU)) == [data for topic, data in said if topic == IMU]
    assert len(memory.ranges) <= 4  # nothing is fetched twice


def test_what_is_announced_is_fetched_together(tmp_path, memory, monkeypatch):
    monkeypatch.setattr(remote_copy, 'PIECE_BYTES', 64 << 10)
    monkeypatch.setattr(remote_copy, 'TAIL_BYTES', 16 << 10)
    file = write_bag(tmp_path / 'b', 3000)
    url = memory.put(file)
    bag = open_bag(url, ahead=lambda _: Request(FIELDS, [TRUTH]))
    planned = list(bag.files[0].copy._pieces)
    memory.ranges.clear()
    read_tables(bag, FIELDS, [TRUTH])
    pieces = -(-file.stat().st_size // (64 << 10))
    assert bag.files[0].copy._pieces == planned  # in the one plan of both topics
    assert all(piece.coming is not None for piece in planned)
    assert len(memory.ranges) <= pieces + 1
    assert memory.bytes <= file.stat().st_size + 8192 * pieces


def test_one_piece_is_fetched_ahead(tmp_path, memory, monkeypatch):
    monkeypatch.setattr(remote_copy, 'PIECE_BYTES', 16 << 10)
    monkeypatch.setattr(remote_copy, 'TAIL_BYTES', 4 << 10)
    bag = open_bag(memory.put(write_bag(tmp_path / 'b', 3000)))
    memory.ranges.clear()
    messages = bag.messages([IMU])
    while not memory.ranges:  # the first ones came with the end and the front
        next(messages)
    copy = bag.files[0].copy
    ordered = [piece.coming is not None for piece in copy._pieces]
    assert ordered == [True, True, *[False] * (len(ordered) - 2)]
    assert len(ordered) > 3
    copy._pieces[1].coming.result()
    assert len(memory.ranges) == 2
    list(messages)
    assert len(memory.ranges) <= len(ordered)


def test_ranges_are_joined_over_small_gaps_only():
    gap, size = remote_copy.GAP_BYTES, 1 << 30
    near, far = 4096 + gap, 1 << 25
    assert joined([(far, far + 10), (0, 10), (near, near + 10)], size) == [
        (0, near + 4096),
        (far, far + 4096),
    ]
    assert joined([(0, 100), (100, 200)], 150) == [(0, 150)]
    assert joined([], size) == []
    piece = remote_copy.PIECE_BYTES
    long = joined([(at, at + 1000) for at in range(0, 3 * piece, 1000)], size)
    assert all(end - start <= piece + 8192 for start, end in long)
    assert all(a[1] <= b[0] for a, b in pairwise(long))


# -- what is verified -----------------------------------------------------------------------------


def chunk_of(data, topic_number):
    """Offset in the middle of the data of a chunk."""
    chunks = [(at, size) for at, opcode, size in records_of(data) if opcode == 0x06]
    at, size = chunks[topic_number]
    return at + size // 2


def test_a_changed_byte_of_what_is_read_is_found(tmp_path, memory):
    path, _ = write_with_images(tmp_path / 'b', 20, every=10)
    data = bytearray(path.read_bytes())
    file = open_bag(path).files[0]
    camera = next(n for n, c in file.channels.items() if c.topic == CAMERA)
    number = next(i for i, b in enumerate(file.blocks) if b.channels == {camera})
    data[chunk_of(data, number)] ^= 1
    bag = open_bag(memory.put(data))
    assert bag.problems == []  # nobody has looked there
    assert len(list(bag.messages([IMU]))) == 20
    assert len(list(bag.messages([SONAR]))) == 2
    with pytest.raises(BagError, match='changed while it was read: '):
        list(bag.messages([CAMERA]))
    whole = open_bag(memory.put(data), whole=True)
    assert whole.problems
    assert whole.is_verified


def test_a_wrong_index_is_not_believed(tmp_path, memory):
    data = bytearray(write_bag(tmp_path / 'b', 50).read_bytes())
    at = next(at for at, opcode, _ in records_of(data) if opcode == 0x0B)
    data[at + 9 + 42 + 4 + 2] ^= 3
    bag = open_bag(memory.put(data))
    assert bag.is_verified  # its checksum is wrong: the file was read whole
    assert 'no whole index' in bag.remarks[0]
    footer = len(data) - 8 - 4
    data[footer : footer + 4] = bytes(4)
    bag = open_bag(memory.put(data, 'without_checksum.mcap'))
    with pytest.raises(BagError, match='the index counts'):
        list(bag.messages())


@pytest.mark.parametrize('share', [0.3, 0.9])
def test_an_unfinished_bag_is_read_whole_and_says_so(tmp_path, memory, share):
    data = write_bag(tmp_path / 'b', 400).read_bytes()
    cut = data[: int(share * len(data))]
    (tmp_path / 'cut.mcap').write_bytes(cut)
    here, there = open_bag(tmp_path / 'cut.mcap'), open_bag(memory.put(cut, 'cut.mcap'))
    assert there.problems == here.problems != []
    assert list(there.records()) == list(here.records())
    assert there.is_verified
    (said,) = there.remarks
    assert (
        said == f'memory://fleet/cut.mcap: has no whole index; all its {len(cut)} bytes are read'
    )
    assert memory.ranges[-1] == (0, len(cut))


def test_recover_and_doctor_read_it_all(tmp_path, memory):
    file = write_bag(tmp_path / 'b', 100)
    url = memory.put(file)
    result = recover(url, tmp_path / 'again')
    assert result.message_count == 201
    assert str(result.source) == url
    assert memory.ranges[-1] == (0, file.stat().st_size)
    assert open_source(url, whole=True).bag.is_verified
    assert not open_source(url).bag.is_verified


# -- what goes wrong ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ('url', 'said'),
    [
        ('memory://fleet/none.mcap', 'memory://fleet/none.mcap does not exist'),
        ('nothing://fleet/none.mcap', 'nothing:// is no storage that is known'),
        (
            'abfs://fleet/none.mcap',
            r'abfs:// needs the package adlfs \(pip install adlfs\)',
        ),
    ],
)
@pytest.mark.usefixtures('memory')
def test_a_wrong_address_is_a_wrong_call(url, said):
    with pytest.raises(WrongRequestError, match=said):
        open_bag(url)


@pytest.mark.parametrize(
    ('data', 'said'),
    [
        (b'', r'is empty \(0 bytes\)'),
        (b'not a bag' * 100, 'is not an MCAP file'),
        (b'SQLite format 3\0' * 100, 'is an sqlite3 bag'),
        (b'\x89MCAP', 'ends within the first 8 bytes'),
    ],
)
def test_what_is_no_bag(memory, data, said):
    url = memory.put(data)
    with pytest.raises(BagError, match=f'^{url}.*{said}'):
        open_bag(url)


def test_a_missing_package_is_named_with_the_version_that_fits(monkeypatch):
    def missing(*_):
        raise ImportError('Install s3fs to access S3')

    monkeypatch.setattr(fsspec.core, 'url_to_fs', missing)
    with pytest.raises(WrongRequestError) as found:
        open_bag('s3://fleet/a.mcap')
    assert str(found.value) == (
        f's3://fleet/a.mcap: s3:// needs the package s3fs (pip install s3fs=={fsspec.__version__})'
    )


def test_other_kinds_of_bags_are_not_read_at_an_address():
    with pytest.raises(BagError, match='only MCAP is read at an address'):
        open_source('memory://fleet/cruise.bag')


def test_a_storage_that_fails_later_is_a_sentence(tmp_path, memory, monkeypatch):
    bag = open_bag(memory.put(write_with_images(tmp_path / 'b', 200, 1 << 20)[0]))

    def fail(*_, **__):
        raise OSError('connection reset by peer')

    monkeypatch.setattr(MemoryFileSystem, 'cat_file', fail)
    with pytest.raises(BagError, match=r'a.mcap: cannot be read \(connection reset by peer\)'):
        list(bag.messages([IMU]))
    monkeypatch.undo()
    assert len(list(bag.messages([IMU]))) == 200  # a piece that did not come is not taken for one


def test_an_object_that_changes_meanwhile_is_noticed(tmp_path, memory):
    url = memory.put(write_bag(tmp_path / 'a', 200))
    bag = open_bag(url)
    memory.put(write_with_images(tmp_path / 'b', 3)[0])
    remote_copy_of_new = open_bag(url)
    assert CAMERA in remote_copy_of_new.topics
    del remote_copy_of_new
    with pytest.raises(BagError):
        list(bag.messages())


def test_a_copy_goes_with_its_bag(tmp_path, memory):
    url = memory.put(write_bag(tmp_path / 'a', 20))
    bag = open_bag(url)
    before = len(memory.ranges)
    again = open_bag(url)
    assert len(memory.ranges) == before  # both read one copy
    del bag, again
    gc.collect()
    open_bag(url)
    assert len(memory.ranges) == 2 * before


def test_progress_goes_from_file_to_file(tmp_path, memory):
    data = write_bag(tmp_path / 'b', 50).read_bytes()
    for number in range(2):
        memory.put(data, f'run/run_{number}.mcap')
    for whole, most in ((False, 2), (True, 10)):
        shares = []
        open_bag('memory://fleet/run', shares.append, whole=whole)
        assert shares == sorted(shares)
        assert {0.5, 1.0} <= set(shares)
        assert len(shares) <= most
