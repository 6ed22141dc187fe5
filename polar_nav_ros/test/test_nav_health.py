"""nav/health: level, status, culprits and ages of an engine for a machine."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from polar_nav_core.engine.health.conditions import Condition, Culprit, Health, Level, Present
from polar_nav_core.engine.params import EngineParams
from polar_nav_msgs.msg import NavHealth, NavState
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.diagnostics import Level as Worst
from polar_nav_ros.health_message import health_to_msg, status_of
from polar_nav_ros.navigation_session import NavigationSession

NOW = 1_000_000_000_000
GATED = Condition('fixes gated', Level.WARN, Culprit.FIXES, '3 fixes gated')
REFUSED = Condition('DVL refused', Level.ERROR, Culprit.DVL | Culprit.IMU, 'DVL refused')
LOST = Condition('lost', Level.ERROR, Culprit.UNEXPLAINED, 'lost')


def health(*conditions):
    present = tuple(Present(c, NOW - 10**9, 1) for c in conditions)
    return Health(NOW, present, 3.0, 2, (NOW - 10**8, 0, 0))


def engine(*conditions, **changes):
    made = SimpleNamespace(
        health=health(*conditions),
        divergence='',
        navigating=True,
        history_warning='',
        aiding_warning='',
        resets=5,
        integrity=SimpleNamespace(since_fused_s=4.0),
    )
    for name, value in changes.items():
        setattr(made, name, value)
    return made


def message(*conditions, radius=3.0, imu_ns=NOW, **changes):
    found = health_to_msg(engine(*conditions, **changes), NOW, radius, imu_ns)
    to_bytes(found)
    return found


def test_all_is_well():
    m = message()
    assert (m.level, m.status, m.culprit) == (NavHealth.OK, NavHealth.STATUS_NAVIGATING, 0)
    assert (m.r95_horizontal_m, m.imu_age_s, m.fix_age_s) == (3.0, 0.0, 4.0)
    assert m.dvl_age_s == pytest.approx(0.1)
    assert math.isnan(m.depth_age_s)  # none was used yet
    assert (m.reset_counter, list(m.conditions)) == (2, [])
    assert (m.header.stamp.sec, m.header.stamp.nanosec) == (1000, 0)


def test_the_culprits_are_those_of_the_worst_level():
    m = message(GATED, REFUSED)
    assert (m.level, m.status) == (NavHealth.ERROR, NavHealth.STATUS_DEGRADED)
    assert m.culprit == NavHealth.DVL | NavHealth.IMU
    assert list(m.conditions) == ['ERROR: DVL refused', 'WARN: 3 fixes gated']
    assert message(GATED).level == NavHealth.WARN
    assert message(GATED).status == NavHealth.STATUS_DEGRADED


@pytest.mark.parametrize(
    ('conditions', 'changes', 'status', 'level'),
    [
        ((LOST,), {}, NavHealth.STATUS_LOST, NavHealth.ERROR),
        ((), {'divergence': 'lost', 'health': None}, NavHealth.STATUS_DIVERGED, NavHealth.ERROR),
        ((), {'navigating': False, 'health': None}, NavHealth.STATUS_ALIGNING, NavHealth.WARN),
        ((), {'health': None}, NavHealth.STATUS_NAVIGATING, NavHealth.OK),
        ((), {'history_warning': 'too fast'}, NavHealth.STATUS_DEGRADED, NavHealth.WARN),
    ],
)
def test_status(conditions, changes, status, level):
    m = message(*conditions, **changes)
    assert (m.status, m.level) == (status, level)


ABSENT = Condition('source /dvl', Level.WARN, Culprit.DVL, 'nobody publishes /dvl')


def test_what_the_node_knows_of_its_sources_stands_beside():
    m = health_to_msg(engine(), NOW, 3.0, NOW, beside=(ABSENT,))
    assert (m.level, m.status) == (NavHealth.WARN, NavHealth.STATUS_DEGRADED)
    assert m.culprit == NavHealth.DVL
    assert list(m.conditions) == ['WARN: nobody publishes /dvl']
    m = health_to_msg(engine(REFUSED, GATED), NOW, 3.0, NOW, beside=(ABSENT,))
    assert m.culprit == NavHealth.DVL | NavHealth.IMU
    assert list(m.conditions)[-1] == 'WARN: nobody publishes /dvl'
    assert status_of(engine()) == ('navigating', Worst.OK)
    assert status_of(engine(), (ABSENT,)) == ('degraded', Worst.WARN)
    assert status_of(engine(REFUSED), (ABSENT,)) == ('degraded', Worst.ERROR)


def test_a_session_publishes_what_its_node_knows_and_no_estimate_is_needed():
    session = NavigationSession(EngineParams(), 'auv', {})
    session.engine.last_imu_ns = NOW
    session.beside = (ABSENT,)
    (aligning,) = session.silence(0.5, 'waiting for: a position fix')
    assert list(aligning.message.conditions) == [
        'WARN: no state yet: waiting for: a position fix',
        'WARN: nobody publishes /dvl',
    ]
    state = NavState(position_covariance_g=np.eye(3).ravel())
    session.engine = engine()
    (navigating,) = session._health(NOW, state)
    assert list(navigating.message.conditions) == ['WARN: nobody publishes /dvl']


def test_a_silent_imu_is_an_error():
    m = message(radius=math.nan, imu_ns=NOW - 3 * 10**9)
    assert (m.level, m.culprit) == (NavHealth.ERROR, NavHealth.IMU)
    assert m.imu_age_s == pytest.approx(3.0)
    assert list(m.conditions) == ['ERROR: no IMU sample for 3 s: nothing is estimated']
    assert math.isnan(message(imu_ns=None, navigating=False, health=None).imu_age_s)


def test_culprits_are_the_bits_of_the_message():
    for culprit in Culprit:
        if culprit:
            assert getattr(NavHealth, culprit.name) == culprit
    assert [bytes([v]) for v in Level] == [NavHealth.OK, NavHealth.WARN, NavHealth.ERROR]


def test_the_clock_of_the_computer_gives_the_beat_while_there_is_no_estimate():
    session = NavigationSession(EngineParams(), 'auv', {})
    assert list(session.silence(5.0)) == []  # no IMU sample ever came
    session.engine.last_imu_ns = NOW
    (aligning,) = session.silence(0.5)
    assert aligning.topic == 'nav/health'
    assert aligning.message.status == NavHealth.STATUS_ALIGNING
    session.engine = engine()
    session.engine.last_imu_ns = NOW
    assert list(session.silence(1.9)) == []  # estimates may still come
    (silent,) = session.silence(2.5)
    assert (silent.message.level, silent.message.culprit) == (NavHealth.ERROR, NavHealth.IMU)
    assert silent.message.imu_age_s == pytest.approx(2.5)
    assert silent.message.header.stamp.sec == 1002
    assert math.isnan(silent.message.r95_horizontal_m)
