"""sent = received + lost + in flight."""

from pathlib import Path
from types import SimpleNamespace as Message

import pytest

from polar_nav_tools.analysis.packets import delivery_of, stated_in_flight
from polar_nav_tools.bags import open_bag
from polar_nav_tools.scoring.delivery import delivery, delivery_table

S = 10**9
SENT = {('leader', n): 2 * n * S for n in range(10)}  # the last one at 18 s
REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'


def came(*numbers, after_s=3.0):
    return [(('leader', n), round((2 * n + after_s) * S)) for n in numbers]


def test_what_could_still_have_come_is_in_flight_and_the_rest_is_lost():
    d = delivery(SENT, came(0, 1, 3, 4, 5, 7), 19 * S)
    # 2, 6 are lost; 8 (sent at 16 s) could have come by 19 s, and 9 (18 s) not yet.
    assert (d.sent, d.received, d.lost, d.in_flight) == (10, 6, 3, 1)
    assert not d.stated
    slow = [*came(0, 1, 3, 4, 5), *came(7, after_s=4.0)]
    assert delivery(SENT, slow, 19 * S).in_flight == 2


def test_the_links_own_statement_counts_when_there_is_one():
    d = delivery(SENT, came(*range(8)), 19 * S, {('leader', 9)})
    assert (d.lost, d.in_flight, d.stated) == (1, 1, True)
    # A packet that came after all is not in flight, whatever was stated.
    assert delivery(SENT, came(*range(10)), 30 * S, {('leader', 9)}).in_flight == 0


@pytest.mark.parametrize('stated', [None, {('leader', 8), ('leader', 9)}])
def test_the_account_adds_up(stated):
    received = [*came(0, 1, 2, 2, 5, 5, 5), (('leader', 77), 5 * S)]
    d = delivery(SENT, received, 20 * S, stated)
    assert d.sent == d.received + d.lost + d.in_flight == 10
    assert (d.received, d.repeated, d.unsent) == (4, 3, 1)


def test_nothing_sent_is_nothing_lost():
    d = delivery({}, [], 0)
    assert (d.sent, d.received, d.lost, d.in_flight) == (0, 0, 0, 0)


def bag_saying(*texts):
    messages = [
        Message(status=[Message(values=[Message(key='in_flight_packets', value=t)])])
        for t in texts
    ]
    messages.insert(0, Message(status=[Message(values=[Message(key='sent', value='3')])]))
    return Message(
        topics={'/diagnostics': Message(count=len(messages))},
        read=lambda _: enumerate(messages),
    )


def test_the_statement_is_read_from_the_last_diagnostics():
    said = 'leader->follower#12@170 leader->other#3@171 a->b->follower#4@9'
    assert stated_in_flight(bag_saying('', said), 'follower') == {('leader', 12), ('a->b', 4)}
    assert stated_in_flight(bag_saying(''), 'follower') == set()
    assert stated_in_flight(bag_saying(), 'follower') is None


def test_a_recorded_run_is_accounted_for():
    found = delivery_of(open_bag(REFERENCE), 'follower')
    assert found is not None
    assert found.stated
    assert (found.sent, found.received, found.lost, found.in_flight) == (14, 13, 1, 0)
    assert found.unsent == 0
    assert delivery_table(found).rows[0]['lost'] == 1
