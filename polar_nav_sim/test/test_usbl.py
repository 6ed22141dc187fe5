"""USBL: two-way timing with moving ends, closed through the core's own fix."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from polar_nav_core import usbl as core
from polar_nav_core.attitude import matrix_from_euler
from polar_nav_sim.interrogator import Interrogator
from polar_nav_sim.mission import load_mission
from polar_nav_sim.poses import NotYet, TrajectoryPoses, TruthHistory
from polar_nav_sim.sensors.usbl import Usbl, UsblErrors
from polar_nav_sim.sound_speed import SoundSpeed
from polar_nav_sim.truth_cdr import encode

C = 1440.0
WATER = SoundSpeed.constant(C)
ARRAY = (1.0, 0.2, -0.3)
ARRAY_RPY = (4.0, -3.0, 40.0)
TRANSPONDER = (-0.5, 0.1, 0.4)
EXACT = UsblErrors(
    cosine_sigma=0.0,
    range_sigma_m=0.0,
    lever_b=ARRAY,
    rpy_deg=ARRAY_RPY,
    transponder_lever_b=TRANSPONDER,
)


def ends(name):
    mission = load_mission(name)
    return mission, [TrajectoryPoses(mission.truth(v)) for v in mission.vehicles]


def array_of(errors=EXACT, seed=1):
    return Usbl(errors, WATER, seed, 'leader', 'follower')


@pytest.mark.parametrize('name', ['demo', 'near_pole', 'over_pole', 'south_pole', 'antimeridian'])
def test_cycle_obeys_the_speed_of_sound(name):
    mission, (leader, follower) = ends(name)
    cycle = array_of().cycle(0, mission.start_ns + 300_123_456_789, leader, follower)
    array = [leader.pose(t).point(np.array(ARRAY))[0] for t in (cycle.t1_ns, cycle.t4_ns)]
    there = [follower.pose(t).point(np.array(TRANSPONDER))[0] for t in (cycle.t2_ns, cycle.t3_ns)]
    out = np.linalg.norm(there[0] - array[0]) / C
    back = np.linalg.norm(array[1] - there[1]) / C
    assert (cycle.t2_ns - cycle.t1_ns) * 1e-9 == pytest.approx(out, abs=2e-9)
    assert (cycle.t4_ns - cycle.t3_ns) * 1e-9 == pytest.approx(back, abs=2e-9)
    assert cycle.t3_ns - cycle.t2_ns == 100_000_000


@pytest.mark.parametrize('name', ['demo', 'near_pole', 'over_pole', 'racetrack', 'dive'])
def test_noise_free_fix_is_the_transponder_at_t3(name):
    """With the core's own way back, under a centimetre; the reply's own motion is known here."""
    mission, (leader, follower) = ends(name)
    for second in (1.0, 37.7, 200.0):
        usbl = array_of()
        t1_ns = mission.start_ns + round(second * 1e9)
        reading = usbl.read(usbl.cycle(0, t1_ns, leader, follower))
        cycle = reading.cycle
        at1, at4 = leader.pose(t1_ns), leader.pose(cycle.t4_ns)
        C_a_b = matrix_from_euler(*np.radians(ARRAY_RPY[::-1]))
        C_a_e = at4.C_b_e @ C_a_b
        arm, tail = np.array(ARRAY), np.array(TRANSPONDER)
        moved_e = at4.point(arm)[0] - at1.point(arm)[0]
        # The transponder moves while it turns around; seen from it, the array started elsewhere.
        turned_e = (
            follower.pose(cycle.t3_ns).point(tail)[0] - follower.pose(cycle.t2_ns).point(tail)[0]
        )
        distance = core.range_at_reply(
            reading.range_m, 1e-6, reading.direction_a, C_a_e.T @ (moved_e - turned_e)
        ).distance
        fix_e = at4.point(arm)[0] + C_a_e @ (distance * reading.direction_a)
        truth_e = follower.pose(cycle.t3_ns).point(tail)[0]
        assert np.linalg.norm(fix_e - truth_e) < 1e-3
        # Without that, half of the turn-around's motion is left, as in a real instrument.
        plain = core.range_at_reply(reading.range_m, 1e-6, reading.direction_a, C_a_e.T @ moved_e)
        assert abs(plain.distance - distance) < 0.5 * 3.2 * 0.1 + 1e-3


def test_noise_has_its_sigmas_and_does_not_depend_on_order():
    mission, (leader, follower) = ends('demo')
    errors = dataclasses.replace(EXACT, cosine_sigma=1e-3, range_sigma_m=0.3)
    cycle = array_of(errors).cycle(0, mission.start_ns + 10**9, leader, follower)
    usbl = array_of(errors)
    readings = {}
    for n in [*range(999, -1, -1)]:
        readings[n] = usbl.read(dataclasses.replace(cycle, sequence=n))
    cosines = np.array([r.direction_a[:2] for r in readings.values()]) - cycle.direction_a[:2]
    ranges = np.array([r.range_m for r in readings.values()])
    exact = 0.5 * C * ((cycle.t4_ns - cycle.t1_ns) * 1e-9 - 0.1)
    assert_allclose(cosines.std(axis=0), 1e-3, rtol=0.1)
    assert_allclose([ranges.std(), ranges.mean() - exact], [0.3, 0.0], atol=0.04)
    assert_allclose([np.linalg.norm(r.direction_a) for r in readings.values()], 1.0, atol=1e-12)
    again = array_of(errors).read(dataclasses.replace(cycle, sequence=500))
    assert again.range_m == readings[500].range_m


def test_loss_outliers_and_a_wrong_sound_speed():
    mission, (leader, follower) = ends('demo')
    cycle = array_of().cycle(0, mission.start_ns + 10**9, leader, follower)
    lossy = array_of(dataclasses.replace(EXACT, loss_probability=0.25))
    lost = [lossy.read(dataclasses.replace(cycle, sequence=n)) is None for n in range(1000)]
    assert np.mean(lost) == pytest.approx(0.25, abs=0.05)
    strange = array_of(dataclasses.replace(EXACT, outlier_probability=1.0, outlier_range_m=50.0))
    far = [strange.read(dataclasses.replace(cycle, sequence=n)).range_m for n in range(300)]
    exact = array_of().read(cycle).range_m
    assert exact < min(far) < max(far) < exact + 50.0
    slow = array_of(dataclasses.replace(EXACT, assumed_sound_speed=1500.0)).read(cycle)
    assert slow.range_m == pytest.approx(exact * 1500.0 / C)
    assert slow.sound_speed == 1500.0


def asked_every_2_s(mission, target_from_s=0.0):
    """Stamp and interrogator after each message of truth, the target's from a time on."""
    blocks = {v: mission.truth(v).samples(0, mission.sample_count) for v in mission.vehicles}
    messages = {v: encode(b) for v, b in blocks.items()}
    histories = {'': TruthHistory(10**10), 'follower': TruthHistory(10**10)}
    asker = Interrogator({'follower': array_of()}, histories, period_s=2.0, first_s=1.0)
    asker.begin(mission.start_ns, mission.start_ns)
    for i, stamp_ns in enumerate(blocks['leader'].stamp_ns.tolist()):
        histories[''].add(stamp_ns, messages['leader'][i])
        if stamp_ns >= mission.start_ns + target_from_s * 1e9:
            histories['follower'].add(stamp_ns, messages['follower'][i])
        yield stamp_ns, asker


