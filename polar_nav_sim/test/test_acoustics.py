"""The channel: times add up, fates belong to packets, order does not matter."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from polar_nav_core.errors import ConfigError
from polar_nav_sim.acoustics import Channel, ChannelSpec, Packet
from polar_nav_sim.mission import load_mission
from polar_nav_sim.poses import TrajectoryPoses, TruthHistory
from polar_nav_sim.resources import DATA
from polar_nav_sim.sound_speed import SoundSpeed, WaterSpec
from polar_nav_sim.truth_cdr import encode

MISSION = load_mission('over_pole')
POSES = {v: TrajectoryPoses(MISSION.truth(v)) for v in MISSION.vehicles}
WATER = SoundSpeed.constant(1440.0)
START = MISSION.start_ns


def channel(seed=1, **changes):
    return Channel(ChannelSpec(**changes), WATER, seed, POSES)


def packet(n, second=10.0, data=bytes(32), source='leader', destination='follower', bit_rate=0.0):
    return Packet(source, destination, n, START + round(second * 1e9), bit_rate, data)


def test_receive_time_is_the_sum_of_its_parts():
    c = channel(detection_delay_s=0.25, bit_rate=512.0)
    c.send(packet(0))
    (arrival,) = c.arrived(START + 20 * 10**9)
    travel_s = (arrival.receive_ns - arrival.packet.transmit_ns) * 1e-9 - 256 / 512.0 - 0.25
    heard_ns = arrival.packet.transmit_ns + round(travel_s * 1e9)
    sent_e = POSES['leader'].pose(arrival.packet.transmit_ns).r_e
    distance = np.linalg.norm(POSES['follower'].pose(heard_ns).r_e - sent_e)
    assert travel_s == pytest.approx(distance / 1440.0, abs=5e-9)
    assert arrival.data == bytes(32)
    # A packet that states its own bit rate is sent at that.
    c.send(packet(1, bit_rate=256.0))
    (slow,) = c.arrived(START + 20 * 10**9)
    assert slow.receive_ns - arrival.receive_ns == 500_000_000


def test_packets_come_out_in_order_of_time_and_not_before():
    c = channel(random_delay_mean_s=2.0)
    for n in range(20):
        c.send(packet(n, second=10.0 + 0.1 * n))
        c.send(packet(n, second=10.0 + 0.1 * n, source='follower', destination='leader'))
    out = []
    for second in np.arange(10.0, 20.0, 0.05):
        now_ns = START + round(second * 1e9)
        arrived = c.arrived(now_ns)
        assert all(now_ns - 50_000_001 <= a.receive_ns <= now_ns for a in arrived)
        out += arrived
    keys = [(a.receive_ns, a.source, a.destination, a.sequence) for a in out]
    assert len(keys) == 40
    assert keys == sorted(keys)
    assert c.in_flight == []
    assert [a.sequence for a in out if a.source == 'leader'] != list(range(20))


@pytest.mark.parametrize('kind', ['uniform', 'exponential'])
def test_fate_of_a_packet_is_its_own(kind):
    changes = {
        'random_delay': kind, 'random_delay_mean_s': 1.5, 'random_delay_max_s': 4.0,
        'loss_probability': 0.2, 'bit_error_rate': 0.01,
    }  # fmt: skip
    forwards = [channel(**changes).fate(packet(n)) for n in range(2000)]
    c = channel(**changes)
    backwards = [c.fate(packet(n)) for n in reversed(range(2000))][::-1]
    assert forwards == backwards
    delays = np.array([f.delay_s for f in forwards])
    assert 0.0 <= delays.min() <= delays.max() <= 4.0
    cut = 1.5 if kind == 'uniform' else 1.5 * (1.0 - np.exp(-4.0 / 1.5))
    assert_allclose(delays.mean(), cut, rtol=0.06)
    assert_allclose(np.mean([f.lost for f in forwards]), 0.2, atol=0.03)
    assert_allclose(np.mean([f.bits_flipped for f in forwards]), 2.56, rtol=0.06)
    assert forwards[5] != channel(seed=2, **changes).fate(packet(5))
    assert forwards[5] != c.fate(packet(5, destination='leader', source='follower'))


def test_bit_errors_are_in_the_bytes():
    c = channel(bit_error_rate=0.05)
    f = c.fate(packet(3, data=bytes(range(32))))
    flipped = np.unpackbits(np.frombuffer(f.data, np.uint8) ^ np.arange(32, dtype=np.uint8)).sum()
    assert flipped == f.bits_flipped > 0


def test_what_is_lost_far_or_under_way_is_counted():
    c = channel(loss_probability=1.0)
    c.send(packet(0))
    assert c.arrived(START + 10**11) == []
    assert (c.counts['lost'], c.counts['sent'], c.in_flight) == (1, 1, [])
    c = channel(max_range_m=100.0)
    c.send(packet(0))
    assert c.arrived(START + 10**11) == []
    assert c.counts['out_of_range'] == 1
    c = channel()
    c.send(packet(7))
    assert [p.sequence for p in c.in_flight] == [7]
    assert c.arrived(START + 10 * 10**9 + 1) == []
    assert [p.sequence for p in c.in_flight] == [7]
    with pytest.raises(ValueError, match="no vehicle 'ship'"):
        c.send(packet(0, destination='ship'))


def test_a_packet_older_than_the_first_truth_is_counted_and_harms_nothing():
    """So it is when this node starts after the others."""
    histories = {}
    for v in MISSION.vehicles:
        block = MISSION.truth(v).samples(500, 1001)
        histories[v] = TruthHistory(10**11)
        for stamp_ns, data in zip(block.stamp_ns.tolist(), encode(block), strict=True):
            histories[v].add(stamp_ns, data)
    c = Channel(ChannelSpec(), WATER, 1, histories)
    c.send(packet(0, second=4.9))
    c.send(packet(1, second=5.1))
    assert [a.sequence for a in c.arrived(START + 10**10)] == [1]
    assert (c.counts['before_truth'], c.counts['delivered'], c.in_flight) == (1, 1, [])


def test_impossible_delays_are_refused():
    with pytest.raises(ConfigError, match='random_delay_mean_s'):
        ChannelSpec(random_delay_mean_s=6.0, random_delay_max_s=10.0)
    assert ChannelSpec(
        random_delay='exponential', random_delay_mean_s=6.0, random_delay_max_s=10.0
    )


def test_harmonic_mean_of_a_profile():
    depth, speed = np.array([0.0, 50.0, 200.0]), np.array([1430.0, 1440.0, 1460.0])
    water = SoundSpeed(depth, speed)
    z = np.linspace(20.0, 120.0, 200_001)
    middle = 0.5 * (z[1:] + z[:-1])
    slowness = np.mean(1.0 / np.interp(middle, depth, speed))
    assert water.mean(20.0, 120.0) == pytest.approx(1.0 / slowness, abs=1e-6)
    assert water.mean(120.0, 20.0) == water.mean(20.0, 120.0)
    assert water.mean(60.0, 60.0) == water.at(60.0)
    assert water.mean(60.0, 60.002) == pytest.approx(water.at(60.001), abs=1e-6)
    assert water.mean(-10.0, 0.0) == pytest.approx(1430.0)
    assert water.mean(300.0, 400.0) == pytest.approx(1460.0)


def test_real_profile_and_bad_ones(tmp_path):
    cast = 'arctic_ssp/sizrs_2016_october6_drop6.csv'
    water = SoundSpeed.from_spec(WaterSpec(sound_speed_profile=cast))
    assert (DATA / cast).is_file()
    assert 1430.0 < water.mean(60.0, 100.0) < 1450.0
    assert SoundSpeed.from_spec(WaterSpec(sound_speed=1500.0)).mean(0.0, 99.0) == 1500.0
    with pytest.raises(ConfigError, match=r'nothing\.csv'):
        SoundSpeed.from_spec(WaterSpec(sound_speed_profile='nothing.csv'))
    bad = tmp_path / 'bad.csv'
    bad.write_text('depth_m,sound_speed_mps\n10,1440\n5,1450\n')
    with pytest.raises(ConfigError, match='must increase'):
        SoundSpeed.from_csv(bad)
    bad.write_text('depth,speed\n1,2\n')
    with pytest.raises(ConfigError, match='no column'):
        SoundSpeed.from_csv(bad)
