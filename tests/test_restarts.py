"""A follower that is killed and started again, simulated: soon, near and honest."""

from __future__ import annotations

import sys

import pytest
from restarts import late_or_off, optimistic, simulated, table_of

pytest.importorskip('rclpy')


@pytest.mark.slow
def test_restarts_of_a_settled_follower():
    found = simulated('demo', 9971, count=8)
    assert not late_or_off(found), table_of(found)
    assert not optimistic(found), table_of(found)


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize('mission', ['demo', 'racetrack', 'lawnmower'])
def test_fifty_restarts(mission):
    found = simulated(mission, 9971)
    sys.stdout.write(f'{mission}: {table_of(found)}\n')
    assert not late_or_off(found)
    assert not optimistic(found)
