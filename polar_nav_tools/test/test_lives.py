"""A follower that was killed and started again: each of its lives is replayed, bit for bit."""

import dataclasses
import json
import re
import sys
from pathlib import Path

import pytest

pytest.importorskip('rclpy')

from rclpy.serialization import deserialize_message

from polar_nav_core.engine.saved import pack
from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.params import to_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_follower.session import Session
from polar_nav_msgs.msg import AcousticPacket, Command, Depth, Dvl, Restore
from polar_nav_ros import topics
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.stamps import to_msg, to_ns
from polar_nav_tools.bags import BagWriter, open_bag
from polar_nav_tools.cli import main
from polar_nav_tools.replay.by_message import parameters, replay
from polar_nav_tools.replay.recorded import choose_follower, load_inputs
from polar_nav_tools.replay.verification import verify

sensor_msgs = pytest.importorskip('sensor_msgs.msg')

REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'
TYPES = {
    topics.IMU: sensor_msgs.Imu,
    topics.DVL: Dvl,
    topics.DEPTH: Depth,
    topics.RX: AcousticPacket,
}
OUTPUTS = (topics.STATE, topics.RECEIPT, topics.CLOCK_STEP, topics.COMMAND, topics.RESTORE)
TRUTH = '/follower/truth'
S = 10**9


def params_of(bag):
    recorded = parameters(choose_follower(bag, None)[1], None, {})
    return dataclasses.replace(recorded, state_file='there', state_period_s=1.0)


class Recording:
    """A bag under way, and the node whose messages it has."""

    def __init__(self, path, source):
        self.params = params_of(source)
        self.writer = BagWriter(path, {})
        for topic in (*TYPES, *OUTPUTS):
            self.writer.add_topic(f'/follower/{topic}', topics.TYPES[topic])
        truth = source.channel(TRUTH).type
        self.writer.add_topic(TRUTH, truth, described=source.definition(TRUTH))
        self.writer.add_topic(topics.RUN_INFO, topics.TYPES[topics.RUN_INFO])

    def start(self, log_ns):
        """Another process: it describes itself, and has taken nothing yet."""
        self.session = Session(self.params, 'follower')
        self.session.marks_starts = True
        self.describe(log_ns)

    def describe(self, log_ns):
        from std_msgs.msg import String

        text = json.dumps(
            {
                'node': '/follower/follower_node',
                'package': 'polar_nav_follower',
                'engine_version': ENGINE_VERSION,
                'params': to_mapping(self.params),
            }
        )
        self.writer.write(topics.RUN_INFO, to_bytes(String(data=text)), log_ns)

    def write(self, topic, data, log_ns):
        self.writer.write(f'/follower/{topic}', data, log_ns)

    def publish(self, published, log_ns):
        for topic, _, data in published:
            if topic in OUTPUTS:
                self.write(topic, data, log_ns)

    def end(self, log_ns):
        """The node ends in order."""
        self.publish(self.session.flush(), log_ns)
        taken = {f'/follower/{t}': n for t, n in self.session.taken.items() if t in TYPES}
        message = Command(
            kind=Command.SHUTDOWN, taken_topics=list(taken), taken_counts=list(taken.values())
        )
        message.header.stamp = to_msg(self.session.reorder.newest_imu_ns)
        self.write(topics.COMMAND, to_bytes(message), log_ns)

    def restore(self, saved, log_ns):
        stamp_ns = self.session.reorder.start_ns
        message = Restore(data=pack(saved))
        message.header.stamp, message.saved_time = to_msg(stamp_ns), to_msg(saved.stamp_ns)
        self.write(topics.RESTORE, to_bytes(message), log_ns)
        self.publish(self.session.take(topics.RESTORE, message), log_ns)


