"""Reads a bag while it is opened and afterwards: the same comes out; and bags to try it on."""

from bag_samples import IMU, RUN_INFO, STATE, TRUTH, TYPES, imu, stamp_ns, truth, write_bag
from mcap.writer import Writer

from polar_nav_tools.bags import BagError, open_bag
from polar_nav_tools.bags.request import Request
from polar_nav_tools.bags.schemas import definition
from polar_nav_tools.bags.tables import read_tables

TIME = ('header.stamp.sec', 'header.stamp.nanosec')
OMEGA = tuple(f'angular_velocity.{a}' for a in 'xyz')
WANTED = {IMU: (TIME, OMEGA, 'angular_velocity_covariance'), TRUTH: (*TIME, 'r_e'), STATE: (TIME,)}
RAW = (RUN_INFO, '/nothing')
REQUEST = Request(WANTED, RAW)


def wants(bag):
    """As a caller does: what it wants is in the messages of the bag."""
    assert bag.node_infos is not None
    return REQUEST


def equal(a, b):
    assert a.columns.keys() == b.columns.keys()
    for topic, columns in b.columns.items():
        assert a.columns[topic].keys() == columns.keys()
        for name, column in columns.items():
            mine = a.columns[topic][name]
            assert (mine.dtype, mine.shape) == (column.dtype, column.shape)
            assert mine.tobytes() == column.tobytes()
    assert a.payloads == b.payloads
    assert a.odd == b.odd


def outcome(call):
    try:
        return call(), None
    except BagError as error:
        return None, str(error)


def both(path, request=REQUEST):
    """Read with and without; whether something was read ahead, None for what is no bag."""
    two, sentence = outcome(lambda: open_bag(path))
    one, other = outcome(lambda: open_bag(path, ahead=lambda _: request))
    assert other == sentence
    if two is None:
        return None
    assert one.problems == two.problems
    assert one.files == two.files
    assert [list(f.tallies) for f in one.files] == [list(f.tallies) for f in two.files]
    was_ahead = one.read_ahead is not None
    ours, said = outcome(lambda: read_tables(one, *request))
    theirs, expected = outcome(lambda: read_tables(two, *request))
    assert said == expected
    if theirs is not None:
        equal(ours, theirs)
    assert was_ahead <= (theirs is not None)
    assert one.read_ahead is None
    return was_ahead


def written(path, messages, **options):
    """Write messages with mcap: (topic, type, data) in their order, each kind a channel."""
    with path.open('wb') as stream:
        writer = Writer(stream, chunk_size=2000, **options)
        writer.start('ros2')
        schemas, channels = {}, {}
        for k, (topic, name, data) in enumerate(messages):
            if name not in schemas:
                text = definition(name).text.encode()
                schemas[name] = writer.register_schema(name, 'ros2msg', text)
            if (topic, name) not in channels:
                channels[topic, name] = writer.register_channel(topic, 'cdr', schemas[name])
            writer.add_message(channels[topic, name], stamp_ns(k), data, stamp_ns(k))
        writer.finish()
    return path


def usual(count=60):
    for k in range(count):
        yield IMU, TYPES[IMU], imu(k)
        yield TRUTH, TYPES[TRUTH], truth(k)


def without_checksum_of_the_index(data):
    """Let the index say anything."""
    data[-12:-8] = bytes(4)
    return data


def small(tmp_path):
    return write_bag(tmp_path / 'bag', 30, chunk_bytes=2000)
