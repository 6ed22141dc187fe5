"""Refused fixes by themselves: for how long, where they lie, when they are to be believed."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from fix_samples import S, fix

from polar_nav_core.engine.fix_rules import held, out_of_reach
from polar_nav_core.engine.health.conditions import Culprit, Level
from polar_nav_core.engine.integrity import IntegrityMonitor
from polar_nav_core.engine.params import EngineParams

AWAY = np.array([300.0, 400.0, 0.0])


def refused(count, offset=lambda _: AWAY, *, period_s=10.0, first_s=10.0, max_gated_s=300.0):
    """Monitor after refused fixes, each received 1 s after it was valid."""
    monitor = IntegrityMonitor(max_gated_s)
    for k in range(count):
        t = first_s + k * period_s
        monitor.gated(round(t * S), round((t + 1.0) * S), np.asarray(offset(t), dtype=float))
    return monitor


def scattered(scatter):
    """Offsets on both sides of the common one, by so much."""
    sign = [1.0]

    def offset(_):
        sign[0] = -sign[0]
        return AWAY + sign[0] * np.array([0.0, 0.0, scatter])

    return offset


# -- numbers and sentences ------------------------------------------------------------------------


def test_a_new_monitor_has_nothing_to_report():
    monitor = IntegrityMonitor(300.0)
    state = monitor.state(50 * S)
    assert (state.level, state.gated_run, state.gated_s) == (Level.OK, 0, 0.0)
    assert math.isnan(state.since_fused_s)
    assert math.isnan(state.scatter)
    assert np.isnan(state.offset_G).tolist() == [True, True, True]
    assert monitor.quiet
    assert monitor.longest_gated_s == 0.0
    assert not monitor.lasting(50 * S)


def test_the_condition_of_the_watchdog_has_the_same_sentence():
    fused = refused(0)
    fused.fused(10 * S, 11 * S)
    for monitor, stamp_s, key in ((refused(4), 42, 'fixes gated'), (fused, 1000, 'no fixes')):
        state = monitor.state(stamp_s * S)
        (condition,) = state.conditions
        assert (condition.key, condition.level, condition.culprit, condition.sentence) == (
            key, state.level, Culprit.FIXES, state.sentence,
        )  # fmt: skip
    assert refused(0).state(42 * S).conditions == []


@pytest.mark.parametrize(('count', 'gated_s'), [(0, 0.0), (1, 0.0), (2, 10.0), (3, 20.0)])
def test_refusals_last_from_the_first_one_received(count, gated_s):
    state = refused(count).state((1 + 10 * max(count, 1)) * S)
    assert state.gated_run == count
    assert state.gated_s == pytest.approx(gated_s)


def test_refusals_that_stop_count_for_three_intervals_more():
    monitor = refused(5, period_s=8.0)
    assert monitor.state(1000 * S).gated_s == pytest.approx(32.0 + 24.0)
    assert monitor.state(50 * S).gated_s == pytest.approx(39.0)
    assert monitor.state(5 * S).gated_s == 0.0  # a stamp from before them


def test_the_scatter_is_the_root_mean_square_distance_from_the_mean():
    rng = np.random.default_rng(3)
    offsets = AWAY + 20.0 * rng.standard_normal((12, 3))
    rows = iter(offsets)
    state = refused(12, lambda _: next(rows)).state(130 * S)
    np.testing.assert_allclose(state.offset_G, offsets.mean(axis=0))
    assert state.scatter == pytest.approx(math.sqrt(3.0) * offsets.std(axis=0).mean(), rel=0.1)
    spread = np.linalg.norm(offsets - offsets.mean(axis=0), axis=1)
    assert state.scatter == pytest.approx(math.sqrt(np.mean(spread**2)))


@pytest.mark.parametrize(('scatter', 'common'), [(0.0, True), (249.0, True), (251.0, False)])
def test_an_offset_is_common_while_the_scatter_is_below_half_of_it(scatter, common):
    monitor = refused(20, scattered(scatter))
    assert ('displaced by about 500 m' in monitor.state(201 * S).sentence) == common
    assert ('no offset in common' in monitor.state(201 * S).sentence) == (not common)
    assert monitor.agrees_with_refused(AWAY) == common


def test_a_fix_lies_with_the_refused_ones_within_half_their_offset():
    monitor = refused(3)
    up = np.array([0.0, 0.0, 1.0])
    assert monitor.agrees_with_refused(AWAY + 249.0 * up)
    assert not monitor.agrees_with_refused(AWAY + 251.0 * up)
    assert not refused(2).agrees_with_refused(AWAY)


def test_an_error_names_the_limit_and_what_the_crew_can_do():
    monitor = refused(8, max_gated_s=60.0)
    assert monitor.state(70 * S).level is Level.WARN
    assert not monitor.lasting(70 * S)
    state = monitor.state(72 * S)
    assert state.level is Level.ERROR
    assert 'max_gated_s 60 s' in state.sentence
    assert '8 fixes gated in a row over 61 s' in state.sentence
    assert monitor.lasting(72 * S)


@pytest.mark.parametrize(('since_s', 'level'), [(300.0, Level.OK), (300.5, Level.WARN)])
def test_dead_reckoning_is_a_warning_after_the_same_limit(since_s, level):
    monitor = IntegrityMonitor(300.0)
    monitor.fused(5 * S, 6 * S)
    state = monitor.state(round((6.0 + since_s) * S))
    assert (state.level, state.since_fused_s) == (level, pytest.approx(since_s))
    assert f'{since_s:.0f} s' in state.sentence


@pytest.mark.parametrize(('since_s', 'level'), [(300.0, Level.OK), (301.0, Level.WARN)])
def test_a_start_that_no_fix_confirms_is_a_warning_after_the_same_limit(since_s, level):
    monitor = IntegrityMonitor(300.0, 60.0)
    monitor.unused.began(7 * S)
    state = monitor.state(round((7.0 + since_s) * S))
    assert state.level is level
    assert ('301 s since the start: dead reckoning' in state.sentence) == (level is Level.WARN)
    monitor.fused(300 * S, 301 * S)
    assert monitor.state(400 * S).level is Level.OK


@pytest.mark.parametrize(
    ('now_s', 'level'), [(69.0, Level.OK), (75.0, Level.WARN), (309.0, Level.WARN), (315.0, 2)]
)
def test_fixes_that_come_and_are_not_used_are_an_error_after_it(now_s, level):
    monitor = IntegrityMonitor(300.0, 60.0)
    monitor.unused.came(1 * S)  # before the start
    monitor.unused.began(5 * S)
    for t in range(10, round(now_s) + 1, 8):
        monitor.unused.came(t * S)
    state = monitor.state(round(now_s * S))
    assert state.level == level
    number = len(range(10, round(now_s) + 1, 8))
    if level != Level.OK:
        said = f'{number} fixes came over {now_s - 10.0:.0f} s and none was ever fused'
        assert state.sentence.startswith(said)


def test_unused_fixes_that_stop_coming_are_no_error_and_believed_ones_begin_anew():
    monitor = IntegrityMonitor(300.0, 60.0)
    monitor.unused.began(5 * S)
    for t in range(10, 90, 8):
        monitor.unused.came(t * S)
    assert monitor.state(3600 * S).level is Level.WARN
    monitor.believed(3600 * S, 0.0)
    assert monitor.state(3700 * S).level is Level.OK


# -- refused fixes that pass the gate later -------------------------------------------------------


def follow(monitor, offset_G, at_s):
    monitor.fused(round(at_s * S), round((at_s + 1.0) * S), np.asarray(offset_G))


def test_an_estimate_that_followed_refused_fixes_is_doubted_until_they_lead_it_back():
    monitor = refused(6)
    assert monitor.moved == []
    follow(monitor, AWAY, 70.0)
    (condition,) = monitor.moved
    assert (condition.key, condition.level) == ('fixes followed', Level.WARN)
    assert '500 m off' in condition.sentence
    follow(monitor, np.array([2.0, 1.0, 0.0]), 600.0)
    assert monitor.moved == [condition]
    for k in range(6):
        monitor.gated((700 + k) * S, (701 + k) * S, -0.9 * AWAY)
    assert monitor.moved == [condition]
    follow(monitor, -0.9 * AWAY, 710.0)
    assert monitor.moved == []


@pytest.mark.parametrize('way', ['believed', 'passed'])
def test_fixes_that_jumped_and_are_followed_are_an_error_until_they_jump_back(way):
    """Which of the two places is right, nothing shows that comes later."""

    def followed(offset_G, at_s, first):
        for k in range(6):
            leaps = k == 0 and first
            monitor.gated((at_s + k) * S, (at_s + 1 + k) * S, offset_G, leaps=leaps)
        if way == 'believed':
            before = monitor.moved
            monitor.believed((at_s + 10) * S, 0.0)
            assert monitor.moved == before  # the filter may refuse them still
            monitor.fused((at_s + 11) * S, (at_s + 12) * S, np.zeros(3))
        else:
            follow(monitor, offset_G, at_s + 10.0)

    monitor = IntegrityMonitor(60.0)
    followed(AWAY, 10, first=True)
    (condition,) = monitor.moved
    assert (condition.key, condition.level) == ('fixes followed', Level.ERROR)
    assert condition.sentence.startswith('fixes jumped 500 m, farther than the vehicle can')
    again = IntegrityMonitor(60.0)
    again.followed.restore(monitor.followed.to_save())
    assert again.moved == [condition]
    followed(-AWAY, 1000, first=True)
    assert monitor.moved == []
    assert monitor.followed.to_save() is None


def test_fixes_that_are_believed_without_a_jump_are_none():
    monitor = refused(6)
    monitor.believed(100 * S, 0.0)
    follow(monitor, np.zeros(3), 101.0)
    assert monitor.moved == []
    gone = IntegrityMonitor(60.0)  # only the first one was far off: an outlier
    for k in range(6):
        gone.gated((10 + k) * S, (11 + k) * S, AWAY * (1.0 if k == 0 else 0.4), leaps=k == 0)
    gone.believed(100 * S, 0.0)
    follow(gone, np.zeros(3), 101.0)
    assert all(c.level is Level.WARN for c in gone.moved)


def test_a_fix_that_lies_with_the_estimate_or_ends_no_run_follows_none():
    back = refused(6)
    follow(back, np.array([10.0, 0.0, 0.0]), 70.0)
    assert back.moved == []
    late = refused(6)  # valid at 10, 20, ... 60 s
    follow(late, AWAY, 30.0)
    assert late.moved == []
    follow(late, AWAY, 70.0)
    assert len(late.moved) == 1
    unasked = refused(6)
    unasked.fused(70 * S, 71 * S)
    assert unasked.moved == []


# -- runs that end --------------------------------------------------------------------------------


def test_a_fused_fix_ends_only_what_was_valid_before_it():
    monitor = refused(6)  # valid at 10, 20, ... 60 s
    monitor.fused(30 * S, 65 * S)
    state = monitor.state(66 * S)
    assert state.gated_run == 3
    assert state.gated_s == pytest.approx(66.0 - 41.0)
    assert monitor.longest_gated_s == pytest.approx(65.0 - 11.0)
    assert not monitor.quiet
    monitor.fused(60 * S, 70 * S)
    assert monitor.state(71 * S).gated_s == 0.0
    assert monitor.longest_gated_s == pytest.approx(54.0)  # the longer of the two


def test_one_fix_that_passes_by_chance_ends_no_conflict():
    """Three in a row do."""
    monitor = refused(6)
    for k in (7, 8):
        monitor.fused(10 * k * S, (10 * k + 1) * S)
        assert monitor.conflict()[0] == pytest.approx(AWAY)
        assert not monitor.quiet
    assert monitor.gated(90 * S, 91 * S, 1.2 * AWAY)
    for k in (10, 11):
        monitor.fused(10 * k * S, (10 * k + 1) * S)
        assert monitor.conflict()[0] == pytest.approx(AWAY)
    monitor.fused(120 * S, 121 * S)
    assert not monitor.conflict()[0].any()
    assert monitor.quiet


def test_few_that_were_refused_leave_no_conflict():
    monitor = refused(2)
    monitor.fused(30 * S, 31 * S)
    assert not monitor.conflict()[0].any()
    assert monitor.quiet


def test_the_newest_reception_counts_whatever_comes_late():
    monitor = IntegrityMonitor(300.0)
    monitor.fused(50 * S, 52 * S)
    monitor.fused(10 * S, 51 * S)
    assert monitor.state(60 * S).since_fused_s == pytest.approx(8.0)
    assert not monitor.gated(50 * S, 61 * S, AWAY)
    assert monitor.quiet
    assert monitor.gated(50 * S + 1, 61 * S, AWAY)
    assert not monitor.quiet


def test_believed_fixes_begin_anew():
    monitor = refused(12)
    monitor.contradiction(0, doubted=True, least_s=0.0)
    monitor.believed(140 * S, 0.0)
    assert monitor.quiet
    assert monitor.longest_gated_s == pytest.approx(129.0)
    assert not monitor.gated(140 * S, 145 * S, AWAY)
    assert monitor.moved == []
    # The doubt of before is over, too.
    for k in range(12):
        monitor.gated((150 + k) * S, (151 + k) * S, AWAY)
    assert monitor.contradiction(20, doubted=False, least_s=0.0) is None


def test_a_start_that_was_off_is_a_warning_for_the_rest_of_the_run():
    monitor = refused(12)
    monitor.believed(140 * S, 500.0)
    monitor.believed(150 * S, 30.0)
    (condition,) = monitor.moved
    assert (condition.key, condition.level, condition.culprit) == (
        'start', Level.WARN, Culprit.FIXES,
    )  # fmt: skip
    assert 'lay 500 m from the stated start' in condition.sentence


# -- what they contradict -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ('fused', 'count', 'believed'),
    [
        (0, 9, False),
        (0, 10, True),
        (5, 10, True),
        (6, 11, False),
        (6, 12, True),
        (9, 17, False),
        (9, 18, True),
    ],
)
def test_a_filter_with_few_fixes_believes_twice_as_many(fused, count, believed):
    found = refused(count).contradiction(fused, doubted=False, least_s=0.0)
    assert (found is not None) == believed
    if found is not None:
        assert found.distance == pytest.approx(500.0)
        assert found.constant


@pytest.mark.parametrize(('count', 'doubted', 'believed'), [(9, 1, 0), (10, 1, 1), (40, 0, 0)])
def test_a_settled_filter_believes_them_only_where_another_sensor_is_doubted(
    count, doubted, believed
):
    found = refused(count).contradiction(10, doubted=bool(doubted), least_s=0.0)
    assert (found is not None) == bool(believed)
    assert found is None or not found.constant  # what is wrong is not the start


@pytest.mark.parametrize(('speed', 'count', 'believed'), [(0.0, 40, 0), (1.0, 10, 1), (1.0, 9, 0)])
def test_without_a_dvl_it_believes_them_where_their_offset_changes(speed, count, believed):
    """An IMU makes that of a tilt that is wrong; a leader that is displaced stays where it is."""
    monitor = refused(count, lambda t: AWAY + speed * (t - 10.0) * np.array([0.6, 0.8, 0.0]))
    assert monitor.contradiction(10, doubted=False, least_s=0.0) is None
    found = monitor.contradiction(10, doubted=False, alone=True, least_s=0.0)
    assert (found is not None) == bool(believed)
    assert found is None or not found.constant


def test_a_doubt_lasts_while_they_are_refused():
    monitor = refused(9)
    assert monitor.contradiction(10, doubted=True, least_s=0.0) is None
    monitor.gated(100 * S, 101 * S, AWAY)
    assert monitor.contradiction(10, doubted=False, least_s=0.0) is not None


@pytest.mark.parametrize(('least_s', 'believed'), [(90.0, True), (90.1, False)])
def test_they_have_to_last(least_s, believed):
    found = refused(10).contradiction(0, doubted=False, least_s=least_s)
    assert (found is not None) == believed


def test_only_the_newest_twenty_count():
    """Those before may lie elsewhere; the newest show what is so now."""
    monitor = refused(60, lambda t: AWAY if t >= 410.0 else -AWAY)
    found = monitor.contradiction(0, doubted=False, least_s=0.0)
    assert found is not None
    assert found.distance == pytest.approx(500.0)
    assert found.constant
    assert monitor.contradiction(0, doubted=False, least_s=190.0) is not None
    assert monitor.contradiction(0, doubted=False, least_s=190.1) is None


def test_what_scatters_is_not_believed():
    assert refused(20, scattered(240.0)).contradiction(0, doubted=True, least_s=0.0) is not None
    assert refused(20, scattered(260.0)).contradiction(0, doubted=True, least_s=0.0) is None


@pytest.mark.parametrize(
    ('speed', 'constant'), [(0.0, True), (0.1, True), (0.137, True), (0.14, False), (0.2, False)]
)
def test_an_offset_that_grows_by_five_per_cent_is_not_constant(speed, constant):
    """Over 190 s: 0.137 m/s is 26.03 m of 526.03 m, 0.14 m/s is 26.6 m of 526.6 m."""
    monitor = refused(20, lambda t: AWAY + speed * (t - 10.0) * np.array([0.6, 0.8, 0.0]))
    found = monitor.contradiction(0, doubted=False, least_s=0.0)
    assert found.distance == pytest.approx(500.0 + speed * 190.0)
    assert found.constant == constant


@pytest.mark.parametrize(
    ('sigmas', 'constant'), [(3.5, True), (3.95, True), (4.05, False), (4.5, False)]
)
def test_a_trend_within_four_sigmas_of_the_scatter_is_none(sigmas, constant):
    """The sigma of a change over n evenly spaced values is sqrt(12 / n) of their scatter."""
    rng = np.random.default_rng(5)
    t = 10.0 + 10.0 * np.arange(20)
    noise = 60.0 * rng.standard_normal((20, 3))
    rows = np.column_stack([np.ones(20), t - t.mean()])
    noise -= rows @ np.linalg.lstsq(rows, noise, rcond=None)[0]
    scatter = math.sqrt(np.mean(np.sum(noise**2, axis=1)))
    change = sigmas * scatter * math.sqrt(12.0 / 20.0)
    assert change > 0.06 * 900.0  # it is the scatter that decides
    offsets = dict(zip(t, noise + AWAY + np.outer(t / 190.0, [change, 0.0, 0.0]), strict=True))
    found = refused(20, offsets.get).contradiction(0, doubted=False, least_s=0.0)
    assert found.constant == constant


def test_a_conflict_is_where_they_lie_and_how_it_moves():
    velocity = np.array([0.5, -0.3, 0.1])
    monitor = refused(20, lambda t: AWAY + velocity * t)
    offset_G, speed_G = monitor.conflict()
    np.testing.assert_allclose(offset_G, AWAY + velocity * 200.0, rtol=1e-9)
    np.testing.assert_allclose(speed_G, velocity, rtol=1e-9)


def test_few_refused_fixes_have_a_mean_and_no_trend():
    for count, found in ((2, np.zeros(3)), (3, AWAY), (9, AWAY)):
        offset_G, speed_G = refused(count).conflict()
        np.testing.assert_allclose(offset_G, found)
        assert speed_G.tolist() == [0.0, 0.0, 0.0]
    for count in (3, 4, 9):
        moving = refused(count, lambda t: AWAY + np.array([t, 0.0, 0.0]))
        offset_G, speed_G = moving.conflict()
        lined = count > 3
        at_s = 10.0 * count if lined else 20.0
        np.testing.assert_allclose(offset_G, AWAY + np.array([at_s, 0.0, 0.0]))
        np.testing.assert_allclose(speed_G, [float(lined), 0.0, 0.0], atol=1e-12)
    # Ten of one moment have none either.
    offset_G, speed_G = refused(10, period_s=0.0).conflict()
    np.testing.assert_allclose(offset_G, AWAY)
    assert not speed_G.any()


def test_an_estimate_that_runs_away_faster_and_faster_is_one_conflict():
    """Of nine fixes beside which it accelerates the mean lies far from most."""

    def offset(t):
        return np.array([0.3 * (t / 10.0) ** 2, 0.0, 0.0])

    for count in range(4, 12):
        offset_G, speed_G = refused(count, offset).conflict()
        newest = offset(10.0 * count)[0]
        assert 0.7 * newest < offset_G[0] < 1.1 * newest
        assert speed_G[0] > 0.0


@pytest.mark.parametrize(
    ('count', 'grows_mps', 'least_s', 'found'),
    [
        (6, 30.0, 50.0, True),
        (5, 30.0, 0.0, False),
        (6, 30.0, 50.1, False),
        (6, 0.0, 0.0, False),
        (6, -30.0, 0.0, True),
    ],
)
def test_an_estimate_runs_away_from_six_that_leave_it_steadily(count, grows_mps, least_s, found):
    monitor = refused(count, lambda t: AWAY + np.array([grows_mps * t, 0.0, 0.0]))
    assert monitor.runs_away(least_s) == found


def test_it_runs_away_from_none_that_scatter():
    assert not refused(20, scattered(400.0)).runs_away(0.0)


def test_scattered_fixes_are_no_conflict():
    offset_G, speed_G = refused(20, scattered(400.0)).conflict()
    assert (offset_G.tolist(), speed_G.tolist()) == ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])


def test_fixes_count_in_the_order_of_their_validity():
    monitor = IntegrityMonitor(300.0)
    for t in (40.0, 10.0, 30.0, 20.0, 60.0, 50.0, 100.0, 70.0, 90.0, 80.0):
        monitor.gated(round(t * S), 101 * S, AWAY + np.array([t, 0.0, 0.0]))
    offset_G, speed_G = monitor.conflict()
    np.testing.assert_allclose(offset_G, AWAY + np.array([100.0, 0.0, 0.0]))
    np.testing.assert_allclose(speed_G, [1.0, 0.0, 0.0], atol=1e-12)


# -- reasons to refuse a fix before the gate ------------------------------------------------------


def driver(offset_G, nis):
    return SimpleNamespace(offset=lambda _: None if offset_G is None else (offset_G, nis))


STATION = EngineParams(mode='station', max_fix_sigma=10.0, max_speed=2.0)


@pytest.mark.parametrize(
    ('offset', 'nis', 'refused_s'),
    [
        ((201.0, 0.0, 0.0), 101.0, True),
        ((199.0, 0.0, 0.0), 101.0, False),  # it may have gone there in 100 s at 2 m/s
        ((201.0, 0.0, 0.0), 100.0, False),  # within ten sigmas
        (None, 0.0, False),
    ],
)
def test_a_fix_of_a_station_is_out_of_reach_by_sigma_and_by_speed(offset, nis, refused_s):
    offset_G = None if offset is None else np.array(offset)
    reason = out_of_reach(STATION, fix(1, 199.0, 200.0), driver(offset_G, nis), math.inf, 100 * S)
    assert bool(reason) == refused_s
    assert not reason or reason.startswith('201 m from the estimate, NIS 101.0')


@pytest.mark.parametrize(
    ('params', 'gate'),
    [
        (STATION, 20.0),  # the gate decides
        (EngineParams(mode='station', max_fix_sigma=0.0), math.inf),
        (EngineParams(max_fix_sigma=10.0), math.inf),  # kernels decide
    ],
)
def test_no_fix_is_out_of_reach_where_something_else_decides(params, gate):
    far = driver(np.array([1e6, 0.0, 0.0]), 1e9)
    assert out_of_reach(params, fix(1, 199.0, 200.0), far, gate, 100 * S) == ''


@pytest.mark.parametrize(
    ('received_s', 'offset', 'nis', 'refused_here'),
    [
        (100.0, AWAY, 70.0, True),
        (70.0, AWAY, 70.0, False),  # not for longer than max_gated_s yet
        (100.0, -AWAY, 70.0, False),  # elsewhere
        (100.0, AWAY, 81.0, False),  # the gate refuses it surely, and has the numbers
        (100.0, None, 70.0, False),
    ],
)
def test_fixes_that_lie_with_the_refused_ones_are_held_back(received_s, offset, nis, refused_here):
    monitor = refused(9, max_gated_s=60.0)
    one = fix(1, received_s - 1.0, received_s)
    reason = held(monitor, one, driver(offset, nis), 20.0)
    assert bool(reason) == refused_here
    if reason:
        assert reason.startswith(
            '500.0 m off, like the 9 fixes before it that were gated over 89 s'
        )
        assert '(NIS about 70.0)' in reason
