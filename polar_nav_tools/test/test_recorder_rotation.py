"""A bag that goes on in a next file by size or time: one bag for every reader."""

from pathlib import Path

import pytest
import yaml
from bag_samples import IMU, TRUTH, TYPES, imu, truth
from rosbags.highlevel import AnyReader

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import from_mapping
from polar_nav_tools.bags import BagWriter, open_bag
from polar_nav_tools.bags.info import bag_info
from polar_nav_tools.bags.rosbag2_metadata import ROOT_KEY
from polar_nav_tools.record.params import RecorderParams
from polar_nav_tools.record.recording import Recording, Rotation

REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference_4'
WALL_NS = 1_900_000_000_000_000_000
STEP_NS = 10_000_000


def record(path, count, *, lost=(), resume=False, finish=True, **limits):
    """Record so many IMU samples, each tenth with a truth; some publications never arrived."""

    def opened(resume=True):
        return BagWriter(path, {'seed': 1}, resume=resume, chunk_bytes=4096)

    rotation = Rotation(opened, **limits)
    recording = Recording(opened(resume), simulated=False, rotation=rotation)
    for topic, kind in TYPES.items():
        recording.add_topic(topic, kind)
    number = 0
    for k in range(count):
        number += 1 + (k in lost)
        recording.take(IMU, imu(k), WALL_NS + k * STEP_NS, number)
        if k % 10 == 0:
            recording.take(TRUTH, truth(k), WALL_NS + k * STEP_NS)
        if k % 7 == 0:
            recording.commit()
    if finish:
        recording.finish()
    else:
        recording.commit()
        recording.abandon()
    return recording


def spans_s(bag):
    return [(f.last_ns - f.first_ns) * 1e-9 for f in bag.files]


def test_by_time(tmp_path):
    record(tmp_path / 'b', 1000, max_ns=3 * 10**9)
    bag = open_bag(tmp_path / 'b')
    assert [f.path.name for f in bag.files] == [f'b_{n}.mcap' for n in range(4)]
    assert spans_s(bag) == pytest.approx([2.99, 2.99, 2.99, 0.99])
    assert [d for _, _, d in bag.messages([IMU])] == [imu(k) for k in range(1000)]
    assert bag.problems == []
    assert bag.holes_ns == []
    assert bag_info(bag).is_complete


def test_by_size(tmp_path):
    record(tmp_path / 'b', 2000, max_bytes=30_000)
    bag = open_bag(tmp_path / 'b')
    sizes = [f.path.stat().st_size for f in bag.files]
    assert len(sizes) >= 3
    assert all(30_000 <= size < 60_000 for size in sizes[:-1])
    assert [d for _, _, d in bag.messages([IMU])] == [imu(k) for k in range(2000)]
    assert bag.problems == []


def test_metadata_names_all_files_for_others(tmp_path):
    record(tmp_path / 'b', 1000, max_ns=3 * 10**9)
    metadata = yaml.safe_load((tmp_path / 'b' / 'metadata.yaml').read_text())[ROOT_KEY]
    assert metadata['message_count'] == 1100
    assert metadata['relative_file_paths'] == [f'b_{n}.mcap' for n in range(4)]
    assert [f['message_count'] for f in metadata['files']] == [330, 330, 330, 110]
    with AnyReader([tmp_path / 'b']) as reader:
        assert reader.message_count == 1100


def test_losses_count_in_the_file_that_they_are_of(tmp_path):
    recording = record(tmp_path / 'b', 1000, lost=(5, 6, 400), max_ns=3 * 10**9)
    assert recording.lost == 3
    assert open_bag(tmp_path / 'b').problems == [
        f'{IMU}: 2 messages were lost on the way to the recorder',
        f'{IMU}: 1 messages were lost on the way to the recorder',
    ]


def test_a_killed_recorder_leaves_all_files_and_another_goes_on(tmp_path):
    path = tmp_path / 'b'
    record(path, 500, max_ns=3 * 10**9, finish=False)
    bag = open_bag(path)
    assert [f.finished for f in bag.files] == [True, False]
    assert bag.message_count >= 540  # the last chunk is lost
    record(path, 700, resume=True, max_ns=3 * 10**9)
    bag = open_bag(path)
    assert [f.finished for f in bag.files] == [True, False, True, True, True]
    assert sum('goes on' in p for p in bag.problems) == 1


def test_a_bag_that_is_gone_on_with_has_all_files_also_before_its_end(tmp_path):
    path = tmp_path / 'b'
    record(path, 100)
    record(path, 100, resume=True, finish=False)
    assert [f.finished for f in open_bag(path).files] == [True, False]


@pytest.mark.parametrize('wrong', [{'max_bag_size': -1}, {'max_bag_duration': -0.5}])
def test_limits_are_checked(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        from_mapping(RecorderParams, wrong)


@pytest.mark.slow
def test_doctor_replay_and_verify_read_a_split_recording(tmp_path):
    pytest.importorskip('rclpy')
    from polar_nav_tools.doctor.examine import examine
    from polar_nav_tools.replay.recorded import load_inputs
    from polar_nav_tools.replay.verification import verify

    whole = open_bag(REFERENCE)

    def opened(resume=True):
        info = {k: v for k, v in whole.run_info.items() if k != 'recording'}
        return BagWriter(tmp_path / 'b', info, resume=resume)

    rotation = Rotation(opened, max_ns=8 * 10**9)
    recording = Recording(opened(resume=False), simulated=False, rotation=rotation)
    for topic in whole.topics:
        recording.add_topic(topic, whole.channel(topic).type)
    for r in whole.records():
        recording.take(r.topic, r.data, r.log_time_ns)
    split = open_bag(recording.finish())
    assert len(split.files) >= 4
    assert [(r.topic, r.log_time_ns, r.data) for r in split.records()] == [
        (r.topic, r.log_time_ns, r.data) for r in whole.records()
    ]
    result = verify(load_inputs(split, 'follower'))
    assert result.equal
    assert {f.severity for f in examine(split).findings} == {
        f.severity for f in examine(whole).findings
    }
