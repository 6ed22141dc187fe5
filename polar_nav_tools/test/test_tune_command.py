"""`polar tune`: what is suggested goes into a copy of the mapping, comments stay; refusals."""

import json
import sys
from pathlib import Path

import pytest
import yaml
from foreign_samples import MAPPING, engine_parameters
from foreign_samples import write as write_sample
from foreign_worlds import (
    DVL_SIGMA,
    FIX_SIGMA,
    Recorder,
    aiding_columns,
    imu_column,
    mapping,
    stamps_of,
    truth_of,
    write_columns,
)

from polar_nav_ros.adapters import mapping_file
from polar_nav_tools.cli import main

BAGS = Path(__file__).parents[2] / 'bags'
DURATION_S = 300.0
COMMENT = '# Ada says so'
KEYS = {
    'name', 'source', 'unit', 'stated', 'found', 'sigma_share', 'at_most', 'verdict', 'refuted',
    'suggested', 'changes', 'why', 'about',
}  # fmt: skip


def polar(*words):
    """Exit status of the command."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, 'argv', ['polar', *map(str, words)])
        return main()


@pytest.fixture(scope='module')
def vehicle(tmp_path_factory):
    """An sqlite3 bag of ROS's own types, and a mapping that states a DVL five times too good."""
    folder = tmp_path_factory.mktemp('tune')
    truth, make = truth_of(DURATION_S), Recorder()
    columns = [imu_column(make, truth, stamps_of(truth, 0.0, DURATION_S, 0.01))]
    columns += aiding_columns(make, truth, 0.0, DURATION_S)
    bag = write_columns(folder / 'bag', make, columns, 'sqlite3')
    what = mapping()
    what['dvl']['sigma'] = DVL_SIGMA / 5.0
    what['fixes'][0]['sigma'] = [5.0 * FIX_SIGMA[0], 5.0 * FIX_SIGMA[1]]
    path = folder / 'mapping.yaml'
    text = yaml.safe_dump(what, sort_keys=False)
    path.write_text(text.replace('dvl:\n', f'dvl:\n  {COMMENT}\n'))
    return bag, path


@pytest.mark.slow
def test_a_mapping_is_suggested_and_the_old_one_stays(vehicle, capsys):
    bag, path = vehicle
    before = path.read_text()
    assert polar('tune', bag, '--map', path, '--write', '--json') == 0
    said = json.loads(capsys.readouterr().out)
    assert said['ok']
    assert said['path'] == str(bag)
    assert path.read_text() == before
    by_name = {p['name']: p for p in said['parameters']}
    assert all(set(p) == KEYS for p in said['parameters'])
    dvl = by_name['dvl_sigma']
    assert dvl['verdict'] == 'ESTIMATED'
    assert dvl['found'] == pytest.approx(DVL_SIGMA, rel=0.2)
    assert dvl['stated'] == pytest.approx(DVL_SIGMA / 5.0)
    assert not by_name['depth_sigma']['changes']
    held_out = said['held_out']
    assert held_out['verdict'] == 'better'
    assert all(n['inside'] for n in held_out['nis'].values())
    assert not held_out['nis']['dvl']['stated'] < held_out['nis']['dvl']['band'][1]
    assert set(held_out['nees']['suggested']) == {'position', 'velocity', 'heading'}
    new = path.with_name('mapping_tuned.yaml')
    assert said['written']['path'] == str(new)
    assert COMMENT in new.read_text()
    assert '# polar tune bag of 2026-03-01: stated 0.002; 1-sigma' in new.read_text()
    right = mapping_file.load(new)
    assert right.dvl.sigma == pytest.approx(dvl['suggested'], rel=1e-3)
    if 'fix_sigma' in said['written']['names']:
        assert right.fixes[0].sigma[0] == pytest.approx(2.0 * right.fixes[0].sigma[1], rel=1e-3)
    assert polar('tune', bag, '--map', path, '--write') == 2
    assert 'exists' in capsys.readouterr().err


@pytest.mark.slow
def test_a_recording_of_this_project(capsys):
    assert polar('tune', BAGS / 'reference_4') == 0
    said = capsys.readouterr()
    for word in ('gyro_noise_density', 'NOT_EXCITED', 'ESTIMATED', 'held out', 'NEES', 'IMU:'):
        assert word in said.out
    assert 'nothing was changed' in said.out


@pytest.mark.slow
def test_without_a_mapping_parameters_are_printed(capsys):
    words = ['--set', 'dvl_markov_sigma=0.2', '--write']
    assert polar('tune', BAGS / 'reference_4', *words) == 0
    said = capsys.readouterr()
    values = yaml.safe_load(said.out[said.out.index('parameters:') :])
    assert 0.0 < values['parameters']['dvl_markov_sigma'] < 0.1
    assert 'nothing was changed' not in said.out


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['mcap', 'ros1'])
def test_a_bag_of_any_origin_and_kind(kind, tmp_path, capsys):
    bag = write_sample(tmp_path / ('cruise' if kind == 'mcap' else 'cruise.bag'), kind)
    text = yaml.safe_load(MAPPING) | {'parameters': engine_parameters()}
    path = tmp_path / 'm.yaml'
    path.write_text(yaml.safe_dump(text))
    assert polar('tune', bag, '--map', path, '--json') == 0
    said = json.loads(capsys.readouterr().out)
    assert said['ok']
    assert said['held_out']['rows'] > 200
    assert {p['name'] for p in said['parameters']} >= {'dvl_sigma', 'depth_sigma', 'fix_sigma'}


@pytest.mark.parametrize(
    ('words', 'text'),
    [
        (['station'], 'mode sins'),
        (['reference_4', '--accept', 'x'], '--map'),
        (['reference_4', '--set', 'gyro_noise_density=-1.0'], 'gyro_noise_density'),
        (['nothing_here'], 'nothing_here'),
    ],
)
def test_what_cannot_be_tuned_is_named(words, text, capsys, monkeypatch):
    monkeypatch.chdir(BAGS)
    assert polar('tune', *words) == 2
    assert text in capsys.readouterr().err
