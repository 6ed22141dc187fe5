"""Lockstep bookkeeping: nothing goes on before everybody is there and has taken everything."""

from dataclasses import dataclass, field

import pytest

from polar_nav_ros.flow import Flow


@dataclass
class Ack:
    node: str
    published_topics: list = field(default_factory=list)
    published_counts: list = field(default_factory=list)
    published_matched: list = field(default_factory=list)
    taken_topics: list = field(default_factory=list)
    taken_counts: list = field(default_factory=list)
    taken_matched: list = field(default_factory=list)


def imu(taken=0, published=0, sees=(1, 1)):
    return Ack('/f/imu', ['/f/imu/data'], [published], [sees[1]], ['/f/truth'], [taken], [sees[0]])


def follower(taken=0, sees=1):
    return Ack('/f/follower', [], [], [], ['/f/imu/data'], [taken], [sees])


def ready_flow():
    flow = Flow(['/f/imu', '/f/follower'])
    flow.own({'/f/truth': 0}, {'/f/truth': 1})
    flow.update(imu())
    flow.update(follower())
    return flow


def test_not_ready_before_everybody_is_heard():
    flow = Flow(['/f/imu', '/f/follower'])
    flow.own({'/f/truth': 0}, {'/f/truth': 1})
    assert flow.missing() == ['/f/follower has not been heard', '/f/imu has not been heard']
    flow.update(imu())
    assert flow.missing() == ['/f/follower has not been heard']
    flow.update(follower())
    assert flow.ready()


def test_not_ready_before_publishers_and_subscribers_have_met():
    flow = ready_flow()
    flow.update(imu(sees=(0, 1)))
    assert flow.missing() == ['/f/imu sees 0 of 1 publishers of /f/truth']
    flow.update(imu(sees=(1, 0)))
    assert flow.missing() == ['/f/imu sees 0 of 1 subscribers of /f/imu/data']
    flow.update(imu())
    flow.own({'/f/truth': 0}, {'/f/truth': 0})
    assert flow.missing() == ['the truth sees 0 of 1 subscribers of /f/truth']


def test_settles_only_when_the_whole_chain_has_taken_everything():
    flow = ready_flow()
    assert flow.settled()
    flow.own({'/f/truth': 20})
    assert not flow.settled()
    flow.update(imu(taken=20, published=20))
    assert not flow.settled()
    assert flow.laggards() == {'/f/follower': {'/f/imu/data': (0, 20)}}
    flow.update(follower(taken=19))
    assert not flow.settled()
    flow.update(follower(taken=20))
    assert flow.settled()


def test_counts_of_all_publishers_of_a_topic_add_up():
    flow = Flow(['/a', '/b', '/c'])
    for name in ('/a', '/b'):
        flow.update(Ack(name, ['/t'], [3], [1]))
    flow.update(Ack('/c', taken_topics=['/t'], taken_counts=[5], taken_matched=[2]))
    assert flow.published() == {'/t': 6}
    assert not flow.settled()
    flow.update(Ack('/c', taken_topics=['/t'], taken_counts=[6], taken_matched=[2]))
    assert flow.settled()


def test_strangers_are_not_waited_for():
    flow = ready_flow()
    assert not flow.update(
        Ack('/stranger', taken_topics=['/f/truth'], taken_counts=[0], taken_matched=[1])
    )
    assert flow.settled()


def test_lag_is_the_time_that_the_slowest_subscriber_has_not_taken():
    flow = ready_flow()
    assert flow.lag_s(0.0) == 0.0
    flow.own({'/f/truth': 1001})
    flow.update(imu(taken=1001, published=1001))
    flow.update(follower(taken=800))
    # 201 of 1001 messages in 10.01 s have not been taken, one of them is under way.
    assert flow.lag_s(10.01) == pytest.approx(2.0)
    flow.update(follower(taken=1000))
    assert flow.lag_s(10.01) == 0.0
    # The truth's own reader, too.
    flow.update(imu(taken=500, published=1001))
    assert flow.lag_s(10.01) == pytest.approx(5.0)


def test_a_rare_message_under_way_is_no_lag():
    flow = ready_flow()
    flow.own({'/f/truth': 10})
    flow.update(imu(taken=10, published=3))
    flow.update(follower(taken=2))
    assert flow.lag_s(30.0) == 0.0
