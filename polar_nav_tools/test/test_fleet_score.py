"""`polar score PATTERN --out FILE.parquet`: bags found, one row each, nothing done twice."""

import json
import shutil
from pathlib import Path

import fsspec
import pyarrow.parquet as pq
import pytest
from fleet_samples import REFERENCE, STATION, as_a_new_process, fleet

from polar_nav_core.errors import ConfigError
from polar_nav_tools.analysis.judged import judged_of
from polar_nav_tools.bags import open_bag
from polar_nav_tools.bags.remote.address import bag_path
from polar_nav_tools.fleet import score as fleet_score
from polar_nav_tools.fleet import task as fleet_task
from polar_nav_tools.fleet.named import expanded, has_pattern, named
from polar_nav_tools.fleet.score import Outcome, Scored, tasks_of
from polar_nav_tools.fleet.task import BagScore
from polar_nav_tools.tasks.rows import DONE, VARYING, Row

pytestmark = pytest.mark.slow

polar = pytest.fixture(as_a_new_process)


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    return fleet(tmp_path_factory.mktemp('fleet'))


@pytest.fixture
def scored(monkeypatch):
    """Names of the bags that were scored, with the configuration."""
    done = []

    def counted(job):
        done.append((job.bag.path.name, job.configuration))
        return fleet_task.score_job(job)

    monkeypatch.setattr(fleet_score, 'score_job', counted)
    return done


@pytest.fixture
def memory(bags):
    """The same bags in a storage in memory."""
    fs = fsspec.filesystem('memory')
    fs.store.clear()
    for path in sorted(bags.rglob('*.mcap')):
        fs.pipe_file(f'/fleet/{path.relative_to(bags)}', path.read_bytes())
    yield fs
    fs.store.clear()


def rows(path):
    return {(r['bag'], r['configuration']): r for r in pq.read_table(path).to_pylist()}


def options(*names):
    """Options of a run in this process with these configurations."""
    return ('--configs', ','.join(names), '--out', 'scores.parquet', '--jobs', '1')


# -- patterns -------------------------------------------------------------------------------------


def touched(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b'x')
    return folder


def test_a_pattern_is_files_and_folders_with_bags(tmp_path):
    touched(tmp_path, 'a/x.mcap', 'b/b_0.mcap', 'b/metadata.yaml', 'c/d/y.mcap', 'c/z.txt', 'r.md')
    names = [str(p.relative_to(tmp_path)) for p in expanded([tmp_path / '**/*.mcap'])]
    assert names == ['a/x.mcap', 'b/b_0.mcap', 'c/d/y.mcap']
    assert [p.name for p in expanded([tmp_path / '*'])] == ['a', 'b']
    assert [p.name for p in expanded([tmp_path / '*', tmp_path / 'a'])] == ['a', 'b']


def test_files_of_one_bag_are_one_bag(tmp_path):
    touched(tmp_path, 'run/run_0.mcap', 'run/run_1.mcap', 'two/one_0.mcap', 'two/other_0.mcap')
    names = [str(p.relative_to(tmp_path)) for p in expanded([tmp_path / '**/*.mcap'])]
    assert names == ['run', 'two/one_0.mcap', 'two/other_0.mcap']


def test_patterns_at_addresses(memory):
    found = expanded(['memory://fleet/**/*.mcap'])
    assert [str(p) for p in found] == [
        'memory://fleet/a/whole.mcap',
        'memory://fleet/b/short.mcap',
        'memory://fleet/c/text.mcap',
    ]
    memory.pipe_file('/fleet/run/run_0.mcap', b'x')
    memory.pipe_file('/fleet/run/run_1.mcap', b'x')
    assert str(expanded(['memory://fleet/r*/*.mcap'])[0]) == 'memory://fleet/run'
    assert str(expanded(['memory://fleet/[a]/*'])[0]) == 'memory://fleet/a/whole.mcap'


