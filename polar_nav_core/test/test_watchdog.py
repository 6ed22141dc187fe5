"""The watchdog: silent on white innovations, names what is off, remembers since when."""

import numpy as np
import pytest
from compiled import jit_only

from polar_nav_core.engine.health.conditions import RUNAWAY, Condition, Culprit, Level
from polar_nav_core.engine.health.statistics import statistics
from polar_nav_core.engine.health.view import Envelope, Gaps, View
from polar_nav_core.engine.health.watchdog import (
    DEPTH,
    DVL,
    FIX,
    Watchdog,
    is_alone,
    judged,
    refused_alone,
    scatter,
)
from polar_nav_core.kernels import watch

S = np.diag([0.04, 0.09, 0.01])
SIGMA = np.sqrt(np.diagonal(S))
EAST = np.array([0.7, 0.0, 0.0])


def memories():
    return np.zeros((watch.STREAMS, watch.MEMORIES, watch.WIDTH))


def feed(kept, stream, z, course=0.0, *, m=3, fused=True, speed=2.0):
    """One attempt: innovation z [m] on a course [rad, from grid east to grid north]."""
    z = np.ascontiguousarray(z, dtype=float)
    nis = float(np.sum(z[:m] ** 2 / np.diagonal(S)[:m]))
    v = speed * np.cos(course), speed * np.sin(course)
    watch.observe(kept[stream], z, S, nis, m, fused, *v, z, S)


def view(kept, stamp_ns=10**12, **changes):
    usual = {
        'opened_ns': np.zeros(3, dtype=np.int64),
        'used_ns': np.zeros(3, dtype=np.int64),
        'speed': 2.0,
        'depth': 100.0,
        'P_horizontal': np.eye(2),
        'resets': 0,
    }
    return View(stamp_ns=stamp_ns, memories=kept, **{**usual, **changes})


def look(kept, dog=None, **changes):
    dog = dog or Watchdog(Envelope(max_speed=10.0, max_depth=6000.0))
    return dog.look(view(kept, **changes), [])


@jit_only
def test_statistics_of_white_innovations_are_chi_square():
    rng, found = np.random.default_rng(1), []
    for _ in range(300):
        kept = memories()
        for _ in range(400):
            feed(kept, FIX, SIGMA * rng.standard_normal(3), rng.uniform(0.0, 6.0))
        found.append(statistics(kept))
    for memory in range(watch.MEMORIES):
        values = np.array([[s.grid[FIX, memory], s.track[FIX, memory]] for s in found])
        assert values.mean() == pytest.approx(1.0, abs=0.1)  # chi-square (1)
        nis = np.array([s.nis[FIX, memory] for s in found])
        sigmas = np.array([s.nis_sigmas[FIX, memory] for s in found])
        assert nis.mean() == pytest.approx(1.0, abs=0.01)
        assert 0.5 < sigmas.std() < 1.1  # three degrees of freedom of a fix scatter less than one


def test_memories_forget():
    kept = memories()
    for _ in range(2000):
        feed(kept, DVL, SIGMA * 0.0)
    number = statistics(kept).number[DVL]
    np.testing.assert_allclose(number, [60.0, 600.0], rtol=0.03)


@pytest.mark.parametrize('stream', [DVL, DEPTH, FIX])
@jit_only
def test_silent_on_white_innovations(stream):
    rng, kept = np.random.default_rng(2), memories()
    m = 1 if stream == DEPTH else 3
    for k in range(20_000):
        feed(kept, stream, SIGMA * rng.standard_normal(3), 1e-3 * k, m=m)
        if k % 50 == 0:
            assert not look(kept).present


def test_fixes_off_along_the_track_on_every_course_are_the_dvl():
    rng, kept = np.random.default_rng(3), memories()
    for k in range(600):
        course = 0.05 * k
        off = -0.7 * np.array([np.cos(course), np.sin(course), 0.0])
        feed(kept, FIX, SIGMA * (off + rng.standard_normal(3)), course)
    health = look(kept)
    assert health.culprit is Culprit.DVL
    assert 'ahead whatever the course: scale of the DVL' in health.sentence


