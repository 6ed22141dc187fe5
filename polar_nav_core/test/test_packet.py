"""The packet codec: round trips within the resolution, damage is seen, sigmas never round down."""

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
    assert (
        sent.leader_sigma_horizontal
        <= got.leader_sigma_horizontal
        <= 1.061 * sent.leader_sigma_horizontal
    )


@given(st.integers(0, 2**62), st.integers(-(10**14), 10**14))
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
