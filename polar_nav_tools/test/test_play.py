"""Playback without ROS: selection, names, QoS of the metadata, order, pace."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polar_nav_core.errors import ConfigError
from polar_nav_tools.bags.qos import Qos, to_yaml
from polar_nav_tools.bags.reader import Topic
from polar_nav_tools.play.offers import QUEUE_DEPTH, Offer, offer_of, profiles_of_folder
from polar_nav_tools.play.order import Message, in_order, measure
from polar_nav_tools.play.pace import Lag, Timeline, clock_cdr, publish_all, with_clock, within
from polar_nav_tools.play.selection import Selection, choose, parse_remaps, split_names

from bag_samples import IMU, TRUTH, write_bag  # isort: skip

S = 1_000_000_000


NAV_STATE = 'polar_nav_msgs/msg/NavState'
GRAPH = {
    name: Topic(name, kind, 1)
    for name, kind in {
        '/follower/imu/data_raw': 'sensor_msgs/msg/Imu',
        '/follower/acomms/rx': 'polar_nav_msgs/msg/AcousticPacket',
        '/follower/acomms/decoded': 'polar_nav_msgs/msg/LeaderBroadcast',
        '/follower/nav/state': NAV_STATE,
        '/follower/nav/command': 'polar_nav_msgs/msg/Command',
        '/follower/odometry': 'nav_msgs/msg/Odometry',
        '/follower/truth': 'polar_nav_msgs/msg/VehicleTruth',
        '/robot/odometry': 'nav_msgs/msg/Odometry',
        '/clock': 'rosgraph_msgs/msg/Clock',
        '/run_info': 'std_msgs/msg/String',
    }.items()
}


# -- selection and names


def test_all_topics_keep_their_names():
    assert choose(GRAPH, Selection()) == {name: name for name in GRAPH}


def test_inputs_are_without_what_a_vehicle_computed():
    left = choose(GRAPH, Selection(inputs=True))
    assert set(left) == {
        '/follower/imu/data_raw',
        '/follower/acomms/rx',
        '/follower/truth',
        '/robot/odometry',  # of a vehicle that is none of ours it may be a sensor
        '/clock',
    }


def test_patterns_and_exclusions():
    chosen = choose(
        GRAPH, Selection(topics=['follower/*'], exclude=['*/nav/*', '/follower/truth'])
    )
    assert set(chosen) == {
        '/follower/imu/data_raw',
        '/follower/acomms/rx',
        '/follower/acomms/decoded',
        '/follower/odometry',
    }


def test_a_namespace_comes_before_all_names_but_clock_and_the_remapped():
    remap = parse_remaps(['/follower/imu/data_raw:=/imu'])
    names = choose(GRAPH, Selection(remap=remap, namespace='/a/b/'))
    assert names['/follower/imu/data_raw'] == '/imu'
    assert names['/follower/acomms/rx'] == '/a/b/follower/acomms/rx'
    assert names['/clock'] == '/clock'


def test_a_recorded_clock_is_left_out_where_one_is_made():
    assert '/clock' not in choose(GRAPH, Selection(clock=True))


@pytest.mark.parametrize(
    ('selection', 'word'),
    [
        (Selection(topics=['/nothing']), '/nothing'),
        (Selection(exclude=['/nothing']), '/nothing'),
        (Selection(exclude=['*']), 'no topic is left'),
        (Selection(remap={'/nothing': '/x'}), '/nothing'),
        (Selection(remap={'/follower/truth': '/a b'}), '/a b'),
        (Selection(remap={'/follower/truth': '/a__b'}), '/a__b'),
        (Selection(remap={'/follower/truth': '/run_info'}), '/run_info'),
        (Selection(namespace='1st'), '1st'),
        (Selection(clock=True, remap={'/follower/truth': '/clock'}), '--clock'),
    ],
)
def test_options_that_do_not_fit_the_bag_are_refused(selection, word):
    with pytest.raises(ConfigError, match=word):
        choose(GRAPH, selection)


def test_remaps_and_lists_of_names():
    assert parse_remaps(['/a:=b', 'c:=/d']) == {'/a': '/b', 'c': '/d'}
    assert split_names(['/a, /b', '/c,']) == ['/a', '/b', '/c']
    with pytest.raises(ConfigError, match='OLD:=NEW'):
        parse_remaps(['/a=/b'])
    with pytest.raises(ConfigError, match='twice'):
        parse_remaps(['/a:=/b', '/a:=/c'])


# -- QoS of the metadata


@pytest.mark.parametrize('best_effort', [False, True])
@pytest.mark.parametrize('latched', [False, True])
def test_what_our_recorder_writes_is_offered_again(best_effort, latched):
    recorded = Qos(
        reliability='best_effort' if best_effort else 'reliable',
        durability='transient_local' if latched else 'volatile',
        depth=7,
    )
    for profiles in (to_yaml([recorded]), [recorded.to_dict()]):
        offer = offer_of('/t', profiles)
        assert (offer.reliable, offer.latched) == (not best_effort, latched)
        assert offer.depth == (7 if latched else QUEUE_DEPTH)
        assert (offer.deadline_ns, offer.lifespan_ns, offer.lease_ns) == (None, None, None)


def test_older_metadata_have_numbers():
    text = (
        '- history: 2\n  depth: 5\n  reliability: 2\n  durability: 1\n'
        '  deadline: {sec: 0, nsec: 500000000}\n  lifespan: {sec: 2147483647, nsec: 4294967295}\n'
        '  liveliness: 3\n  liveliness_lease_duration: {sec: 1, nsec: 0}\n'
    )
    offer = offer_of('/t', text)
    assert not offer.reliable
    assert offer.latched
    assert offer.keep_all
    assert offer.deadline_ns == 500_000_000
    assert offer.manual_liveliness
    assert offer.lease_ns == S


def test_several_publishers_become_one_that_serves_the_subscribers_of_each():
    best, latched = Qos(reliability='best_effort'), Qos(durability='transient_local')
    both = offer_of('/t', to_yaml([best, latched]))
    assert both.reliable
    assert both.latched
    assert not offer_of('/t', to_yaml([best, best])).reliable


@pytest.mark.parametrize('word', ['system_default', 'unknown', 'best_available', 0, 7])
def test_what_is_not_best_effort_is_reliable(word):
    assert offer_of('/t', [{'reliability': word, 'depth': 3}]).reliable


@pytest.mark.parametrize('profiles', [None, '', [], '[1, 2]', '{', 'x' * 200_000, 3])
def test_without_a_profile_it_is_reliable(profiles):
    assert offer_of('/t', profiles) == Offer()
    assert offer_of('/tf_static', profiles).latched


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.text(max_size=8),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from(['depth', 'reliability', 'history', 'deadline', 'sec', 'nsec']),
                inner,
                max_size=5,
            )
        ),
        max_leaves=12,
    )
)
def test_any_metadata_make_an_offer(profiles):
    assert offer_of('/t', profiles).depth >= 1


def test_profiles_of_the_folder(tmp_path):
    path = write_bag(tmp_path / 'b', 5)
    assert set(profiles_of_folder(path)) == {IMU, TRUTH, '/run_info'}
    assert profiles_of_folder(tmp_path) == {}


# -- order


TIMES = st.lists(st.tuples(st.sampled_from('abc'), st.integers(0, 50)), max_size=40)


@given(TIMES)
def test_messages_come_by_log_time_and_else_as_in_the_file(times):
    span = measure(times, 'abc')
    messages = [Message(t, ns, bytes([k])) for k, (t, ns) in enumerate(times)]
    assert list(in_order(messages, span.window_ns)) == sorted(messages, key=lambda m: m.log_ns)


@given(TIMES)
def test_the_window_holds_no_more_than_it_must(times):
    chosen = [t for t in times if t[0] in 'ab']
    span = measure(times, 'ab')
    assert span.counts == {k: n for k in 'ab' if (n := sum(t == k for t, _ in chosen))}
    behind = [max(n for _, n in chosen[: k + 1]) - ns for k, (_, ns) in enumerate(chosen)]
    assert span.window_ns == max(behind, default=0)
    if times:
        assert (span.first_ns, span.last_ns) == (
            min(ns for _, ns in times),
            max(ns for _, ns in times),
        )


def test_a_time_span_begins_with_the_latched_messages_before_it():
    found = [
        Message('/tf_static', 1, b'1'),
        Message('/imu', 2, b'2'),
        Message('/tf_static', 3, b'3'),
    ]
    found += [Message('/imu', ns, b'') for ns in range(4, 9)]
    got = list(within(found, 5, 7, {'/tf_static': 1}))
    assert got == [Message('/tf_static', 5, b'3'), *(Message('/imu', ns, b'') for ns in (5, 6, 7))]
    assert list(within(found[:3], 5, 7, {'/tf_static': 5})) == [
        Message('/tf_static', 5, b'1'),
        Message('/tf_static', 5, b'3'),
    ]


# -- pace


def test_the_clock_ticks_from_the_first_time_to_the_last():
    got = list(with_clock([Message('/imu', 10, b''), Message('/imu', 25, b'')], 10, 40, 10))
    assert [(m.topic, m.log_ns) for m in got] == [
        ('/clock', 10),
        ('/imu', 10),
        ('/clock', 20),
        ('/imu', 25),
        ('/clock', 30),
        ('/clock', 40),
    ]


def test_a_clock_message_is_what_rclpy_serializes():
    assert clock_cdr(1_700_000_000 * S + 5) == b'\0\1\0\0' + struct.pack('<iI', 1_700_000_000, 5)
    assert clock_cdr(1 << 62)[4:8] == struct.pack('<i', 0x7FFFFFFF)


class Time:
    """Steady clock that passes only in pauses and while something is published."""

    def __init__(self, cost_ns=0):
        self.now_ns, self.cost_ns, self.published = 1000, cost_ns, []

    def pause(self, seconds):
        self.now_ns += round(seconds * S)

    def publish(self, message):
        self.published.append((message.log_ns, self.now_ns))
        self.now_ns += self.cost_ns

    def play(self, messages, rate=1.0, stopped=lambda: False):
        lag = Lag()
        whole = publish_all(
            messages,
            Timeline(messages[0].log_ns, rate, self.now_ns),
            self.publish,
            lag=lag,
            now_ns=lambda: self.now_ns,
            pause=self.pause,
            stopped=stopped,
        )
        return whole, lag


def of_times(*log_ns):
    return [Message('/t', ns, b'') for ns in log_ns]


@pytest.mark.parametrize('rate', [0.5, 1.0, 4.0])
def test_each_message_is_published_when_it_is_due(rate):
    time = Time()
    whole, lag = time.play(of_times(0, 3 * S, 3 * S, 10 * S), rate)
    assert whole
    assert [now - 1000 for _, now in time.published] == [
        round(t / rate) for t in (0, 3 * S, 3 * S, 10 * S)
    ]
    assert (lag.count, lag.largest_ns) == (4, 0)


def test_delays_do_not_add_up_and_nothing_is_left_out():
    time = Time(cost_ns=S // 2)
    whole, lag = time.play(of_times(0, 1, 2, 10 * S))
    assert whole
    assert [now - 1000 for _, now in time.published] == [0, S // 2, S, 10 * S]
    assert lag.largest_ns == S - 2
    assert lag.at_ns == 2


def test_a_stop_ends_it_also_in_a_long_pause():
    time = Time()
    whole, lag = time.play(of_times(0, 1000 * S), stopped=lambda: time.now_ns > 5 * S)
    assert not whole
    assert lag.count == 1
    assert time.now_ns < 6 * S