def test_fixes_off_to_one_side_of_the_map_drift():
    rng, kept = np.random.default_rng(4), memories()
    for k in range(600):
        feed(kept, FIX, SIGMA * (EAST + rng.standard_normal(3)), 0.05 * k)
    health = look(kept)
    assert health.culprit is Culprit.FIXES
    assert 'towards grid east' in health.sentence
    assert '-0.' in health.sentence  # estimate minus fix is positive: fixes lie to the west


def test_on_one_course_the_two_look_the_same():
    rng, kept = np.random.default_rng(5), memories()
    for _ in range(600):
        feed(kept, FIX, SIGMA * (EAST + rng.standard_normal(3)))
    assert look(kept).culprit == Culprit.FIXES | Culprit.DVL


def test_outliers_are_no_bias_but_scatter():
    rng, kept = np.random.default_rng(6), memories()
    for k in range(900):
        wild = 30.0 if k % 5 == 0 else 1.0
        feed(kept, FIX, wild * SIGMA * rng.standard_normal(3), 0.01 * k)
    health = look(kept)
    assert [p.condition.key for p in health.present] == ['position fixes noise']
    assert health.level is Level.WARN


@jit_only
def test_refused_sensors_are_an_error_that_ends_and_is_counted():
    rng, kept = np.random.default_rng(7), memories()
    dog = Watchdog(Envelope(max_speed=10.0, max_depth=6000.0))
    stamps = iter(range(10**12, 10**13, 10**9))
    for _ in range(2):
        for _ in range(40):
            feed(kept, DVL, SIGMA * (9.0 + rng.standard_normal(3)), fused=False)
        first, then = (look(kept, dog, stamp_ns=next(stamps)) for _ in range(2))
        assert first.level is Level.ERROR
        assert first.culprit == Culprit.DVL | Culprit.IMU
        assert '% of DVL refused' in first.sentence
        assert then.present[0].since_ns == first.stamp_ns
        for _ in range(20_000):
            feed(kept, DVL, SIGMA * rng.standard_normal(3))
        assert not look(kept, dog, stamp_ns=next(stamps)).present
    assert first.present[0].count == 2


def test_a_gate_that_was_opened_again_is_an_error_for_a_minute():
    kept, opened = memories(), np.array([10**12, 0, 0], dtype=np.int64)
    soon = look(kept, stamp_ns=10**12 + 30 * 10**9, opened_ns=opened)
    assert soon.level is Level.ERROR
    assert 'refused until 30 s ago' in soon.sentence
    assert not look(kept, stamp_ns=10**12 + 61 * 10**9, opened_ns=opened).present


@jit_only
@pytest.mark.parametrize(('refused_s', 'expected'), [(11, True), (9, False)])
def test_a_sensor_that_was_refused_for_long_and_is_used_again_is_an_error(refused_s, expected):
    """The covariance grew until it passed its gate: the estimate goes over to it then."""
    rng, kept = np.random.default_rng(8), memories()
    dog = Watchdog(Envelope(max_speed=10.0, max_depth=6000.0))
    for _ in range(40):
        feed(kept, DVL, SIGMA * (9.0 + rng.standard_normal(3)), fused=False)
    for second in range(refused_s):
        assert look(kept, dog, stamp_ns=(1000 + second) * 10**9).level is Level.ERROR
    for _ in range(20_000):
        feed(kept, DVL, SIGMA * rng.standard_normal(3))
    last_s = 999 + refused_s
    found = look(kept, dog, stamp_ns=(last_s + 59) * 10**9).present
    assert ['was refused until 59 s ago' in p.condition.sentence for p in found] == [
        True
    ] * expected
    assert [p.condition.level for p in found] == [Level.ERROR] * expected
    assert not look(kept, dog, stamp_ns=(last_s + 60) * 10**9).present


def test_a_ping_that_leapt_is_an_error_for_a_minute():
    """It passed the gate: nothing else says that the attitude was wrong."""
    assert not look(memories(), stamp_ns=10**9).present
    (present,) = look(memories(), stamp_ns=1059 * 10**9, leapt_ns=1000 * 10**9).present
    assert present.condition.level is Level.ERROR
    assert present.condition.culprit == Culprit.IMU | Culprit.DVL
    assert 'by far too much 59 s ago' in present.condition.sentence
    assert not look(memories(), stamp_ns=1060 * 10**9, leapt_ns=1000 * 10**9).present


