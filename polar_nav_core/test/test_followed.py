"""Refused fixes that the estimate has followed: their sum, jumps, and what leads back."""

import numpy as np
import pytest
from fix_samples import PLACE, fix

from polar_nav_core.engine.followed import Followed, leaps
from polar_nav_core.engine.health.conditions import Level


@pytest.mark.parametrize('before', [False, True])
@pytest.mark.parametrize(('metres', 'far'), [(50.0, False), (52.0, True)])
def test_a_leap_is_beyond_what_the_vehicle_can_have_moved_and_four_sigmas(metres, far, before):
    """20 m/s for 2 s, and 11.3 m; a fix may be older than the one that was used."""
    one = fix(1, 98.0 if before else 102.0, r_e=PLACE, covariance_e=4.0 * np.eye(3))
    other = fix(2, 100.0, r_e=PLACE + np.array([metres, 0.0, 0.0]), covariance_e=4.0 * np.eye(3))
    assert leaps(one, other, 20.0) is far
    assert not leaps(one, one, 20.0)


@pytest.mark.parametrize('metres', [0.4, 500.0])
def test_a_way_of_any_length_is_said_until_half_of_it_is_left(metres):
    followed, way_G = Followed(), np.array([metres, 0.0, 0.0])
    followed.used(None)
    assert followed.conditions() == []
    followed.leapt(way_G)
    followed.believed(way_G)
    assert followed.conditions() == []
    followed.used(None)
    (said,) = followed.conditions()
    assert said.level is Level.ERROR
    followed.used(-0.4 * way_G)
    assert len(followed.conditions()) == 1
    followed.used(-0.2 * way_G)
    assert followed.conditions() == []
    assert followed.to_save() is None


def test_what_was_restored_is_led_back_as_what_was_seen():
    followed = Followed()
    followed.restore((1.0, 0.0, False))
    assert followed.to_save() == (1.0, 0.0, False)
    (said,) = followed.conditions()
    assert said.level is Level.WARN
    followed.used(np.array([-1.0, 0.0, 0.0]))
    assert followed.conditions() == []
