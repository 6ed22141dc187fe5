"""Tasks in this process: keys, rows that last, only what is missing, failures."""

import os
import subprocess
import sys
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from task_samples import Sum, Walk, tasks_of, walk

from polar_nav_core.errors import ConfigError
from polar_nav_tools.experiments.catalog import EXPERIMENTS
from polar_nav_tools.experiments.request import Request
from polar_nav_tools.experiments.runner import tasks_of as tasks_of_experiment
from polar_nav_tools.tasks import store as store_module
from polar_nav_tools.tasks.execution import Workers, execute
from polar_nav_tools.tasks.feed import Feed
from polar_nav_tools.tasks.keys import canonical, key_of
from polar_nav_tools.tasks.packing import pack, unpack
from polar_nav_tools.tasks.rows import DONE, FAILED, STOPPED, VARYING, Row
from polar_nav_tools.tasks.store import opened

HERE = Workers(1)


def nothing(*_):
    pass


def done(folder, jobs, workers=HERE, **options):
    with opened(folder) as store:
        tasks = tasks_of(jobs)
        rows = execute(tasks, walk, store, workers, nothing, **options)
        store.finish([t.key for t in tasks])
    return rows


def table(folder):
    """Rows of a folder without what may differ between equal tasks."""
    return pq.read_table(folder / 'rows.parquet').drop_columns(list(VARYING))


# -- keys -----------------------------------------------------------------------------------------

PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda of: st.lists(of, max_size=3) | st.dictionaries(st.text(), of, max_size=3),
    max_leaves=8,
)


@given(PLAIN, PLAIN)
def test_keys_are_equal_where_values_are(a, b):
    def exact(value):  # 1, 1.0 and True are other parameters; 0.0 and -0.0, too
        if isinstance(value, dict):
            return ('dict', *sorted(((k, exact(v)) for k, v in value.items()), key=repr))
        if isinstance(value, list):
            return ('list', *map(exact, value))
        return (type(value).__name__, repr(value))

    assert (key_of('x', a) == key_of('x', b)) == (exact(a) == exact(b))


def test_the_last_bit_of_a_number_counts():
    keys = {key_of('x', value) for value in (0.1, np.nextafter(0.1, 1.0), 0.0, -0.0, 1, 1.0, True)}
    assert len(keys) == 7


def test_order_of_a_mapping_is_no_content():
    assert key_of('x', {'a': 1, 'b': 2.0}) == key_of('x', {'b': 2.0, 'a': 1})
    assert key_of('x', {'a': 1}) != key_of('y', {'a': 1})


def test_a_key_depends_on_the_engine(monkeypatch):
    before = key_of('x', 1)
    monkeypatch.setattr('polar_nav_tools.tasks.keys.ENGINE_VERSION', 1000)
    assert key_of('x', 1) != before


@dataclass(frozen=True)
class Nested:
    values: np.ndarray
    call: object


def test_arrays_functions_and_files_are_stated_by_content(tmp_path):
    a = Nested(np.arange(3.0), partial(tasks_of, stretch=3))
    assert canonical(a) == canonical(Nested(np.arange(3.0), partial(tasks_of, stretch=3)))
    assert canonical(a) != canonical(Nested(np.arange(3.0), partial(tasks_of, stretch=4)))
    assert canonical(a) != canonical(Nested(np.arange(3), a.call))
    first, second = tmp_path / 'first', tmp_path / 'second'
    first.write_text('same')
    second.write_text('same')
    assert canonical(first) == canonical(second)
    second.write_text('other')
    assert canonical(first) != canonical(second)


def test_what_has_no_content_has_no_key(tmp_path):
    for value in (lambda: 1, object(), Nested(np.zeros(1), lambda: 1)):
        with pytest.raises(TypeError):
            key_of('x', value)
    with pytest.raises(ConfigError, match='nothing'):
        key_of('x', tmp_path / 'nothing')


def test_keys_are_those_of_another_process():
    value = "{*map(str, range(50))}, {'q': 0.1, 'p': (1, None)}"
    code = f'from polar_nav_tools.tasks.keys import key_of; print(key_of("x", ({value})))'
    other = subprocess.run(
        [sys.executable, '-c', code],
        env={**os.environ, 'PYTHONHASHSEED': '12345'},
        capture_output=True,
        text=True,
        check=True,
    )
    assert other.stdout.strip() == key_of(
        'x', ({*map(str, range(50))}, {'q': 0.1, 'p': (1, None)})
    )