def two_lives(path, *, in_order=False):
    """Bag with a follower that ends after 12 s, and one that takes its state up at 14 s."""
    source = open_bag(REFERENCE)
    names = {f'/follower/{topic}': topic for topic in TYPES}
    records = list(source.records([*names, TRUTH]))
    begin_ns = records[0].log_time_ns
    bag = Recording(path, source)
    bag.start(begin_ns)
    saved, late, again = None, [], False
    # Discovery finds one topic after another.
    hears = {topics.RX: 13.9, topics.DEPTH: 13.95, topics.IMU: 14.0, topics.DVL: 14.35}
    for record in records:
        if record.topic == TRUTH:
            bag.writer.write(TRUTH, record.data, record.log_time_ns)
            continue
        topic, after_s = names[record.topic], (record.log_time_ns - begin_ns) / S
        message = deserialize_message(record.data, TYPES[topic])
        if topic == topics.DEPTH and not late and after_s > 8.0:
            late.append(record)  # comes when nobody listens
            continue
        bag.write(topic, record.data, record.log_time_ns)
        if after_s < 12.0:
            bag.publish(bag.session.take(topic, message), record.log_time_ns)
            if after_s > 11.0 and saved is None:
                saved = bag.session.engine.saved()
            continue
        if len(late) == 1 and after_s > 12.5:
            bag.write(topics.DEPTH, late[0].data, record.log_time_ns)
            late.append(None)
        if not again and after_s > 13.0:
            if in_order:
                bag.end(record.log_time_ns)
            bag.start(record.log_time_ns)
            again = True
        heard_s = (to_ns(message.header.stamp) - begin_ns) / S
        if not again or heard_s < hears[topic]:
            continue
        bag.publish(bag.session.take(topic, message), record.log_time_ns)
        if topic == topics.IMU and saved is not None and bag.session.reorder.start_ns is not None:
            bag.restore(saved, record.log_time_ns)
            saved = None
        if len(late) == 2 and after_s > 20.0:  # and one that comes too late
            bag.write(topics.DEPTH, late[0].data, record.log_time_ns)
            message = deserialize_message(late[0].data, Depth)
            bag.publish(bag.session.take(topics.DEPTH, message), record.log_time_ns)
            bag.describe(record.log_time_ns)  # a recorder that was started again hears it anew
            late.append(None)
    bag.end(records[-1].log_time_ns)
    bag.writer.finish({})
    return path


@pytest.fixture(scope='module')
def killed(tmp_path_factory):
    return two_lives(tmp_path_factory.mktemp('lives') / 'killed')


def test_each_life_is_verified(killed):
    inputs = load_inputs(killed)
    first, second = inputs.lives
    assert first.until_ns is not None
    assert second.until_ns is None
    assert min(len(life.live[topics.STATE]) for life in inputs.lives) > 80
    assert min(len(life.live[topics.RECEIPT]) for life in inputs.lives) > 2
    assert [r.topic for r in second.refused] == [topics.DEPTH]
    result = verify(killed)
    assert result.equal, result.difference
    (begin, end), (again, last) = result.lives_s
    assert begin == 0.0
    # The window of two seconds waits in a node that is killed; another watches pings for two.
    assert 9.0 < end < 11.0 < 15.9 < again < 16.3 < 25.0 < last
    assert result.lives_text.startswith(f'2 lives: 0.0 to {end:.1f} s, {again:.1f} to ')


def test_what_came_while_nobody_listened_is_of_no_life(killed):
    first, second = load_inputs(killed).lives
    taken = [
        {to_ns(m.header.stamp) for t, m in life.messages if t == topics.IMU}
        for life in (first, second)
    ]
    assert max(taken[0]) + S < min(taken[1])
    restores = [t for t, _ in second.messages].count(topics.RESTORE)
    assert (restores, [t for t, _ in first.messages].count(topics.RESTORE)) == (1, 0)
    # The second one heard the DVL last of all.
    heard = [
        next(to_ns(m.header.stamp) for t, m in second.messages if t == topic)
        for topic in (topics.IMU, topics.DVL)
    ]
    assert heard[1] - heard[0] > 0.3 * S


@pytest.mark.slow
def test_a_life_that_ended_in_order_is_followed_to_its_end(tmp_path):
    bag = two_lives(tmp_path / 'ended', in_order=True)
    first, _ = load_inputs(bag).lives
    assert first.until_ns is None
    assert verify(bag).equal


def without(source, target, drop):
    """Copy of a bag without the messages that ``drop`` names."""
    source = open_bag(source)
    with BagWriter(target, {}) as writer:
        for topic, known in source.topics.items():
            writer.add_topic(topic, known.type)
        counts = {}
        for record in source.records():
            counts[record.topic] = counts.get(record.topic, -1) + 1
            if not drop(record.topic.removeprefix('/follower/'), counts[record.topic]):
                writer.write(record.topic, record.data, record.log_time_ns)
    return target


