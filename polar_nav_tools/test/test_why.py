"""The story of a fix: from the reference bag, and from a copy of it with every kind of mishap."""

import io
import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

pytest.importorskip('rclpy')

from rclpy.serialization import deserialize_message, serialize_message

from polar_nav_core.errors import ConfigError
from polar_nav_core.link.packet import FIELDS, SIZE, VERSION, crc16
from polar_nav_msgs.msg import AcousticPacket
from polar_nav_tools.analysis.opening import follower_of
from polar_nav_tools.bags import BagWriter, open_bag
from polar_nav_tools.bags.arrays import load_estimates, load_truth
from polar_nav_tools.cli import main
from polar_nav_tools.replay.recorded import followers_of
from polar_nav_tools.series.vehicle import ReceiptRecord
from polar_nav_tools.why import UnknownFixError, load_records, story_of
from polar_nav_tools.why.damage import damage_of, field_of_byte
from polar_nav_tools.why.figure import write_figure
from polar_nav_tools.why.plot import plot
from polar_nav_tools.why.records import Packet, _joined, _numbered
from polar_nav_tools.why.story import ranges
from polar_nav_tools.why.words import headline, paragraphs

REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'
RX, TX = '/follower/acomms/rx', '/leader/acomms/tx'
LOST = 4  # in the reference bag


def records_of(path, configuration=None):
    bag = open_bag(path)
    name = follower_of(bag)
    return load_records(bag, name, configuration, params=followers_of(bag)[name])


@pytest.fixture(scope='module')
def whole():
    return records_of(REFERENCE)


@pytest.fixture(scope='module')
def mishaps(tmp_path_factory):
    """The reference bag without estimates: 7 damaged, 6 heard twice, 8 overtaken by 9."""
    path = tmp_path_factory.mktemp('why') / 'mishaps'
    source = open_bag(REFERENCE)
    written = []
    for record in source.records():
        if record.topic.startswith('/follower/nav/'):
            continue
        written.append((record.topic, record.log_time_ns, record.data))
        if record.topic != RX:
            continue
        m = deserialize_message(record.data, AcousticPacket)
        if m.sequence == 7:
            data = bytearray(m.data)
            data[5] ^= 0x01  # validity
            data[40] ^= 0x81
            m.data = bytes(data)
            written[-1] = (RX, record.log_time_ns, serialize_message(m))
        if m.sequence == 6:
            m.receive_time.sec += 3
            written.append((RX, record.log_time_ns + 3 * 10**9, serialize_message(m)))
        if m.sequence == 8:
            m.receive_time.sec += 3
            written[-1] = (RX, record.log_time_ns + 3 * 10**9, serialize_message(m))
    with BagWriter(path, {'mission': 'mishaps'}) as writer:
        for topic in source.topics.values():
            if topic.name.startswith('/follower/nav/'):
                continue
            writer.add_topic(topic.name, topic.type, described=source.definition(topic.name))
        # The node's end says how many messages it had taken: that does not hold here.
        for name, stamp_ns, data in sorted(written, key=lambda w: w[1]):
            writer.write(name, data, stamp_ns)
    return path


@pytest.fixture(scope='module')
def troubled(mishaps):
    return records_of(mishaps)


def text_of(story):
    lines = [headline(story)]
    for title, sentences in paragraphs(story):
        lines += [title, *sentences]
    return '\n'.join(lines)


def drawn(story, width=80):
    console = Console(file=io.StringIO(), width=width, highlight=False)
    console.print(plot(story, width))
    return console.file.getvalue()


# -- a fix that was used


