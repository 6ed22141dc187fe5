"""`polar play`: tracks of a bag, wrong calls, figures; nothing is published."""

import json
import sys
from pathlib import Path

import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_tools.bags import BagWriter
from polar_nav_tools.bags.schemas import Definition
from polar_nav_tools.cli import main
from polar_nav_tools.foreign.sources import open_source
from polar_nav_tools.play.offers import Offer
from polar_nav_tools.play.order import Span
from polar_nav_tools.play.pace import Lag
from polar_nav_tools.play.run import Options, Played
from polar_nav_tools.play.tracks import Track, Tracks, find_tracks, messages_of

from bag_samples import IMU, START_NS, STEP_NS, write_bag  # isort: skip

S = 1_000_000_000


def test_any_stands_alone():
    with pytest.raises(ConfigError, match='alone'):
        Options(wait=['any', '/a'])


def test_all_messages_of_a_bag_with_their_times(tmp_path):

    source = open_source(write_bag(tmp_path / 'b', 20))
    found = find_tracks(source, {IMU: '/imu'}, say=pytest.fail)
    assert [(t.name, t.published, t.type) for t in found.playable] == [
        (IMU, '/imu', 'sensor_msgs/msg/Imu')
    ]
    assert found.refused == {}
    got = list(messages_of(source, {IMU}))
    assert [m.log_ns for m in got] == [START_NS + k * STEP_NS + 1000 for k in range(20)]
    assert [m.data for m in got] == list(source.bag.payloads(IMU))


@pytest.fixture
def polar(monkeypatch, capsys):
    """Run the tool; exit status, stdout and stderr."""

    def run(*arguments):
        monkeypatch.setattr(sys, 'argv', ['polar', *map(str, arguments)])
        status = main()
        out = capsys.readouterr()
        return status, out.out, out.err

    return run


@pytest.mark.parametrize(
    ('arguments', 'word'),
    [
        (['--topics', '/nothing'], '/nothing'),
        (['--rate', '0'], '--rate'),
        (['--rate', 'nan'], '--rate'),
        (['--clock', '-1'], '--clock'),
        (['--start', '1000'], '--start'),
        (['--remap', 'x'], '--remap'),
        (['--wait', 'any,/a'], '--wait'),
    ],
)
def test_a_wrong_call_has_status_2_and_one_sentence(polar, tmp_path, arguments, word):
    path = write_bag(tmp_path / 'b', 5)
    status, out, err = polar('play', path, *arguments)
    assert status == 2
    assert out == ''
    assert err.count('\n') == 1
    assert word in err


def test_a_bag_of_which_nothing_can_be_published_has_status_1(polar, tmp_path):

    writer = BagWriter(tmp_path / 'b', {})
    described = Definition('acme_msgs/msg/Data', 'float64 x\n')
    writer.add_topic('/acme', 'acme_msgs/msg/Data', described=described)
    writer.write('/acme', b'\0\1\0\0' + bytes(8), START_NS)
    writer.finish()
    status, out, err = polar('play', tmp_path / 'b', '--no-build')
    assert status == 1
    assert out == ''
    for word in ('/acme', 'acme_msgs/msg/Data', '--no-build'):
        assert word in err


def test_figures_are_json():

    tracks = Tracks([Track('/a', '/b', 'std_msgs/msg/String', Offer())], {'/c': 'why'})
    lag = Lag(2, 300_000_000, 200_000_000, 2 * S)
    played = Played(Path('b'), tracks, Span(S, 3 * S), S, 3 * S, {'/a': 2}, {'/a': 1}, lag)
    values = json.loads(json.dumps(played.to_dict(), allow_nan=False))
    assert values['topics'][0]['published_as'] == '/b'
    assert values['lag_max_s'] == 0.2
    assert values['lag_max_at_s'] == 1.0
    assert '0.200 s late, at 1.000 s' in played.remark()
    assert [c.split(':')[0] for c in played.complaints()] == ['/c is not played', '/a']