@pytest.mark.slow
def test_packets_that_only_the_recorder_got_are_not_taken(killed, tmp_path):
    """A flood: the middleware dropped packets for the node, of which it has told nothing."""
    source, target = open_bag(killed), tmp_path / 'flood'
    name, packets = f'/follower/{topics.RX}', 0
    with BagWriter(target, {}) as writer:
        for topic, known in source.topics.items():
            writer.add_topic(topic, known.type)
        for record in source.records():
            packets += record.topic == name
            if record.topic == name and packets > 8:
                earlier = deserialize_message(record.data, AcousticPacket)
                earlier.receive_time = to_msg(to_ns(earlier.receive_time) - 2_000_000)
                for _ in range(3):
                    writer.write(name, to_bytes(earlier), record.log_time_ns)
                    writer.write(name, record.data, record.log_time_ns)
            writer.write(record.topic, record.data, record.log_time_ns)
    assert packets > 10
    before, after = (load_inputs(bag).lives[1].messages for bag in (killed, target))
    assert [t for t, _ in after].count(topics.RX) == [t for t, _ in before].count(topics.RX)
    assert verify(target).equal


def test_sensor_messages_that_only_the_recorder_got_are_named(killed, tmp_path):
    """The middleware dropped them for the node; no receipt states which."""
    source, target = open_bag(killed), tmp_path / 'dropped'
    name, number = f'/follower/{topics.DEPTH}', 0
    with BagWriter(target, {}) as writer:
        for topic, known in source.topics.items():
            writer.add_topic(topic, known.type)
        for record in source.records():
            writer.write(record.topic, record.data, record.log_time_ns)
            number += record.topic == name
            if record.topic == name and number % 50 == 40:
                other = deserialize_message(record.data, Depth)
                other.header.stamp = to_msg(to_ns(other.header.stamp) + 7_000_000)
                other.depth += 1.0
                writer.write(name, to_bytes(other), record.log_time_ns)
    assert not any(life.dropped for life in load_inputs(killed).lives)
    result = verify(target)
    assert not result.equal
    (sentence,) = result.problems
    assert re.match('[2-4] of ', sentence)
    assert f'{name} in the bag never reached the follower' in sentence


def test_messages_that_were_lost_in_the_kill_are_no_difference(killed, tmp_path):
    first = load_inputs(killed).lives[0]
    last = len(first.live[topics.STATE]) - 1
    found = without(killed, tmp_path / 'lost', lambda t, n: t == topics.STATE and n == last)
    assert verify(found).equal


def found_late(source, target, found_s, lost=(), late=(topics.STATE, topics.RECEIPT)):
    """Copy of a bag whose recorder found the second follower some time after the beginning.

    What its publishers keep comes then, at once; its messages on ``late`` topics before then, and
    those of states that ``lost`` numbers, are not there.
    """
    source = open_bag(source)
    records = list(source.records())
    begin_ns = records[0].log_time_ns
    kept, states = [], 0
    with BagWriter(target, {}) as writer:
        for topic, known in source.topics.items():
            writer.add_topic(topic, known.type)
        for record in records:
            since_s = (record.log_time_ns - begin_ns) / S
            topic = record.topic.removeprefix('/follower/')
            if 12.9 < since_s < found_s:
                if topic in (topics.CLOCK_STEP, topics.RESTORE, topics.RUN_INFO):
                    kept.append(record)
                    continue
                if topic in late:
                    continue
            while kept and since_s >= found_s:
                one = kept.pop(0)
                writer.write(one.topic, one.data, record.log_time_ns)
            states += topic == topics.STATE
            if topic != topics.STATE or states not in lost:
                writer.write(record.topic, record.data, record.log_time_ns)
    return target


def test_what_a_life_said_before_the_recorder_found_it_is_no_difference(killed, tmp_path):
    """A busy computer: what its publishers keep is there, the first estimates are not."""
    late = found_late(killed, tmp_path / 'late', 19.5)
    first, second = load_inputs(killed).live, load_inputs(late).live
    missed = {topic: len(first[topic]) - len(second[topic]) for topic in first}
    assert missed[topics.STATE] > 10
    result = verify(late)
    assert result.equal, result.difference
    assert [sentence.partition(' ')[0] for sentence in result.unheard] == [
        str(count) for count in missed.values() if count
    ]
    end = 'the recorder had found the follower that was started again; the others are equal'
    assert all(sentence.endswith(end) for sentence in result.unheard)
    # What was published for certain after it was found is a difference.
    number = len(load_inputs(late).lives[0].live[topics.STATE]) + 40
    assert not verify(found_late(killed, tmp_path / 'lost', 19.5, lost=(number,))).equal


