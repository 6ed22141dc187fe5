"""The station: times of a cycle, errors and quanta, its period, other axes and sound speeds."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from sim_station import FRAME, START_NS, Straight

from polar_nav_core.errors import ConfigError
from polar_nav_core.link.station_packet import SIZE, decode, encode
from polar_nav_sim.sensors.station import Station, StationErrors, least_period_s
from polar_nav_sim.sound_speed import SoundSpeed
from polar_nav_sim.station_sequence import SequenceSpec, StationSequence

VECTORS = json.loads((Path(__file__).parent / 'data' / 'has_station.json').read_text())
C = 1500.0
WATER = SoundSpeed.constant(C)
EXACT = {
    'range_error': 0.0,
    'range_quantum_m': 0.0,
    'bearing_error_deg': 0.0,
    'bearing_quantum_deg': 0.0,
}
HERE = Straight((0.0, 0.0, 0.0), psi=0.3)
THERE = Straight((-850.0, 350.0, -15.0), (1.2, -0.7, 0.01))


def station(seed=1, **errors):
    return Station(StationErrors(**errors), WATER, seed, 'station', 'auv', FRAME)


def sequence(target, end_s, own=HERE, spec=None, **errors):
    spec = spec or SequenceSpec()
    e = StationErrors(**errors)
    s = StationSequence(station(**errors), own, target, spec, e, START_NS, START_NS)
    return s, list(s.advance(START_NS + round(end_s * 1e9)))


def test_a_cycle_is_solved_with_moving_ends():
    own = Straight((10.0, 20.0, 1.0), (-2.0, 1.0, 0.0), psi=0.3, rate=0.02)
    c = station(turn_around_s=0.3).cycle(7, START_NS, own, THERE)
    out = np.linalg.norm(THERE.place(c.t2_ns) - own.place(c.t1_ns))
    back = np.linalg.norm(own.place(c.t4_ns) - THERE.place(c.t3_ns))
    assert (c.t2_ns - c.t1_ns) * 1e-9 == pytest.approx(out / C, abs=2e-9)
    assert (c.t4_ns - c.t3_ns) * 1e-9 == pytest.approx(back / C, abs=2e-9)
    assert c.t3_ns - c.t2_ns == 300_000_000
    np.testing.assert_allclose(c.position, own.place(c.t4_ns), atol=1e-6)
    np.testing.assert_allclose(c.position + c.line, THERE.place(c.t3_ns), atol=1e-6)
    assert c.heading == pytest.approx(0.3 + 0.02 * (c.t4_ns - START_NS) * 1e-9, abs=1e-9)


def test_without_errors_range_and_bearing_give_the_place():
    s = station(**EXACT)
    r = s.read(s.cycle(0, START_NS, HERE, THERE))
    angle = r.polar.bearing + r.polar.station_heading
    level = math.sqrt(r.polar.range**2 - r.cycle.line[2] ** 2)
    place = r.polar.station[:2] + level * np.array([math.cos(angle), math.sin(angle)])
    # The range is the mean of both ways; the vehicle made 0.8 m between them.
    np.testing.assert_allclose(place, THERE.place(r.cycle.t3_ns)[:2], atol=1e-6)
    assert r.transmit_ns == r.cycle.t4_ns + 200_000_000


def test_the_delay_is_that_of_the_paper():
    """tau_d = 2 D/c + N/v + T_sigma; the packet's last part is the acoustic link's."""
    for row in VECTORS['delay']:
        s = station(processing_s=float(row['T_proc']), **EXACT)
        cycle = s.cycle(0, START_NS, HERE, Straight((max(row['D'], 1e-3), 0.0, 0.0)))
        reading = s.read(cycle)
        link_s = 8 * SIZE / row['rate'] + row['D'] / row['c']
        delay_s = (reading.transmit_ns - cycle.t3_ns) * 1e-9 + link_s
        assert row['bits'] == 8 * SIZE
        assert delay_s == pytest.approx(row['tau'], abs=1e-6)
        assert least_period_s(row['D'], C, row['rate'], row['T_proc']) == pytest.approx(
            row['tau'] + row['D'] / C
        )


def test_sigmas_are_those_of_the_reference_covariance():
    e = StationErrors()
    for row in VECTORS['polar']:
        D, b = row['D'], row['bearing'] + row['psi_has']
        J = np.array([[math.cos(b), -D * math.sin(b)], [math.sin(b), D * math.cos(b)]])
        R = np.diag([e.range_sigma(D) ** 2, e.bearing_sigma**2])
        np.testing.assert_allclose(J @ R @ J.T, row['cov'], rtol=1e-9)


def test_errors_are_uniform_within_their_bounds_and_quanta():
    s, n = station(seed=4), 600
    readings = [s.read(s.cycle(k, START_NS + k * 500_000_000, HERE, THERE)) for k in range(n)]
    ranges, bearings, true, angles = (
        np.array(x)
        for x in zip(
            *(
                (
                    r.polar.range,
                    r.polar.bearing,
                    0.5 * C * (r.cycle.t4_ns - r.cycle.t1_ns) * 1e-9,
                    math.atan2(r.cycle.line[1], r.cycle.line[0]) - r.cycle.heading,
                )
                for r in readings
            ),
            strict=True,
        )
    )
    half = math.radians(0.5)
    np.testing.assert_allclose(ranges, 0.5 * np.round(ranges / 0.5), atol=1e-9)
    np.testing.assert_allclose(bearings, half * np.round(bearings / half), atol=1e-12)
    errors = np.remainder(bearings - angles + math.pi, 2 * math.pi) - math.pi
    # Share of the largest error that is possible; mean and mean square by four standard errors.
    for x, bound, sigma in (
        (ranges - true, 0.01 * true + 0.25, np.array([r.polar.range_sigma for r in readings])),
        (
            errors,
            np.full(n, math.radians(1.25)),
            np.array([r.polar.bearing_sigma for r in readings]),
        ),
    ):
        assert 0.9 < np.abs(x / bound).max() <= 1.0
        assert abs(np.mean(x / sigma)) < 4 / math.sqrt(n)
        assert np.mean((x / sigma) ** 2) == pytest.approx(1.0, abs=4 * 0.9 / math.sqrt(n))
    assert abs(np.corrcoef(ranges - true, errors)[0, 1]) < 4 / math.sqrt(n)


def test_heading_errors_are_constant_and_told():
    plain = station(**EXACT)
    biased = station(heading_bias_deg=2.0, **EXACT)
    cycle = plain.cycle(0, START_NS, HERE, THERE)
    turned = biased.read(cycle).polar.station_heading - plain.read(cycle).polar.station_heading
    assert turned == pytest.approx(math.radians(2.0))
    drawn = [station(seed=n, heading_sigma_deg=1.0, **EXACT) for n in range(200)]
    errors = np.array([s.read(cycle).polar.station_heading - 0.3 for s in drawn])
    assert np.std(errors) == pytest.approx(math.radians(1.0), rel=0.2)
    assert drawn[0].read(cycle).polar.station_heading_sigma == pytest.approx(math.radians(1.0))
    later = drawn[0].read(drawn[0].cycle(9, START_NS + 10**9, HERE, THERE))
    assert later.polar.station_heading - 0.3 == pytest.approx(errors[0], abs=1e-9)


def test_the_assumed_sound_speed_scales_the_range():
    cycle = station(**EXACT).cycle(0, START_NS, HERE, THERE)
    true, assumed = (station(assumed_sound_speed=c, **EXACT).read(cycle) for c in (0.0, 1450.0))
    assert (true.polar.sound_speed, assumed.polar.sound_speed) == (1500.0, 1450.0)
    assert assumed.polar.range / true.polar.range == pytest.approx(1450.0 / 1500.0)


def test_readings_depend_on_seed_and_number_only():
    cycles = [station().cycle(n, START_NS + n * 10**9, HERE, THERE) for n in range(3)]
    one, two = station(), station()
    forwards = [one.read(c) for c in cycles]
    backwards = [two.read(c) for c in reversed(cycles)][::-1]
    assert [r.polar.range for r in forwards] == [r.polar.range for r in backwards]
    assert station(seed=2).read(cycles[0]).polar.bearing != forwards[0].polar.bearing


def test_the_packet_tells_the_reading():
    s = station()
    r = s.read(s.cycle(300, START_NS, HERE, THERE))
    got = decode(encode(r.report(1, 2)), r.transmit_ns)
    assert got.sequence == 300 % 256
    assert got.range == pytest.approx(r.polar.range, abs=1e-9)
    assert got.bearing == pytest.approx(r.polar.bearing, abs=5e-5)
    assert abs(got.validity_ns - r.cycle.t3_ns) <= 50_000
    assert abs(got.return_ns - r.cycle.t4_ns) < 15_000_000  # 1 % of D/c and a rounding


def test_pings_keep_their_period():
    s, readings = sequence(THERE, 26.0)
    pings = [r.cycle.t1_ns - START_NS for r in readings]
    assert pings == [n * 2_500_000_000 for n in range(10)]
    assert [r.cycle.sequence for r in readings] == list(range(10))
    assert (s.lost, s.queued, s.sequence) == (0, 0, 10)


def test_lost_cycles_leave_a_gap_in_the_numbers():
    s, readings = sequence(THERE, 500.0, loss_probability=0.3)
    numbers = [r.cycle.sequence for r in readings]
    assert s.lost + len(numbers) == s.sequence
    assert 0.15 * s.sequence < s.lost < 0.45 * s.sequence


def test_a_period_too_short_is_refused_with_its_name():
    """3 D/c + N/v + T_sigma at 1140 m, 9600 bit/s and 0.2 s is 2.5 s."""
    assert sequence(Straight((1139.9, 0.0, 0.0)), 3.0)[1]
    with pytest.raises(ConfigError, match=r'period_s: 2\.5 s is shorter .* 2\.501 s .* 1140 m'):
        sequence(Straight((1140.4, 0.0, 0.0)), 3.0)


def test_or_the_next_ping_waits():
    spec = SequenceSpec(when_short='queue')
    s, readings = sequence(Straight((2000.0, 0.0, 0.0)), 60.0, spec=spec)
    pings = np.array([r.cycle.t1_ns for r in readings])
    least_s = least_period_s(2000.0, C, 9600.0, 0.2)
    np.testing.assert_allclose(np.diff(pings) * 1e-9, least_s, atol=1e-6)
    assert s.queued == s.sequence
    assert sequence(Straight((900.0, 0.0, 0.0)), 60.0, spec=spec)[0].queued == 0
