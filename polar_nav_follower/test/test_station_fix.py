"""A station's packet to a fix: what is read, what is refused, and which number it gets."""

import math
import struct
from dataclasses import replace

import numpy as np
import pytest

from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.link import packet, station_packet
from polar_nav_core.link.packet import crc16
from polar_nav_core.link.station_packet import StationReport
from polar_nav_follower.measurements.fix import fix_from_packet
from polar_nav_follower.measurements.station_fix import StationNumbers, station_fix_from_packet
from polar_nav_follower.params import FollowerParams

T_NS = 1_772_323_200_000_000_000
REPORT = StationReport(
    source=1,
    target=2,
    sequence=7,
    validity_ns=T_NS,
    station_position=np.array([10.0, -20.5, 0.3]),
    station_heading=0.3,
    station_heading_sigma=0.01,
    range=900.0,
    bearing=-2.0,
    sound_speed=1500.0,
)


def read(data, params=None, numbers=None, receive_ns=T_NS + 1_500_000_000):
    return station_fix_from_packet(
        data,
        'station',
        5,
        6,
        receive_ns - 600_000_000,
        receive_ns,
        params or FollowerParams(),
        numbers or StationNumbers(),
    )


def test_what_the_station_measured_arrives_with_the_sigmas_of_has_math_4():
    fix, report = read(station_packet.encode(REPORT))
    assert fix.refusal is None
    assert (fix.validity_ns, fix.sequence, fix.order, fix.arrival) == (T_NS, 7, 5, 6)
    assert fix.receive_ns - fix.transmit_ns == 600_000_000
    assert report is not None
    assert report.return_ns == T_NS + 600_000_000
    assert not np.isfinite(fix.r_e).any()
    polar = fix.polar
    np.testing.assert_allclose(polar.station, [10.0, -20.5, 0.3], atol=0.051)
    assert polar.station_heading == pytest.approx(0.3, abs=1e-4)
    assert polar.station_heading_sigma >= 0.01
    assert polar.range == pytest.approx(900.0, abs=0.051)
    assert polar.bearing == pytest.approx(-2.0, abs=1e-4)
    # sD^2 = (0.01 D)^2 / 3 + 0.5^2 / 12; sa^2 = (1 deg)^2 / 3 + (0.5 deg)^2 / 12
    assert polar.range_sigma == pytest.approx(math.sqrt(9.0**2 / 3 + 0.25 / 12), rel=1e-3)
    sigma_deg = math.sqrt(1 / 3 + 0.25 / 12)
    assert polar.bearing_sigma == pytest.approx(math.radians(sigma_deg), rel=1e-3)


def test_a_damaged_packet_holds_nothing():
    data = bytearray(station_packet.encode(REPORT))
    data[9] ^= 4
    fix, report = read(bytes(data))
    assert fix.refusal is Verdict.BAD_CRC
    assert report is None
    assert fix.polar is None
    assert (fix.validity_ns, fix.sequence) == (0, 5)


@pytest.mark.parametrize(
    ('change', 'says'),
    [
        ({'source': 9}, 'sent by station 9, ours is 1'),
        ({'target': 9}, 'meant for vehicle 9, this is 2'),
    ],
)
def test_other_people_s_packets_are_told_apart(change, says):
    fix, report = read(station_packet.encode(replace(REPORT, **change)))
    assert (fix.refusal, fix.reason) == (Verdict.UNKNOWN_SOURCE, says)
    assert report is not None
    assert fix.validity_ns == T_NS


def leader_packet():
    return packet.encode(
        packet.Broadcast(
            source=1,
            target=2,
            sequence=3,
            validity_ns=T_NS,
            return_ns=T_NS,
            leader_r_e=np.array([6.378e6, 0.0, 0.0]),
            leader_sigma_horizontal=1.0,
            leader_sigma_vertical=1.0,
            leader_v_G=np.zeros(3),
            leader_sigma_velocity=0.01,
            leader_grid_heading=0.0,
            leader_sigma_heading=1e-3,
            r_lf_G=np.zeros(3),
            r_lf_covariance_G=np.eye(3),
            sound_speed=1440.0,
        )
    )


def test_a_leader_s_packet_is_of_no_use_to_a_follower_of_a_station_and_the_other_way_round():
    fix, _ = read(leader_packet())
    assert fix.refusal is Verdict.BAD_FORMAT
    assert "mode station takes range and bearing of a station's packet" in fix.reason
    fix, _ = fix_from_packet(
        station_packet.encode(REPORT), 'station', 5, 6, T_NS, T_NS, FollowerParams()
    )
    assert fix.refusal is Verdict.BAD_FORMAT
    assert "mode sins takes the position in a leader's packet" in fix.reason


def test_bytes_of_another_format_or_of_none():
    for data in (b'', b'\x02', bytes(range(200))):
        assert read(data)[0].refusal is Verdict.BAD_FORMAT
    body = b'\x07' + station_packet.encode(REPORT)[1:-2]
    fix, _ = read(body + struct.pack('<H', crc16(body)))
    assert fix.refusal is Verdict.BAD_FORMAT
    assert 'packet format 7' in fix.reason


def test_a_range_of_nothing_is_no_measurement():
    fix, _ = read(station_packet.encode(replace(REPORT, range=0.0)))
    assert fix.refusal is Verdict.NOT_FINITE


def numbered(numbers, count, period_s=2.5, clock_s=0.0):
    """Number that an interrogation gets, which is ``count`` in truth; clock off by ``clock_s``."""
    stamp_ns = T_NS + round(count * period_s * 1e9)
    data = station_packet.encode(replace(REPORT, sequence=count % 256, validity_ns=stamp_ns))
    return read(data, numbers=numbers, receive_ns=stamp_ns + round((1 + clock_s) * 1e9))[
        0
    ].sequence


def test_the_eight_bits_of_the_number_are_made_whole():
    numbers = StationNumbers()
    assert [numbered(numbers, k) for k in range(700)] == list(range(700))


def test_losses_disorder_and_repetition_do_not_confuse_the_numbers():
    numbers = StationNumbers()
    order = [0, 3, 2, 5, 5, 250, 249, 270, 260, 255, 511, 512, 400]
    assert [numbered(numbers, k) for k in order] == order


def test_after_a_silence_of_more_than_a_turn_the_pace_tells_the_number():
    numbers = StationNumbers()
    for k in range(40):
        numbered(numbers, k)
    # 40 + 256 would look like 40 again, if only the eight bits were compared.
    assert numbered(numbers, 296) == 296
    assert numbered(numbers, 1500) == 1500


@pytest.mark.parametrize('by_s', [-1.7e9, -3e5, 3e5, 3e8])
def test_a_clock_of_this_vehicle_that_steps_by_days_changes_no_number(by_s):
    numbers = StationNumbers()
    for k in range(300):
        numbered(numbers, k)
    assert numbered(numbers, 300, clock_s=by_s) == 300
    assert numbered(numbers, 301) == 301
