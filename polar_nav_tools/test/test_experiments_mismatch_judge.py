"""Wrong, covered, reported, verdict: the judge of the mismatch table on courses made by hand."""

import numpy as np
import pytest

from polar_nav_tools.experiments.mismatch import judge
from polar_nav_tools.experiments.mismatch.culprits import UNEXPLAINED
from polar_nav_tools.experiments.mismatch.judge import (
    ERROR,
    OK,
    WARN,
    Course,
    Deviation,
    HealthReport,
)

S = 1_000_000_000


def deviation(ratio):
    """Errors on the second of three axes, so many sigmas of 0.5."""
    error = np.zeros((len(ratio), 3))
    error[:, 1] = 0.5 * np.asarray(ratio)
    return Deviation(error, np.full_like(error, 0.5), np.asarray(ratio) ** 2 / 3.0)


def course(position=None, heading=None, velocity=None, seconds=200):
    """Estimates every second of a run of 200 s; kinds not given have no error."""
    n = seconds
    still = np.zeros(n)
    kinds = [still if x is None else x for x in (position, heading, velocity)]
    return Course(np.arange(1.0, n + 1.0), *(deviation(x) for x in kinds), duration_s=200.0)


def beyond(first, last, sigmas=4.1):
    """Ratio that is ``sigmas`` from ``first`` to ``last`` [s], both included."""
    t = np.arange(1.0, 201.0)
    return np.where((t >= first) & (t <= last), sigmas, 0.0)


@pytest.mark.parametrize('kind', judge.KINDS)
def test_wrong_is_more_than_a_twentieth_of_the_second_half_beyond_four_sigmas(kind):
    assert not judge.is_wrong(course(**{kind: beyond(101, 105)}))
    assert judge.is_wrong(course(**{kind: beyond(101, 106)}))


def test_the_first_half_does_not_count():
    assert not judge.is_wrong(course(position=beyond(1, 100)))


def test_just_under_four_sigmas_is_not_wrong_and_not_covered():
    c = course(position=beyond(101, 200, sigmas=3.9))
    assert not judge.is_wrong(c)
    assert not judge.is_covered(c)
    assert judge.is_covered(course(position=beyond(101, 200, sigmas=2.9)))


def test_a_filter_that_stopped_in_the_first_half_is_wrong():
    c = course(seconds=80, position=np.zeros(80), heading=np.zeros(80), velocity=np.zeros(80))
    assert judge.is_wrong(c)
    assert not judge.is_covered(c)


def test_an_error_that_is_no_number_is_beyond_and_a_sigma_that_is_none_is_not_judged():
    lost = Deviation(np.array([[np.nan]]), np.array([[1.0]]), np.zeros(1))
    assert lost.ratio()[0] == np.inf
    unpublished = Deviation(np.array([[7.0]]), np.array([[np.nan]]), np.zeros(1))
    assert unpublished.ratio()[0] == 0.0


def test_the_first_wrong_time_begins_a_stretch_that_lasts():
    short_then_long = np.maximum(beyond(110, 115), beyond(130, 150))
    assert judge.first_wrong_s(course(position=short_then_long), 0.0) == 130.0
    assert judge.first_wrong_s(course(position=beyond(50, 150)), 100.0) == 100.0
    assert np.isnan(judge.first_wrong_s(course(position=beyond(110, 115)), 0.0))


def test_sizes_are_of_the_second_half():
    found = judge.errors_of(course(position=beyond(101, 200, sigmas=2.0)))
    assert found['rms'] == pytest.approx(1.0)
    assert found['end'] == pytest.approx(1.0)
    assert found['said'] == pytest.approx(np.hypot(0.5, 0.5))
    assert found['nees_position'] == pytest.approx(4.0 / 3.0)
    assert found['beyond_position'] == 0.0


def report(second, level, culprit=''):
    return HealthReport(second * S, level, f'at {second}', culprit)


def test_a_right_report_names_the_culprit_or_nothing():
    history = [report(0, OK), report(50, WARN, 'fixes'), report(70, ERROR, 'dvl')]
    found = judge.reported(history, 40 * S, ('dvl',))
    assert found.first == history[1]
    assert found.named == history[2]
    assert judge.reported(history, 40 * S, ('imu',)).named is None
    vague = [report(0, OK), report(60, WARN, UNEXPLAINED)]
    assert judge.reported(vague, 40 * S, ('imu',)).named == vague[1]


def test_what_stood_before_the_fault_is_no_report_of_it():
    standing = [report(0, OK), report(30, WARN, 'fixes'), report(90, ERROR, 'fixes')]
    assert judge.reported(standing, 40 * S, ('fixes',)).first is None
    again = [*standing, report(100, OK), report(120, WARN, 'fixes')]
    assert judge.reported(again, 40 * S, ('fixes',)).named == again[-1]
    other = [*standing[:2], report(50, WARN, 'dvl')]
    assert judge.reported(other, 40 * S, ('dvl',)).named == other[-1]


def test_onsets_and_shares_of_a_level():
    history = [
        report(0, WARN),
        report(10, OK),
        report(20, ERROR),
        report(30, WARN),
        report(40, OK),
    ]
    assert judge.onsets(history, WARN) == 2
    assert judge.onsets(history, ERROR) == 1
    assert judge.share_at(history, ERROR, 0, 50 * S) == pytest.approx(0.2)
    assert judge.share_at(history, WARN, 25 * S, 45 * S) == pytest.approx(0.75)


NOTHING = {
    'wrong': False,
    'visible': True,
    'covered': False,
    'in_time': False,
    'named': False,
    'spoke': False,
}


@pytest.mark.parametrize(
    ('given', 'verdict'),
    [
        ({}, 'OK'),
        ({'wrong': True}, 'WRONG+SILENT'),
        ({'wrong': True, 'spoke': True}, 'WRONG+MISNAMED'),
        ({'wrong': True, 'spoke': True, 'named': True}, 'WRONG+LATE'),
        ({'wrong': True, 'spoke': True, 'named': True, 'in_time': True}, 'WRONG, reported'),
        ({'visible': False, 'wrong': True}, 'invisible, not covered'),
        ({'visible': False, 'covered': True}, 'invisible, covered'),
    ],
)
def test_verdicts(given, verdict):
    assert judge.verdict_of(**{**NOTHING, **given}) == verdict
    assert verdict in judge.SEVERITY


@pytest.mark.parametrize(
    ('given', 'verdict'),
    [
        ({'visible': False}, judge.BEYOND_STATED),
        ({'visible': False, 'covered': True}, 'invisible, covered'),
        ({'wrong': True}, 'WRONG+SILENT'),
    ],
)
def test_a_fault_beyond_twice_its_stated_sigma_says_so_while_it_is_invisible(given, verdict):
    assert judge.verdict_of(**{**NOTHING, **given}, beyond_stated=True) == verdict
    assert verdict in judge.SEVERITY


def test_unreported_verdicts_are_the_wrong_ones_without_a_report_in_time():
    assert judge.UNREPORTED == ('WRONG+LATE', 'WRONG+MISNAMED', 'WRONG+SILENT')


def test_what_is_silent_is_beyond_while_health_is_ok():
    c = course(position=beyond(121, 160), heading=beyond(151, 170))  # 50 of 100 s
    said = [report(0, OK), report(130, WARN), report(140, OK), report(165, ERROR)]
    # 121 to 129 and 140 to 164, the level of a stamp being that from it on.
    assert judge.silent_share(c, said, 0) == pytest.approx(0.34)
    assert judge.silent_share(c, [], 0) == pytest.approx(0.5)
    assert judge.silent_share(c, [report(0, WARN)], 0) == 0.0