def test_what_is_no_pattern(tmp_path):
    odd = touched(tmp_path, 'a[1].mcap') / 'a[1].mcap'
    assert not has_pattern(odd)
    assert expanded([odd]) == [odd]
    assert not has_pattern('https://host/a.mcap?list=[1]*')
    assert has_pattern('https://host/*.mcap?key=1')
    with pytest.raises(ConfigError, match='no bag matches'):
        expanded([tmp_path / '*.bag'])


def test_the_shell_may_have_expanded_it(polar, bags, scored):
    paths = sorted(bags.rglob('[ws]*.mcap'))
    assert polar('score', *paths, *options('default'))[0] == 0
    assert scored == [('whole.mcap', 'default'), ('short.mcap', 'default')]


def test_a_pattern_without_out_is_scored_side_by_side(polar, bags):
    status, out, _ = polar('score', bags / '[ab]/*.mcap', '--configs', 'default', '--json')
    assert status == 0
    assert list(json.loads(out)['bags']) == ['whole.mcap', 'short.mcap']


# -- rows -----------------------------------------------------------------------------------------


def test_the_numbers_are_those_of_one_bag(polar, bags):
    _, out, _ = polar('score', bags / 'b/short.mcap', '--configs', 'default', '--json')
    alone = json.loads(out)
    polar('score', bags / '[ab]/*.mcap', *options('default', 'modified_akf'))
    row = rows('scores.parquet')[str(bags / 'b/short.mcap'), 'default']
    figures = alone['runs']['default']
    assert row['vehicle'] == alone['vehicle']
    assert (row['ok'], row['complaints'], row['verified']) == (1, '', 1)
    for name, value in figures['summary'].items():
        if isinstance(value, float | int):
            assert row[name] == value, name
    whole = figures['windows']['whole']['components']
    assert row['windows.whole.components.horizontal.rms'] == whole['horizontal']['rms']
    assert (
        row['windows.whole.nees_position.mean']
        == (figures['windows']['whole']['nees_position']['mean'])
    )
    assert len(row) > 300


@pytest.mark.usefixtures('memory')
def test_at_an_address_the_rows_are_equal(polar, bags):
    polar('score', bags / '[ab]/*.mcap', *options('default'))
    here = pq.read_table('scores.parquet').to_pylist()
    status, _, err = polar('score', 'memory://fleet/[ab]/*.mcap', *options('default'))
    assert (status, err) == (0, 'polar: wrote scores.parquet\n')
    there = pq.read_table('scores.parquet').to_pylist()
    other = {'key', 'bag', 'verified', 'content', *VARYING}
    assert [{k: v for k, v in r.items() if k not in other} for r in here] == (
        [{k: v for k, v in r.items() if k not in other} for r in there]
    )
    assert [(r['bag'], r['verified']) for r in there] == [
        ('memory://fleet/a/whole.mcap', 0),
        ('memory://fleet/b/short.mcap', 0),
    ]


def test_a_failure_is_a_row_and_a_status(polar, bags):
    status, out, err = polar('score', bags / '**/*.mcap', *options('default'))
    assert status == 1
    row = rows('scores.parquet')[str(bags / 'c/text.mcap'), 'default']
    assert row['status'] == 'failed'
    assert row['reason'].startswith('BagError: ')
    assert 'is not an MCAP file' in row['reason']
    assert row['r_x'] is None
    assert 'text.mcap, default: BagError' in err
    assert '1 failed: --failed makes them again' in err
    assert 'failed' in out


