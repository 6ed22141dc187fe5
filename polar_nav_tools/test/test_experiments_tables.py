"""`./polar experiment`: files, manifest, the paper beside ours, errors that name the option."""

import csv
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_tools.cli import experiment_spelling, main
from polar_nav_tools.experiments import ablation, consistency
from polar_nav_tools.experiments import jobs as jobs_module
from polar_nav_tools.experiments.ablation import plan as plan_ablation
from polar_nav_tools.experiments.catalog import EXPERIMENTS
from polar_nav_tools.experiments.choices import Choices, choices_from, choices_table
from polar_nav_tools.experiments.columns import filter_columns, pick
from polar_nav_tools.experiments.jobs import Job, RunResult, run_job
from polar_nav_tools.experiments.paper import PAPER, QUANTITIES
from polar_nav_tools.experiments.request import Request, Size
from polar_nav_tools.experiments.runner import run_jobs, tasks_of
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.summary import spread
from polar_nav_tools.experiments.tables import COMPARED
from polar_nav_tools.tasks import execution
from polar_nav_tools.tasks.execution import Workers
from polar_nav_tools.tasks.store import opened

PAIR = 'conventional_akf,modified_akf,clairvoyant'


@pytest.fixture
def polar(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        monkeypatch.setattr(sys, 'argv', ['polar', *map(str, arguments)])
        status = main()
        out = capsys.readouterr()
        return status, out.out, out.err

    return run


def of(rows, **want):
    found = [r for r in rows if all(r[k] == v for k, v in want.items())]
    assert len(found) == 1
    return found[0]


@pytest.mark.slow
def test_table2_writes_tables_figure_and_a_complete_manifest(polar, tmp_path):
    folder = tmp_path / 'out'
    arguments = ('--quick', '--duration', 40, '--columns', PAIR, '--jobs', 1, '--out', folder)
    status, out, _ = polar('experiment', 'run', 'table2', *arguments, '--json')
    assert status == 0
    said = json.loads(out)
    manifest = json.loads((folder / 'manifest.json').read_text())
    assert {f.name for f in folder.iterdir()} == {*manifest['files'], 'manifest.json'}
    assert set(manifest['files']) == {
        'table2.md', 'table2.csv', 'figure9.png', 'figure9.svg', 'rows.parquet',
    }  # fmt: skip
    assert said['runs'] == manifest['runs']
    assert manifest['seeds'] == [1]
    assert manifest['duration_s'] == 40.0
    assert manifest['choices']['speed_mps'] == 3.0
    assert {'numpy', 'scipy', 'numba'} <= manifest['versions'].keys()
    assert manifest['cpu']
    assert 'git_commit' in manifest
    assert list(manifest['filters']) == PAIR.split(',')
    assert manifest['groups']['D']['fixes']['delay_steps'] == 20
    assert [r['stopped_s'] for r in manifest['runs']] == [None] * 3

    markdown = (folder / 'table2.md').read_text()
    assert '1252.2' in markdown  # the paper's, as printed
    rows = list(csv.DictReader((folder / 'table2.csv').read_text().splitlines()))
    paper = of(rows, filter='modified_akf', window='whole', quantity='r_x')
    assert float(paper['paper']) == 37.3563
    lag = {
        name: float(of(rows, filter=name, window='second half', quantity='lag')['median'])
        for name in PAIR.split(',')
    }
    # 3 m/s, mean delay 1.05 s.
    assert lag['conventional_akf'] == pytest.approx(3.15, abs=0.4)
    assert abs(lag['modified_akf']) < 0.4
    assert abs(lag['modified_akf'] - lag['clairvoyant']) < 0.1


@pytest.mark.slow
def test_table1_and_its_figure_in_parallel_processes(polar, tmp_path):
    status, out, err = polar(
        'experiment',
        'run',
        'figure8',
        '--quick',
        '--duration',
        10,
        '--jobs',
        2,
        '--out',
        tmp_path / 'a',
    )
    assert status == 0, err
    assert 'paper D1' in out
    assert (tmp_path / 'a' / 'figure8.png').stat().st_size > 10_000
    manifest = json.loads((tmp_path / 'a' / 'manifest.json').read_text())
    assert [r['group'] for r in manifest['runs']] == ['D1', 'D2', 'D3', 'D4']
    assert manifest['processes'] == 2


def test_ablation_in_small(polar, tmp_path):
    arguments = ('--duration', 20, '--columns', 'ignore,rewind', '--jobs', 1, '--out', tmp_path)
    status, out, err = polar('experiment', 'ablation', '--quick', *arguments)
    assert status == 0, err
    assert 'Processor time per fix' in out
    runs = json.loads((tmp_path / 'manifest.json').read_text())['runs']
    assert len(runs) == 1 + 2 * 2
    with_fixes = [r for r in runs if r['filter'] != 'no fixes']
    assert all(r['fixes']['FUSED'] >= 14 for r in with_fixes)
    assert (tmp_path / 'ablation.svg').exists()


def test_ablation_crosses_strategies_delays_periods_and_noise():
    jobs = plan_ablation(Request(), Size(100.0, 2), ['rewind', 'clairvoyant'])
    assert len(jobs) == 2 * 3 * (1 + 2 * 7 * 2)
    longest = max(jobs, key=lambda job: job.fixes.delay_s)
    assert longest.fixes.delay_s == 60.0
    assert EngineParams(**longest.changes).max_delay_s > 60.0
    assert {(j.world.imu, j.world.dvl_rate_hz) for j in jobs} == {
        ('paper_6_1', 10.0),
        ('paper_6_2', 10.0),
        ('paper_6_2', 0.0),
    }


def test_ablation_tells_of_fixes_that_were_not_fused():
    def run(column, verdicts):
        metrics = {'r_half': 1.0, 'nees_position_half': 1.0}
        group = '6.2; fix every 1 s; delay 5 s'
        return RunResult(group, column, 1, metrics, np.nan, '', verdicts, 0.1, {})

    request = Request(sensors=['6.2'], periods_s=[1.0], delays_s=[5.0])
    runs = [run('clone', {'FUSED': 9, 'TOO_OLD': 45}), run('rewind', {'FUSED': 54})]
    shown = ablation.tables(runs, Size(100.0, 1), request)[0].rows
    assert [row['d0'] for row in shown] == ['1.00; 45 of 54 fixes not fused', '1.00']


def test_ablation_crosses_what_is_asked_for():
    request = Request(sensors=['6.2'], periods_s=[2.0], delays_s=[5.0, 7.0])
    jobs = plan_ablation(request, Size(100.0, 1), ['rewind'])
    with_fixes = [j for j in jobs if j.column.name == 'rewind']
    assert [(j.fixes.period_s, j.fixes.delay_s) for j in with_fixes] == [(2.0, 5.0), (2.0, 7.0)]


def test_docs_state_every_choice():
    page = Path(__file__).resolve().parents[2] / 'docs' / 'experiments.md'
    assert choices_table() in page.read_text(encoding='utf-8')


def test_a_filter_that_stops_has_a_time_and_no_numbers(monkeypatch):
    real = jobs_module.engine_run.run

    def stopping(params, inputs):
        result = real(params, inputs)
        return type(result)(result.track, result.receipts, 'lost definiteness')

    monkeypatch.setattr(jobs_module.engine_run, 'run', stopping)
    choices = Choices()
    job = Job('D', pick(choices, ['ignore'])[0], 1, choices.world(10.0), FixSpec(), series=True)
    result = run_job(job)
    assert result.stopped
    assert result.metrics == {}
    assert 0.0 < result.stopped_s <= 10.0
    assert len(result.series['time_s'])
    assert spread([result], 'r').count == 0


def test_spread_is_over_the_runs_that_lasted():
    def run(value, reason=''):
        metrics = {} if reason else {'r': value}
        return RunResult('D', 'x', 1, metrics, 5.0, reason, {}, 0.0)

    s = spread([run(1.0), run(4.0), run(2.0), run(0.0, 'gone')], 'r')
    assert (s.median, s.low, s.high, s.count, s.stopped) == (2.0, 1.0, 4.0, 3, 1)
    assert s.text() == '2.00 (1.00 to 4.00); 1 of 4 stopped'


@pytest.mark.slow
def test_a_failing_job_ends_the_parallel_run(tmp_path):
    choices = Choices()
    column = pick(choices, ['ignore'])[0]
    broken = [
        Job('D', column, seed, choices.world(10.0, dvl_rate_hz=7.0), FixSpec()) for seed in (1, 2)
    ]
    with opened(tmp_path) as store, pytest.raises(ConfigError, match='dvl_rate_hz'):
        run_jobs(tasks_of(broken, run_job), Workers(2), store, lambda *_: None)


def interrupted(polar, monkeypatch, arguments, after):
    """Run that somebody interrupts after so many runs, and how many of the next one were made."""
    real, made = execution.attempt, []

    def counting(*task):
        if len(made) == after:
            raise KeyboardInterrupt
        made.append(task)
        return real(*task)

    monkeypatch.setattr(execution, 'attempt', counting)
    status, _, err = polar(*arguments)
    assert status == 130
    assert '--resume' in err
    made[:], after = [], None
    return made


def test_an_interrupted_experiment_goes_on(polar, monkeypatch, tmp_path):
    arguments = ('experiment', 'run', 'consistency', '--duration', 30, '--seeds', 3, '--jobs', 1)
    assert polar(*arguments, '--out', tmp_path / 'whole')[0] == 0
    made = interrupted(polar, monkeypatch, (*arguments, '--out', tmp_path / 'other'), 4)
    status, _, err = polar(*arguments, '--out', tmp_path / 'other')
    assert status == 2
    assert '4 runs' in err
    assert '--resume' in err
    assert made == []
    status, _, err = polar(*arguments, '--resume', '--out', tmp_path / 'other')
    assert status == 0
    assert '4 of 6 runs were there already' in err
    assert len(made) == 2
    for name in ('consistency.csv', 'consistency.md', 'consistency.svg'):
        assert (tmp_path / 'other' / name).read_bytes() == (tmp_path / 'whole' / name).read_bytes()


@pytest.mark.slow
def test_more_seeds_make_the_missing_runs_only(polar, monkeypatch, tmp_path):
    arguments = ('experiment', 'run', 'consistency', '--duration', 30, '--jobs', 1)
    arguments = (*arguments, '--columns', 'rewind', '--out', tmp_path, '--seeds')
    assert polar(*arguments, 1)[0] == 0
    made = []
    real = execution.attempt
    monkeypatch.setattr(execution, 'attempt', lambda *x: made.append(x) or real(*x))
    assert polar(*arguments, 3, '--resume')[0] == 0
    assert len(made) == 2
    assert polar(*arguments, 3, '--resume')[0] == 0
    assert len(made) == 2
    assert polar(*arguments, 3)[0] == 0  # without it a finished experiment begins anew
    assert len(made) == 5


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_an_interrupt_ends_all_processes(tmp_path):
    command = [sys.executable, '-m', 'polar_nav_tools.cli', 'experiment', 'run', 'figure8']
    command += ['--duration', '3000', '--seeds', '50', '--jobs', '2', '--out', str(tmp_path)]
    parent = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        wait_until(lambda: len(workers_of(parent.pid)) == 2, 100.0)
        workers = workers_of(parent.pid)
        parent.send_signal(signal.SIGINT)  # to the parent alone, as a supervisor would
        assert parent.wait(30.0) == 130
        said = parent.stderr.read()
        assert 'Traceback' not in said
        assert '--resume goes on' in said
    finally:
        parent.kill()
        parent.wait()
        parent.stderr.close()
    wait_until(lambda: not any(worker.is_running() for worker in workers))


def workers_of(parent):
    """Spawned workers of a process."""
    return [
        child
        for child in psutil.Process(parent).children()
        if any('spawn_main' in word for word in child.cmdline())
    ]


def wait_until(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_consistency_counts_minutes_inside_the_band(polar, tmp_path):
    arguments = ('--duration', 130, '--seeds', 4, '--columns', 'rewind', '--jobs', 1)
    status, out, err = polar('experiment', 'run', 'consistency', *arguments, '--out', tmp_path)
    assert status == 0, err
    assert 'inside the 99 % band' in out
    assert (tmp_path / 'consistency.png').exists()
    runs = json.loads((tmp_path / 'manifest.json').read_text())['runs']
    assert {r['metrics']['nees_dof'] for r in runs} == {21.0}
    assert 40 < np.mean([r['fixes']['FUSED'] for r in runs]) < 46  # 64 less 30 %


@pytest.mark.parametrize(('scale', 'inside', 'outside'), [(1.0, 100.0, 0), (9.0, 0.0, 2)])
def test_bands_refuse_what_is_not_honest(scale, inside, outside):
    # Chi-square variables of 21 and 3 degrees of freedom, means of 50 runs.
    rng = np.random.default_rng(3)
    t = np.arange(3.0, 130.0, 3.0)

    def run(seed):
        series = {'time_s': t, 'nees': scale * rng.chisquare(21, t.size)}
        series['nees_position'] = scale * rng.chisquare(3, t.size)
        metrics = {'nees_dof': 21.0}
        return RunResult('prior', 'rewind', seed, metrics, np.nan, '', {}, 0.0, series)

    runs = [run(seed) for seed in range(50)]
    table = consistency.tables(runs, Size(130.0, 50), Request())[0]
    assert [row['minutes'] for row in table.rows] == [2, 2]
    assert [row['inside'] for row in table.rows] == [inside] * 2
    assert [row['outside'] for row in table.rows] == [outside] * 2


def test_every_filter_makes_engine_parameters_and_all_compared_are_known():
    choices = choices_from(['engine.adaptive_floor=0.25', 'forgetting=0.999'])
    columns = filter_columns(choices)
    assert set(COMPARED) <= set(columns)
    for column in columns.values():
        params = EngineParams(**{**choices.filter_changes(2.0), **column.changes})
        assert (params.adaptive_floor, params.forgetting) == (0.25, 0.999)
    assert sum(c.clairvoyant for c in columns.values()) == 1


def test_the_paper_has_all_its_numbers():
    for table in PAPER.values():
        for column in table.values():
            assert list(column) == [q.key for q in QUANTITIES]
            assert np.all(np.array(list(column.values())) > 0.0)


def test_list_names_all(polar):
    status, out, _ = polar('experiment', 'list')
    assert status == 0
    for name in EXPERIMENTS:
        assert f'\n{name} ' in f'\n{out}'


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (
            (
                'run',
                'table9',
            ),
            ("'table9'", 'table1'),
        ),
        (('run', 'table1', '--set', 'colour=blue'), ('colour', 'speed_mps')),
        (('run', 'table1', '--set', 'speed_mps'), ('--set speed_mps', 'name=value')),
        (('run', 'table1', '--set', 'speed_mps=fast'), ('speed_mps=fast',)),
        (('run', 'table1', '--set', 'speed_mps=50'), ('speed_mps', '50', '20')),
        (('run', 'table1', '--set', 'engine.colour=1'), ('engine.colour',)),
        (('run', 'table1', '--columns', 'magic'), ('--columns', "'magic'", 'rewind')),
        (('run', 'table1', '--duration', '1'), ('--duration', '10')),
        (('run', 'table1', '--seeds', '0'), ('--seeds', '0')),
        (('run', 'table1', '--jobs', '0'), ('--jobs', '0')),
        (('ablation', '--sensors', '7.1'), ('--sensors', "'7.1'", '6.2')),
        (('ablation', '--delays', '1,soon'), ('--delays', "'soon'")),
        (('ablation', '--periods', '0'), ('--periods', '0')),
        (('imu-errors', 'bag', '--experiment', 'table1'), ('table1', 'table3')),
        (('imu-errors', 'no_bag'), ('no_bag',)),
        (('imu-errors', 'no_bag', '--mean', 'half'), ('mean', 'half')),
    ],
)
def test_bad_options_are_named_in_one_sentence(polar, arguments, words):
    status, out, err = polar('experiment', *arguments)
    assert status == 2
    assert out == ''
    lines = err.strip().splitlines()
    assert len(lines) == 1, err
    for word in words:
        assert word in lines[0]


