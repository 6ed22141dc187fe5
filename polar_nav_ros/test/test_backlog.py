"""A node that gets more than it can take: turns end, losses are counted, lateness is reported."""

import inspect
import logging

import numpy as np
import pytest

from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import ImuSample
from polar_nav_core.engine.params import EngineParams
from polar_nav_ros.backlog import Backlog, Drain, informed
from polar_nav_ros.diagnostics import Level
from polar_nav_ros.navigation_health import NavigationHealth

S = 10**9


class Flood:
    """A queue that is never empty, or has so many messages."""

    def __init__(self, waiting=None, first=1):
        self.waiting, self.number = waiting, first - 1

    def take_message(self, _msg_type, _raw):
        if self.waiting == 0:
            return None
        if self.waiting is not None:
            self.waiting -= 1
        self.number += 1
        return b'', {'received_timestamp': S, 'publication_sequence_number': self.number}


class Clocks:
    """Steady and system time that a test sets."""

    def __init__(self):
        self.now_s, self.ahead_s = 0.0, 100.0

    def backlog(self):
        return Backlog(lambda: self.now_s, lambda: round((self.now_s + self.ahead_s) * S))


def taken(drain, queue):
    got = []
    drain.take(queue, bytes, got.append, raw=True)
    return len(got)


def test_a_turn_ends_in_a_flood():
    drain = Drain(2000, Backlog(), lambda: True)
    assert taken(drain, Flood()) == 2000
    assert taken(drain, Flood(7, 2001)) == 7
    assert (drain.count, drain.lost) == (2007, 0)


def test_messages_that_the_queue_dropped_are_counted():
    single = True
    drain = Drain(10, Backlog(), lambda: single)
    taken(drain, Flood(5))
    taken(drain, Flood(5, 9))
    assert drain.lost == 3
    taken(drain, Flood(5, 1))  # another publisher's life
    assert drain.lost == 3
    single = False
    taken(drain, Flood(5, 100))  # two publishers have numbers of their own
    single = True
    taken(drain, Flood(5, 300))
    assert drain.lost == 3
    taken(drain, Flood(5, 307))
    assert drain.lost == 5


def test_a_message_is_fresh_that_has_not_waited():
    clocks = Clocks()
    drain = Drain(10, clocks.backlog(), lambda: True)
    clocks.now_s = 10.0
    assert drain.is_fresh({'received_timestamp': round(109.996 * S)})
    assert not drain.is_fresh({'received_timestamp': round(109.994 * S)})
    assert not drain.is_fresh({'received_timestamp': 0})  # a middleware that does not note it


def test_a_node_is_behind_by_what_its_newest_message_waited():
    clocks = Clocks()
    backlog = clocks.backlog()
    clocks.now_s = 10.0
    backlog.emptied()
    clocks.now_s = 13.0
    backlog.taken(round(110.5 * S))
    assert backlog.behind_s == 2.5
    backlog.taken(round(112.5 * S))
    assert backlog.behind_s == 0.0
    clocks.ahead_s += 3600.0  # somebody sets the computer's clock
    backlog.taken(round(112.5 * S))
    assert backlog.behind_s == 3.0
    backlog.emptied()
    backlog.taken(round(112.5 * S))
    assert backlog.behind_s == 0.0
    backlog.taken(0)  # a middleware that does not note it
    assert backlog.behind_s == 0.0


def test_a_flood_is_a_warning_and_changes_nothing_else():
    engine = Engine(EngineParams())
    health = NavigationHealth(engine, logging.getLogger('test'), lambda: 0.0)
    for k in range(3):
        sample = ImuSample(S + k * 10**7, k, np.zeros(3), np.array([0.0, 0.0, 9.83]))
        list(engine.process(sample))
    assert health.diagnose({}).level is Level.OK
    found = health.diagnose({}, behind_s=2.25, lost=7)
    assert found.level is Level.WARN
    assert found.message.startswith('falls behind by 2.2 s')
    assert '7 messages were dropped' in found.message
    assert found.values['flood'] == found.message
    assert health.diagnose({}, lost=7).level is Level.OK
    assert '2 messages were dropped before it took them (9 so far)' in (
        health.diagnose({}, lost=9).message
    )


def test_a_callback_that_is_informed_takes_two_arguments_or_a_pair():
    taken = []

    def callback(message, about):
        taken.append((message, about))

    call = informed(callback)
    call('one', {'received_timestamp': 1})
    call(('two', {'received_timestamp': 2}))
    assert taken == [('one', {'received_timestamp': 1}), ('two', {'received_timestamp': 2})]
    # By its signature rclpy knows that it wants both.
    with pytest.raises(TypeError):
        inspect.signature(call).bind('one')
    inspect.signature(call).bind('one', {})
