"""The packet codec: round trips within the resolution, damage is seen, sigmas never round down."""

import math
from dataclasses import FrozenInstanceError
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polar_nav_core.link import packet

NOW = 1_772_323_200_000_000_000


def broadcast(**changes):
    A = np.array([[1.0, 0.2, 0.1], [0.0, 0.8, -0.3], [0.0, 0.0, 0.5]])
    values = {
        'source': 1,
        'target': 2,
        'sequence': 77,
        'validity_ns': NOW + 123_456_789,
        'return_ns': NOW + 523_456_789,
        'leader_r_e': np.array([-555573.7529, 962281.9675, 6259444.4802]),
        'leader_sigma_horizontal': 0.37,
        'leader_sigma_vertical': 0.0,
        'leader_v_G': np.array([1.234, -2.5, 0.01]),
        'leader_sigma_velocity': 0.01,
        'leader_grid_heading': -2.1,
        'leader_sigma_heading': 3e-4,
        'r_lf_G': np.array([600.123, -300.456, -40.789]),
        'r_lf_covariance_G': A @ A.T,
        'sound_speed': 1438.27,
    }
    return packet.Broadcast(**{**values, **changes})


def test_crc_check_value():
    assert packet.crc16(b'123456789') == 0x29B1


def test_round_trip_within_resolution():
    sent = broadcast()
    got = packet.decode(packet.encode(sent), NOW + 3_000_000_000)
    assert (got.source, got.target, got.sequence) == (1, 2, 77)
    assert abs(got.validity_ns - sent.validity_ns) <= packet.TICK_NS // 2
    assert abs(got.return_ns - sent.return_ns) <= packet.TICK_NS // 2
    np.testing.assert_allclose(got.leader_r_e, sent.leader_r_e, atol=0.0051)
    np.testing.assert_allclose(got.r_lf_G, sent.r_lf_G, atol=0.0051)
    np.testing.assert_allclose(got.leader_v_G, sent.leader_v_G, atol=0.00051)
    assert got.leader_grid_heading == pytest.approx(-2.1, abs=1e-4)
    assert got.leader_sigma_vertical == 0.0
    assert got.leader_sigma_velocity == pytest.approx(0.01, rel=0.061)
    assert got.leader_sigma_heading == pytest.approx(
        5e-6 * 1.06 ** math.ceil(np.log(60) / np.log(1.06))
    )
    assert got.sound_speed == pytest.approx(1438.27, abs=0.0051)
    assert got.version == 1
    assert (
        sent.leader_sigma_horizontal
        <= got.leader_sigma_horizontal
        <= 1.061 * sent.leader_sigma_horizontal
    )


@given(st.integers(2 * 10**14, 2**31 * 10**9 - 2 * 10**14), st.integers(-(10**14), 10**14))
def test_validity_is_the_nearest_one(received_ns, age_ns):
    sent = broadcast(validity_ns=received_ns - age_ns, return_ns=received_ns - age_ns + 5 * 10**8)
    got = packet.decode(packet.encode(sent), received_ns)
    assert abs(got.validity_ns - sent.validity_ns) <= packet.TICK_NS // 2


