"""A recorder that was killed goes on in a next file of the same bag."""

import pytest
import yaml
from bag_samples import IMU, TYPES, imu
from rosbags.highlevel import AnyReader

from polar_nav_tools.bags import BagError, BagWriter, open_bag
from polar_nav_tools.bags.info import bag_info
from polar_nav_tools.bags.recover import recover
from polar_nav_tools.bags.rosbag2_metadata import ROOT_KEY


def part(path, numbers, *, resume, finished):
    writer = BagWriter(path, {'seed': 1}, resume=resume)
    writer.add_topic(IMU, TYPES[IMU])
    for k in numbers:
        writer.write(IMU, imu(k), 10**9 + k * 10**7)
    writer.flush()
    if finished:
        count = {IMU: {'count': len(numbers), 'lost': 0}}
        writer.finish({'recording': {'topics': count}})
    else:
        writer.abandon()
    return writer.path


@pytest.fixture
def resumed(tmp_path):
    path = tmp_path / 'b'
    part(path, range(100), resume=True, finished=False)
    part(path, range(150, 180), resume=True, finished=False)
    part(path, range(200, 300), resume=True, finished=True)
    return path


def test_the_files_are_one_bag(resumed):
    bag = open_bag(resumed)
    assert [f.path.name for f in bag.files] == ['b_0.mcap', 'b_1.mcap', 'b_2.mcap']
    expected = [*range(100), *range(150, 180), *range(200, 300)]
    assert [d for _, _, d in bag.messages()] == [imu(k) for k in expected]
    holes = [(b - a) // 10**7 for a, b in bag.holes_ns]
    assert holes == [51, 21]
    said = [p.partition(';')[0] for p in bag.problems]
    assert 'b_1.mcap: goes on 0.510 s after the file before' in said
    assert 'b_2.mcap: goes on 0.210 s after the file before' in said
    assert sum('not finished' in p for p in said) == 2
    assert len(said) == 4  # and each recorder's own counts are right
    found = bag_info(bag)
    assert found.message_count == 230
    assert not found.is_complete


def test_metadata_has_all_files_for_others(resumed, tmp_path):
    metadata = yaml.safe_load((resumed / 'metadata.yaml').read_text())[ROOT_KEY]
    assert metadata['message_count'] == 230
    assert [f['message_count'] for f in metadata['files']] == [100, 30, 100]
    (topic,) = metadata['topics_with_message_count']
    assert topic['message_count'] == 230
    assert metadata['duration']['nanoseconds'] == 299 * 10**7
    recover(resumed, tmp_path / 'mended')  # others read no file without its index
    with AnyReader([tmp_path / 'mended']) as reader:
        assert reader.message_count == 230


def test_a_first_file_that_is_no_bag_is_left_out(tmp_path):
    path = tmp_path / 'b'
    path.mkdir()
    (path / 'b_0.mcap').write_bytes(b'')
    assert part(path, range(10), resume=True, finished=True).name == 'b_1.mcap'
    assert open_bag(path).message_count == 10


def test_without_resume_a_bag_is_never_touched(resumed):
    with pytest.raises(BagError, match='exists already'):
        BagWriter(resumed, {})


def test_counts_of_the_wrong_file_are_a_problem(tmp_path):
    path = tmp_path / 'b'
    part(path, range(100), resume=True, finished=True)
    writer = BagWriter(path, {}, resume=True)
    writer.add_topic(IMU, TYPES[IMU])
    writer.write(IMU, imu(0), 3 * 10**9)
    writer.finish({'recording': {'topics': {IMU: {'count': 101, 'lost': 2}}}})
    said = open_bag(path).problems
    assert said == [
        f'{IMU}: the recorder wrote 101 messages, 1 are there',
        f'{IMU}: 2 messages were lost on the way to the recorder',
    ]