def test_an_imu_sample_that_was_half_believed_is_a_warning_for_a_minute():
    (present,) = look(memories(), stamp_ns=1059 * 10**9, shock_ns=1000 * 10**9).present
    assert (present.condition.level, present.condition.culprit) == (Level.WARN, Culprit.IMU)
    assert 'an IMU sample leapt 59 s ago' in present.condition.sentence
    assert not look(memories(), stamp_ns=1060 * 10**9, shock_ns=1000 * 10**9).present


def test_states_that_no_vehicle_can_be_in():
    assert '20.0 m/s is faster' in look(memories(), speed=20.0).sentence
    assert 'no depth' in look(memories(), depth=9000.0).sentence
    assert look(memories(), depth=9000.0).level is Level.ERROR
    assert 'no depth' in look(memories(), depth=-50.5).sentence
    assert not look(memories(), depth=-49.5).present


def test_a_circle_above_the_limit_is_lost():
    dog = Watchdog(Envelope(max_speed=10.0, max_depth=6000.0, lost_radius=100.0))
    near = look(memories(), dog, P_horizontal=1600.0 * np.eye(2))
    assert (near.lost, near.level) == (False, Level.OK)
    far = look(memories(), dog, P_horizontal=1700.0 * np.eye(2))
    assert (far.lost, far.level, far.culprit) == (True, Level.ERROR, Culprit.UNEXPLAINED)
    assert far.sentence == ('lost: the vehicle is within 101 m with 95 %, lost_radius is 100 m')
    assert look(memories(), dog, P_horizontal=np.full((2, 2), np.nan)).lost
    assert look(memories(), dog, speed=11.0).lost


def test_the_likelihood_ratios_have_the_mean_one_in_a_world_as_stated():
    """The premise of Lorden's bound: a sum exceeds h once in exp(h) attempts at most."""
    x = np.random.default_rng(8).standard_normal((200_000, 3))
    limited = np.clip(x, -watch.RISE_LIMIT, watch.RISE_LIMIT)
    calm = np.minimum(np.mean(x**2, axis=1), 2.0 * watch.RISE_LIMIT)
    for shift, ratio in zip(watch.SHIFTS, watch.NOISES, strict=True):
        assert np.mean(np.exp(shift * limited - 0.5 * shift**2)) < 1.0
        more = 1.5 * (calm * (1.0 - 1.0 / ratio) - np.log(ratio))
        assert np.mean(np.exp(more)) < 1.02


def attempts_until_reported(innovation, most=1000):
    """Attempts after a settled start until the first condition, of innovations by number."""
    rng, kept, dog = np.random.default_rng(9), memories(), Watchdog(Envelope(10.0, 6000.0))
    for _ in range(300):
        feed(kept, FIX, SIGMA * rng.standard_normal(3))
    for k in range(most):
        feed(kept, FIX, SIGMA * innovation(rng.standard_normal(3), k))
        health = look(kept, dog)
        if health.present:
            return k + 1, health
    raise AssertionError('never reported')


def test_a_step_that_the_filter_absorbs_is_reported_before_it_is_forgotten():
    """3 sigma, absorbed by a filter with a memory of 25 fixes; its scatter hides it in means.

    Within a minute at a fix every 2 s.
    """
    step = np.array([3.0, 0.0, 0.0])
    count, health = attempts_until_reported(lambda z, k: z + step * np.exp(-k / 25.0))
    assert count <= 30
    assert health.level is Level.WARN
    assert Culprit.FIXES in health.culprit


def test_a_slow_drift_is_reported():
    count, health = attempts_until_reported(lambda z, k: z + EAST * min(1.0, k / 60.0))
    assert count <= 150
    assert Culprit.FIXES in health.culprit


def test_a_larger_scatter_is_reported_within_a_few_attempts():
    count, health = attempts_until_reported(lambda z, _: 3.0 * z)
    assert count <= 15
    assert health.present[0].condition.key == 'position fixes noise'


