"""Bytes of packets in the messages of modems, and the file of a modem bridge. Ring 1."""

import base64
from array import array
from types import SimpleNamespace

import numpy as np
import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_core.link import packet, station_packet
from polar_nav_ros.adapters import modem_file
from polar_nav_ros.adapters.mapping_file import parse
from polar_nav_ros.adapters.messages import Fields, stamp_ns_of
from polar_nav_ros.adapters.packets import packet_of, payload_of
from polar_nav_ros.adapters.rows import places_of

DATA = bytes([packet.VERSION, *range(200, 200 + packet.SIZE - 1)])


def stamp(ns):
    return SimpleNamespace(sec=ns // 10**9, nanosec=ns % 10**9)


def read(message, kind, extra=''):
    text = f'imu: {{topic: /i}}\nfixes: [{{topic: /m, type: {kind}, source: modem, {extra}}}]'
    (mapping,) = parse(text, 'm').fixes
    stream = mapping.position.stream
    places = places_of(stream, 'packet', kind, Fields(message), 'm')
    return packet_of(message, places.quantities, mapping, stamp_ns_of(message, places.stamp, 7), 5)


@pytest.mark.parametrize(
    'value',
    [
        DATA,
        array('B', DATA),
        np.frombuffer(DATA, np.uint8),
        np.frombuffer(DATA, np.int8),
        [bytes([one]) for one in DATA],
        list(DATA),
    ],
)
def test_payloads_of_every_form_of_bytes(value):
    assert payload_of(value, '') == DATA


def test_a_text_needs_an_encoding():
    assert payload_of(DATA.hex(), 'hex') == DATA
    assert payload_of(base64.b64encode(DATA).decode(), 'base64') == DATA
    with pytest.raises(ValueError, match='encoding: hex'):
        payload_of('text', '')


def test_what_a_modem_adds_is_taken_off():
    header = SimpleNamespace(stamp=stamp(12_000_000_034))
    rest = SimpleNamespace(dataframe_bytes=array('B', DATA + bytes(135)))
    row = read(SimpleNamespace(header=header, packet=rest), 'ros_acomms_msgs/msg/ReceivedPacket')
    assert row == (DATA, 'modem', 5, 0, 12_000_000_034)
    line = SimpleNamespace(header=header, msg=SimpleNamespace(data=array('B', DATA + b'\n')))
    assert read(line, 'acomms_msgs/msg/AcommsRxByteArray').data == DATA


def test_fields_of_any_type_with_their_times():
    message = SimpleNamespace(
        body=SimpleNamespace(bits=array('B', DATA), used=30),
        done=stamp(9_000_000_001),
        began=7.5,
        number=3,
        who='ship',
    )
    fields = (
        'fields: {payload: body.bits, length: body.used, receive_time: done, '
        'transmit_time: began, sequence: number, source: who}'
    )
    row = read(message, 'acme_msgs/msg/Heard', fields)
    assert row == (DATA[:30], 'ship', 3, 7_500_000_000, 9_000_000_001)


def test_a_type_without_a_header_takes_the_time_of_arrival():
    message = SimpleNamespace(data=array('B', DATA))
    kind = 'std_msgs/msg/UInt8MultiArray'
    assert read(message, kind, 'clock: log').receive_ns == 7
    with pytest.raises(ConfigError, match='has no header: give `stamp: log`'):
        read(message, kind)


FILE = """
packets: {kind}
receive: {{topic: modem/rx, type: std_msgs/msg/UInt8MultiArray, stamp: log}}
transmit: {{topic: modem/tx, type: {type}, {extra}}}
"""


@pytest.mark.parametrize(
    ('kind', 'type_', 'extra', 'says'),
    [
        ('leader', 'seatrac_interfaces/msg/ModemSend', '', 'carries at most 30 bytes, a packet'),
        ('leader', 'std_msgs/msg/UInt8MultiArray', 'max_payload_bytes: 56', 'has 57: fragments'),
        ('station', 'std_msgs/msg/UInt8MultiArray', 'max_payload_bytes: 8', 'has 24: fragments'),
        ('ship', 'std_msgs/msg/UInt8MultiArray', '', 'none of leader, station'),
        ('leader', 'std_msgs/msg/UInt8MultiArray', 'most: 8', 'unknown key most'),
    ],
)
def test_files_of_modems_that_cannot_carry_a_packet(tmp_path, kind, type_, extra, says):
    path = tmp_path / 'modem.yaml'
    path.write_text(FILE.format(kind=kind, type=type_, extra=extra), encoding='utf-8')
    with pytest.raises(ConfigError, match=says):
        modem_file.load(path)


def test_a_packet_of_a_station_fits_a_short_modem(tmp_path):
    path = tmp_path / 'modem.yaml'
    text = FILE.format(kind='station', type='seatrac_interfaces/msg/ModemSend', extra='')
    path.write_text(text, encoding='utf-8')
    file = modem_file.load(path)
    assert file.transmit.most == 30 >= station_packet.SIZE
    assert file.receive.position.stream.stamp == 'log'
