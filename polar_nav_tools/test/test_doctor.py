"""The doctor: each thing that can be wrong with a bag is found, named, placed and counted."""

import json
import struct
import sys

import numpy as np
import pytest
from bag_samples import START_NS, STEP_NS, imu, make, stamp, stamp_ns

from polar_nav_tools.bags import BagWriter, open_bag
from polar_nav_tools.bags.finding import Severity
from polar_nav_tools.cli import main
from polar_nav_tools.doctor.examine import examine

IMU = '/auv/imu'
RX, RECEIPT, TX = '/follower/acomms/rx', '/follower/nav/receipt', '/leader/acomms/tx'
PACKET_TYPE, RECEIPT_TYPE = 'polar_nav_msgs/msg/AcousticPacket', 'polar_nav_msgs/msg/FixReceipt'
N = 2000


def bag_of(path, stamps, logs=None, info=None):
    """A bag with IMU messages of given stamps, logged 5 ms later unless told otherwise."""
    logs = [s + 5_000_000 for s in stamps] if logs is None else logs
    with BagWriter(path, info or {}) as writer:
        writer.add_topic(IMU, 'sensor_msgs/msg/Imu')
        for stamp_at, log_ns in zip(stamps, logs, strict=True):
            writer.write(IMU, make('sensor_msgs/msg/Imu', **stamp(int(stamp_at))), int(log_ns))
    return path


def regular():
    return [stamp_ns(k) for k in range(N)]


def findings(path, what=None, level=None):
    found = examine(open_bag(path)).findings
    return [f for f in found if what in (None, f.name) and level in (None, f.severity)]


def only(path, what, level):
    """The one finding that is not ok, of this kind and level."""
    odd = [f for f in findings(path) if f.severity != Severity.OK]
    assert [(f.name, f.severity) for f in odd] == [(what, level)], odd
    return odd[0]


def test_a_healthy_bag(tmp_path):
    path = bag_of(tmp_path / 'b', regular())
    examination = examine(open_bag(path))
    assert examination.ok
    assert {f.severity for f in examination.findings} == {Severity.OK}
    (rate,) = findings(path, 'rate')
    assert rate.value == pytest.approx(100.0)
    (delay,) = findings(path, 'stamps')
    assert delay.value == pytest.approx(0.005)
    assert '0 errors, 0 warnings' in examination.summary()


def test_gap(tmp_path):
    stamps = [s for k, s in enumerate(regular()) if not 500 <= k < 560 and k != 900]
    found = only(bag_of(tmp_path / 'b', stamps), 'gap', Severity.WARNING)
    assert (found.topic, found.value, found.stamp_ns) == (IMU, 1, stamp_ns(499))
    assert 'about 60 messages' in found.text
    assert '0.610 s' in found.text
    assert found.at_s == pytest.approx(499 * 0.01 - 0.005)