@pytest.mark.parametrize('sequence', [0, 5, 13])
def test_the_parts_of_the_way_join_and_add_up_to_the_age(whole, sequence):
    story = story_of(whole, sequence)
    (receipt,) = story.copy.receipts
    for a, b in zip(story.legs, story.legs[1:], strict=False):
        # The leader's t3 is its own, from the measured range; it and t4 are rounded to 0.1 ms.
        assert abs(a.stop_ns - b.start_ns) <= 1_000_000, (a, b)
    counted = [leg for leg in story.legs if leg.counted]
    assert sum(leg.seconds for leg in counted) == pytest.approx(receipt.age_s, abs=1e-9)
    assert [leg.name for leg in counted] == [
        'reply to the array',
        'processing',
        'bits',
        'packet to follower',
        'detection and the rest',
    ]
    by_name = {leg.name: leg.seconds for leg in story.legs}
    assert by_name['bits'] == pytest.approx(8 * SIZE / 9600.0)
    assert by_name['processing'] == pytest.approx(0.3, abs=2e-4)
    assert by_name['turn-around'] == pytest.approx(0.1)
    assert by_name['packet to follower'] == pytest.approx(by_name['reply to the array'], abs=0.01)
    assert by_name['detection and the rest'] > 0.0


def test_what_it_changed_agrees_with_estimates_and_truth(whole):
    story = story_of(whole, 5)
    bag = open_bag(REFERENCE)
    e, t = load_estimates(bag, 'follower'), load_truth(bag, 'follower')
    c = story.change
    assert c.before_ns < story.copy.packet.receive_ns <= c.after_ns
    for stamp, error, sigma in (
        (c.before_ns, c.error_before, c.sigma_before),
        (c.after_ns, c.error_after, c.sigma_after),
    ):
        i, j = (
            int(np.flatnonzero(e.stamp_ns == stamp)[0]),
            int(np.flatnonzero(t.stamp_ns == stamp)[0]),
        )
        distance = np.linalg.norm(e.r_e[i] - t.r_e[j])
        height = e.height[i] - t.height[j]
        assert error == pytest.approx(math.sqrt(distance**2 - height**2), abs=1e-3)
        assert sigma == pytest.approx(math.sqrt(np.trace(e.P_position_G[i][:2, :2])))
    assert c.sigma_after < c.sigma_before
    # The correction lies along the innovation, and is a part of it.
    innovation = story.copy.final.innovation_G[:2]
    assert c.shift[:2] @ innovation > 0.0
    assert np.linalg.norm(c.shift[:2]) < np.linalg.norm(innovation)


def test_between_fixes_nothing_is_taken_for_a_change(whole):
    """The motion that is taken out leaves millimetres at 3 m/s."""
    e = whole.estimates
    received = {h.packet.receive_ns for h in whole.heard}
    quiet = next(
        s
        for s in e.stamp_ns[150:].tolist()
        if not any(s - 3 * 10**8 < r <= s + 3 * 10**8 for r in received)
    )
    heard = whole.heard[5]
    receipt = replace(heard.final, stamp_ns=quiet + 50_000_000)
    moved = replace(whole, heard=(replace(heard, receipts=(receipt,)),))
    story = story_of(moved, heard.packet.sequence)
    assert np.linalg.norm(story.change.shift) < 0.005


def test_the_belief_and_the_fix_make_the_innovation(whole):
    """Up to what DVL and depth have taught the filter of the time of validity since then."""
    stories = [story_of(whole, n) for n in range(2, 14) if n != LOST]
    alone = [s for s in stories if not s.others]
    assert len(alone) > 5
    for story in alone:
        belief = story.belief
        np.testing.assert_allclose(
            belief.difference[:2], story.copy.final.innovation_G[:2], atol=0.03
        )
        assert belief.error < 4.0 * np.hypot(*belief.sigma[:2])
        assert belief.fix_error < 4.0 * np.hypot(*belief.fix_sigma[:2])


