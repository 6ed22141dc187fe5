"""Course through refused fixes: where they say that a vehicle is, how fast, and how sure."""

import numpy as np
import pytest

from polar_nav_core.engine.course import course_of
from polar_nav_core.engine.disagreement import Refused

S = 1_000_000_000
AXES = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Grid axes of ECEF ones: up is x."""


def fixes(places_G, time_s, sigma=1.0):
    return [
        Refused(round(t * S), AXES.T @ np.array([*z, 5.0]), sigma**2 * np.eye(3), np.zeros(3))
        for t, z in zip(time_s, places_G, strict=True)
    ]


def straight(time_s, velocity, sigma, rng):
    return np.outer(time_s, velocity) + sigma * rng.standard_normal((len(time_s), 2))


def test_its_errors_are_those_that_it_states():
    time_s, velocity, rng = 2.0 * np.arange(6), np.array([2.0, -1.0]), np.random.default_rng(1)
    squares = []
    for _ in range(400):
        row = fixes(straight(time_s, velocity, 1.0, rng), time_s)
        course = course_of(row, AXES, 15 * S)
        there = AXES @ course.newest_e
        error = np.array(
            [there[:2] + course.position - 15.0 * velocity, course.velocity - velocity]
        )
        weights = np.linalg.inv(course.covariance)
        squares += [float(e @ weights @ e) for e in error.T]
    # It reckons with a manoeuvre, of which there is none.
    assert 0.3 < np.mean(squares) / 2.0 < 1.0
    fitted = course_of(fixes(straight(time_s, velocity, 0.1, rng), time_s, 0.1), AXES, 10 * S)
    assert fitted.covariance[0, 0] < 0.2**2


def test_only_the_newest_count():
    time_s = 2.0 * np.arange(10)
    places = np.outer(time_s, [1.0, 0.0])
    places[:4] += [500.0, -300.0]
    course = course_of(fixes(places, time_s), AXES, 18 * S)
    np.testing.assert_allclose(course.velocity, [1.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(course.position, [0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ('time_s', 'places'),
    [
        ([0.0, 2.0], [[0.0, 0.0], [2.0, 0.0]]),  # too few
        ([0.0, 0.5, 1.0], [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]),  # at once
        ([0.0, 2.0, 4.0], [[0.0, 0.0], [90.0, 0.0], [0.0, 0.0]]),  # on no course
    ],
)
def test_what_is_no_course_is_none(time_s, places):
    assert course_of(fixes(places, time_s), AXES, 5 * S) is None


def test_an_older_course_is_less_certain():
    time_s = 2.0 * np.arange(4)
    row = fixes(np.outer(time_s, [1.0, 0.0]), time_s)
    now, later = (course_of(row, AXES, stamp) for stamp in (6 * S, 16 * S))
    assert later.position[0] == pytest.approx(10.0)
    # 0.3 m/s^2 for ten seconds, at least
    assert later.covariance[0, 0] > now.covariance[0, 0] + 15.0**2
    assert later.covariance[1, 1] > now.covariance[1, 1] + 3.0**2 - 1e-6
