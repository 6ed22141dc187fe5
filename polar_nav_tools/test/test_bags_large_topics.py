"""Topics with large messages have chunks of their own; order and bytes are as they were."""

import numpy as np
import pytest
from bag_samples import IMU, START_NS, TYPES, imu, make, stamp, stamp_ns
from mcap.stream_reader import StreamReader
from strict_reader import strict_complaints

from polar_nav_tools.bags import BagWriter, open_bag
from polar_nav_tools.bags.claims import claimed_by_index
from polar_nav_tools.bags.recover import recover
from polar_nav_tools.bags.writer import LARGE_BYTES

SONAR, CAMERA = '/follower/sonar', '/follower/camera'
IMAGE = 'sensor_msgs/msg/Image'


def image(k, size):
    noise = np.random.default_rng(k).integers(0, 16, size, dtype=np.uint8)
    return make(IMAGE, **stamp(stamp_ns(k)), data=noise)


def write_with_images(directory, count=40, size=LARGE_BYTES, every=5, **options):
    """Bag with an IMU, a camera and a sonar; returns the .mcap file and what was written."""
    said = []
    with BagWriter(directory, {'seed': 7}, **{'flush_s': 1e9, **options}) as writer:
        writer.add_topic(IMU, TYPES[IMU])
        for topic in (CAMERA, SONAR):
            writer.add_topic(topic, IMAGE)
        for k in range(count):
            for topic, data in (
                (IMU, imu(k)),
                *(
                    [(CAMERA, image(k, size)), (SONAR, image(1000 + k, size))]
                    if k % every == 0
                    else []
                ),
            ):
                writer.write(topic, data, stamp_ns(k), stamp_ns(k))
                said.append((topic, data))
    return writer.path, said


def channels_of_chunks(path):
    file = claimed_by_index(path)
    return [{file.channels[n].topic for n in block.channels} for block in file.blocks]


def test_a_chunk_has_one_large_topic_or_none(tmp_path):
    path, said = write_with_images(tmp_path / 'b')
    held = channels_of_chunks(path)
    assert {frozenset(h) for h in held} == {frozenset({t}) for t in (IMU, CAMERA, SONAR)}
    assert [(t, data) for t, _, data in open_bag(path).messages()] == said
    assert strict_complaints(path) == []
    with path.open('rb') as stream:
        assert list(StreamReader(stream, validate_crcs=True).records)


def test_large_messages_in_a_row_share_chunks(tmp_path):
    with BagWriter(tmp_path / 'b', {}, chunk_bytes=4 * LARGE_BYTES, flush_s=1e9) as writer:
        writer.add_topic(CAMERA, IMAGE)
        for k in range(12):
            writer.write(CAMERA, image(k, LARGE_BYTES), stamp_ns(k))
    assert 3 <= len(channels_of_chunks(writer.path)) <= 4


def test_a_topic_that_became_large_stays_apart(tmp_path):
    with BagWriter(tmp_path / 'b', {}, flush_s=1e9) as writer:
        writer.add_topic(IMU, TYPES[IMU])
        writer.add_topic(CAMERA, IMAGE)
        for k, size in enumerate((10, LARGE_BYTES, 10, 10)):
            writer.write(IMU, imu(k), START_NS + k)
            writer.write(CAMERA, image(k, size), START_NS + k)
    first, *rest = channels_of_chunks(writer.path)
    assert first == {IMU, CAMERA}
    assert rest == [{CAMERA}, {IMU}, {CAMERA}, {IMU}, {CAMERA}]


@pytest.mark.parametrize('flush_s', [0.0, 1e9])
def test_killed_bags_lose_no_more_than_without_large_topics(tmp_path, flush_s):
    path, said = write_with_images(tmp_path / 'b', flush_s=flush_s)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    recovered = recover(path, tmp_path / 'again')
    bag = open_bag(recovered.target)
    kept = [(t, data) for t, _, data in bag.messages()]
    assert kept == said[: len(kept)]
    assert len(kept) > len(said) // 3