def test_pauses_are_not_counted_as_missing_messages(tmp_path):
    # 200 s of messages in ten parts with 1000 s between them: a recorder that was stopped.
    stamps = [s + k // 200 * 1000 * 10**9 for k, s in enumerate(regular())]
    found = only(bag_of(tmp_path / 'b', stamps), 'gap', Severity.WARNING)
    assert found.value == 9
    assert '0.2216 Hz by count and duration' in found.text
    assert 'about' not in found.text


def test_a_jump_of_the_clock_is_no_gap(tmp_path):
    stamps = [s + (k >= 1200) * 54_500 * 10**9 for k, s in enumerate(regular())]
    path = bag_of(tmp_path / 'b', stamps, regular())
    assert not findings(path, 'gap')


def test_backwards(tmp_path):
    stamps = regular()
    stamps[700], stamps[701] = stamps[701], stamps[700]
    found = only(bag_of(tmp_path / 'b', stamps, regular()), 'backwards', Severity.SEVERE)
    assert (found.value, found.stamp_ns) == (1, stamp_ns(701))


def test_repeated(tmp_path):
    stamps = regular()
    stamps[3] = stamps[2]
    found = only(bag_of(tmp_path / 'b', stamps), 'repeated stamp', Severity.WARNING)
    assert (found.value, found.stamp_ns) == (1, stamp_ns(2))


def test_zero(tmp_path):
    stamps = [0] * N
    found = findings(bag_of(tmp_path / 'b', stamps, regular()), 'zero stamp')
    assert [(f.severity, f.value) for f in found] == [(Severity.SEVERE, N)]


def test_a_recording_that_begins_at_zero(tmp_path):
    stamps = [k * STEP_NS for k in range(N)]
    assert not findings(bag_of(tmp_path / 'b', stamps), level=Severity.SEVERE)
    stamps = regular()
    stamps[7] = 0
    found = findings(bag_of(tmp_path / 'c', stamps, regular()), 'zero stamp')
    assert [(f.severity, f.value) for f in found] == [(Severity.WARNING, 1)]


@pytest.mark.parametrize('by_s', [2.5, -2.5])
def test_jump(tmp_path, by_s):
    stamps = [s + round(by_s * 1e9) * (k >= 1200) for k, s in enumerate(regular())]
    path = bag_of(tmp_path / 'b', stamps, regular())
    (found,) = findings(path, 'jump')
    assert (found.severity, found.stamp_ns) == (Severity.SEVERE, stamp_ns(1199))
    assert found.value == pytest.approx(by_s)


def test_a_transport_that_stalls_is_no_jump(tmp_path):
    logs = np.array(regular()) + 5_000_000
    logs[800:1000] = logs[1000]  # two seconds of messages at once
    path = bag_of(tmp_path / 'b', regular(), logs)
    assert not findings(path, 'jump')
    assert not findings(path, level=Severity.SEVERE)


def test_drift(tmp_path):
    logs = [START_NS + round(k * STEP_NS * 1.01) + 5_000_000 for k in range(N)]
    found = only(bag_of(tmp_path / 'b', regular(), logs), 'drift', Severity.WARNING)
    assert found.value == pytest.approx(-0.01, rel=0.02)


def test_a_clock_that_is_not_of_this_world(tmp_path):
    logs = [START_NS + round(k * STEP_NS / 0.29) + 5_000_000 for k in range(N)]
    found = only(bag_of(tmp_path / 'b', regular(), logs), 'drift', Severity.SEVERE)
    assert 'at 29 % of real time' in found.text


def test_jitter_is_no_drift(tmp_path):
    jitter = np.random.default_rng(1).exponential(0.02, N)
    logs = np.maximum.accumulate(np.array(regular()) + (jitter * 1e9).astype(np.int64))
    assert not findings(bag_of(tmp_path / 'b', regular(), logs), 'drift')


def test_logged_before_it_was_valid(tmp_path):
    logs = [s - 300_000_000 for s in regular()]
    found = only(bag_of(tmp_path / 'b', regular(), logs), 'future', Severity.WARNING)
    assert found.value == N
    assert '0.300 s' in found.text


def test_two_clocks(tmp_path):
    logs = [s + 86_400 * 10**9 for s in regular()]
    found = only(bag_of(tmp_path / 'b', regular(), logs), 'other clock', Severity.WARNING)
    assert found.value == pytest.approx(86_400)


def test_log_times_made_of_stamps_say_nothing(tmp_path):
    logs = [s - 300_000_000 for s in regular()]
    info = {'recorder': {'log_time': 'simulation'}}
    assert not findings(bag_of(tmp_path / 'b', regular(), logs, info), level=Severity.WARNING)


def test_an_unfinished_bag(tmp_path):
    path = bag_of(tmp_path / 'b', regular())
    file = next(path.glob('*.mcap'))
    file.write_bytes(file.read_bytes()[:-400])
    assert 'incomplete' in {f.name for f in findings(path, level=Severity.SEVERE)}


def packets_bag(path, verdicts=6, sent=8, received=6):
    with BagWriter(path, {}) as writer:
        for topic, kind in ((TX, PACKET_TYPE), (RX, PACKET_TYPE), (RECEIPT, RECEIPT_TYPE)):
            writer.add_topic(topic, kind)
        for k in range(max(sent, received)):
            about = {
                **stamp(stamp_ns(100 * k)),
                'source': 'leader',
                'destination': 'follower',
                'sequence': k,
                'transmit_time__sec': stamp_ns(100 * k) // 10**9,
            }
            got = stamp_ns(100 * k) + 2 * 10**9
            if k < sent:
                writer.write(TX, make(PACKET_TYPE, **about), stamp_ns(100 * k))
            if k < received:
                data = make(PACKET_TYPE, **about, receive_time__sec=got // 10**9)
                writer.write(RX, data, got)
            if k < min(received, verdicts):
                data = make(
                    RECEIPT_TYPE,
                    **stamp(got),
                    source='leader',
                    topic='acomms/rx',
                    sequence=k,
                    verdict_text='FUSED',
                    receive_time__sec=got // 10**9,
                )
                writer.write(RECEIPT, data, got)
    return path


def test_totals_that_add_up(tmp_path):
    path = packets_bag(tmp_path / 'b')
    (verdicts,) = findings(path, 'verdicts')
    assert (verdicts.severity, verdicts.text) == (
        Severity.OK,
        '6 packets received, 6 verdicts: FUSED 6',
    )
    (packets,) = findings(path, 'packets')
    assert packets.severity == Severity.OK
    assert '8 packets sent = 6 received + ' in packets.text


def test_a_packet_without_a_verdict(tmp_path):
    (found,) = findings(packets_bag(tmp_path / 'b', verdicts=4), 'verdicts')
    assert (found.severity, found.value, found.topic) == (Severity.SEVERE, 2, RX)


def test_a_packet_that_nobody_sent(tmp_path):
    (found,) = findings(packets_bag(tmp_path / 'b', sent=5), 'unsent')
    assert (found.severity, found.value) == (Severity.SEVERE, 1)


@pytest.mark.parametrize('others', [0, 3])
def test_a_topic_whose_messages_are_all_too_short(tmp_path, others):
    """No time of it is known; found by mutating the one message that a rare topic has."""
    with BagWriter(tmp_path / 'b', {}) as writer:
        writer.add_topic(IMU, 'sensor_msgs/msg/Imu')
        writer.add_topic('/other/imu', 'sensor_msgs/msg/Imu')
        writer.write(IMU, b'\0\1\0\0', START_NS)
        for k in range(others):
            writer.write('/other/imu', imu(k), stamp_ns(k))
    found = examine(open_bag(tmp_path / 'b'))
    (short,) = [f for f in found.findings if f.name == 'unreadable']
    assert (short.topic, short.severity, short.value) == (IMU, Severity.SEVERE, 1)
    assert found.to_dict()['topics'][IMU]['count'] == 0
    assert '1 errors' in found.summary()


def test_messages_that_state_the_other_byte_order(tmp_path):
    """Their frame's name has 117 million bytes then; one that is big-endian is well."""
    big = b'\0\0\0\0' + struct.pack('>iII', 1_700_000_000, 10_000_000, 5) + b'body\0' + bytes(299)
    with BagWriter(tmp_path / 'b', {}) as writer:
        writer.add_topic(IMU, 'sensor_msgs/msg/Imu')
        writer.add_topic('/big/imu', 'sensor_msgs/msg/Imu')
        for k in range(3):
            writer.write(IMU, b'\0\0' + imu(k)[2:], stamp_ns(k))
        writer.write('/big/imu', big, stamp_ns(0))
    (found,) = findings(tmp_path / 'b', 'unreadable')
    assert (found.topic, found.severity, found.value) == (IMU, Severity.SEVERE, 3)
    assert 'byte order' in found.text


def test_commands_and_saved_states_that_make_no_sense(tmp_path):
    """A replay refuses the bag for one of them."""
    command, restore = '/auv/nav/command', '/auv/nav/restore'
    with BagWriter(tmp_path / 'b', {}) as writer:
        writer.add_topic(command, 'polar_nav_msgs/msg/Command')
        writer.add_topic(restore, 'polar_nav_msgs/msg/Restore')
        for k, kind in enumerate((2, 77, 4)):
            data = make('polar_nav_msgs/msg/Command', kind=kind, **stamp(stamp_ns(k)))
            writer.write(command, data, stamp_ns(k))
        data = make('polar_nav_msgs/msg/Restore', **stamp(stamp_ns(9)))
        writer.write(restore, data, stamp_ns(9))
    orders, states = findings(tmp_path / 'b', 'no sense')
    assert (orders.topic, orders.severity, orders.value) == (command, Severity.SEVERE, 2)
    assert orders.text == '2 of 3 messages make no sense: 77 is not a valid CommandKind'
    assert orders.stamp_ns == stamp_ns(1)
    assert states.topic == restore


def test_silent_topics(tmp_path):
    with BagWriter(tmp_path / 'b', {}) as writer:
        writer.add_topic(IMU, 'sensor_msgs/msg/Imu')
        writer.add_topic('/quiet', 'sensor_msgs/msg/Imu')
        writer.write(IMU, imu(0), stamp_ns(0))
    found = only(tmp_path / 'b', 'silent', Severity.WARNING)
    assert found.topic == '/quiet'


def test_the_command(tmp_path, monkeypatch, capsys):
    def polar(*arguments):
        monkeypatch.setattr(sys, 'argv', ['polar', *map(str, arguments)])
        status = main()
        return status, capsys.readouterr().out

    well = bag_of(tmp_path / 'well', regular())
    ill = bag_of(tmp_path / 'ill', [0] * N, regular())
    assert polar('doctor', well)[0] == 0
    status, out = polar('doctor', well, '--json')
    assert (status, json.loads(out)['ok']) == (0, True)
    assert json.loads(out)['topics'][IMU]['count'] == N
    status, out = polar('doctor', ill)
    assert status == 1
    assert f'  error  {IMU}: {N} of {N} stamps are zero' in out
    status, out = polar('doctor', ill, '--json')
    said = json.loads(out)
    assert (status, said['ok'], said['errors']) == (1, False, 1)
    assert polar('doctor', well, '--all')[1].count('ok  ') >= 3


def test_a_clock_that_stands_still(tmp_path):
    """All stamps equal, of 1970: once no interval was regular, and nothing was found."""
    info = {'recorder': {'log_time': 'simulation'}}
    path = bag_of(tmp_path / 'b', [5_999_999_999] * N, regular(), info)
    odd = [f for f in findings(path) if f.severity != Severity.OK]
    assert {(f.name, f.severity, f.value) for f in odd} == {
        ('repeated stamp', Severity.SEVERE, N - 1),
        ('other clock', Severity.SEVERE, N),
    }


def test_packets_may_overtake_one_another(tmp_path):
    stamps = [stamp_ns(200 * k) for k in range(60)]
    stamps[20], stamps[21] = stamps[21], stamps[20]
    with BagWriter(tmp_path / 'b', {}) as writer:
        writer.add_topic(RX, PACKET_TYPE)
        for k, at in enumerate(stamps):
            writer.write(RX, make(PACKET_TYPE, **stamp(at)), stamp_ns(200 * k) + 10**9)
    assert [f.name for f in findings(tmp_path / 'b', level=Severity.SEVERE)] == []
    (found,) = findings(tmp_path / 'b', 'overtaken', Severity.OK)
    assert found.value == 1
