"""Rules of clocks, message by message: how many must agree, and what becomes of the others."""

import numpy as np
import pytest
from closed_loop import World

from polar_nav_core.engine.clocks import Clocks
from polar_nav_core.engine.events import ClockStep, DepthSample, DvlPing, ImuSample, shifted
from polar_nav_core.engine.imu_clock import Refused

NS = 10**9


@pytest.fixture(scope='module')
def events():
    world = World(12.0)
    found = [*world.imu(), *world.depth(rng=np.random.default_rng(5))]
    return sorted(found, key=lambda e: e.key)


def depths(events, offset_s, *, imu_s=lambda _: 0.0, seen=True):
    """What comes of each depth: its number from 4 s on, and actions of the clocks.

    ``offset_s`` of that number, and ``imu_s`` of the time, are what is added to stamps [s].
    """
    clocks, number, out = Clocks(0.25, 0.05), -1, []
    for event in events:
        since_s = (event.stamp_ns - events[0].stamp_ns) / NS
        is_depth = isinstance(event, DepthSample)
        number += is_depth and since_s >= 4.0
        by_s = offset_s(number) if is_depth else imu_s(since_s)
        arrival_ns = event.stamp_ns if seen else None
        actions = clocks.take(shifted(event, round(by_s * NS)), arrival_ns)
        if is_depth and number >= 0:
            out.append(actions)
        assert is_depth or imu_s(since_s) or all(isinstance(a, ImuSample) for a in actions)
    return out


def test_the_third_message_in_a_row_shows_that_a_clock_stepped(events):
    first, second, third, *others = depths(events, lambda n: 10.0 if n >= 0 else 0.0)
    assert first == second == []
    assert [type(a) for a in third] == [ClockStep] + 3 * [DepthSample]
    assert third[0].step_ns == pytest.approx(10.0 * NS, abs=0.02 * NS)
    assert all([type(a) for a in actions] == [DepthSample] for actions in others)


def test_one_message_ahead_is_refused_and_one_behind_is_only_late(events):
    waits, after, *_ = depths(events, lambda n: 10.0 if n == 0 else 0.0)
    assert waits == []
    assert [type(a) for a in after] == [Refused, DepthSample]
    waits, after, *_ = depths(events, lambda n: -10.0 if n == 0 else 0.0)
    assert waits == []
    assert [type(a) for a in after] == [DepthSample, DepthSample]


def test_messages_that_run_away_from_one_another_are_no_clock(events):
    out = depths(events, lambda n: 10.0 * (n + 1) if 0 <= n < 4 else 0.0)
    assert not [a for actions in out for a in actions if isinstance(a, ClockStep)]
    assert len([a for actions in out for a in actions if isinstance(a, Refused)]) == 4


def test_where_arrival_says_nothing_a_second_message_shows_a_gap(events):
    first, second, third, *_ = depths(events, lambda n: 20.0 if n >= 0 else 0.0, seen=False)
    assert first == []
    assert [type(a) for a in second] == [DepthSample, DepthSample]
    assert [type(a) for a in third] == [DepthSample]


@pytest.mark.parametrize(('after', 'at_once'), [(4, True), (5, False)])
def test_five_messages_settle_that_a_topic_has_a_clock_of_its_own(events, after, at_once):
    """Before that it follows a step of the IMU's clock with the first message that makes it."""
    step_s = 10.0
    out = depths(
        events,
        lambda n: step_s if n >= after else 0.0,
        imu_s=lambda t: step_s if t >= 3.955 else 0.0,
    )
    first = [type(a) for a in out[after]]
    assert first == ([ClockStep, DepthSample] if at_once else [])


@pytest.mark.parametrize(
    ('ppm', 'followed_s', 'most_s'), [(300, 1105.0, 0.34), (700, 820.0, 0.58), (1000, None, 1.5)]
)
def test_an_imus_clock_that_creeps_slow_is_followed_late_or_never(ppm, followed_s, most_s):
    """The bound of what can have been stamped is of ten minutes; pings take 0.1 s to come."""
    clocks, steps, ahead_s, zero = Clocks(0.25, 0.05), [], [], np.zeros(3)
    for k in range(10 * 1500):
        now_ns = k * NS // 10
        actions = clocks.take(
            ImuSample(NS + round(now_ns * (1 - 1e-6 * ppm)), k, zero, zero), now_ns
        )
        if k % 10 == 5:
            ping = DvlPing(NS + now_ns - NS // 10, k, True, zero, np.eye(3))
            actions += clocks.take(ping, now_ns)
        for a in actions:
            if isinstance(a, ClockStep):
                steps.append((a.topic, now_ns / NS))
            elif isinstance(a, DvlPing):
                ahead_s.append((a.stamp_ns + NS // 10 - clocks.imu.newest_ns) / NS)
    assert max(ahead_s) <= most_s
    if followed_s is None:
        assert not steps
    else:
        ((topic, at_s),) = steps
        assert topic == 'dvl/data'
        assert at_s <= followed_s


def late_depths(events, late_s):
    """What comes of each depth that arrives late by ``late_s`` of its number [s]; None: never.

    Numbers are from 3 s on.
    """
    begin_ns, arrivals, number = events[0].stamp_ns, [], -1
    for event in events:
        by_s = 0.0
        if isinstance(event, DepthSample):
            number += event.stamp_ns - begin_ns >= 3 * NS
            by_s = late_s(number)
        if by_s is not None:
            arrivals.append((event.stamp_ns + round(by_s * NS), event))
    clocks, out = Clocks(0.25, 0.05), []
    for arrival_ns, event in sorted(arrivals, key=lambda one: (one[0], one[1].key)):
        out.append((event, clocks.take(event, arrival_ns)))
    return [(event, actions) for event, actions in out if isinstance(event, DepthSample)]


def steps(found):
    return [a for _, actions in found for a in actions if isinstance(a, ClockStep)]


def in_time(event, actions):
    """Whether a message is used, with the stamp that it has."""
    return [a.stamp_ns for a in actions if isinstance(a, DepthSample)] == [event.stamp_ns]


def test_messages_that_are_late_by_chance_are_no_clock(events):
    """The last one is 0.8 s late, so that one in time seems to be ahead of it by as much."""
    late = [0.4, 0.8, *8 * [None]]
    found = late_depths(events, lambda n: late[n] if 0 <= n < len(late) else 0.0)
    assert not steps(found)
    used = [a.stamp_ns for _, actions in found for a in actions]
    assert sorted(used) == sorted(event.stamp_ns for event, _ in found)


def test_a_step_that_was_none_is_taken_back(events):
    """All were late, by more and more, and then none is: it looks like a clock that steps."""
    late = np.repeat([0.4, 0.8, None], [11, 12, 8]).tolist()
    found = late_depths(events, lambda n: late[n] if 0 <= n < len(late) else 0.0)
    there, back = steps(found)
    assert there.step_ns == -back.step_ns != 0
    assert back.stamp_ns - there.stamp_ns < 5 * NS
    assert all(in_time(*one) for one in found[-5:])