def test_an_output_that_is_found_before_the_names_is_of_its_own_life(killed, tmp_path):
    bag = found_late(killed, tmp_path / 'late', 19.5, late=())
    assert [life.span_ns for life in load_inputs(bag).lives] == [
        life.span_ns for life in load_inputs(killed).lives
    ]
    result = verify(bag)
    assert result.equal, result.difference
    assert not result.unheard


def test_a_last_life_that_was_killed_is_followed_to_its_last_output(killed, tmp_path):
    inputs = load_inputs(killed)
    last = len(inputs.live[topics.STATE]) - 12
    found = without(
        killed,
        tmp_path / 'dead',
        lambda t, n: t == topics.COMMAND or (t == topics.STATE and n > last),
    )
    assert load_inputs(found).lives[1].until_ns is not None
    assert verify(found).equal


@pytest.mark.slow
@pytest.mark.parametrize('life', [0, 1])
def test_a_missing_message_in_either_life_is_a_difference(killed, tmp_path, life):
    lives = load_inputs(killed).lives
    middle = 40 + life * len(lives[0].live[topics.STATE])
    found = without(killed, tmp_path / 'cut', lambda t, n: t == topics.STATE and n == middle)
    result = verify(found)
    assert not result.equal
    assert result.difference.index == middle
    imu = without(killed, tmp_path / 'imu', lambda t, n: t == topics.DVL and n == 30 + 80 * life)
    assert not verify(imu).equal


def test_a_recording_with_a_hole_is_compared_up_to_it(killed, tmp_path):
    """Its recorder was killed, and went on in a next file."""
    source = open_bag(killed)
    records = list(source.records())
    cut = next(k for k, r in enumerate(records) if r.log_time_ns > records[0].log_time_ns + 20 * S)
    whole = load_inputs(killed).lives
    for resume, part in ((False, records[:cut]), (True, records[cut + 300 :])):
        writer = BagWriter(tmp_path / 'torn', {}, resume=resume)
        for topic, known in source.topics.items():
            writer.add_topic(topic, known.type, described=source.definition(topic))
        for record in part:
            writer.write(record.topic, record.data, record.log_time_ns)
        writer.flush()
        if resume:
            writer.finish()
        else:
            writer.abandon()
    torn = open_bag(tmp_path / 'torn')
    assert [f.path.name for f in torn.files] == ['torn_0.mcap', 'torn_1.mcap']
    assert torn.message_count == len(records) - 300
    said = ' '.join(torn.problems)
    assert 'torn_0.mcap: the recording was not finished' in said
    assert 'torn_1.mcap: goes on ' in said
    first, second = load_inputs(torn).lives
    assert first.live == whole[0].live
    assert second.torn
    assert 0 < len(second.live[topics.STATE]) < len(whole[1].live[topics.STATE]) - 50
    result = verify(torn)
    assert result.equal, result.difference
    assert result.lives_text.endswith('(up to the hole in the recording)')


def test_another_configuration_is_replayed_in_each_life(killed):
    result = replay(killed, configuration='modified_akf')
    stamps = [len(result.of(topics.STATE, life)) for life in (0, 1)]
    assert stamps == [len(life.live[topics.STATE]) for life in load_inputs(killed).lives]


@pytest.mark.slow
def test_the_command_names_the_lives(killed, monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', ['polar', 'verify', str(killed)])
    assert main() == 0
    assert '2 lives: 0.0 to ' in capsys.readouterr().out
    monkeypatch.setattr(sys, 'argv', ['polar', 'score', str(killed), '--json'])
    assert main() == 0
    assert json.loads(capsys.readouterr().out)
    monkeypatch.setattr(sys, 'argv', ['polar', 'doctor', str(killed)])
    main()
    assert 'was started again, and heard nothing' not in capsys.readouterr().err


def test_a_session_names_the_first_message_of_each_topic_after_the_imus():
    session = Session(FollowerParams(state_file='there'), 'follower')
    session.marks_starts = True
    depth, imu = Depth(), sensor_msgs.Imu()
    depth.header.stamp, imu.header.stamp = to_msg(3 * S), to_msg(4 * S)
    assert not list(session.take(topics.DEPTH, depth))
    named = [p.message.source for p in session.take(topics.IMU, imu)]
    assert named == ['imu/data_raw 0', 'depth/data 0']
    assert not list(session.take(topics.IMU, imu))
