"""The station's packet: 192 bits, round trips within the resolution, damage is seen."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polar_nav_core.link import packet, station_packet
from polar_nav_core.link.fields import TICK_NS, PacketError, kind_of
from polar_nav_core.link.station_packet import StationReport, decode, encode

NOW = 1_772_323_200_000_000_000


def report(**changes):
    values = {
        'source': 1,
        'target': 2,
        'sequence': 300,
        'validity_ns': NOW + 123_456_789,
        'station_position': np.array([12.34, -567.89, 0.05]),
        'station_heading': -2.1,
        'station_heading_sigma': 3e-3,
        'range': 987.5,
        'bearing': 1.234,
        'sound_speed': 1438.0,
    }
    return StationReport(**{**values, **changes})


def test_it_is_192_bits():
    assert station_packet.SIZE * 8 == 192
    assert len(encode(report())) == 24


@given(
    st.lists(st.floats(-3276.0, 3276.0), min_size=3, max_size=3),
    st.floats(-10.0, 10.0),
    st.floats(0.0, 6553.0),
    st.floats(-10.0, 10.0),
    st.integers(1400, 1655),
    st.floats(1e-6, 10.0),
    st.integers(0, 2**32 - 1),
    st.integers(-(10**13), 10**13),
)
def test_round_trip_within_resolution(place, heading, distance, bearing, c, sigma, number, age):
    sent = report(
        station_position=np.array(place),
        station_heading=heading,
        station_heading_sigma=sigma,
        range=distance,
        bearing=bearing,
        sound_speed=float(c),
        sequence=number,
        validity_ns=NOW - age,
    )
    got = decode(encode(sent), NOW)
    assert (got.source, got.target, got.sequence) == (1, 2, number % 256)
    assert abs(got.validity_ns - sent.validity_ns) <= TICK_NS // 2
    np.testing.assert_allclose(got.station_position, place, atol=0.0501)
    assert abs(got.range - distance) <= 0.0501
    for told, true in ((got.station_heading, heading), (got.bearing, bearing)):
        assert abs(math.remainder(told - true, 2 * math.pi)) <= 2 * math.pi / 65536
    assert got.sound_speed == c
    assert sigma * (1 - 1e-9) <= got.station_heading_sigma <= max(1.061 * sigma, 5.01e-6)
    again = decode(encode(got), NOW)
    assert repr(again) == repr(got)


def test_quanta_of_the_station_are_told_exactly():
    got = decode(
        encode(report(range=987.5, station_position=np.array([600.0, -500.0, -5.0]))), NOW
    )
    assert got.range == pytest.approx(987.5, abs=1e-9)
    np.testing.assert_allclose(got.station_position, [600.0, -500.0, -5.0], atol=1e-9)


def test_return_time_follows_from_the_range():
    got = decode(encode(report(range=1438.0)), NOW)
    assert got.return_ns == got.validity_ns + 10**9


@given(st.integers(0, 191), st.integers(0, 191))
def test_one_or_two_flipped_bits_are_seen(i, j):
    data = bytearray(encode(report()))
    data[i // 8] ^= 1 << (i % 8)
    if j != i:
        data[j // 8] ^= 1 << (j % 8)
    with pytest.raises(PacketError) as error:
        decode(bytes(data), NOW)
    assert error.value.damaged


@given(st.binary(max_size=60))
def test_any_bytes_give_a_report_or_the_error(data):
    sentence = 'a report'
    try:
        decode(data, NOW)
    except PacketError as error:
        sentence = str(error)
    assert sentence


@pytest.mark.parametrize(
    ('change', 'field'),
    [
        ({'range': 7000.0}, 'range'),
        ({'station_position': np.array([0.0, 4000.0, 0.0])}, 'station_position'),
        ({'sound_speed': 1399.0}, 'sound_speed'),
        ({'bearing': math.nan}, 'bearing'),
        ({'source': 256}, 'source'),
    ],
)
def test_out_of_range_names_the_field(change, field):
    with pytest.raises(ValueError, match=field):
        encode(report(**change))


def test_the_first_byte_tells_the_kind():
    assert kind_of(encode(report())) == station_packet.VERSION == 2
    assert packet.VERSION == 1
    with pytest.raises(PacketError):
        kind_of(b'')
    with pytest.raises(PacketError, match='24 bytes, version 1 has'):
        packet.decode(encode(report()), NOW)


def test_documentation_lists_every_field():
    page = station_packet.documentation()
    assert all(f.name in page for f in station_packet.FIELDS)
