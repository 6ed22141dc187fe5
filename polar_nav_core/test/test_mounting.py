"""A yaw between DVL and IMU that is another one after the DVL's gate has opened again."""

import numpy as np
import pytest

from polar_nav_core.engine.health.conditions import Culprit, Level
from polar_nav_core.engine.health.mounting import Mounting
from polar_nav_core.kernels.sins.consider import COLUMNS, DVL_YAW

S = 1_000_000_000
OPENED_S = 400


def shared(yaw, known=0.95):
    """State.shared in which innovations have shown the yaw [stated sigma]."""
    found = np.zeros((COLUMNS + 1, COLUMNS))
    found[0, DVL_YAW] = known * yaw
    found[1 + DVL_YAW, DVL_YAW] = known
    return found


def looks(before, after, *, known_s=0, opened_s=OPENED_S, end_s=600):
    """What is found every second; the yaw is known from ``known_s`` on, and anew after 20 s."""
    mounting, found = Mounting(), []
    for second in range(end_s):
        opened_ns = opened_s * S if second >= opened_s else 0
        yaw = before if second < OPENED_S else after
        known = 0.95 if second >= known_s else 0.0
        if opened_s <= second < opened_s + 20:
            known = 0.0
        found.append(mounting.look(second * S, opened_ns, shared(yaw, known)))
    return found


def test_a_yaw_that_has_changed_is_named_as_soon_as_it_is_known():
    found = looks(0.1, 3.9)
    assert not any(found[: OPENED_S + 20])
    assert all(found[OPENED_S + 20 :])
    (condition,) = found[-1]
    assert condition.level is Level.ERROR
    assert condition.culprit == Culprit.DVL | Culprit.IMU | Culprit.HEADING
    assert 'changed by 3.8 of its stated sigma' in condition.sentence


@pytest.mark.parametrize(
    ('after', 'level'),
    [(1.0, None), (1.71, None), (1.73, Level.WARN), (-3.42, Level.WARN), (-3.45, Level.ERROR)],
)
def test_its_level_goes_by_the_variance_of_both(after, level):
    """Each is known to sqrt(0.05 / 0.95) of a sigma: a change of 1.72 is 5.3 sigma, the limit."""
    found = looks(0.0, after)[-1]
    assert [c.level for c in found] == ([] if level is None else [level])


def test_without_an_opened_gate_it_is_the_matter_of_others():
    assert not any(looks(0.1, 3.3, opened_s=10_000))


def test_what_was_shown_less_than_a_minute_before_is_no_reference():
    """It may have been shown by what the pings were refused for."""
    assert not any(looks(0.1, 3.3, known_s=OPENED_S - 59))
    assert looks(0.1, 3.3, known_s=OPENED_S - 61)[-1]


@pytest.mark.parametrize(
    ('known', 'change', 'named'),
    [(0.4, 9.1, False), (0.4, 9.3, True), (0.8, 3.7, False), (0.8, 3.8, True)],
)
def test_a_yaw_that_innovations_show_less_well_must_change_by_more(known, change, named):
    """The limit is sqrt(28 * 2 (1 - known) / known) of a sigma."""
    mounting = Mounting()
    assert mounting.look(0, 0, shared(0.5, known)) == []
    found = mounting.look(100 * S, 100 * S, shared(0.5 + change, known))
    assert bool(found) is named


def opened_after(known_ns, opened_ns):
    """What is found at an opening of looks at some stamps before it, all at one yaw."""
    mounting = Mounting()
    for stamp_ns in known_ns:
        assert mounting.look(stamp_ns, 0, shared(0.0)) == []
    return mounting.look(opened_ns, opened_ns, shared(4.0))


def test_what_was_known_just_a_minute_before_is_a_reference():
    assert opened_after([S], 61 * S)
    assert not opened_after([S + 1], 61 * S)


def test_a_later_look_takes_the_place_of_an_earlier_one_after_a_minute():
    """Looks 63 s apart, in which the yaw creeps: the change is one against the last but one."""
    mounting = Mounting()
    for k in range(5):
        assert mounting.look(63 * k * S, 0, shared(1.0 * k)) == []
    (condition,) = mounting.look(63 * 5 * S, 63 * 5 * S, shared(8.0))
    assert 'changed by 4.0 of its stated sigma' in condition.sentence


def test_the_first_mounting_stays_the_reference():
    """A gate that opens once more does not make what has turned the way it was."""
    mounting = Mounting()
    for second in range(1000):
        opened_ns = 0 if second < 400 else (400 if second < 700 else 700) * S
        found = mounting.look(second * S, opened_ns, shared(0.0 if second < 400 else 3.0))
    assert found


def test_nothing_is_said_where_innovations_show_no_yaw():
    mounting = Mounting()
    assert mounting.look(0, 0, None) == []
    assert mounting.look(S, S, shared(3.0, 0.1)) == []
