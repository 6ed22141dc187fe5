"""Fixes that may have drifted, or a current that changed: said while it makes a difference."""

import numpy as np
import pytest

from polar_nav_core.engine.health.conditions import Culprit, Level
from polar_nav_core.engine.health.drifted import KEPT_NS, Drifted

S = 1_000_000_000
P = 100.0 * np.eye(2)
"""Ten metres each way."""
USUAL = np.array([0.2, -0.1])


def told(drifted, spans, P_horizontal=P, begin_s=0, sigma=0.0):
    """Conditions at each second of (seconds, current, when it began [s] or None) in a row."""
    found, second = [], begin_s
    for seconds, current, began_s in spans:
        for _ in range(seconds):
            second += 1
            began_ns = None if began_s is None else began_s * S
            place = np.array(current), (sigma * np.eye(2)) ** 2, began_ns, P_horizontal
            found.append(drifted.look(second * S, *place))
    return found


def changed(east=0.0, north=0.0):
    return USUAL + np.array([east, north])


def test_a_current_that_changes_is_no_fault_while_nothing_shows_one():
    assert not any(told(Drifted(), [(600, USUAL, None), (600, changed(0.5), None)]))


def test_it_is_said_from_three_sigmas_on_and_after_the_evidence_has_faded():
    spans = [(600, USUAL, None), (60, changed(0.1), None), (60, changed(0.1), 600)]
    found = told(Drifted(), [*spans, (1920, changed(0.1), None)])
    (first,) = (k for k, one in enumerate(found) if one and not found[k - 1])
    assert first == pytest.approx(900, abs=5)  # 0.1 m/s since 600 s: 30 m
    assert all(found[first:])
    (condition,) = found[-1]
    assert (condition.level, condition.culprit) == (Level.WARN, Culprit.FIXES | Culprit.MODEL)
    assert 'since 34 min ago (0.10 m/s now)' in condition.sentence
    assert 'led the position 202 m, 20.2 sigmas' in condition.sentence


def test_a_current_that_was_not_known_may_have_been_another():
    """As at the start of a run, where the estimate has yet to find it."""
    spans = [(600, USUAL, None), (1000, changed(0.1), 600)]
    assert told(Drifted(), spans, sigma=0.03)[-1]  # 100 m, with 10 and 30 m
    assert not told(Drifted(), spans, sigma=0.032)[-1]
    unlike = np.diag([1.0, 0.1])  # the worst axis counts for both
    assert told(Drifted(), spans, sigma=0.03 * unlike)[-1]
    assert not told(Drifted(), spans, sigma=0.032 * unlike)[-1]


def test_it_ends_where_the_way_has_come_back():
    spans = [(600, USUAL, None), (500, changed(0.1), 600), (500, changed(-0.1), None)]
    found = told(Drifted(), spans)
    assert found[1100]
    (end,) = (k for k, one in enumerate(found) if not one and found[k - 1])
    assert end == pytest.approx(1345, abs=10)  # 50 m less 25


def test_what_began_later_counts_no_more_than_the_first():
    spans = [(600, USUAL, None), (300, changed(0.1), 600), (300, changed(0.2), 900)]
    (condition,) = told(Drifted(), spans)[-1]
    assert 'led the position 89 m' in condition.sentence


def test_what_began_with_the_run_is_counted_from_the_first_current_that_is_known():
    found = told(Drifted(), [(20, USUAL, None), (600, changed(0.1), 0)])
    (condition,) = found[-1]
    assert 'led the position 60 m' in condition.sentence
    assert not any(told(Drifted(), [(600, changed(0.1), 0)]))


@pytest.mark.parametrize('began_s', [700, 9999])
def test_what_begins_now_counts_from_now(began_s):
    found = told(Drifted(), [(699, USUAL, None), (321, changed(0.1), began_s)])
    (condition,) = found[-1]
    assert 'since 5 min ago' in condition.sentence
    assert 'led the position 32 m' in condition.sentence


def test_the_current_before_is_the_mean_of_two_minutes():
    """Not of what was before them, and up to the moment from which the change counts."""
    spans = [(481, changed(5.0), None), (120, USUAL, None), (400, changed(0.1), 601)]
    (condition,) = told(Drifted(), spans)[-1]
    assert 'led the position 40 m' in condition.sentence
    spans = [(541, changed(0.1), None), (60, USUAL, None), (400, changed(0.15), 601)]
    (condition,) = told(Drifted(), spans)[-1]
    assert 'led the position 40 m' in condition.sentence


def test_what_is_older_than_all_that_is_known_is_counted_from_there():
    long_s = KEPT_NS // S + 2000
    drifted = Drifted()
    assert not any(told(drifted, [(long_s, USUAL, None)]))
    assert len(drifted._past) < (KEPT_NS + 130 * S) // (10 * S)
    (condition,) = told(drifted, [(200, changed(0.2), 0)], begin_s=long_s)[-1]
    assert 'led the position 40 m' in condition.sentence
