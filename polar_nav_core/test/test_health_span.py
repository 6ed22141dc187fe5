"""The 95 % circle is exact; the levels of a run summed up decide whether it was well."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from polar_nav_core.engine.health.conditions import Condition, Culprit, Health, Level, Present
from polar_nav_core.engine.health.radius import radius_95
from polar_nav_core.engine.health.span import Look, Span, span_of, words_of_health

OK, WARN = Look(Level.OK, ''), Look(Level.WARN, 'drifts by 3 m')


def error(number):
    return Look(Level.ERROR, f'{number} fixes gated')


@pytest.mark.parametrize('ratio', [1.0, 0.9, 0.3, 0.05, 1e-3])
@pytest.mark.parametrize('turn', [0.0, 0.7])
def test_the_circle_holds_95_percent(ratio, turn):
    """By the same probability over angles instead of over one axis."""
    c, s = math.cos(turn), math.sin(turn)
    T = np.array([[c, -s], [s, c]])
    R = radius_95(T @ np.diag([25.0, 25.0 * ratio**2]) @ T.T) / 5.0

    def outside(angle):
        inverse = math.cos(angle) ** 2 + (math.sin(angle) / ratio) ** 2
        return math.exp(-0.5 * R * R * inverse) / (ratio * inverse)

    places = (0.3 * ratio, ratio, 10.0 * ratio)  # where it is steep for a thin ellipse
    found = quad(outside, 0.0, 0.5 * math.pi, points=places, limit=2000)[0]
    assert 1.0 - found / (0.5 * math.pi) == pytest.approx(0.95, abs=1e-7)


def test_the_circle_of_a_line_a_point_and_of_no_covariance():
    assert radius_95(np.diag([4.0, 0.0])) == pytest.approx(2.0 * 1.959963984540054)
    assert radius_95(np.eye(2)) == pytest.approx(math.sqrt(-2.0 * math.log(0.05)))
    assert radius_95(np.zeros((2, 2))) == 0.0
    for bad in (np.full((2, 2), np.nan), np.diag([1.0, -1.0]), np.array([[1.0, 2.0], [2.0, 1.0]])):
        assert math.isnan(radius_95(bad))


def test_warnings_are_well():
    span = span_of([WARN] * 10)
    assert (span.warnings, span.last, span.complaint) == (10, Level.WARN, '')
    assert span_of([]) == Span()
    assert not span_of([]).complaint
    assert not span_of([]).remark
    assert span.remark == 'WARN at the end: drifts by 3 m'
    assert span_of([*[WARN] * 3, OK]).remark == 'WARN for 75 % of the time: drifts by 3 m'
    assert not span_of([WARN, *[OK] * 9]).remark
    assert not span_of([WARN, error(1)]).remark  # the worse one is said


def test_a_word_on_what_passed_however_short_it_was():
    assert span_of([WARN, *[OK] * 199]).any_word == 'WARN for 0.5 % of the time: drifts by 3 m'
    assert span_of([WARN, error(1), *[OK] * 998]).any_word.startswith('ERROR for 0.1 % of')
    assert span_of([OK, WARN]).any_word == span_of([OK, WARN]).remark
    assert span_of([OK, error(1)]).any_word == span_of([OK, error(1)]).complaint
    assert not span_of([OK] * 3).any_word
    assert not span_of([]).any_word


def test_an_error_at_the_end_is_not_well():
    span = span_of([OK] * 99 + [error(7)])
    assert span.complaint == 'ERROR at the end: 7 fixes gated'


def test_an_error_for_more_than_a_tenth_of_the_time_is_not_well():
    assert not span_of([OK] * 90 + [error(1)] * 10 + [OK]).complaint
    looks = [Look(Level.ERROR, 'other'), *map(error, range(12)), *[OK] * 80]
    assert span_of(looks).complaint == 'ERROR for 14 % of the time: 11 fixes gated'


def test_every_condition_of_a_run_is_said_once_errors_first():
    """Also one that stood only where another one was worse, as of pings that are too sure."""

    def look(*conditions):
        return Health(1, tuple(Present(c, 1, 1) for c in conditions), 1.0, 0)

    sure = Condition('dvl too sure', Level.WARN, Culprit.DVL, 'the DVL states less noise')
    refused = [
        Condition('DVL refused', level, Culprit.DVL, f'{share} % of DVL refused')
        for level, share in ((Level.ERROR, 60), (Level.WARN, 10))
    ]
    health = [look(), look(refused[0], sure), look(refused[1], sure), look(sure)]
    assert words_of_health(health) == [
        'ERROR for 50 % of the time: 60 % of DVL refused',
        'WARN for 75 % of the time: the DVL states less noise',
    ]
    assert words_of_health([]) == []