def test_the_words_of_a_fused_fix(whole):
    text = text_of(story_of(whole, 5))
    for words in (
        'Fix 5 of leader for follower, 1.74 s old: used (FUSED); it moved the position by',
        'The array pinged at 11.000 s (t1)',
        'bits: 0.048 s (3 %), 456 bit at 9600 bit/s',
        'age when received: 1.740 s',
        'sound speed 1440.0 m/s',
        'there is no gate',
        'Delay handling back_propagate, 17 filter steps back',
        'No other fix was under way',
    ):
        assert words in text, words
    assert 'nan' not in text.lower()


def test_others_on_their_way(whole):
    assert story_of(whole, 13).others == ()
    story = story_of(whole, 3)
    (other,) = story.others
    assert other.sequence == 2
    assert other.validity_ns < story.validity_ns < other.receive_ns


# -- fixes that came to nothing


def test_a_lost_packet(whole):
    story = story_of(whole, LOST)
    assert story.fate == 'lost'
    assert story.copies == ()
    assert story.change is None
    assert story.broadcast is not None  # what was sent is known
    text = text_of(story)
    assert f'Fix {LOST} of leader for follower was sent and never arrived' in text
    assert 'It was to be expected at about' in text
    assert 'Nobody heard it' in text
    # As the others came: about as old.
    age = (story.expected_ns - story.validity_ns) * 1e-9
    assert 1.2 < age < 2.0


def test_the_recording_ended_before_it_was_sent(whole):
    story = story_of(whole, 14)
    assert 'the recording ended before the leader sent it' in headline(story)


def test_the_recording_ended_before_it_arrived(whole):
    cut = replace(
        whole,
        heard=tuple(h for h in whole.heard if h.packet.sequence < 12),
        end_ns=story_of(whole, 13).copy.packet.receive_ns - 10**8,
    )
    assert story_of(cut, 13).fate == 'in the water'
    assert story_of(cut, 12).fate == 'lost'


def test_a_number_that_is_not_there_names_those_that_are(whole):
    with pytest.raises(UnknownFixError, match=r'no fix 99 of follower: the bag holds 0 to 14$'):
        story_of(whole, 99)
    gap = replace(
        whole,
        measured=tuple(m for m in whole.measured if m.sequence != 9),
        sent=tuple(p for p in whole.sent if p.sequence != 9),
        heard=tuple(h for h in whole.heard if h.packet.sequence != 9),
    )
    with pytest.raises(UnknownFixError, match='0 to 8, 10 to 14; the array recorded no reply'):
        story_of(gap, 9)
    with pytest.raises(UnknownFixError, match="no fix from 'nobody'"):
        story_of(whole, 3, 'nobody')


def test_ranges_in_words():
    assert ranges({0, 1, 2, 5, 7, 8}) == '0 to 2, 5, 7 to 8'
    assert '(30 in all)' in ranges(set(range(0, 60, 2)))


# -- mishaps, by a replay


def test_a_bag_without_receipts_is_replayed(troubled, whole):
    assert troubled.replayed
    assert not whole.replayed
    assert troubled.configuration == whole.configuration == 'modified_akf'


def test_a_damaged_packet_says_which_bits(troubled):
    story = story_of(troubled, 7)
    damage = story.copy.damage
    assert story.copy.verdict == 'BAD_CRC'
    assert damage.bits == 3
    assert damage.differing == (5, 40)
    assert damage.fields == ('validity', 'r_lf_G')
    received = story.copy.packet.data
    assert damage.computed == crc16(received[:-2]) != damage.stated
    text = text_of(story)
    assert f'CRC-16 of the {SIZE} bytes as received is {damage.computed:#06x}' in text
    assert f'3 bits of {8 * SIZE} came flipped (byte 5, 40, in validity, r_lf_G)' in text
    assert f'[{received[40]:02x}]' in text
    assert story.change is None
    # The content is known from the sent packet.
    assert 'Nobody could read it; by the bytes that were sent' in text
    assert story.copy.legs[-1].stop_ns == story.copy.packet.receive_ns