def test_what_is_not_well_is_status_1(polar, bags, tmp_path):
    data = (bags / 'b/short.mcap').read_bytes()
    (tmp_path / 'cut.mcap').write_bytes(data[: len(data) * 2 // 3])
    status, out, err = polar('score', tmp_path / '*.mcap', *options('default'), '--json')
    assert status == 1
    (row,) = rows('scores.parquet').values()
    assert (row['status'], row['ok']) == ('done', 0)
    assert 'bytes are ignored' in row['complaints']
    said = json.loads(out)
    assert (said['ok'], said['failed'], said['rows']) == (False, 0, 1)
    assert 'bytes are ignored (and' in said['complaints'][0]
    assert 'bytes are ignored (and' in err


def scores(**complaints):
    rows = []
    for name, said in complaints.items():
        score = BagScore('follower', '{"summary": {}}', (), said, True, '', 1.0)
        rows.append(Scored('a.mcap', name, Row('key', DONE), score))
    return rows


def test_the_configuration_that_decides_is_that_of_one_bag():
    unwell = scores(default=(), modified_akf=('diverged', 'and more'))
    both = Outcome(unwell, 0, Path('x.parquet'), judged_of(['default', 'modified_akf']))
    assert both.complaints() == []
    alone = Outcome(unwell[1:], 0, Path('x.parquet'), judged_of(['modified_akf']))
    assert alone.complaints() == ['a.mcap: diverged (and 1 more)']


def test_both_modes_in_one_fleet(polar, bags):
    status, out, _ = polar('score', bags / 'a/*.mcap', STATION, *options('default'))
    assert status in (0, 1)
    assert {r['status'] for r in rows('scores.parquet').values()} == {'done'}
    assert 'All bags' in out


# -- nothing twice --------------------------------------------------------------------------------


def test_resume_makes_what_is_missing(polar, bags, scored):
    polar('score', bags / 'a/*.mcap', *options('default'))
    before = rows('scores.parquet')
    status, _, err = polar(
        'score', bags / '[ab]/*.mcap', *options('default', 'modified_akf'), '--resume'
    )
    assert status == 0
    assert '1 of 4 rows were there already' in err
    assert scored == [
        ('whole.mcap', 'default'),
        ('whole.mcap', 'modified_akf'),
        ('short.mcap', 'default'),
        ('short.mcap', 'modified_akf'),
    ]
    after = rows('scores.parquet')
    assert len(after) == 4
    (kept,) = before.items()
    assert after[kept[0]] == kept[1]


def test_an_interrupted_run_goes_on(polar, bags, scored, monkeypatch):
    def interrupted(job):
        if scored:
            raise KeyboardInterrupt
        scored.append(job.bag.path.name)
        return fleet_task.score_job(job)

    with monkeypatch.context() as patch:
        patch.setattr(fleet_score, 'score_job', interrupted)
        status, _, err = polar('score', bags / '[ab]/*.mcap', *options('default'))
    assert status == 130
    assert '--resume goes on with them' in err
    assert not Path('scores.parquet').exists()
    status, _, err = polar('score', bags / '[ab]/*.mcap', *options('default'))
    assert status == 2
    assert 'scores.parts' in err
    assert polar('score', bags / '[ab]/*.mcap', *options('default'), '--resume')[0] == 0
    assert scored == ['whole.mcap', ('short.mcap', 'default')]
    assert len(rows('scores.parquet')) == 2
    assert not Path('scores.parts').exists()


def test_failed_makes_those_again_that_failed(polar, bags, scored, tmp_path):
    (tmp_path / 'd').mkdir()
    shutil.copy(bags / 'c/text.mcap', tmp_path / 'd/x.mcap')
    place = tmp_path / 'd/x.mcap'
    fs = fsspec.filesystem('memory')
    fs.pipe_file('/fleet/x.mcap', place.read_bytes())
    polar('score', place, bags / 'b/short.mcap', *options('default'))
    polar('score', place, bags / 'b/short.mcap', *options('default'), '--resume')
    assert len(scored) == 2  # a failure is a row, too
    status, _, _ = polar('score', place, bags / 'b/short.mcap', *options('default'), '--failed')
    assert (status, len(scored)) == (1, 3)
    shutil.copy(bags / 'a/whole.mcap', place)  # another content is another task
    assert polar('score', place, bags / 'b/short.mcap', *options('default'), '--resume')[0] == 0
    assert len(scored) == 4
    status, _, err = polar('score', bags / 'b/short.mcap', *options('default'), '--failed')
    assert status == 2
    assert 'no row of these bags in scores.parquet failed' in err


def keys(*paths, vehicle=None, names=('default',)):
    bags = [(path, named(path)) for path in map(bag_path, paths)]
    return [task.key for task in tasks_of(bags, names, vehicle)]


def test_a_key_is_the_content_and_no_name(bags, tmp_path):
    copy = tmp_path / 'other.mcap'
    shutil.copy(bags / 'a/whole.mcap', copy)
    (key,) = keys(bags / 'a/whole.mcap')
    assert keys(copy) == [key]
    assert keys(copy, vehicle='follower') != [key]
    assert keys(copy, names=('modified_akf',)) != [key]
    data = bytearray(copy.read_bytes())
    data[1000] ^= 1
    copy.write_bytes(data)
    assert keys(copy) != [key]
    assert keys(REFERENCE) != [key]  # the folder has a metadata.yaml, which can be wrong


def test_a_key_at_an_address_is_what_the_storage_says(memory):
    (key,) = keys('memory://fleet/a/whole.mcap')
    assert keys('memory://fleet/a/whole.mcap') == [key]
    memory.pipe_file('/fleet/a/whole.mcap', memory.cat_file('/fleet/a/whole.mcap'))
    bag_path('memory://fleet/a/whole.mcap').found(again=True)
    assert keys('memory://fleet/a/whole.mcap') != [key]  # written again


def test_a_bag_that_changes_before_it_is_read_fails(bags, memory):
    path = bag_path('memory://fleet/a/whole.mcap')
    (task,) = tasks_of([(path, named(path))], ['default'], None)
    fleet_task._newest.clear()
    memory.pipe_file('/fleet/a/whole.mcap', (bags / 'b/short.mcap').read_bytes())
    with pytest.raises(Exception, match='not any more what it was'):
        fleet_task.score_job(task.argument)


def test_configurations_of_a_bag_read_it_once(polar, memory, monkeypatch):
    opened = []

    def counted(path, **more):
        opened.append(path)
        return open_bag(path, **more)

    monkeypatch.setattr(fleet_task, 'open_bag', counted)
    assert memory.exists('/fleet/a/whole.mcap')
    both = options('default', 'modified_akf')
    assert polar('score', 'memory://fleet/a/*.mcap', *both)[0] == 0
    assert len(opened) == 1


# -- wrong calls ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        (['none.mcap', '--out', 's.parquet'], 'none.mcap does not exist'),
        (['*.mcap', '--out', 's.parquet'], 'no bag matches'),
        ([REFERENCE, '--out', 's.csv'], 'does not end with .parquet'),
        ([REFERENCE, '--out', 's.parquet', '--jobs', '0'], '--jobs: 0 is less than 1'),
        ([REFERENCE, '--out', 's.parquet', '--configs', 'fast'], "no configuration 'fast'"),
        (
            [REFERENCE, '--out', 's.parquet', '--failed'],
            'no row of these bags in s.parquet failed',
        ),
        ([REFERENCE, '--out', 's.parquet', '--recorded'], 'goes without --recorded'),
        ([REFERENCE, '--resume'], 'go with --out'),
        (['memory://none/*.mcap', '--out', 's.parquet'], 'memory://none/*.mcap: no bag matches'),
        (['memory://none/a.mcap', '--out', 's.parquet'], 'memory://none/a.mcap does not exist'),
    ],
)
def test_a_wrong_call_is_status_2(polar, arguments, said):
    status, _, err = polar('score', *arguments)
    assert status == 2
    assert said in ' '.join(err.replace('│', ' ').split())
    assert 'Traceback' not in err