@pytest.mark.slow
@pytest.mark.parametrize('name', EXPERIMENTS)
def test_every_run_of_every_experiment_has_a_key_of_its_own(name):
    one = EXPERIMENTS[name]
    request = Request(quick=True, seeds=2)
    size = one.size(request)
    plan = one.plan(request, size, one.suite.present(one.columns))
    keys = [t.key for t in tasks_of_experiment(plan, one.suite.run_job)]
    again = one.plan(request, size, one.suite.present(one.columns))
    assert len(set(keys)) == len(keys) > 0
    assert keys == [t.key for t in tasks_of_experiment(again, one.suite.run_job)]


# -- rows on disk ---------------------------------------------------------------------------------


def test_results_come_back_bit_for_bit():
    bits = np.array([0x7FF8000000000123, 0x8000000000000000, 1], dtype=np.uint64)
    odd = bits.view(np.float64)
    before = Walk({'nan': float(odd[0]), 'zero': -0.0, 'least': odd[2]}, 0.1, '', {}, {'w': odd})
    after = unpack(Walk, pack(before))
    assert after.series['w'].tobytes() == odd.tobytes()
    assert np.array(list(after.metrics.values())).tobytes() == odd.tobytes()
    with pytest.raises(ValueError, match='no Sum'):
        unpack(Sum, pack(before))