def test_a_copy_that_comes_later_is_told_apart(troubled):
    story = story_of(troubled, 6)
    assert [c.verdict for c in story.copies] == ['FUSED', 'DUPLICATE']
    assert story.main == 0
    text = text_of(story)
    assert 'Copy 2 of 2: packet 6' in text
    assert 'Verdict: DUPLICATE, fix 6 of leader came before.' in text


def test_an_overtaken_fix(troubled):
    story = story_of(troubled, 8)
    assert story.copy.verdict == 'FUSED'
    assert [o.sequence for o in story.others] == [7, 9, 10] or [
        o.sequence for o in story.others
    ] == [9, 10]
    assert 'newer, and there first' in text_of(story)
    assert 'Fix 8 was under way too' in text_of(story_of(troubled, 9))
    assert 'older, and there later' in text_of(story_of(troubled, 9))


# -- joining


def packet(order, stamp, number=None, source='leader'):
    broadcast = None if number is None else _Broadcast(number, stamp)
    return Packet(source, order, stamp, stamp + 10**9, 9600.0, b'', broadcast, '')


class _Broadcast:
    def __init__(self, sequence, validity_ns):
        self.sequence, self.validity_ns = sequence, validity_ns


def test_numbers_unwrap_and_damaged_packets_take_that_of_what_was_sent():
    stamps = [k * 10**10 for k in range(4)]
    sent = _numbered([packet(k, s, (65534 + k) % 65536) for k, s in enumerate(stamps)], [], {})
    assert [p.sequence for p in sent] == [65534, 65535, 65536, 65537]
    known = {(p.source, p.order): p.sequence for p in sent}
    heard = _numbered([packet(2, stamps[2]), packet(9, stamps[3])], [], known)
    assert [p.sequence for p in heard] == [65536, 9]


def receipt(sequence, receive_ns, revision=0, verdict='FUSED'):
    none = np.full(3, np.nan)
    return ReceiptRecord(
        receive_ns, 0, verdict, '', 'acomms/rx', 'leader', sequence, revision, 1, 1, receive_ns,
        None, 1.0, 'rewind', 0, none, none, float('nan'), 0, float('inf'),
    )  # fmt: skip


def test_receipts_go_to_their_packets():
    a, b = (replace(packet(k, 0, k), sequence=k) for k in (3, 3))
    c = replace(packet(4, 5, 4), sequence=4)
    receipts = [
        receipt(3, 10**9),
        receipt(3, 10**9, verdict='DUPLICATE'),
        receipt(3, 10**9, revision=1, verdict='GATED'),
        receipt(8, 10**9),
        replace(receipt(3, 10**9), topic='dvl/data'),
    ]
    heard, loose = _joined([a, b, c], receipts)
    assert [[r.verdict_text for r in h.receipts] for h in heard] == [
        ['FUSED', 'GATED'],
        ['DUPLICATE'],
        [],
    ]
    assert [r.sequence for r in loose] == [8]


def test_revisions_and_gates_are_told(whole):
    heard = whole.heard[5]
    first = replace(heard.final, nis=30.0, gate=21.1, verdict_text='GATED', reason='because')
    second = replace(heard.final, revision=1, reason='decided anew after fix 9')
    story = story_of(
        replace(whole, heard=(replace(heard, receipts=(first, second)),)), heard.packet.sequence
    )
    text = text_of(story)
    assert 'Verdict: GATED, because.' in text
    assert 'the gate is 21.1' in text
    assert 'Revision 1: FUSED, decided anew after fix 9.' in text
    assert story.copy.verdict == 'FUSED'


def test_fields_of_bytes_tile_the_packet():
    names = field_of_byte(bytes([VERSION]) + bytes(SIZE - 1))
    assert len(names) == SIZE
    assert list(dict.fromkeys(names)) == [*(f.name for f in FIELDS), 'crc']