def test_help_states_example_and_choices(polar):
    assert tuple(EXPERIMENTS) == experiment_spelling.NAMES
    wanted = {
        'run': EXPERIMENTS,
        'ablation': ('6.1', '6.2 without DVL'),
        'imu-errors': ('remove|keep', 'table3|figure11'),
        'list': (),
    }
    for command, words in wanted.items():
        status, out, _ = polar('experiment', command, '--help')
        assert status == 0
        assert f'./polar experiment {command}' in out
        for word in words:
            assert word in out, (command, word)


@pytest.mark.parametrize(
    ('old', 'new'),
    [
        ('table1 --quick', 'run table1 --quick'),
        ('--seeds 2 --set speed_mps=2 has-loss', 'run has-loss --seeds 2 --set speed_mps=2'),
        ('ablation --delays 0,5', 'ablation --delays 0,5'),
        ('--quick ablation --json', 'ablation --quick --json'),
        ('--list', 'list'),
        ('table3 --imu-errors BAG --quick', 'imu-errors BAG --quick'),
        (
            'figure11 --imu-errors=BAG --imu-mean keep --imu-earth-rate=keep --out o',
            'imu-errors BAG --experiment figure11 --mean keep --earth-rate keep --out o',
        ),
        ('run table1 --quick', 'run table1 --quick'),
        ('tabel1 --quick', 'tabel1 --quick'),
        ('--help', '--help'),
    ],
)
def test_old_spellings_are_the_subcommands_of_today(old, new):
    assert experiment_spelling.today(old.split()) == new.split()


def test_an_old_spelling_runs_with_a_hint_on_stderr(polar):
    status, out, err = polar('experiment', '--list')
    assert status == 0
    assert 'table1 ' in out
    assert './polar experiment list' in err
    status, _, err = polar('experiment', 'table1', '--jobs', 0)
    assert status == 2
    hint, error = err.strip().splitlines()
    assert './polar experiment run table1 --jobs 0' in hint
    assert '--jobs: 0' in error
