"""`./polar campaign`: what its file may state, resuming, failures, the run of a key again."""

import json
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_sim.resources import find_mission
from polar_nav_tools.campaign import campaign as campaign_module
from polar_nav_tools.campaign.campaign import tasks_of
from polar_nav_tools.campaign.runs import run_job
from polar_nav_tools.campaign.spec import read
from polar_nav_tools.cli import main
from polar_nav_tools.experiments.runner import result_of
from polar_nav_tools.tasks import execution
from polar_nav_tools.tasks.rows import VARYING

WORLD = {'duration_s': 20.0, 'constants': 'prior', 'dvl_rate_hz': 5.0, 'depth_rate_hz': 5.0}
SPEC = {
    'world': WORLD,
    'fixes': {'period_s': 2.0, 'delay_kind': 'uniform', 'delay_s': 4.0},
    'vary': {'engine.configuration': ['default', 'modified_akf']},
    'draw': {'world.latitude_deg': {'uniform': [70, 89]}},
}


@pytest.fixture
def polar(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        monkeypatch.setattr(sys, 'argv', ['polar', *map(str, arguments)])
        status = main()
        out = capsys.readouterr()
        return status, out.out, out.err

    return run


def written(folder, values=SPEC, **changes):
    path = folder / 'spec.yaml'
    path.write_text(yaml.safe_dump({**values, **changes}))
    return path


def table(folder):
    return pq.read_table(folder / 'rows.parquet').drop_columns(list(VARYING))


# -- the file -------------------------------------------------------------------------------------

WRONG = [
    ({'wrold': {}}, "unknown key 'wrold'"),
    ({'world': {'speed': 2.0}}, 'world: unknown parameter speed'),
    ({'world': {'speed_mps': -1.0}}, 'world: parameter speed_mps'),
    ({'world': {'mission': 'demo'}}, 'world.mission'),
    ({'world': {'imu': 'recorded'}}, 'world.imu'),
    ({'world': 3}, 'world: expected a mapping'),
    ({'fixes': {'period_s': 'often'}}, 'fixes: parameter period_s'),
    ({'engine': {'gate': 0.9}}, 'engine: unknown parameter gate'),
    ({'mission': 'nowhere'}, 'mission: '),
    ({'mission': 3}, 'mission: 3 is not a word'),
    ({'settings': 'some'}, 'settings: '),
    ({'mismatch': 'gravity'}, "mismatch: no row 'gravity'"),
    ({'mismatch': 'gyro_step_1dph'}, 'mismatch: gyro_step_1dph begins after'),
    ({'fault': 'imu_nonsense'}, 'fault: '),
    ({'fault': 'thrust_silent:30@5'}, 'fault: thrust_silent:30@5 is none of sins mode'),
    ({'station': {}}, 'world stands beside station'),
    ({'vary': {'world.speed_mps': 2.0}}, 'vary.world.speed_mps: expected a list'),
    ({'vary': {'world.speed_mps': [2.0, -1.0]}}, 'world: parameter speed_mps'),
    ({'vary': {'wrold.speed_mps': [2.0]}}, 'vary.wrold.speed_mps'),
    ({'draw': {'world.speed_mps': {'even': [1, 2]}}}, 'draw.world.speed_mps: expected one of'),
    ({'draw': {'world.speed_mps': {'uniform': [2, 1]}}}, 'draw.world.speed_mps.uniform'),
    ({'draw': {'world.speed_mps': {'log_uniform': [0, 1]}}}, 'draw.world.speed_mps.log_uniform'),
    ({'draw': {'engine.configuration': {'choice': ['default']}}}, 'in vary and in draw'),
]


@pytest.mark.parametrize(('change', 'said'), WRONG, ids=[said for _, said in WRONG])
def test_what_is_wrong_in_a_file_is_named(polar, tmp_path, change, said):
    path = written(tmp_path, **change)
    status, _, err = polar('campaign', path, '--jobs', 1)
    assert status == 2
    assert f'{path}: {said}' in err if 'in vary' not in said else said in err
    assert 'Traceback' not in err


def test_a_file_that_is_no_mapping_is_named(polar, tmp_path):
    path = tmp_path / 'spec.yaml'
    path.write_text('[1, 2]')
    assert polar('campaign', path)[0] == 2
    assert polar('campaign', tmp_path / 'nothing.yaml')[0] == 2
    path.write_text('a: [')
    status, _, err = polar('campaign', path)
    assert status == 2
    assert str(path) in err


def test_station_has_its_own_numbers(tmp_path):
    station = {'station': {'duration_s': 30, 'noise': 0.5}}
    spec = read(written(tmp_path, station))
    assert spec.point({}).scene.scenario.noise == 0.5
    with pytest.raises(ConfigError, match=r'station.noise: .* is no float'):
        read(written(tmp_path, {'station': {'noise': True}}))
    with pytest.raises(ConfigError, match=r'station: no parameter .nose.'):
        read(written(tmp_path, {'station': {'nose': 1.0}}))
    with pytest.raises(ConfigError, match='sins mode'):
        read(written(tmp_path, station, mismatch='gyro_step_1dph'))


def test_every_combination_has_the_same_draw_of_a_seed(tmp_path):
    draw = {**SPEC['draw'], 'fixes.sigma': {'log_uniform': [0.5, 5.0]}}
    draw['fixes.first_s'] = {'normal': [3.0, 0.1]}
    draw['world.speed_mps'] = {'uniform': [2.0, 4.0]}
    draw['mission'] = {'choice': ['', 'demo']}
    spec = read(written(tmp_path, draw=draw))
    tasks = tasks_of(spec, 20, 5)
    assert len(tasks) == len({t.key for t in tasks}) == 40
    assert [t.names['world.latitude_deg'] for t in tasks[::2]] == [
        t.names['world.latitude_deg'] for t in tasks[1::2]
    ]
    assert [t.stretch for t in tasks[::2]] == [t.stretch for t in tasks[1::2]]
    values = [t.names['world.latitude_deg'] for t in tasks]
    assert 70.0 <= min(values) < max(values) <= 89.0
    assert len(set(values)) == 20
    assert {t.names['mission'] for t in tasks} == {'', 'demo'}
    speeds = [t.names['world.speed_mps'] for t in tasks[::2]]
    assert abs(np.corrcoef(speeds, values[::2])[0, 1]) < 0.7  # streams of their own
    # Another parameter drawn beside it, and another order of seeds, change no draw.
    alone = tasks_of(read(written(tmp_path)), 1, 24)
    assert alone[0].names['world.latitude_deg'] == values[-1]


def test_a_key_is_of_the_content(tmp_path):
    keys = [t.key for t in tasks_of(read(written(tmp_path)), 2, 1)]
    other = tmp_path / 'other'
    other.mkdir()
    assert keys == [t.key for t in tasks_of(read(written(other)), 2, 1)]
    assert keys[2:] == [t.key for t in tasks_of(read(written(tmp_path)), 1, 2)]
    for change in (
        {'world': {**WORLD, 'duration_s': 21.0}},
        {'engine': {'gate_probability': 0.99}},
        {'settings': 'exact'},
        {'fault': 'imu_silent:3@5'},
        {'mission': 'demo'},
    ):
        changed = [t.key for t in tasks_of(read(written(tmp_path, **change)), 2, 1)]
        assert not set(changed) & set(keys)


def test_a_mission_travels_with_its_runs(tmp_path):
    mission = tmp_path / 'mine.yaml'
    mission.write_text(find_mission('racetrack').read_text())
    (by_file,) = tasks_of(read(written(tmp_path, {'mission': 'mine.yaml', 'world': WORLD})), 1, 1)
    (by_name,) = tasks_of(read(written(tmp_path, {'mission': 'racetrack', 'world': WORLD})), 1, 1)
    assert by_file.key == by_name.key
    mission.unlink()
    assert run_job(by_file.argument).metrics == run_job(by_name.argument).metrics


# -- runs -----------------------------------------------------------------------------------------


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """Rows of three seeds of two filters that nothing disturbed."""
    folder = tmp_path_factory.mktemp('whole')
    spec = read(written(folder))
    order = campaign_module.Order(spec, 3, 1, folder / 'out')
    campaign_module.run(order, lambda *_: None, lambda: None)
    return folder / 'out'


def test_a_campaign_reports_and_goes_on(polar, whole, tmp_path, monkeypatch):
    path = written(tmp_path)
    run = ('campaign', path, '--jobs', 1, '--out', tmp_path / 'out')
    status, out, err = polar(*run, '--runs', 1)
    assert status == 0, err
    assert 'Worst runs' in out
    made, real = [], execution.attempt
    monkeypatch.setattr(execution, 'attempt', lambda *x: made.append(x) or real(*x))
    status, _, err = polar(*run, '--runs', 3, '--resume')
    assert status == 0
    assert '2 of 6 runs were there already' in err
    assert len(made) == 4
    assert table(tmp_path / 'out').equals(table(whole))
    columns = table(whole).column_names
    assert {'engine.configuration', 'world.latitude_deg', 'seed', 'rms'} <= set(columns)
    text = (tmp_path / 'out' / 'campaign.md').read_text()
    for title in ('Quantiles over runs', 'Worst runs', 'Normalized squared error'):
        assert title in text


def test_an_interrupted_campaign_is_not_begun_anew(polar, tmp_path, monkeypatch):
    made, real = [], execution.attempt

    def counting(*task):
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append(task)
        return real(*task)

    monkeypatch.setattr(execution, 'attempt', counting)
    run = ('campaign', written(tmp_path), '--jobs', 1, '--runs', 2)
    status, _, err = polar(*run)
    assert status == 130
    assert '--resume' in err
    monkeypatch.setattr(execution, 'attempt', real)
    status, _, err = polar(*run)
    assert status == 2
    assert 'reports/spec' in err
    assert polar(*run, '--resume')[0] == 0


def test_failures_are_rows_and_are_made_again(polar, whole, tmp_path, monkeypatch):
    path = written(tmp_path)
    run = ('campaign', path, '--runs', 3, '--jobs', 1, '--out', tmp_path / 'out')

    def failing(job):
        if job.seed == 2:
            raise ZeroDivisionError('no such luck')
        return run_job(job)

    monkeypatch.setattr(campaign_module, 'run_job', failing)
    monkeypatch.setattr(campaign_module, 'result_of', lambda row, _: result_of(row, run_job))
    status, out, err = polar(*run)
    assert status == 1
    assert '2 runs failed: --failed' in err
    assert 'ZeroDivisionError: no such luck' in out
    bad = [r for r in table(tmp_path / 'out').to_pylist() if r['status'] == 'failed']
    assert [r['where'].split(':')[0] for r in bad] == ['test_campaign.py'] * 2
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, 'argv', [*map(str, ('polar', *run)), '--failed'])
    assert main() == 0
    assert table(tmp_path / 'out').select(table(whole).column_names).equals(table(whole))
    monkeypatch.setattr(sys, 'argv', [*map(str, ('polar', *run)), '--failed'])
    assert main() == 2  # none is left