@pytest.mark.parametrize('turn_deg', [-20.0, 20.0, 60.0])
def test_pings_refused_across_the_track_name_the_heading(turn_deg):
    rng, kept, turn = np.random.default_rng(10), memories(), np.radians(turn_deg)
    for _ in range(40):
        v = 3.0 * np.array([np.cos(turn) - 1.0, np.sin(turn), 0.0])
        feed(kept, DVL, v + 0.01 * rng.standard_normal(3), fused=False)
    health = look(kept)
    named = abs(turn_deg) < 45.0  # a larger turn is along track, too
    assert (Culprit.HEADING in health.culprit) is named
    assert Culprit.DVL in health.culprit
    assert ('the heading is off' in health.sentence) is named


def test_a_shift_that_has_ended_is_forgotten():
    rng, kept = np.random.default_rng(11), memories()
    for k in range(1500):
        feed(kept, FIX, SIGMA * (rng.standard_normal(3) + (EAST if k < 100 else 0.0)))
    assert not look(kept).present


def test_pings_refused_one_after_the_other_are_an_error_before_most_are():
    """Thirty good ones came before, so that a share says nothing for three seconds."""
    kept = memories()
    for _ in range(40):
        feed(kept, 0, np.zeros(3))
    feed(kept, 0, [3.0, 0.0, 0.0], fused=False)

    def after(number, since_s):
        used, row = np.array([10**12 - round(since_s * 1e9), 0, 0]), np.array([number, 0, 0])
        health = look(kept, used_ns=used, refused_row=row)
        return [p.condition.sentence for p in health.present if p.condition.key == 'DVL refused']

    assert after(8, 1.7) == ['the newest 8 DVL refused: DVL and inertial navigation disagree']
    assert after(4, 1.7) == after(40, 1.4) == []


def remembered(stream, memory, number, **columns):
    """Memories of one stream with so many attempts, and means of some columns."""
    kept = memories()
    row = kept[stream, memory]
    row[watch.WEIGHT] = row[watch.WEIGHT_2] = number
    row[watch.SQUARE : watch.SQUARE + 3] = number
    for name, mean in columns.items():
        row[getattr(watch, name)] = number * mean
    return kept


@pytest.mark.parametrize('stream', [DVL, DEPTH, FIX])
@pytest.mark.parametrize(('memory', 'limit'), [(watch.SHORT, 45.0), (watch.LONG, 40.0)])
@pytest.mark.parametrize(
    ('times', 'level'),
    [(1.0, None), (1.01, Level.WARN), (3.99, Level.WARN), (4.01, Level.ERROR)],
)
def test_a_mean_is_reported_beyond_its_limit_and_an_error_beyond_four(
    stream, memory, limit, times, level
):
    kept = remembered(stream, memory, limit, TRACK=np.sqrt(times))
    assert [p.condition.level for p in look(kept).present] == ([] if level is None else [level])
    few = remembered(stream, memory, 9.9, TRACK=20.0)
    assert not look(few).present


@pytest.mark.parametrize('stream', [DVL, DEPTH, FIX])
@pytest.mark.parametrize('axis', [0, 1, 2])
def test_a_mean_on_any_axis_is_reported(stream, axis):
    kept = remembered(stream, watch.SHORT, 30.0)
    kept[stream, watch.SHORT, watch.TRACK + axis] = 30.0 * 1.5
    s = statistics(kept)
    assert judged(s, s.track, s.track_rise, stream)[1:] == (watch.SHORT, axis)
    assert len(look(kept).present) == 1


def test_the_size_of_an_offset_on_one_course_is_of_both_axes():
    means = {'TRACK': 1.5, 'GRID': 1.5}
    kept = remembered(FIX, watch.SHORT, 30.0, **means)
    kept[FIX, watch.SHORT, watch.GRID + 1] = 30.0 * -2.0
    kept[FIX, watch.SHORT, watch.TRACK + 1] = 30.0 * -2.0
    assert 'fixes lie 2.5 sigma off on average' in look(kept).sentence


def test_a_sum_at_its_limit_is_not_beyond_it():
    calm = statistics(memories())
    for rise, told in ((15.3, False), (15.4, True)):
        s = calm._replace(noise_rise=np.full_like(calm.noise_rise, rise))
        assert bool(scatter(s, FIX, early=True)) is told