def test_rows_outlive_a_killed_process(tmp_path):
    code = (
        'import itertools, sys\n'
        'from polar_nav_tools.tasks.rows import Row\n'
        'from polar_nav_tools.tasks.store import opened\n'
        'with opened(__import__("pathlib").Path(sys.argv[1])) as store:\n'
        '    for i in itertools.count():\n'
        '        store.add([Row(f"{i:08d}", "done", content=b"x" * 1000)])\n'
        '        print(i, flush=True)\n'
    )
    with subprocess.Popen(
        [sys.executable, '-c', code, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as writer:
        told = [writer.stdout.readline().strip() for _ in range(30)]
        writer.kill()
    with opened(tmp_path) as store:
        assert {f'{int(i):08d}' for i in told} <= set(store.rows)
        assert {row.content for row in store.rows.values()} == {b'x' * 1000}
        assert store.is_unfinished
        assert store.damaged == []


def test_half_a_file_counts_for_nothing(tmp_path):
    with opened(tmp_path) as store:
        store.add([Row('a', DONE), Row('b', DONE)])
        store.add([Row('c', DONE)])
    whole = sorted((tmp_path / 'rows.parts').iterdir())[1]
    (tmp_path / 'rows.parts' / '000000009.tmp').write_bytes(whole.read_bytes()[:50])
    whole.write_bytes(whole.read_bytes()[:-20])
    with opened(tmp_path) as store:
        assert set(store.rows) == {'a', 'b'}
        assert store.damaged == [whole]
        assert not list((tmp_path / 'rows.parts').glob('*.tmp'))


def test_parts_are_merged_and_finished_in_the_order_of_the_plan(tmp_path, monkeypatch):
    monkeypatch.setattr(store_module, '_MOST_PARTS', 4)
    with opened(tmp_path) as store:
        for key in 'hgfedcba':
            store.add([Row(key, DONE, {'name': key}, {'size': float(ord(key))})])
            assert len(list((tmp_path / 'rows.parts').iterdir())) < 4
        path = store.finish('bdacefg')
        assert pq.read_table(path)['name'].to_pylist() == list('bdacefgh')
        assert not (tmp_path / 'rows.parts').exists()
    with opened(tmp_path) as store:
        assert set(store.rows) == set('abcdefgh')


def test_a_failure_does_not_replace_a_result_and_is_replaced_by_one(tmp_path):
    with opened(tmp_path) as store:
        store.add([Row('a', FAILED), Row('b', DONE)])
        store.add([Row('a', DONE), Row('b', FAILED)])
        store.finish(['a', 'b'])
        assert pq.read_table(tmp_path / 'rows.parquet')['status'].to_pylist() == [DONE, DONE]


def test_two_runs_do_not_write_to_one_folder(tmp_path):
    with (
        opened(tmp_path),
        pytest.raises(ConfigError, match=str(tmp_path)),
        opened(tmp_path),
    ):
        pass


def test_columns_are_names_numbers_and_why(tmp_path):
    done(tmp_path, [Sum(1), Sum(2, fails=True)], failures=True)
    table = pq.read_table(tmp_path / 'rows.parquet').to_pylist()
    assert table[0]['seed'] == 1
    assert table[0]['scale'] == 1.0
    assert table[0]['most'] >= abs(table[0]['end'])
    assert table[1]['most'] is None
    assert table[1]['reason'] == 'ValueError: seed 2 cannot be walked'
    assert table[1]['where'].startswith('task_samples.py:')


# -- execution ------------------------------------------------------------------------------------


def test_only_what_is_missing_is_done(tmp_path):
    log = tmp_path / 'calls'
    jobs = [Sum(seed, log=str(log)) for seed in range(6)]
    done(tmp_path / 'rows', jobs[:4])
    done(tmp_path / 'rows', jobs)
    assert log.read_text().split() == list('012345')
    done(tmp_path / 'undisturbed', jobs)
    assert table(tmp_path / 'rows').equals(table(tmp_path / 'undisturbed'))


def test_equal_tasks_are_done_once(tmp_path):
    log = tmp_path / 'calls'
    rows = done(tmp_path / 'rows', [Sum(3, log=str(log))] * 3)
    assert log.read_text().split() == ['3']
    assert len(rows) == 3


def test_a_filter_that_stopped_is_a_result(tmp_path):
    (row,) = done(tmp_path, [Sum(1, scale=100.0)])
    end = unpack(Walk, row.content).metrics['end']
    assert (row.status, row.reason) == ((STOPPED, 'went too far') if end > 15 else (DONE, ''))
    assert STOPPED in {r.status for r in done(tmp_path, [Sum(s, 100.0) for s in range(9)])}


def test_an_error_ends_everything_but_what_was_finished(tmp_path):
    jobs = [Sum(0), Sum(1, fails=True), Sum(2)]
    with pytest.raises(ValueError, match='seed 1'):
        done(tmp_path, jobs)
    with opened(tmp_path) as store:
        assert [r.status for r in store.rows.values()] == [DONE]


def test_progress_counts_what_was_there_and_what_failed(tmp_path):
    told = []
    jobs = [Sum(0), Sum(1, fails=True), Sum(2)]
    done(tmp_path, jobs[:1])
    with opened(tmp_path) as store:
        execute(tasks_of(jobs), walk, store, HERE, lambda *x: told.append(x), failures=True)
    assert told == [(1, 3, 0), (2, 3, 1), (3, 3, 1)]


# -- which worker does what -----------------------------------------------------------------------


@given(st.lists(st.integers(0, 3), max_size=30), st.lists(st.integers(0, 2), max_size=60))
def test_every_task_is_given_out_once(stretches, turns):
    tasks = [replace(t, stretch=s) for t, s in zip(tasks_of([Sum(0)] * 30), stretches)]  # noqa: B905
    tasks = [replace(t, key=str(i)) for i, t in enumerate(tasks)]
    feed, given_out = Feed(tasks), []
    for worker in turns:
        given_out.append(feed.next_for(str(worker)))
    feed.keep(['1'])  # the others are gone: what they were to do is not lost
    while (task := feed.next_for('1')) is not None:
        given_out.append(task)
    keys = [t.key for t in given_out if t is not None]
    assert sorted(keys) == sorted(t.key for t in tasks)


def test_a_stretch_stays_with_one_worker_while_there_are_others():
    tasks = [replace(t, key=str(i), stretch=i // 4) for i, t in enumerate(tasks_of([Sum(0)] * 16))]
    feed = Feed(tasks)
    by = {'a': [], 'b': []}
    for worker in 'aabbabababababab':
        by[worker].append(feed.next_for(worker).stretch)
    assert by == {'a': [0] * 4 + [2] * 4, 'b': [1] * 4 + [3] * 4}


def test_one_long_stretch_is_shared():
    tasks = [replace(t, key=str(i), stretch=0) for i, t in enumerate(tasks_of([Sum(0)] * 9))]
    feed = Feed(tasks)
    assert feed.next_for('a').key == '0'
    assert [feed.next_for('b').key for _ in range(3)] == ['5', '6', '7']
    assert feed.next_for('a').key == '1'