def test_the_run_of_a_key_is_repeated_bit_for_bit(polar, whole, tmp_path):
    path = written(tmp_path)
    row = table(whole).to_pylist()[3]
    run = ('campaign', path, '--runs', 3, '--out', whole)
    status, out, err = polar(*run, '--only', row['key'][:12])
    assert status == 0
    assert 'bit for bit' in err
    assert json.loads(out)['metrics']['rms'] == row['rms']
    assert polar(*run, '--only', 'xyz')[0] == 2
    assert polar(*run, '--only', '')[0] == 2


@pytest.mark.slow
def test_faults_mismatches_and_stations_run(polar, tmp_path):
    world = {**WORLD, 'duration_s': 420.0}
    vary = {'mismatch': ['none', 'gyro_step_1dph'], 'fault': ['none', 'imu_silent:3@60']}
    path = written(tmp_path, {'world': world, 'fixes': SPEC['fixes'], 'vary': vary})
    out = ('--out', tmp_path / 'out', '--jobs', 1, '--runs', 1)
    assert polar('campaign', path, *out)[0] == 0
    rows = {(r['mismatch'], r['fault']): r for r in table(tmp_path / 'out').to_pylist()}
    assert len({r['rms'] for r in rows.values()}) == 4
    path = written(tmp_path, {'station': {'duration_s': 60.0}})
    assert polar('campaign', path, *out)[0] == 0
    assert table(tmp_path / 'out')['rms'][0].as_py() > 0.0


def test_engine_parameters_are_those_of_the_file(tmp_path):
    spec = read(written(tmp_path, engine={'gate_probability': 0.99}))
    assert spec.point({}).engine == {'gate_probability': 0.99}
    assert EngineParams(**spec.point({}).engine).gate_probability == 0.99