@pytest.mark.parametrize(
    ('grid', 'culprit'),
    [(0.49, Culprit.DVL), (0.51, Culprit.FIXES | Culprit.DVL), (2.1, Culprit.FIXES)],
)
def test_an_offset_of_fixes_is_of_that_of_which_it_has_twice_as_much(grid, culprit):
    """Means of squares, in their limits: of the track 2.25, and of the map so many times that."""
    track = 1.5 * np.sqrt(45.0 / 30.0)
    health = look(remembered(FIX, watch.SHORT, 30.0, TRACK=track, GRID=np.sqrt(grid) * track))
    assert health.culprit == culprit


@pytest.mark.parametrize(('number', 'told'), [(49.0, False), (51.0, True), (300.0, True)])
def test_a_scatter_that_lasts_is_told_by_the_long_memory(number, told):
    kept = remembered(DEPTH, watch.LONG, number, NIS=9.0)
    kept[DEPTH, watch.SHORT] = remembered(DEPTH, watch.SHORT, 30.0, NIS=1.0)[DEPTH, watch.SHORT]
    found = [p.condition.sentence for p in look(kept).present if 'scatter' in p.condition.sentence]
    assert (
        found
        == ['depth scatter 3.0 times as much as stated (NIS 9.0 per degree of freedom)'] * told
    )


@pytest.mark.parametrize('rise', [watch.ALIKE_RISE, watch.BLOCK_RISE])
@pytest.mark.parametrize(
    ('stream', 'own'), [(DVL, Culprit.DVL), (DEPTH, Culprit.DEPTH), (FIX, Culprit.FIXES)]
)
def test_errors_that_last_may_be_of_what_is_between_them(stream, own, rise):
    kept = memories()
    kept[stream, watch.LONG, rise] = 18.0
    present = look(kept).present
    if stream == DEPTH and rise == watch.ALIKE_RISE:  # any filtered pressure has such neighbours
        assert not present
        return
    assert present[0].condition.key.endswith('alike')
    assert present[0].condition.culprit == own | Culprit.DVL | Culprit.IMU


@pytest.mark.parametrize(('stream', 'limit'), [(DVL, 8.5), (DEPTH, 7.0), (FIX, 7.0)])
def test_blocks_are_told_beyond_their_limit(stream, limit):
    for more in (0.0, 0.1):
        kept = memories()
        kept[stream, watch.SHORT, watch.BLOCK_RISE] = limit + more
        assert bool(look(kept).present) is (more > 0.0)


@pytest.mark.parametrize(('number', 'told'), [(49.0, False), (51.0, True)])
def test_calm_fixes_are_told_from_fifty_on(number, told):
    kept = remembered(FIX, watch.LONG, number, NIS=0.4)
    kept[FIX, watch.LONG, watch.CALM_RISE] = 20.0
    assert bool(look(kept).present) is told


def test_fixes_above_the_estimate_are_of_depth_or_of_fixes():
    means = {'TRACK': 0.0, 'GRID': 0.0}
    kept = remembered(FIX, watch.SHORT, 30.0, **means)
    kept[FIX, watch.SHORT, [watch.GRID + 2, watch.TRACK + 2]] = 30.0 * -1.5
    health = look(kept)
    assert health.sentence.startswith('fixes lie +1.5 sigma above the estimate')
    assert health.culprit == Culprit.FIXES | Culprit.DEPTH


@pytest.mark.parametrize(('share', 'told'), [(0.5, False), (0.51, True)])
def test_more_than_half_of_a_sensor_refused_is_an_error(share, told):
    health = look(remembered(DVL, watch.SHORT, 30.0, REFUSED=share))
    assert (health.level is Level.ERROR) is told


@pytest.mark.parametrize(('across', 'named'), [(0.9, False), (0.91, True), (-0.91, True)])
def test_the_heading_is_named_where_nine_tenths_lie_across(across, named):
    health = look(remembered(DVL, watch.SHORT, 30.0, REFUSED=0.6, ACROSS=across))
    assert health.level is Level.ERROR
    assert health.sentence.startswith('60 % of DVL refused')
    assert (Culprit.HEADING in health.culprit) is named


