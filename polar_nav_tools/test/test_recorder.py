"""The recorder without ROS: times, order, counts, losses, parameters."""

import json

import pytest
from bag_samples import IMU, START_NS, TRUTH, TYPES, imu, make, run_info, stamp, stamp_ns, truth

from polar_nav_core.errors import ConfigError
from polar_nav_tools.bags import BagError, BagWriter, open_bag
from polar_nav_tools.bags.qos import Qos
from polar_nav_tools.record.params import RecorderParams, parse_run_info, parse_topics
from polar_nav_tools.record.recording import Recording

CLOCK, PACKET, DIAGNOSTICS = '/clock', '/follower/acomms/rx', '/diagnostics'
WALL_NS = 1_900_000_000_000_000_000
SECOND = 1_000_000_000


@pytest.fixture
def record(tmp_path):
    """Recording in a bag of its own; call the second function to finish and open it."""

    def start(*, simulated, **options):
        recording = Recording(
            BagWriter(tmp_path / 'b', {'seed': 1}), simulated=simulated, **options
        )
        for topic, name in {
            **TYPES,
            CLOCK: 'rosgraph_msgs/msg/Clock',
            DIAGNOSTICS: 'diagnostic_msgs/msg/DiagnosticArray',
            PACKET: 'polar_nav_msgs/msg/AcousticPacket',
        }.items():
            recording.add_topic(topic, name)

        def finish():
            return open_bag(recording.finish())

        return recording, finish

    return start


