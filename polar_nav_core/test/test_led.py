"""Fixes that have led the position away: said for as long as nothing has led it back."""

import numpy as np
import pytest

from polar_nav_core.engine.health.conditions import Culprit, Level
from polar_nav_core.engine.health.led import Led
from polar_nav_core.engine.health.slow import Evidence, Way, led_by_fixes
from polar_nav_core.kernels.sins import hypotheses as hy

S = 1_000_000_000
P = 0.25 * np.eye(2)
"""Half a metre each way."""


def told(led, ways, P_horizontal=P, *, certain=True):
    """Conditions at each second: of (seconds, way or None) after one another."""
    found, second = [], 0
    for seconds, way in ways:
        for _ in range(seconds):
            second += 1
            shown = None if way is None else Way(np.array(way), certain)
            found.append(led.look(second * S, shown, P_horizontal))
    return found


def test_what_fixes_have_done_is_said_once_their_evidence_has_faded():
    found = told(Led(), [(10, None), (30, (0.0, 2.0)), (500, None)])
    assert not any(found[:40])
    assert all(found[40:])
    (condition,) = found[-1]
    assert condition.culprit == Culprit.FIXES
    assert 'led the position 2.0 m to grid 000 deg, 4.0 of its stated sigmas' in condition.sentence


def test_a_sigma_that_swings_between_fixes_is_one_report():
    led = Led()
    assert told(led, [(30, (0.0, 1.6)), (1, None)])[-1]  # 3.2 sigma
    swings = [told(led, [(1, None)], P * (1.6 / n) ** 2 * 4.0) for n in (2.9, 3.2, 2.6, 3.1, 2.6)]
    assert all(found == [found[0]] and found[0] for found in swings)
    assert not told(led, [(1, None)], P * (1.6 / 2.4) ** 2 * 4.0)[0]
    assert not told(led, [(1, None)], P * (1.6 / 2.9) ** 2 * 4.0)[0]
    assert told(led, [(1, None)], P * (1.6 / 3.1) ** 2 * 4.0)[0]


@pytest.mark.parametrize(('certain', 'level'), [(True, Level.ERROR), (False, Level.WARN)])
def test_what_was_an_error_by_its_evidence_stays_one(certain, level):
    found = told(Led(), [(30, (0.0, 2.0)), (500, None)], certain=certain)
    assert {condition.level for (condition,) in found[30:]} == {level}


def test_an_error_that_is_certain_no_more_is_said_beside_the_warning_of_now():
    """The condition of the drift itself says it alone as long as that is as bad."""
    led = Led()
    assert not any(told(led, [(10, (0.0, 2.0))], certain=False))
    assert not any(told(led, [(1, (0.0, 1.9))], certain=True))
    for (condition,) in told(led, [(5, (0.0, 2.1)), (5, None)], certain=False):
        assert condition.level == Level.ERROR
        assert 'led the position 2.1 m' in condition.sentence


def test_an_error_that_ended_leaves_nothing_to_a_later_warning():
    led = Led()
    assert not any(told(led, [(30, (2.0, 0.0)), (30, (-1.9, 0.0))]))
    (condition,) = told(led, [(30, (0.1, 2.0)), (1, None)], certain=False)[-1]
    assert condition.level == Level.WARN


def test_a_way_within_three_sigmas_is_covered():
    assert not any(told(Led(), [(30, (1.4, 0.0)), (100, None)]))
    assert any(told(Led(), [(30, (1.6, 0.0)), (100, None)]))


@pytest.mark.parametrize(('way', 'heading'), [((-2.0, 0.0), 270), ((2.0, -2.0), 135)])
def test_the_direction_is_a_heading_in_the_grid(way, heading):
    (condition,) = told(Led(), [(30, way), (1, None)])[-1]
    assert f'to grid {heading:03d} deg' in condition.sentence


@pytest.mark.parametrize(('pause_s', 'sum_m'), [(59, 2.0), (60, 3.8)])
def test_evidence_that_pauses_for_a_minute_is_of_the_same_way(pause_s, sum_m):
    """Sixty seconds between two looks are still the same; the larger of both counts then."""
    found = told(Led(), [(30, (2.0, 0.0)), (pause_s, None), (30, (1.8, 0.0)), (1, None)])
    assert f'led the position {sum_m:.1f} m' in found[-1][0].sentence


def test_a_short_way_back_is_another_way():
    """Half a metre back of a metre and a half: none is left that is not covered."""
    assert not any(told(Led(), [(30, (1.8, 0.0)), (30, (-0.5, 0.0)), (100, None)])[30:])


def test_a_covariance_that_has_grown_covers_it():
    led = Led()
    assert told(led, [(30, (2.0, 0.0)), (10, None)])[-1]
    assert led.look(60 * S, None, 4.0 * P) == []


