"""Bags made to take for ever, or to break arithmetic: an answer in proportion to their bytes."""

from types import SimpleNamespace

import numpy as np
import pytest
from bag_samples import RECEIPT, TRUTH, TYPES, make, stamp, stamp_ns, write_bag
from crafted import TEXT, crafted

from polar_nav_tools.bags import BagError, BagWriter, open_bag, reader
from polar_nav_tools.bags.arrays import load_truth, places
from polar_nav_tools.bags.decode import store_of
from polar_nav_tools.bags.finding import Severity
from polar_nav_tools.bags.limits import check_definition, check_size
from polar_nav_tools.cli import main
from polar_nav_tools.doctor.examine import examine


@pytest.fixture(autouse=True)
def _limited(monkeypatch):
    monkeypatch.setattr('polar_nav_tools.bags.limits._state', {'limited': True})


def test_a_bag_of_nothing_but_zeros_is_refused(tmp_path, capsys, monkeypatch):
    zeros = bytes(15_000_000)
    path = crafted(tmp_path / 'b.mcap', [(0, k, zeros) for k in range(6)])
    with pytest.raises(BagError, match=r'b\.mcap: its 0\.\d MB decompress to more than \d+ MB'):
        open_bag(path)
    monkeypatch.setattr('sys.argv', ['polar', 'info', str(path)])
    assert main() == 1
    assert './polar --no-limits' in capsys.readouterr().err
    monkeypatch.setattr('sys.argv', ['polar', '--no-limits', 'info', str(path)])
    assert main() == 0


def test_what_recordings_are_like_is_read():
    check_size('b', 2_000_000, 100_000_000)
    check_size('b', 10_000_000_000, 400_000_000_000)
    with pytest.raises(BagError):
        check_size('b', 370_000, 2_500_000_000)


def test_a_definition_of_a_hundred_thousand_lines():
    constants = ''.join(f'uint8 A{k}=1\n' for k in range(100_000)) + TEXT
    with pytest.raises(BagError, match='the definition of p/msg/T has 100001 lines'):
        store_of(constants, 'p/msg/T')
    check_definition('# a comment\n' * 100_000 + TEXT, 'p/msg/T')


def test_every_channel_is_looked_at_once(tmp_path, monkeypatch):
    """Counting a topic does not go through all channels again, of which there may be 65,000."""
    path = crafted(tmp_path / 'b.mcap', [(k, k, b'\0\1\0\0abcd') for k in range(300)], 300)
    bag = open_bag(path)
    calls = []
    numbers_of = reader.numbers_of
    monkeypatch.setattr(reader, 'numbers_of', lambda *a: calls.append(a) or numbers_of(*a))
    assert len([t for t in bag.topics.values() if t.count == 1]) == 300
    assert len(examine(bag).topics) == 300
    assert 1 <= len(calls) <= 3


def test_topics_by_the_thousand_are_plain_lines(tmp_path, monkeypatch, capsys):
    """Laid out as a table, 60,000 of them took 20 s."""
    path = crafted(tmp_path / 'b.mcap', [(k, k, b'\0\1\0\0abcd') for k in range(1200)], 1200)
    monkeypatch.setattr('sys.argv', ['polar', 'info', str(path)])
    assert main() == 0
    lines = capsys.readouterr().out.splitlines()
    assert 'topic type messages Hz' in lines
    assert len([line for line in lines if line.endswith(' p/msg/T 1 ')]) == 1200


@pytest.mark.slow
def test_of_thousands_of_followers_a_sentence_names_a_few(tmp_path, monkeypatch, capsys):
    with BagWriter(tmp_path / 'b', {}) as writer:
        for k in range(2000):
            topic = f'/f{k:04d}/nav/state'
            writer.add_topic(topic, TYPES[RECEIPT])
            writer.write(topic, make(TYPES[RECEIPT]), stamp_ns(k))
    monkeypatch.setattr('sys.argv', ['polar', 'score', str(tmp_path / 'b')])
    assert main() == 2
    said = capsys.readouterr().err
    assert 'has 2000 followers (f0000, f0001, ' in said
    assert 'f0011, ...): name one' in said
    assert len(said) < 1000


@pytest.mark.parametrize('log_ns', [1 << 63, (1 << 64) - 1])
@pytest.mark.parametrize('command', ['doctor', 'info', 'score', 'replay', 'map', 'recover'])
def test_log_times_beyond_64_bits(tmp_path, monkeypatch, capsys, log_ns, command):
    path = crafted(tmp_path / 'b.mcap', [(0, 1, b'\0\1\0\0abcd'), (0, log_ns, b'\0\1\0\0abcd')])
    monkeypatch.setattr('sys.argv', ['polar', command, str(path)])
    assert main() in (0, 1)
    if command == 'doctor':
        assert '1 messages have a log time after the year 2116' in capsys.readouterr().out


def test_truth_at_the_centre_of_the_earth_is_no_place(tmp_path):
    with BagWriter(tmp_path / 'b', {}) as writer:
        writer.add_topic(TRUTH, TYPES[TRUTH])
        for k in range(3):
            r_e = np.full(3, 5e-324 if k == 1 else 4e6)
            data = make(TYPES[TRUTH], **stamp(stamp_ns(k)), r_e=r_e, c_b_g=np.eye(3).ravel())
            writer.write(TRUTH, data, stamp_ns(k))
    r_e = load_truth(open_bag(tmp_path / 'b'), 'follower').r_e
    assert np.isnan(r_e).all(axis=1).tolist() == [False, True, False]
    given = np.full((2, 3), 4e6)
    assert places(given) is given


def test_a_damaged_last_command():
    recorded = pytest.importorskip('polar_nav_tools.replay.recorded')
    damaged = SimpleNamespace(taken_topics=['/a', '/b'], taken_counts=[1])
    with pytest.raises(BagError, match='names 2 topics and 1 counts'):
        recorded.taken_counts(damaged)


def test_a_sound_bag_has_no_error(tmp_path):
    bag = open_bag(write_bag(tmp_path / 'b'))
    found = examine(bag).findings
    assert [f for f in found if f.severity is Severity.SEVERE] == []