def clock(ns):
    return make('rosgraph_msgs/msg/Clock', clock__sec=ns // SECOND, clock__nanosec=ns % SECOND)


def packet(sent_ns):
    return make('polar_nav_msgs/msg/AcousticPacket', **stamp(sent_ns))


def filed(bag):
    return [(r.topic, r.log_time_ns) for r in bag.records()]


def test_reception_time_and_order_across_topics(record):
    recording, finish = record(simulated=False)
    # A burst comes topic by topic, but is filed in order of arrival.
    for k in (0, 2, 4):
        recording.take(IMU, imu(k), WALL_NS + k)
    for k in (1, 3, 5):
        recording.take(TRUTH, truth(k), WALL_NS + k)
    recording.commit()
    bag = finish()
    assert filed(bag) == [(IMU if k % 2 == 0 else TRUTH, WALL_NS + k) for k in range(6)]
    assert [r.publish_time_ns for r in bag.records()] == [stamp_ns(k) for k in range(6)]


def test_log_time_never_goes_back(record):
    recording, finish = record(simulated=False)
    for time_ns in (WALL_NS, WALL_NS - 5 * SECOND, WALL_NS + 1):  # the system clock was set back
        recording.take(IMU, imu(0), time_ns)
        recording.commit()
    assert [t for _, t in filed(finish())] == [WALL_NS, WALL_NS, WALL_NS + 1]


def test_messages_of_one_topic_keep_the_order_of_arrival(record):
    recording, finish = record(simulated=True)
    for k in (5, 3, 4, 6):
        recording.take(IMU, imu(k), WALL_NS)
    recording.take(TRUTH, truth(4), WALL_NS)
    recording.commit()
    bag = finish()
    assert [d for t, _, d in bag.messages([IMU])] == [imu(k) for k in (5, 3, 4, 6)]
    assert [t for t, _ in filed(bag)] == [TRUTH, IMU, IMU, IMU, IMU]


def test_simulated_time_is_that_of_the_stamps(record):
    recording, finish = record(simulated=True)
    recording.take(IMU, imu(1), WALL_NS)
    recording.take(IMU, imu(2), WALL_NS)
    recording.take(TRUTH, truth(1), WALL_NS)
    recording.take(TRUTH, truth(2), WALL_NS)
    recording.commit()
    # A packet sent long ago stands where it arrived; its publish time tells when it was sent.
    recording.take(PACKET, packet(START_NS - 9 * SECOND), WALL_NS)
    recording.take(IMU, imu(3), WALL_NS)
    recording.commit()
    bag = finish()
    assert filed(bag) == [
        (IMU, stamp_ns(1)),
        (TRUTH, stamp_ns(1)),
        (IMU, stamp_ns(2)),
        (TRUTH, stamp_ns(2)),
        (PACKET, stamp_ns(2)),
        (IMU, stamp_ns(3)),
    ]
    assert next(r.publish_time_ns for r in bag.records([PACKET])) == START_NS - 9 * SECOND


def test_clock_alone_says_what_time_it_is_where_there_is_one(record):
    recording, finish = record(simulated=True)
    recording.take(CLOCK, clock(stamp_ns(10)), WALL_NS)
    recording.take(IMU, imu(500), WALL_NS)  # a stamp from the future
    recording.commit()
    recording.take(CLOCK, clock(stamp_ns(11)), WALL_NS)
    recording.take(TRUTH, truth(11), WALL_NS)
    recording.commit()
    assert filed(finish()) == [
        (CLOCK, stamp_ns(10)),
        (IMU, stamp_ns(10)),
        (CLOCK, stamp_ns(11)),
        (TRUTH, stamp_ns(11)),
    ]


def test_wall_clock_of_diagnostics_does_no_harm(record):
    recording, finish = record(simulated=True)
    diagnosis = make('diagnostic_msgs/msg/DiagnosticArray', **stamp(WALL_NS))
    recording.take(DIAGNOSTICS, diagnosis, WALL_NS)
    recording.take(IMU, imu(1), WALL_NS)
    recording.commit()
    recording.take(DIAGNOSTICS, diagnosis, WALL_NS)
    recording.take(IMU, imu(2), WALL_NS)
    recording.commit()
    bag = finish()
    assert filed(bag) == [
        (DIAGNOSTICS, stamp_ns(1)),
        (IMU, stamp_ns(1)),
        (DIAGNOSTICS, stamp_ns(1)),
        (IMU, stamp_ns(2)),
    ]
    assert [r.publish_time_ns for r in bag.records([DIAGNOSTICS])] == [stamp_ns(1)] * 2


def test_what_comes_before_the_simulation_stands_before_it(record):
    recording, finish = record(simulated=True)
    recording.take('/run_info', run_info(), WALL_NS)
    recording.commit()
    assert recording.waiting == 1
    recording.take(IMU, imu(3), WALL_NS)
    recording.take(IMU, imu(4), WALL_NS)
    recording.commit()
    assert recording.waiting == 0
    assert filed(finish()) == [
        ('/run_info', stamp_ns(3)),
        (IMU, stamp_ns(3)),
        (IMU, stamp_ns(4)),
    ]


def test_simulation_that_never_began(record):
    recording, finish = record(simulated=True)
    recording.take('/run_info', run_info(), WALL_NS)
    recording.commit()
    assert finish().node_params('/follower/follower_node') == {}


def test_messages_with_odd_stamps(record):
    recording, finish = record(simulated=True)
    for data in (imu(1), make(TYPES[IMU]), make(TYPES[IMU], header__stamp__sec=-5), b'\0\1'):
        recording.take(IMU, data, WALL_NS)
    recording.commit()
    bag = finish()
    assert [r.log_time_ns for r in bag.records()] == [stamp_ns(1)] * 4
    assert [r.publish_time_ns for r in bag.records()] == [stamp_ns(1)] * 4


def test_losses_are_counted_by_the_publishers_numbers(record):
    recording, finish = record(simulated=False)
    for number in (7, 8, 11, 12):  # 7 first: it joined late, which is no loss
        recording.take(IMU, imu(0), WALL_NS, number)
    for number in (5, 6, 1, 2, 4):  # the publisher was restarted
        recording.take(TRUTH, truth(0), WALL_NS, number)
    for number in (1, None, 9):  # a second publisher came
        recording.take('/run_info', run_info(), WALL_NS, number)
    assert recording.lost == 3
    assert recording.message_count == 12
    assert recording.topics[IMU].bytes == 4 * len(imu(0))
    bag = finish()
    counted = bag.run_info['recording']['topics']
    assert {t: (c['count'], c['lost']) for t, c in counted.items() if c['count']} == {
        IMU: (4, 2),
        TRUTH: (5, 1),
        '/run_info': (3, None),
    }
    # What was published before it heard the topic is stated beside the losses.
    unheard = {topic: bag.unheard(topic) for topic in (IMU, TRUTH, '/run_info', PACKET, '/other')}
    assert unheard == {IMU: 6, TRUTH: 4, '/run_info': 0, PACKET: 0, '/other': 0}
    assert bag.run_info['seed'] == 1
    assert len(bag.problems) == 2
    assert counted[PACKET]['count'] == 0
    assert bag.topics[PACKET].count == 0


def test_what_publishers_keep_says_nothing_of_the_present(record):
    """A recorder that is started again hears a restart of long ago before it hears the clock."""
    recording, finish = record(simulated=True)
    recording.add_topic('/kept', TYPES[TRUTH], kept=True)
    recording.take('/kept', truth(1), WALL_NS)
    recording.commit()
    assert recording.waiting == 1
    recording.take(CLOCK, clock(stamp_ns(500)), WALL_NS)
    recording.commit()
    recording.take(IMU, imu(501), WALL_NS)
    recording.take('/kept', truth(2), WALL_NS)
    recording.commit()
    bag = finish()
    assert filed(bag) == [
        ('/kept', stamp_ns(500)),
        (CLOCK, stamp_ns(500)),
        ('/kept', stamp_ns(500)),
        (IMU, stamp_ns(500)),
    ]
    assert [r.publish_time_ns for r in bag.records(['/kept'])] == [stamp_ns(1), stamp_ns(2)]


def test_what_came_before_a_next_file_is_not_unheard(tmp_path):
    """It stands in the file before, which a recorder that was killed left without its counts."""
    for resume, number in ((False, 1), (True, 7)):
        writer = BagWriter(tmp_path / 'b', {}, resume=resume, chunk_bytes=1024, flush_s=0.0)
        recording = Recording(writer, simulated=False)
        recording.add_topic(IMU, TYPES[IMU])
        recording.take(IMU, imu(number), WALL_NS + number * SECOND, number)
        recording.commit()
        if not resume:
            recording.abandon()
    bag = open_bag(recording.finish())
    assert len(bag.files) == 2
    assert bag.unheard(IMU) == 0


def test_offered_profiles_are_asked_at_the_first_message(record):
    asked = []

    def offered(topic):
        asked.append(topic)
        return [Qos(reliability='best_effort')]

    recording, finish = record(simulated=False, offered=offered)
    recording.take(IMU, imu(0), WALL_NS)
    assert asked == []
    recording.commit()
    assert asked == [IMU]
    assert 'best_effort' in finish().channel(IMU).metadata['offered_qos_profiles']


def test_topics_of_unknown_types(record):
    recording, _ = record(simulated=False)
    with pytest.raises(BagError, match='package whales is not installed'):
        recording.add_topic('/x', 'whales/msg/Song')


def test_parameters(tmp_path):
    params = RecorderParams(topics=('/a:std_msgs/String', '/b/c:sensor_msgs/msg/Imu'))
    assert parse_topics(params.topics) == {
        '/a': 'std_msgs/msg/String',
        '/b/c': 'sensor_msgs/msg/Imu',
    }
    (tmp_path / 'run.json').write_text('{"seed": 3}')
    assert parse_run_info(str(tmp_path / 'run.json')) == {'seed': 3}
    assert parse_run_info(' {"a": 1}') == {'a': 1}
    assert parse_run_info('') == {}


@pytest.mark.parametrize(
    ('given', 'sentence'),
    [
        (
            {'topics': ('imu:sensor_msgs/msg/Imu',)},
            "topics: 'imu:sensor_msgs/msg/Imu' is not /name",
        ),
        ({'topics': ('/imu',)}, "topics: '/imu' is not /name:package/msg/Type"),
        ({'topics': ('/imu:Imu',)}, "'Imu' is not a message type"),
        ({'topics': ('/i:a/msg/B', '/i:a/msg/B')}, 'topics: /i is named twice'),
        ({'lockstep': True}, 'topics: empty, but with lockstep it must name every topic'),
        ({'run_info': '/no/such/file'}, 'run_info: file /no/such/file cannot be read'),
        ({'run_info': '{"a": '}, 'run_info is not JSON'),
        ({'log_time': 'later'}, "log_time: 'later' is none of auto, reception, simulation"),
        ({'compression': 'zip'}, "compression: 'zip' is none of zstd, lz4, none"),
        ({'flush_period': 5.0}, r'flush_period: 5.0 is outside of \[0.01, 2.0\] s'),
    ],
)
def test_parameters_that_are_refused(given, sentence):
    with pytest.raises((ConfigError, BagError), match=sentence):
        RecorderParams(**given)


def test_run_info_file_must_hold_an_object(tmp_path):
    (tmp_path / 'list.json').write_text(json.dumps([1]))
    with pytest.raises(ConfigError, match=r'list\.json is not a JSON object'):
        RecorderParams(run_info=str(tmp_path / 'list.json'))