def test_damage_without_what_was_sent():
    good = b'hello'
    whole = good + crc16(good).to_bytes(2, 'little')
    assert damage_of(whole, None) is None
    assert damage_of(whole, whole) is None
    damage = damage_of(b'hallo' + whole[-2:], None)
    assert damage.bits is None
    assert damage.stated == crc16(good)


# -- pictures


@pytest.mark.parametrize('width', [60, 100])
def test_the_plot_keeps_to_its_width_and_its_order(whole, width):
    lines = drawn(story_of(whole, 5), width).splitlines()
    assert max(map(len, lines)) <= width
    bars = [line for line in lines if '━' in line]
    assert len(bars) == 7
    starts = [line.index('━') for line in bars]
    assert starts == sorted(starts)
    longest = max(bars, key=lambda line: line.count('━'))
    assert longest.startswith('detection and the rest')
    marks = next(line for line in lines if 't1' in line and 'rx' in line)
    assert marks.index('t1') < marks.index('t3') < marks.index('tx') < marks.index('rx')
    assert any('v' in line and '▲' in line and '·' in line for line in lines)
    assert any(line.startswith('true error') for line in lines)


def test_a_run_without_truth_has_no_true_error(whole):
    story = story_of(replace(whole, truth=None), 5)
    assert 'true error' not in drawn(story)
    assert 'True 2-D error' not in text_of(story)
    assert 'nan' not in text_of(story).lower()


@pytest.mark.parametrize('sequence', [5, LOST, 14])
def test_pictures_are_written(whole, tmp_path, sequence):
    for suffix, begin in (('.png', b'\x89PNG'), ('.svg', b'<?xml')):
        path = tmp_path / 'deep' / f'fix{suffix}'
        write_figure(path, story_of(whole, sequence))
        assert path.read_bytes().startswith(begin)
    with pytest.raises(ConfigError, match=r'\.png or \.svg'):
        write_figure(tmp_path / 'fix.pdf', story_of(whole, sequence))


# -- the command


@pytest.fixture
def polar(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        monkeypatch.setattr(sys, 'argv', ['polar', 'why', *map(str, arguments)])
        status = main()
        out = capsys.readouterr()
        return status, out.out, out.err

    return run


def test_the_command_tells_and_draws(polar):
    status, out, err = polar(REFERENCE, '--seq', 5, '--figure', 'five.svg')
    assert (status, err) == (0, '')
    assert 'it moved the position' in out
    assert 'The way of the packet' in out
    assert out.rstrip().endswith('five.svg')
    assert Path('five.svg').is_file()


def test_the_command_as_json(polar):
    status, out, _ = polar(REFERENCE, '--seq', 5, '--json')
    assert status == 0
    printed = json.loads(out)
    assert printed['verdict'] == 'FUSED'
    assert printed['fate'] == 'arrived'
    assert printed['received'][0]['receipts'][0]['nis'] == pytest.approx(2.86, abs=0.01)
    assert sum(leg['seconds'] for leg in printed['legs'] if leg['counted']) == pytest.approx(
        1.74, abs=0.01
    )
    for sequence in (LOST, 14):
        assert json.loads(polar(REFERENCE, '--seq', sequence, '--json')[1])['verdict'] is None


def test_another_configuration_is_replayed(polar):
    status, out, _ = polar(REFERENCE, '--seq', 5, '-c', 'conventional_akf', '--json')
    printed = json.loads(out)
    assert (status, printed['replayed'], printed['configuration']) == (0, True, 'conventional_akf')
    # Taken as current, fixes hold the position back by up to 3 m/s x 1.7 s.
    recorded = json.loads(polar(REFERENCE, '--seq', 5, '--json')[1])
    assert recorded['change']['error_after'] < 0.5
    assert printed['change']['error_after'] > 2.0


def test_an_unknown_number_is_one_sentence(polar):
    status, out, err = polar(REFERENCE, '--seq', 99)
    assert (status, out) == (2, '')
    assert err == 'polar: no fix 99 of follower: the bag holds 0 to 14\n'
