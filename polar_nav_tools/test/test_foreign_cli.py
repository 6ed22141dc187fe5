"""`polar replay --map`, `polar map` and `polar import csv`: exit status, JSON, refusals."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from foreign_samples import MAPPING, REFERENCE, engine_parameters, write

from polar_nav_tools.bags import open_bag
from polar_nav_tools.cli import main

Polar = Callable[..., tuple[int, str, str]]


@pytest.fixture
def polar(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Polar:
    """Run the tool; exit status, stdout and stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('COLUMNS', '200')

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, 'argv', ['polar', *map(str, arguments)])
        status = main()
        out = capsys.readouterr()
        return status, out.out, out.err

    return run


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The foreign recording as MCAP."""
    return write(tmp_path_factory.mktemp('cli') / 'theirs')


def put(path: Path, changes: dict[str, object] | None = None) -> Path:
    """Write a mapping."""
    top = yaml.safe_load(MAPPING) | {'parameters': engine_parameters()} | (changes or {})
    path.write_text(yaml.safe_dump(top))
    return path


def test_replay_with_a_mapping(polar: Polar, bag: Path, tmp_path: Path) -> None:
    """JSON has findings and score; the bag that is written scores by itself."""
    mapping = put(tmp_path / 'm.yaml')
    out = tmp_path / 'out'
    status, text, _ = polar(
        'replay', bag, '--map', mapping, '--out', out, '-c', 'default', '--json'
    )
    said = json.loads(text)
    assert status == 0
    assert said['ok'] is True
    assert said['configuration'] == 'default'
    assert said['verdicts'] == {'FUSED': 13}
    assert said['score']['default']['summary']['fused'] == 13
    value, word = said['nees'].split(', ')[:2]
    judged = said['score']['default']['windows']['second_half']['nees_position']
    assert float(value) == pytest.approx(judged['mean_per_dof'], rel=0.01)
    assert word == judged['judgement']
    assert open_bag(out).run_info['mapping'] == str(mapping)
    status, text, _ = polar('score', out, '--recorded', '--json')
    assert status == 0
    (one,) = json.loads(text)['runs'].values()
    assert one['summary']['r_x'] == said['score']['default']['summary']['r_x']
    assert polar('replay', bag, '--map', mapping, '--out', out)[0] == 2


def test_severe_findings_refuse_unless_accepted(polar: Polar, bag: Path, tmp_path: Path) -> None:
    """Nothing is printed on stdout, the sentence has the way out, and --accept takes it."""
    fix = yaml.safe_load(MAPPING)['fixes'][0] | {'time_offset_s': 9.0}
    mapping = put(tmp_path / 'm.yaml', {'fixes': [fix]})
    status, out, err = polar('replay', bag, '--map', mapping)
    assert (status, out) == (1, '')
    assert 'refused, nothing was integrated: fix_from_future' in err
    assert '--accept fix_from_future' in err
    assert '/acoustics/position: fix_from_future: 13 fixes are received up to' in err
    status, out, err = polar('replay', bag, '--map', mapping, '--accept', 'fix_from_future')
    assert status == 0
    assert 'severe: fix_from_future: /acoustics/position at 17723232' in err
    assert 'FROM_FUTURE 13' in out
    status, _, err = polar('replay', bag, '--map', mapping, '--accept', 'everything')
    assert status == 2
    assert "'everything' is no finding" in err


def test_map_prints_a_mapping(polar: Polar, tmp_path: Path) -> None:
    """What `polar map` prints of a bag of known types and instruments runs as it is."""
    status, text, _ = polar('map', REFERENCE, '--imu', 'stim300', '--dvl', 'workhorse_1200')
    assert status == 0
    mapping = tmp_path / 'guessed.yaml'
    mapping.write_text(text)
    status, text, err = polar('replay', REFERENCE, '--map', mapping, '--json')
    assert status == 0, err
    assert json.loads(text)['verdicts'] == {'FUSED': 13}
    status, _, err = polar('map', REFERENCE, '--imu', 'tactical')
    assert status == 2
    assert "'tactical' is none of" in err


def test_a_damaged_bag_is_told_of(polar: Polar, bag: Path, tmp_path: Path) -> None:
    """Cut off in the middle: figures of what is there, status 1."""
    file = next(bag.glob('*.mcap'))
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(file.read_bytes()[: file.stat().st_size * 3 // 4])
    status, _, err = polar('replay', cut, '--map', put(tmp_path / 'm.yaml'), '--json')
    assert status == 1
    assert 'cut.mcap' in err


def test_import_csv(polar: Polar, tmp_path: Path) -> None:
    """A short IMU file becomes a bag with its mapping."""
    rows = '\n'.join(f'{k / 100:.2f},0,0,0,0,0,9.81' for k in range(50))
    (tmp_path / 'imu.csv').write_text(f't,p,q,r,x,y,z\n{rows}\n')
    columns = tmp_path / 'columns.yaml'
    columns.write_text('imu: {file: imu.csv, time: t, rate: [p, q, r], force: [x, y, z]}\n')
    status, text, _ = polar('import', 'csv', columns, '--out', 'auv', '--json')
    assert status == 0
    assert json.loads(text)['counts'] == {'/follower/imu/data_raw': 50}
    written = yaml.safe_load(Path('auv/mapping.yaml').read_text())
    assert written['imu'] == {'topic': '/follower/imu/data_raw'}
    assert written['version'] == 2
    status, _, err = polar('import', 'csv', columns, '--out', 'auv')
    assert status == 2
    assert 'never overwritten' in err
