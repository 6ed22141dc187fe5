"""Mutated bags and payloads for seconds or minutes: the tool's own error or a result, no more.

`test_bags_fuzz` lets hypothesis look for small failing files; here time is what counts, and a
message whose bytes were changed goes all the way: opened, examined, replayed, scored.
"""

import contextlib
import resource
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy')

from polar_nav_core.errors import PolarNavError
from polar_nav_tools.analysis.analyse import analyse
from polar_nav_tools.bags import BagWriter, open_bag
from polar_nav_tools.bags.info import bag_info
from polar_nav_tools.doctor.examine import examine
from polar_nav_tools.replay.by_message import replay

REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'
SECONDS_OF_BAG = 6.0
MOST_MEMORY_KB = 500_000
MOST_S = 20.0
LENGTHS = [
    pytest.param(10.0, marks=pytest.mark.slow, id='10 s'),
    pytest.param(300.0, marks=[pytest.mark.slow, pytest.mark.long], id='5 min'),
]


@pytest.fixture(scope='module')
def records():
    """The beginning of the reference bag: topics and serialized messages."""
    bag = open_bag(REFERENCE)
    wanted = {t for t in bag.topics if t.startswith('/follower/') or t == '/run_info'}
    first = min(r.log_time_ns for r in bag.records({'/follower/truth'}))
    end = first + int(SECONDS_OF_BAG * 1e9)
    kept = [r for r in bag.records(wanted) if r.log_time_ns < end or r.topic == '/run_info']
    return bag, kept


def write(path, bag, kept):
    with BagWriter(path, {}, chunk_bytes=16_384) as writer:
        for topic in {r.topic for r in kept}:
            described = bag.definition(topic)
            writer.add_topic(topic, bag.channel(topic).type, described=described)
        for r in kept:
            writer.write(r.topic, r.data, r.log_time_ns)
    return path


def mutated(data, rng):
    """Bytes with a few changes: bits, odd numbers, cuts, repeats."""
    out = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(0, max(1, len(out))))
        kind = rng.integers(0, 6)
        if kind == 0 and out:
            out[at % len(out)] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            odd = [b'\xff' * 8, b'\0' * 8, b'\0\0\0\0\0\0\xf0\x7f', b'\0\0\0\0\0\0\xf8\x7f']
            out[at : at + 8] = odd[rng.integers(0, len(odd))]
        elif kind == 2:
            del out[at:]
        elif kind == 3:
            out[at:at] = out[at : at + int(rng.integers(1, 40))]
        elif kind == 4:
            del out[at : at + int(rng.integers(1, 40))]
        else:
            out[at : at + 4] = rng.bytes(4)
    return bytes(out)


def use(path):
    """What commands do with a bag; only errors that are meant for the user may come."""
    with contextlib.suppress(PolarNavError):
        bag = open_bag(path)
        bag_info(bag)
        examine(bag).to_dict()
        for one in (
            lambda: replay(bag),
            lambda: analyse(bag, (), vehicle='follower', live=True).comparison.tables(),
        ):
            with contextlib.suppress(PolarNavError):
                one()


def fuzz(seconds, seed, make):
    """Make and use broken bags until the time is over; how many there were."""
    rng, count = np.random.default_rng(seed), 0
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        state = rng.bit_generator.state
        begin = time.process_time()  # a busy machine is no hang; pytest's timeout ends a sleep
        path = make(rng, count)
        try:
            use(path)
        except Exception as error:
            raise AssertionError(f'example {count}, generator {state}') from error
        assert time.process_time() - begin < MOST_S, f'example {count} takes too long'
        count += 1
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MOST_MEMORY_KB
    return count


def test_the_bag_that_is_broken_here_is_whole_before(records, tmp_path):
    bag = open_bag(write(tmp_path / 'b', *records))
    assert len(replay(bag).of('nav/state')) > 10
    assert analyse(bag, (), vehicle='follower', live=True).comparison.tables()


@pytest.mark.timeout(900)
@pytest.mark.parametrize('seconds', LENGTHS)
def test_messages(records, tmp_path, seconds):
    bag, kept = records
    topics = sorted({r.topic for r in kept})

    def make(rng, count):
        broken = list(kept)
        # Of some topic, one message or all of them: rare topics get their share.
        topic = topics[rng.integers(0, len(topics))]
        own = [i for i, r in enumerate(kept) if r.topic == topic]
        for i in rng.choice(own, size=min(len(own), int(rng.integers(1, 4))), replace=False):
            broken[i] = kept[i]._replace(data=mutated(kept[i].data, rng))
        shutil.rmtree(tmp_path / str(count - 1), ignore_errors=True)
        return write(tmp_path / str(count), bag, broken)

    assert fuzz(seconds, 1, make) > 3


@pytest.mark.timeout(900)
@pytest.mark.parametrize('seconds', LENGTHS)
def test_files(records, tmp_path, seconds):
    whole = next(write(tmp_path / 'whole', *records).glob('*.mcap')).read_bytes()

    def make(rng, _):
        path = tmp_path / 'x.mcap'
        path.write_bytes(mutated(whole, rng))
        return path

    assert fuzz(seconds, 2, make) > 3