def test_interrogator_waits_for_the_truth_it_needs():
    """Messages come one by one: each fix appears at the first stamp that reaches its t4."""
    mission = load_mission('demo').with_duration(8.0)
    seen = []
    for stamp_ns, asker in asked_every_2_s(mission):
        seen += [(stamp_ns, reading.cycle) for _, reading in asker.advance()]
    assert [c.sequence for _, c in seen] == [0, 1, 2, 3]
    exact = array_of()
    poses = [TrajectoryPoses(mission.truth(v)) for v in mission.vehicles]
    for published_ns, cycle in seen:
        assert cycle.t1_ns == mission.start_ns + 10**9 * (1 + 2 * cycle.sequence)
        assert 0 <= published_ns - cycle.t4_ns < 10**7
        expected = exact.cycle(cycle.sequence, cycle.t1_ns, *poses)
        assert (cycle.t2_ns, cycle.t3_ns, cycle.t4_ns) == (
            expected.t2_ns, expected.t3_ns, expected.t4_ns,
        )  # fmt: skip
        assert_allclose(cycle.direction_a, expected.direction_a, atol=1e-11)


def test_interrogations_before_the_truth_of_the_target_are_never_made():
    mission = load_mission('demo').with_duration(6.0)
    seen = []
    for _, asker in asked_every_2_s(mission, target_from_s=3.5):
        seen += [reading.cycle.sequence for _, reading in asker.advance()]
    assert seen == [2]
    assert asker.lost == 0


def test_history_interpolates_exactly_and_says_what_it_has_not():
    mission = load_mission('racetrack')
    block = mission.truth('follower').samples(20000, 20100)
    history = TruthHistory(500_000_000)
    for stamp_ns, data in zip(block.stamp_ns.tolist(), encode(block), strict=True):
        assert history.add(stamp_ns, data)
    assert not history.add(history.newest_ns, data)
    truth = TrajectoryPoses(mission.truth('follower'))
    rng = np.random.default_rng(1)
    for t_ns in rng.integers(history.oldest_ns, history.newest_ns, 50).tolist():
        got, expected = history.pose(t_ns), truth.pose(t_ns)
        assert np.abs(got.r_e - expected.r_e).max() < 1e-8
        assert np.abs(got.C_b_e - expected.C_b_e).max() < 1e-10
    with pytest.raises(NotYet):
        history.pose(history.newest_ns + 1)
    with pytest.raises(ValueError, match='kept are'):
        history.pose(int(block.stamp_ns[0]))
