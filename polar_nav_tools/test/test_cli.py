"""The command line tool, in process: help, exit status, JSON, one sentence for bad input."""

import json
import subprocess
import sys

import pytest

from polar_nav_core.errors import ConfigError, PolarNavError
from polar_nav_tools.bags import BagError, BagWriter
from polar_nav_tools.bags.errors import WrongRequestError
from polar_nav_tools.cli import main
from polar_nav_tools.cli import status as status_rule

COMMANDS = (
    'demo',
    'test',
    'launch',
    'record',
    'play',
    'replay',
    'score',
    'verify',
    'report',
    'info',
    'recover',
    'doctor',
    'export',
    'why',
    'delay-budget',
    'identify',
)
WITHOUT_FIGURES = ('test', 'launch', 'record')
ON_A_BAG = ('play', 'replay', 'score', 'verify', 'report', 'info', 'recover', 'doctor', 'identify')


@pytest.fixture
def polar(monkeypatch, capsys, tmp_path):
    """Run the tool; exit status, stdout and stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('COLUMNS', '200')

    def run(*arguments):
        monkeypatch.setattr(sys, 'argv', ['polar', *map(str, arguments)])
        status = main()
        out = capsys.readouterr()
        return status, out.out, out.err

    return run


def assert_one_sentence(status, out, err, *words, expected=2):
    assert status == expected
    assert out == ''
    lines = err.strip().splitlines()
    assert len(lines) == 1, err
    assert lines[0].startswith('polar: ')
    for word in words:
        assert str(word) in lines[0]


def test_help_names_every_command(polar):
    status, out, _ = polar('--help')
    assert status == 0
    for command in COMMANDS:
        assert f' {command} ' in out


@pytest.mark.parametrize('command', COMMANDS)
def test_every_command_has_help_with_an_example(polar, command):
    status, out, _ = polar(command, '--help')
    assert status == 0
    assert f'Example: ./polar {command}' in out
    assert ('--json' in out) is (command not in WITHOUT_FIGURES)


def test_without_a_command_the_help_is_shown_and_the_status_is_not_0(polar):
    status, out, _ = polar()
    assert status == 2
    assert 'demo' in out


@pytest.mark.parametrize(
    'arguments', [['fly'], ['info'], ['demo', '--seed', '-3'], ['demo', '-x']]
)
def test_usage_errors_have_status_2(polar, arguments):
    status, out, err = polar(*arguments)
    assert status == 2
    assert out == ''
    assert 'Traceback' not in err


# -- bags that are none


@pytest.mark.parametrize('command', ON_A_BAG)
def test_no_such_bag(polar, command):
    assert_one_sentence(*polar(command, 'nowhere'), 'nowhere')


@pytest.mark.parametrize('command', ON_A_BAG)
def test_a_file_that_is_no_bag(polar, command, tmp_path):
    path = tmp_path / 'notes.mcap'
    path.write_text('not a bag at all, but long enough to look into it\n' * 20)
    assert_one_sentence(*polar(command, path), 'notes.mcap', expected=1)


@pytest.mark.parametrize('command', ON_A_BAG)
def test_an_empty_folder(polar, command, tmp_path):
    (tmp_path / 'empty').mkdir()
    assert_one_sentence(*polar(command, tmp_path / 'empty'), 'empty', expected=1)


# -- bags of something else

STRING = b'\x00\x01\x00\x00\x06\x00\x00\x00hello\x00'


@pytest.fixture
def strange_bag(tmp_path):
    """A whole bag without anything of ours."""
    with BagWriter(tmp_path / 'strange', {'mission': 'none'}, chunk_bytes=4096) as writer:
        writer.add_topic('/chatter', 'std_msgs/msg/String')
        for i in range(2000):
            writer.write('/chatter', STRING, 1_000_000_000 + i * 10_000_000)
    return tmp_path / 'strange'


@pytest.mark.parametrize('command', ['replay', 'score', 'verify', 'report'])
def test_a_bag_without_the_needed_topics(polar, command, strange_bag):
    assert_one_sentence(*polar(command, strange_bag), 'strange', 'follower', expected=1)


def test_info_of_a_strange_bag(polar, strange_bag):
    status, out, err = polar('info', strange_bag, '--json')
    assert (status, err) == (0, '')
    said = json.loads(out)
    assert said['ok'] is True
    assert said['message_count'] == 2000
    status, out, err = polar('info', strange_bag)
    assert (status, err) == (0, '')
    assert '/chatter' in out


def truncated(bag, share=0.6):
    file = next(bag.glob('*.mcap'))
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * share)])
    (bag / 'metadata.yaml').unlink()
    return bag


def test_a_truncated_bag_is_read_and_said_to_be_one(polar, strange_bag):
    status, out, err = polar('info', truncated(strange_bag), '--json')
    assert status == 1
    said = json.loads(out)
    assert said['ok'] is False
    assert 0 < said['message_count'] < 2000
    assert 'not finished' in err
    assert 'Traceback' not in err


def test_recover_makes_it_whole(polar, strange_bag, tmp_path):
    truncated(strange_bag)
    status, out, _ = polar('recover', strange_bag, '--json')
    assert status == 0
    target = tmp_path / 'strange_recovered'
    assert json.loads(out)['path'] == str(target)
    assert (target / 'metadata.yaml').is_file()
    status, out, err = polar('info', target, '--json')
    assert status == 1  # the bag says of itself that something is missing
    assert 'recovered from a broken bag' in err
    assert 'metadata.yaml' not in err


def test_recover_never_overwrites(polar, strange_bag, tmp_path):
    (tmp_path / 'there').mkdir()
    status, out, err = polar('recover', strange_bag, '--out', tmp_path / 'there')
    assert_one_sentence(status, out, err, 'there', 'exists already')


# -- demo and launch: what can be refused before anything starts


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['--mission', 'moon'], ['moon', 'demo']),
        (['--pace', 'warp'], ['warp', 'lockstep']),
        (['--configuration', 'best'], ['best', 'modified_akf']),
        (['--duration', '0.5'], ['duration', '0.5']),
        (['--seed', str(2**31)], ['seed', 2**31]),
    ],
)
def test_demo_refuses_what_does_not_exist(polar, arguments, words):
    assert_one_sentence(*polar('demo', *arguments), *words)


MISTAKEN = """
path: {kind: spiral}
vehicles: {mother: {role: leader}, pup: {}}
"""


def test_demo_refuses_a_mission_file_with_a_mistake(polar, tmp_path):
    (tmp_path / 'mine.yaml').write_text(MISTAKEN)
    assert_one_sentence(*polar('demo', '--mission', 'mine.yaml'), 'mine.yaml', 'spiral')


def test_a_bag_is_never_overwritten(polar, tmp_path):
    (tmp_path / 'old').mkdir()
    assert_one_sentence(*polar('demo', '--bag', 'old'), 'old', 'exists already')
    assert_one_sentence(*polar('launch', '--bag', 'old'), 'old', 'exists already')


@pytest.mark.parametrize(
    ('setting', 'words'),
    [
        ('max_delay', ['expected name=value']),
        ('colour=blue', ['unknown parameter colour', 'docs/parameters.md']),
        ('max_delays=3.0', ['unknown parameter max_delays', 'did you mean max_']),
    ],
)
def test_replay_refuses_settings_that_do_not_exist(polar, strange_bag, setting, words):
    assert_one_sentence(*polar('replay', strange_bag, '--set', setting), *words)


def test_test_refuses_long_and_fast_together(polar):
    status, _, err = polar('test', '--long', '--fast')
    assert status == 2
    assert 'exclude each other' in err


# -- exit status


@pytest.mark.slow
def test_a_reader_that_goes_away_is_well(strange_bag):
    """As `| head` does; what is still to be written goes nowhere, and nothing complains."""
    command = [sys.executable, '-P', '-m', 'polar_nav_tools.cli', 'doctor', '--all', strange_bag]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        said = process.stderr.read().decode()
    assert process.returncode == 0
    assert 'Traceback' not in said
    assert 'BrokenPipe' not in said


@pytest.mark.parametrize(
    ('error', 'expected'),
    [
        (ConfigError('x'), 2),
        (WrongRequestError('x'), 2),
        (FileNotFoundError(), 2),
        (BagError('x'), 1),
        (PolarNavError('x'), 1),
        (OSError(), 1),
        (BrokenPipeError(), 0),
        (KeyboardInterrupt(), 130),
    ],
)
def test_every_error_has_one_of_three_statuses(error, expected):
    assert status_rule.of_error(error) == expected


def test_ctrl_c_is_130(polar, strange_bag, monkeypatch):
    def interrupt(_):
        raise KeyboardInterrupt

    monkeypatch.setattr('polar_nav_tools.bags.info.bag_info', interrupt)
    assert polar('info', strange_bag)[0] == 130
