"""The front door: what a command loads, what its errors and its help name."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from polar_nav_core.engine.configurations import NAMES
from polar_nav_core.errors import ConfigError
from polar_nav_core.user_files import writing
from polar_nav_ros.adapters import mapping, noise_classes
from polar_nav_tools.cli import choices, main
from polar_nav_tools.export import formats
from polar_nav_tools.graph import options
from polar_nav_tools.live.run import read_mission
from polar_nav_tools.terminal import progress

REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'
HEAVY = {'numpy', 'scipy', 'numba', 'rclpy', 'matplotlib', 'rosbags'}
_PROGRAM = """
import sys
from polar_nav_tools.cli import main
sys.argv = ['polar', *sys.argv[1:]]
try:
    main()
except SystemExit:
    pass
print('loaded', *sorted(sys.modules))
"""


def loaded(*arguments):
    """Modules that a command has loaded at its end, in a process of its own."""
    command = [sys.executable, '-P', '-c', _PROGRAM, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split()[1:])


@pytest.mark.parametrize(
    'arguments',
    [
        ('replay', 'nosuch'),
        ('report', 'nosuch'),
        ('doctor', 'nosuch'),
        ('export', 'nosuch', 'x.tum'),
        ('why', 'nosuch', '--seq', '1'),
        ('demo', '--help'),
    ],
    ids=' '.join,
)
def test_what_needs_no_numbers_loads_none(arguments):
    assert not loaded(*arguments) & HEAVY


@pytest.mark.slow
def test_a_delay_budget_needs_no_signal_processing():
    assert not loaded('delay-budget') & {'scipy.signal', 'matplotlib', 'rclpy'}


def test_the_words_of_the_help_are_those_that_count():
    assert choices.PACES == options.PACES
    assert choices.LEADERS == options.LEADERS
    assert choices.FORMATS == formats.FORMATS
    assert choices.FRAMES == formats.FRAMES
    assert choices.CONFIGURATIONS == NAMES
    assert choices.IMU_CLASSES == noise_classes.IMU_CLASSES
    assert choices.DVL_CLASSES == noise_classes.DVL_CLASSES
    assert (choices.REFERENCES, choices.STAMPS) == (mapping.REFERENCES, mapping.STAMPS)


@pytest.mark.parametrize(
    ('command', 'words'),
    [
        ('demo', ('near_pole', 'lockstep|realtime', 'perfect|own', 'back_propagate')),
        ('launch', ('near_pole', 'perfect|own', 'back_propagate', '--network')),
        ('replay', ('back_propagate',)),
        ('why', ('back_propagate',)),
        ('map', ('stim300', 'workhorse_1200', 'bottom|water', 'header|log')),
        ('export', ('tum|csv', 'ecef|enu|grid', 'estimate:NAME')),
    ],
)
def test_help_lists_the_choices(monkeypatch, capsys, command, words):
    monkeypatch.setenv('COLUMNS', '300')
    monkeypatch.setattr('sys.argv', ['polar', command, '--help'])
    main()
    said = capsys.readouterr().out
    assert [w for w in words if w not in said] == []


def test_version(monkeypatch, capsys):
    monkeypatch.setattr('sys.argv', ['polar', '--version'])
    assert main() == 0
    name, number, engine, version = capsys.readouterr().out.split()
    assert (name, engine) == ('polar_nav', 'engine')
    assert number[0].isdigit()
    assert version.isdigit()


@pytest.mark.parametrize('kind', ['tum', 'csv'])
def test_a_full_disk_leaves_no_half_trajectory(monkeypatch, capsys, tmp_path, kind):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(formats, f'_{kind}', full)
    out = tmp_path / f'x.{kind}'
    monkeypatch.setattr('sys.argv', ['polar', 'export', str(REFERENCE), str(out)])
    assert main() == 1
    assert capsys.readouterr().err == f'polar: {out}: No space left on device\n'
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize('command', ['replay', 'score', 'verify', 'report', 'doctor'])
def test_without_a_terminal_work_on_a_bag_writes_no_progress(
    monkeypatch, capsys, tmp_path, command
):
    pytest.importorskip('rclpy')
    monkeypatch.setattr(progress.time, 'monotonic', iter(range(0, 10**6, 100)).__next__)
    out = ('--out', str(tmp_path / 'r.html')) if command == 'report' else ()
    monkeypatch.setattr('sys.argv', ['polar', command, str(REFERENCE), *out])
    assert main() == 0
    assert capsys.readouterr().err == ''


def test_a_duration_of_the_command_line_is_not_blamed_on_a_file():
    with pytest.raises(ConfigError, match=r'^duration: -5\.0 is outside of'):
        read_mission('demo', -5.0)


def test_a_full_disk_names_the_file(tmp_path):
    file = tmp_path / 'track.tum'
    with pytest.raises(OSError, match='No space left') as caught, writing(file):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert caught.value.filename == str(file)


STATION = REFERENCE.with_name('station')


@pytest.mark.parametrize(
    ('arguments', 'path'),
    [
        (('info', REFERENCE), REFERENCE),
        (('doctor', REFERENCE), REFERENCE),
        (('verify', REFERENCE), REFERENCE),
        (('replay', REFERENCE), REFERENCE),
        (('score', REFERENCE, '--configs', 'default'), REFERENCE),
        (('why', REFERENCE, '--seq', '1'), REFERENCE),
        (('identify', STATION), STATION),
        (('export', REFERENCE, 'x.tum'), REFERENCE),
        (('recover', REFERENCE, '--out', 'mended'), 'mended'),
        (('inject', REFERENCE, '--fault', 'imu_silent:1@3', '--out', 'other'), 'other'),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else '',
)
def test_json_names_the_bag_as_path(monkeypatch, capsys, tmp_path, arguments, path):
    """Of the bag that the figures are of; of a command that writes a bag, that one."""
    pytest.importorskip('rclpy')
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr('sys.argv', ['polar', *map(str, arguments), '--json'])
    main()
    said = json.loads(capsys.readouterr().out)
    assert list(said)[:2] == ['ok', 'path']
    assert said['path'] == str(path)
