"""Large arrays in temporary files."""

import ctypes
import errno
import io
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from polar_nav_core import spilled
from polar_nav_core.errors import PolarNavError
from polar_nav_core.spilled_table import Table


@pytest.fixture
def small(monkeypatch):
    """Arrays of any size are spilled, and few rows are worked on at a time."""
    monkeypatch.setattr(spilled, 'LEAST_BYTES', 1)
    monkeypatch.setattr(spilled, 'ROWS', 64)


def resident_kb():
    lines = Path('/proc/self/smaps_rollup').read_text(encoding='ascii').splitlines()
    return int(next(line.split()[1] for line in lines if line.startswith('Rss:')))


def files_open():
    return sum(1 for _ in Path('/proc/self/fd').iterdir())


def test_values_stay_when_memory_is_given_back():
    values = spilled.empty((1_000_000, 4))
    values[:] = np.arange(4_000_000).reshape(-1, 4)
    before = resident_kb()
    spilled.give_back()
    assert resident_kb() < before - 28_000  # it has 32 MB
    assert values[123_456].tolist() == [493_824, 493_825, 493_826, 493_827]
    assert not list(Path(tempfile.gettempdir()).glob('polar-rows-*'))  # it has no name


def test_a_small_array_is_an_ordinary_one():
    assert spilled.empty((3, 2), np.int64).base is None
    assert spilled.empty((1 << 18) - 1, np.uint8).base is None
    assert spilled.empty(1 << 18, np.uint8).base is not None


