"""`polar record --resume`: which bags it goes on with, and what the recorder is told."""

import json
import sqlite3

import pytest
from bag_samples import IMU, TYPES, imu
from mcap.writer import Writer

from polar_nav_core.errors import ConfigError
from polar_nav_tools.bags import BagWriter
from polar_nav_tools.bags.errors import WrongRequestError
from polar_nav_tools.bags.resuming import require_own
from polar_nav_tools.cli import main
from polar_nav_tools.record import recorder_node


@pytest.fixture
def polar(monkeypatch, capsys):
    """Call `polar record` without a recorder: status, what it says, what a recorder is told."""
    told = []
    monkeypatch.setattr(recorder_node, 'main', lambda given: told.append(given) or 0)

    def call(*arguments):
        told.clear()
        monkeypatch.setattr('sys.argv', ['polar', 'record', *map(str, arguments)])
        monkeypatch.setenv('COLUMNS', '300')
        return main(), capsys.readouterr().err, dict(_parameters(told[0]) if told else ())

    return call


def _parameters(given):
    return (part.split(':=') for part in given[2::2])


def a_bag(path, *, finished=True):
    writer = BagWriter(path, {})
    writer.add_topic(IMU, TYPES[IMU])
    writer.write(IMU, imu(0), 10**9)
    writer.flush()
    writer.finish() if finished else writer.abandon()
    return path


def foreign(path):
    with path.open('wb') as file:
        writer = Writer(file)
        writer.start(profile='ros2', library='libmcap 1.2')
        writer.finish()


def test_the_recorder_is_told_to_go_on(polar, tmp_path):
    bag = a_bag(tmp_path / 'b')
    status, said, told = polar('--out', bag, '--resume')
    assert (status, told['resume'], json.loads(told['output'])) == (0, 'true', str(bag))
    assert said == f'polar: recording to {bag}; Ctrl-C ends it\n'
    _, _, told = polar('--out', tmp_path / 'new')
    assert told['resume'] == 'false'


def test_a_file_that_a_kill_left_is_named_and_gone_on_from(polar, tmp_path):
    bag = a_bag(tmp_path / 'b', finished=False)
    (bag / 'b_1.mcap').touch()  # killed as it began
    status, said, told = polar('--out', bag, '--resume')
    assert (status, told['resume']) == (0, 'true')
    assert 'polar: b_0.mcap was not finished; it stays as it is\n' in said
    assert 'polar: b_1.mcap was not finished; it stays as it is\n' in said


@pytest.mark.parametrize(
    ('make', 'status', 'says'),
    [
        (lambda _: None, 2, 'there is no such bag to go on with; without --resume'),
        (
            lambda b: b.write_bytes(b''),
            2,
            'b is a file; --resume goes on with the folder of a bag',
        ),
        (lambda b: b.mkdir(), 1, 'b has no bag in it'),
        (lambda b: a_bag(b.parent / 'a').rename(b), 2, 'a_0.mcap is not named after the folder'),
        (lambda b: (b.mkdir(), foreign(b / 'b_0.mcap')), 2, 'b_0.mcap was written by libmcap 1.2'),
        (lambda b: (b.mkdir(), sqlite3.connect(b / 'b_0.db3')), 2, 'b_0.db3 is of rosbag2'),
        (
            lambda b: (a_bag(b) / 'b_0.mcap').write_bytes(bytes(4096)),
            1,
            'b_0.mcap is not an MCAP file',
        ),
        (
            lambda b: (a_bag(b) / 'b_0.mcap').write_bytes(b'\x89MCAP0\r\n\x01\x20'),
            1,
            'b_0.mcap is damaged: it has no head',
        ),
    ],
)
def test_what_is_no_bag_to_go_on_with_is_said_and_left_alone(polar, tmp_path, make, status, says):
    make(tmp_path / 'b')
    before = sorted(tmp_path.rglob('*'))
    found, said, told = polar('--out', tmp_path / 'b', '--resume')
    assert (found, told) == (status, {})
    assert says in said
    assert said.count('\n') == 1
    assert sorted(tmp_path.rglob('*')) == before


def test_a_bag_that_is_there_is_gone_on_with_on_request_only(polar, tmp_path):
    bag = a_bag(tmp_path / 'b')
    status, said, told = polar('--out', bag)
    assert (status, told) == (2, {})
    assert said == f'polar: {bag} exists already; --resume goes on with it\n'


def test_a_bag_that_a_recorder_is_writing_has_one_recorder(polar, tmp_path):
    writer = BagWriter(tmp_path / 'b', {})
    status, said, told = polar('--out', tmp_path / 'b', '--resume')
    assert (status, told) == (2, {})
    assert 'b_0.mcap is being written by another recorder\n' in said
    with pytest.raises(WrongRequestError, match='another recorder'):
        require_own(tmp_path / 'b')  # as a node does that is started with `resume`
    writer.abandon()  # as when its process ends
    assert polar('--out', tmp_path / 'b', '--resume')[0] == 0


def test_it_needs_the_name_of_a_bag(polar):
    status, said, told = polar('--resume')
    assert (status, told) == (2, {})
    assert '--resume needs --out' in said


def test_a_recorder_that_is_started_again_leaves_foreign_bags_alone_too(tmp_path):
    """With its parameter `resume` a bag may be missing, or damaged by the end of its recorder."""
    require_own(tmp_path / 'none')
    bag = a_bag(tmp_path / 'b', finished=False)
    (bag / 'b_1.mcap').write_bytes(bytes(4096))
    require_own(bag)
    foreign(bag / 'b_2.mcap')
    with pytest.raises(ConfigError, match=r'b_2\.mcap was written by libmcap 1\.2'):
        require_own(bag)