@pytest.mark.parametrize(
    ('stream', 'words'),
    [
        (DVL, 'DVL was refused until 30 s ago and is used again'),
        (DEPTH, 'depth was refused until 30 s ago and is used again'),
        (FIX, 'position fixes were refused until 30 s ago and are used again'),
    ],
)
def test_an_opened_gate_is_told_in_the_words_of_its_sensor(stream, words):
    opened = np.zeros(3, dtype=np.int64)
    opened[stream] = 10**12
    (present,) = look(memories(), stamp_ns=1030 * 10**9, opened_ns=opened).present
    assert present.condition.sentence.startswith(words)
    assert not look(memories(), stamp_ns=1060 * 10**9, opened_ns=opened).present


@pytest.mark.parametrize('stream', [DVL, DEPTH])
def test_a_local_sensor_that_was_used_and_is_not_is_silent(stream):
    dog, used = Watchdog(Envelope(10.0, 6000.0, silent_after_s=10.0)), np.zeros(3, dtype=np.int64)
    assert not look(memories(), dog, used_ns=used).present  # it never was
    used[stream] = 10**12 - 10 * 10**9
    assert not look(memories(), dog, used_ns=used).present
    used[stream] -= 1 * 10**9
    assert look(memories(), dog, used_ns=used).sentence.endswith('used for 11 s')


@pytest.mark.parametrize(
    ('since_s', 'longest_s', 'level'),
    [(20, 5.0, Level.WARN), (20, 2.9, Level.ERROR), (59, 5.0, Level.WARN), (60, 5.0, Level.OK)],
)
def test_a_gap_between_imu_samples_is_told_for_a_minute(since_s, longest_s, level):
    dog = Watchdog(Envelope(10.0, 6000.0, max_imu_gap_s=longest_s))
    health = look(memories(), dog, gaps=Gaps(2, 3.0, 10**12 - since_s * 10**9))
    assert health.level is level
    told = f'IMU gap of 3.0 s ended {since_s} s ago and was bridged'
    assert health.sentence.startswith(told) is (level is not Level.OK)


def test_more_than_a_twentieth_of_the_imu_samples_missing_is_told():
    assert not look(memories(), gaps=Gaps(0, 0.0, 0, 0.05)).present
    health = look(memories(), gaps=Gaps(0, 0.0, 0, 0.06))
    assert health.sentence == '6 % of the IMU samples of the last 20 s are missing'


@pytest.mark.parametrize(
    ('number', 'refused', 'mean', 'found'),
    [
        (30.0, 0.95, 3.5, True),
        (9.0, 0.95, 3.5, False),
        (30.0, 0.85, 3.5, False),
        (30.0, 0.95, 2.5, False),
    ],
)
def test_a_navigation_that_its_dvl_contradicts_for_half_a_minute_has_run_away(
    number, refused, mean, found
):
    kept = remembered(DVL, watch.SHORT, number, REFUSED=refused, GRID=-mean)
    dog = Watchdog(Envelope(10.0, 6000.0))
    keys = [
        [p.condition.key for p in look(kept, dog, stamp_ns=10**12 + s * 10**9).present]
        for s in (0, 29, 30)
    ]
    assert [RUNAWAY in k for k in keys] == [False, False, found]


def test_so_has_one_that_is_faster_than_its_vehicle():
    dog = Watchdog(Envelope(10.0, 6000.0))
    for second, found in ((0, False), (31, True)):
        health = look(memories(), dog, stamp_ns=10**12 + second * 10**9, speed=10.1)
        assert (RUNAWAY in [p.condition.key for p in health.present]) is found
    assert not look(memories(), dog, stamp_ns=10**12 + 90 * 10**9, speed=10.0).present


@pytest.mark.parametrize(
    ('used_s', 'level'), [(996, Level.WARN), (995, Level.ERROR), (0, Level.ERROR)]
)
def test_refused_fixes_are_an_error_where_no_dvl_vouches(used_s, level):
    seen = view(memories(), used_ns=np.array([used_s * 10**9, 0, 0]))
    condition = Condition('fixes gated', Level.WARN, Culprit.FIXES, '3 fixes gated')
    found = refused_alone(condition, seen)
    assert found.level is level
    assert found.key == condition.key
    assert ('no DVL vouches' in found.sentence) == (level is Level.ERROR)
    assert is_alone(seen) == (level is Level.ERROR)