@given(st.integers(0, packet.SIZE * 8 - 1), st.integers(0, packet.SIZE * 8 - 1))
def test_one_or_two_flipped_bits_are_seen(i, j):
    data = bytearray(packet.encode(broadcast()))
    data[i // 8] ^= 1 << (i % 8)
    if j != i:
        data[j // 8] ^= 1 << (j % 8)
    with pytest.raises(packet.PacketError) as error:
        packet.decode(bytes(data), NOW)
    assert error.value.damaged


@given(st.binary(max_size=2 * packet.SIZE))
def test_any_bytes_give_a_packet_or_the_error(data):
    sentence = 'a packet'
    try:
        packet.decode(data, NOW)
    except packet.PacketError as error:
        sentence = str(error)
    assert sentence


@given(st.floats(1e-3, 1e4))
def test_sigma_is_never_rounded_down(sigma):
    sent = broadcast(leader_sigma_horizontal=sigma)
    first = packet.decode(packet.encode(sent), NOW)
    assert first.leader_sigma_horizontal >= sigma * (1 - 1e-9)
    again = packet.decode(packet.encode(first), NOW)
    assert again.leader_sigma_horizontal == first.leader_sigma_horizontal


@given(st.lists(st.floats(-2, 2), min_size=9, max_size=9))
def test_covariance_stays_positive_semidefinite(entries):
    A = np.array(entries).reshape(3, 3) + 0.05 * np.eye(3)
    got = packet.decode(packet.encode(broadcast(r_lf_covariance_G=A @ A.T)), NOW)
    values = np.linalg.eigvalsh(got.r_lf_covariance_G)
    assert values.min() >= -0.02 * values.max()
    assert np.all(np.diag(got.r_lf_covariance_G) >= np.diag(A @ A.T) * (1 - 1e-9))


def test_out_of_range_names_the_field():
    with pytest.raises(ValueError, match='sound_speed'):
        packet.encode(broadcast(sound_speed=900.0))


def test_documentation_lists_every_field():
    page = packet.documentation()
    assert all(f.name in page for f in packet.FIELDS)


def test_bytes_of_format_1_never_change():
    """Bags hold packets: the same content has had these bytes since format 1 exists."""
    assert packet.encode(broadcast()).hex() == (
        '0101024d00d39cf282a00f0143b0fc6553bc0580274f254b00d2043cf60a000d70aa486cea0000a28affff11f0'
        'ffff5d5a51120cd433ab65cd'
    )


SIGMA_MOST = 0.005 * 1.06**254 * (1.0 - 1e-12)
LIMITS = {
    'version': (0, 255, 1),
    'source': (0, 255, 1),
    'target': (0, 255, 1),
    'leader_r_e': (-2.1e7, 2.1e7, 0.5),
    'leader_sigma_horizontal': (0.0, SIGMA_MOST, 0.5),
    'leader_sigma_vertical': (0.0, SIGMA_MOST, 0.5),
    'leader_v_G': (-32.767, 32.767, 1e-4),
    'leader_sigma_velocity': (0.0, SIGMA_MOST, 0.5),
    'leader_sigma_heading': (0.0, SIGMA_MOST * 1e-3, 5e-4),
    'r_lf_G': (-1e5, 1e5, 0.5),
    'sound_speed': (1000.0, 1655.35, 0.005),
}
"""Lowest and highest value that format 1 has room for, and how far beyond is refused."""


@pytest.mark.parametrize('name', LIMITS)
def test_limits_of_fields_are_sent_and_what_is_beyond_is_refused(name):
    low, high, beyond = LIMITS[name]
    vector = name in ('leader_r_e', 'leader_v_G', 'r_lf_G')
    for value, step in ((low, -beyond), (high, beyond)):
        size = 3 if vector else 1
        values = [value] * size
        data = packet.encode(broadcast(**{name: np.array(values) if vector else value}))
        if name != 'version':  # of another format, which a receiver does not read
            got = np.atleast_1d(getattr(packet.decode(data, NOW), name))
            np.testing.assert_allclose(got, values, rtol=0.061, atol=0.0051)
        for k in range(size):
            wrong = np.array(values) + step * (np.arange(size) == k)
            with pytest.raises(ValueError, match=name):
                packet.encode(broadcast(**{name: wrong if vector else value + step}))


@pytest.mark.parametrize(
    ('travel_s', 'fits'), [(0.0, True), (6.5534, True), (-1e-4, False), (6.5536, False)]
)
def test_the_travel_of_the_reply_has_room_for_9_km(travel_s, fits):
    sent = broadcast(validity_ns=NOW, return_ns=NOW + round(travel_s * 1e9))
    if not fits:
        with pytest.raises(ValueError, match='reply_travel'):
            packet.encode(sent)
        return
    assert packet.decode(packet.encode(sent), NOW).return_ns == sent.return_ns


@pytest.mark.parametrize('sequence', [0, 1, 65535, 65536, 65537, 200_000])
def test_the_number_of_a_fix_wraps_at_16_bits(sequence):
    got = packet.decode(packet.encode(broadcast(sequence=sequence)), NOW)
    assert got.sequence == sequence & 0xFFFF


@pytest.mark.parametrize('zero', [0, 1, 2])
def test_an_axis_without_variance_has_no_correlation(zero):
    covariance = np.array([[4.0, 1.2, -0.8], [1.2, 1.0, 0.3], [-0.8, 0.3, 9.0]])
    covariance[zero, :] = covariance[:, zero] = 0.0
    got = packet.decode(packet.encode(broadcast(r_lf_covariance_G=covariance)), NOW)
    assert not got.r_lf_covariance_G[zero].any()
    assert not got.r_lf_covariance_G[:, zero].any()
    np.testing.assert_allclose(got.r_lf_covariance_G, covariance, rtol=0.13, atol=0.04)


def test_each_correlation_keeps_its_place():
    covariance = np.array([[4.0, 1.2, -0.8], [1.2, 1.0, 1.5], [-0.8, 1.5, 9.0]])
    got = packet.decode(packet.encode(broadcast(r_lf_covariance_G=covariance)), NOW)
    sigma = np.sqrt(np.diag(got.r_lf_covariance_G))
    found = got.r_lf_covariance_G / np.outer(sigma, sigma)
    expected = [[1.0, 0.6, -0.8 / 6], [0.6, 1.0, 0.5], [-0.8 / 6, 0.5, 1.0]]
    np.testing.assert_allclose(found, expected, atol=1 / 127)
    assert np.all(np.abs(found) <= np.abs(expected) + 1e-12)  # towards zero


def test_the_page_has_the_table_of_this_format():
    page = Path(__file__).parents[2] / 'docs' / 'packet.md'
    assert packet.documentation() in page.read_text(encoding='utf-8')
    assert f'format 1, {packet.SIZE} bytes' in page.read_text(encoding='utf-8')


def test_a_packet_that_was_read_is_not_edited():
    with pytest.raises(FrozenInstanceError):
        broadcast().sequence = 3


@pytest.mark.parametrize('clock_s', [3, 300, 2**31 - 3, 2**31 - 300])
@pytest.mark.parametrize('day', range(5))
def test_a_time_is_one_that_a_stamp_holds(clock_s, day):
    """A receiver whose clock is wrong may know by how much: the packet is no bad one."""
    sent = broadcast(
        validity_ns=NOW + day * 86_400 * 10**9, return_ns=NOW + day * 86_400 * 10**9 + 10**8
    )
    got = packet.decode(packet.encode(sent), clock_s * 10**9)
    assert 0 <= got.validity_ns <= got.return_ns < 2**31 * 10**9
    assert (got.validity_ns - sent.validity_ns) % ((1 << 32) * packet.TICK_NS) == 0