@pytest.mark.parametrize('pause_s', [0, 20, 300])
def test_fixes_that_lead_back_end_it(pause_s):
    found = told(Led(), [(30, (2.0, 1.0)), (pause_s, None), (30, (-1.8, -1.1)), (100, None)])
    assert not any(found[-100:])


def test_a_way_back_that_is_not_certain_takes_nothing_from_it():
    """What has been followed for good swings, and for a while looks as if fixes led back."""
    led = Led()
    assert told(led, [(30, (2.0, 1.0)), (1, None)], certain=False)[-1]
    found = told(led, [(30, (-1.8, -1.1)), (100, None)], certain=False)
    assert all(found)
    assert 'led the position 2.2 m' in found[-1][0].sentence
    assert not any(told(led, [(30, (-1.8, -1.1)), (100, None)]))


def test_two_ways_long_apart_add_up():
    found = told(Led(), [(30, (1.0, 0.0)), (300, None), (30, (1.0, 0.1)), (10, None)])
    assert not any(found[:330])
    assert 'led the position 2.0 m' in found[-1][0].sentence


def test_a_younger_hypothesis_about_the_same_way_takes_nothing_from_it():
    found = told(Led(), [(30, (3.0, 0.0)), (30, (0.5, 0.0)), (10, None)])
    assert 'led the position 3.0 m' in found[-1][0].sentence


@pytest.mark.parametrize(
    ('drift', 'scale', 'moved_m', 'is_led'),
    [
        (36.0, 0.0, 10.0, True),
        (27.0, 0.0, 10.0, False),
        (36.0, 45.0, 10.0, True),
        (36.0, 55.0, 10.0, False),
        (36.0, 0.0, 2.0, False),
    ],
)
def test_fixes_led_it_where_a_drift_explains_the_evidence_and_has_moved_it(
    drift, scale, moved_m, is_led
):
    """T of a drift and of another kind; how far a drift of 1 m/s has moved the position."""
    bank, slot = np.zeros((hy.ROWS, hy.SLOTS * hy.KINDS)), 2
    first = slot * hy.KINDS
    bank[hy.LAMBDA, first : first + hy.KINDS] = 100.0
    bank[hy.ZETA, first + hy.FIX_EAST] = 20.0  # 0.2 m/s
    bank[hy.STATISTIC, first + hy.FIX_EAST] = drift
    bank[hy.STATISTIC, first + hy.SCALE_STEP] = scale
    per_unit_G = np.zeros((2, hy.SLOTS * hy.KINDS))
    per_unit_G[0, first + hy.FIX_EAST] = moved_m
    evidence = Evidence(bank, np.zeros(hy.SLOTS, dtype=np.int64), per_unit_G)
    found = led_by_fixes(evidence, P)
    assert (found is not None) == is_led
    if is_led:
        np.testing.assert_allclose(found.shift_G, [0.2 * moved_m, 0.0])
        assert not found.certain


@pytest.mark.parametrize(
    ('drift', 'step', 'by_drift', 'by_step', 'led'),
    [
        (0.0, 32.9, 0.0, 10.0, 10.0),
        (0.0, 33.1, 0.0, 10.0, 10.0),
        (0.0, 39.9, 0.0, 5.0, 5.0),
        (0.0, 36.0, 0.0, 2.0, None),
        (45.0, 44.9, 4.0, 12.0, 12.0),
        (44.9, 45.0, 12.0, 4.0, 12.0),
        (60.0, 44.0, 4.0, 12.0, 4.0),
    ],
)
def test_of_a_drift_and_a_step_the_one_that_took_it_further_has_led_it(
    drift, step, by_drift, by_step, led
):
    """Of those that are about as likely."""
    bank = np.zeros((hy.ROWS, hy.SLOTS * hy.KINDS))
    bank[hy.LAMBDA, : hy.KINDS] = 100.0
    bank[hy.ZETA, [hy.FIX_EAST, hy.STEP_EAST]] = 100.0
    bank[hy.STATISTIC, hy.FIX_EAST], bank[hy.STATISTIC, hy.STEP_EAST] = drift, step
    per_unit_G = np.zeros((2, hy.SLOTS * hy.KINDS))
    per_unit_G[0, hy.FIX_EAST], per_unit_G[0, hy.STEP_EAST] = by_drift, by_step
    found = led_by_fixes(Evidence(bank, np.zeros(hy.SLOTS, dtype=np.int64), per_unit_G), np.eye(2))
    assert (None if found is None else float(found.shift_G[0])) == led
    if found is not None:
        statistic = step if led == by_step else drift
        assert found.certain == (statistic > (33.0 if led > 6.0 else 40.0))


def test_without_evidence_there_is_none():
    assert led_by_fixes(None, P) is None