def test_small_ones_share_a_file():
    first, before = spilled.empty(spilled.LEAST_BYTES, np.uint8), files_open()
    more = [spilled.empty(spilled.LEAST_BYTES // 8) for _ in range(100)]
    for k, one in enumerate((first, *more)):
        one[:] = k
    assert all(set(one.tolist()) == {k} for k, one in enumerate((first, *more)))
    assert files_open() < before + 5


FORKED = """
import os, sys
from polar_nav_core import spilled
rows = spilled.LEAST_BYTES // 8
spilled.empty(rows)[:] = 0.0
told, tell = os.pipe()
if (child := os.fork()) == 0:
    os.read(told, 1)
    spilled.empty(rows)[:] = 1.0
    os._exit(0)
mine = spilled.empty(rows)
mine[:] = 2.0
os.write(tell, b'.')
assert os.waitpid(child, 0)[1] == 0
sys.exit(not (mine == 2.0).all())
"""


def test_a_forked_process_shares_no_file():
    subprocess.run([sys.executable, '-c', FORKED], check=True, timeout=60)


@pytest.mark.usefixtures('small')
def test_a_column_that_was_read_at_once_is_given_back():
    values = spilled.empty((1_000_000, 4))
    values[:] = 1.0
    before = resident_kb()
    spilled.by_rows(lambda rows: values[::1000].sum() + rows, np.zeros(3))
    assert resident_kb() < before - 28_000


@pytest.mark.usefixtures('small')
def test_a_function_of_rows_gives_the_same_some_at_a_time():
    values = np.random.default_rng(1).normal(size=(1000, 3))
    found = spilled.by_rows(lambda a, b: np.hypot(a, b[:, None]), values, values[:, 0])
    assert np.array_equal(found, np.hypot(values, values[:, :1]))
    assert found.base is not None
    rows = np.array([7, 999, 7, *range(500)])
    assert np.array_equal(spilled.chosen(values, rows), values[rows])


@pytest.mark.usefixtures('small')
@pytest.mark.parametrize('at', [1, 63, 64, 65, 199])
def test_an_order_is_seen_across_parts(at):
    stamps = np.arange(200)
    assert spilled.ascending(stamps)
    stamps[at] = stamps[at - 1]
    assert spilled.ascending(stamps)
    stamps[at] = stamps[at - 1] - 1
    assert not spilled.ascending(stamps)


@pytest.mark.usefixtures('small')
def test_rows_grow_and_pieces_are_turned():
    rows = spilled.Rows([('a', 'i8'), ('b', 'i2')])
    for k in range(300):
        rows.add((k * k, k))
    assert rows.array()['a'].tolist() == [k * k for k in range(300)]
    assert len(rows) == 300
    pieces, parts = spilled.LastFirst({'few': 9}, 300), [np.full((n, 2), n) for n in (3, 0, 70, 5)]
    for part in reversed(parts):
        pieces.add({'x': part, 'few': part[:3], 'flat': part[:, :0], 'none': np.zeros((0, 24))})
    found = pieces.in_order()
    assert np.array_equal(found['x'], np.concatenate(parts))
    assert np.array_equal(found['few'], np.concatenate([part[:3] for part in parts]))
    assert found['flat'].shape == (78, 0)
    assert found['none'].shape == (0, 24)


@pytest.mark.usefixtures('small')
def test_rows_that_grow_take_room_for_half_as_many_again(monkeypatch):
    taken, empty = [], spilled.empty
    monkeypatch.setattr(spilled, 'empty', lambda *a: taken.append(a[0][0]) or empty(*a))
    rows = spilled.Rows(np.float64)
    for k in range(2000):
        rows.add(float(k))
    assert len(rows.array()) == 2000
    assert max(taken) <= 1.5 * 2000
    assert len(taken) < 15


def test_pieces_take_room_once(monkeypatch):
    taken, empty = [], spilled.empty
    monkeypatch.setattr(spilled, 'empty', lambda *a: taken.append(a[0]) or empty(*a))
    pieces = spilled.LastFirst({}, 320)
    for k in range(300):
        pieces.add({'x': np.array([k])})
    assert pieces.in_order()['x'].tolist() == list(reversed(range(300)))
    assert taken == [(320,)]


@pytest.mark.parametrize('rows', [0, 4000])
@pytest.mark.parametrize('least', [1, 1 << 30])
def test_a_table_is_read_as_it_was_written(monkeypatch, least, rows):
    monkeypatch.setattr(spilled, 'LEAST_BYTES', least)
    monkeypatch.setattr(spilled, 'ROWS', 500)
    before = files_open()
    columns = {
        'stamp': np.arange(3000),
        'state': np.arange(3000, dtype=np.uint8),
        'C': np.arange(27_000.0).reshape(3000, 3, 3),
        'strided': np.arange(6000.0)[::2],
    }
    table = Table(columns, rows)
    for start, stop in ((0, 1), (1, 1), (1, 1000), (1000, 2990), (2990, 3000)):
        table.append({name: column[start:stop] for name, column in columns.items()})
    assert len(table) == 3000
    for found in (table.columns(), table.columns()):
        spilled.give_back()
        for name, column in columns.items():
            assert found[name].dtype == column.dtype
            np.testing.assert_array_equal(found[name], column)
    if least == 1:
        assert files_open() == before + 1  # the pages, which the columns hold
        assert found['C'].base is not None
    del table, found
    assert files_open() == before


@pytest.mark.usefixtures('small')
def test_a_table_that_is_dropped_leaves_no_file_open():
    before = files_open()
    table = Table({'a': np.zeros(0)}, 10)
    table.append({'a': np.zeros(5)})
    assert files_open() > before
    del table
    assert files_open() == before


def test_a_table_without_rows_has_columns():
    found = Table({'a': np.zeros((0, 2))}, 0).columns()
    assert found['a'].shape == (0, 2)


def test_memory_of_freed_objects_is_given_back_where_the_allocator_can(monkeypatch):
    trimmed = []
    with_glibc = SimpleNamespace(malloc_trim=trimmed.append)
    for library in (with_glibc, SimpleNamespace()):
        monkeypatch.setattr(ctypes, 'CDLL', lambda _, library=library: library)
        spilled.give_back_freed()
    assert trimmed == [0]


@pytest.mark.usefixtures('small')
def test_a_full_disk_is_a_sentence(monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, 'posix_fallocate', full)
    with pytest.raises(PolarNavError, match=r'no room for 8 MB .* TMPDIR'):
        spilled.empty(1_000_000)


@pytest.mark.parametrize('most', [0, 8, 24, 1 << 10])
def test_a_spool_reads_what_was_written_wherever_it_lies(most):
    rng = np.random.default_rng(4)
    with spilled.Spool(8 * most) as spool:
        for sizes in ((3, 5, 0, 17, 2), (9, 1, 4)):  # the second time over the first
            spool.begin_anew()
            pieces = [rng.normal(size=n) for n in sizes]
            for piece in pieces:
                room = spool.room(len(piece))
                room[:] = piece
                spool.keep(room)
            assert spool.in_memory == (most >= 27)
            begin = sum(sizes)
            for piece in reversed(pieces):
                begin -= len(piece)
                np.testing.assert_array_equal(spool.read(begin, len(piece)), piece)


def test_a_short_spool_makes_neither_a_file_nor_copies(monkeypatch):
    monkeypatch.setattr(spilled.tempfile, 'TemporaryFile', None)
    spool = spilled.Spool(80)
    room = spool.room(10)
    spool.keep(room)
    assert np.shares_memory(spool.read(0, 10), room)


def test_a_spool_on_a_full_disk_is_a_sentence(monkeypatch):
    class Full(io.BytesIO):
        def write(self, values):
            if len(values):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(spilled.tempfile, 'TemporaryFile', Full)
    spool = spilled.Spool(0)
    with pytest.raises(PolarNavError, match=r'no room for 8 MB .* TMPDIR'):
        spool.keep(spool.room(1_000_000))
