"""Truth messages as bytes, both ways, against rclpy's own where there is one."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from polar_nav_sim.mission import load_mission
from polar_nav_sim.truth_cdr import FIELDS, decode, encode, since_start_ns
from polar_nav_sim.truth_stream import TruthStream

MISSION = load_mission('dive').with_duration(3.05).with_overrides({'sea_floor_depth_m': 200.0})
BLOCK = MISSION.truth('follower').samples(0, 60)
MESSAGES = encode(BLOCK)


def test_decode_is_the_inverse_of_encode():
    for k in (0, 59):
        sample = decode(MESSAGES[k])
        assert sample.stamp_ns == BLOCK.stamp_ns[k]
        assert sample.sequence == k
        assert_array_equal(sample.vector('delta_v_b'), BLOCK.delta_v_b[k])
        assert_array_equal(sample.C_b_G, BLOCK.state.C_b_G[k])
        assert sample.number('altitude') == BLOCK.state.altitude[k]
        assert sample.since_start_ns == since_start_ns(MESSAGES[k]) == k * 10_000_000


def test_damaged_bytes_are_refused():
    for bad in (b'', MESSAGES[0][:100], b'\x00\x00' + MESSAGES[0][2:], MESSAGES[0][:-4]):
        with pytest.raises(ValueError, match='bytes are'):
            decode(bad)


def test_stream_gives_every_sample_of_every_vehicle_once():
    stream = TruthStream(MISSION)
    assert stream.count == 306
    stamps = []
    for k in range(stream.count):
        sample = stream.sample(k)
        assert list(sample) == ['leader', 'follower']
        stamps.append(decode(sample['follower']).stamp_ns)
        stream.prepare(k)
    assert stamps == [MISSION.start_ns + k * 10_000_000 for k in range(306)]
    assert sample['follower'] == encode(MISSION.truth('follower').samples(300, 306))[5]


def test_bytes_are_those_of_rclpy():
    serialization = pytest.importorskip('rclpy.serialization')
    msg_types = pytest.importorskip('polar_nav_msgs.msg')
    msg = serialization.deserialize_message(MESSAGES[30], msg_types.VehicleTruth)
    assert msg.header.frame_id == 'earth'
    assert msg.sequence == 30
    assert msg.depth == BLOCK.state.depth[30]
    assert_array_equal(msg.omega_ib_b, BLOCK.state.omega_ib_b[30])
    fields = msg.get_fields_and_field_types()
    assert list(fields)[2:] == list(FIELDS)
    ours = np.frombuffer(MESSAGES[30], np.uint8).copy()
    theirs = np.frombuffer(serialization.serialize_message(msg), np.uint8).copy()
    # Six bytes of padding behind the frame are whatever was in memory.
    ours[22:28] = theirs[22:28] = 0
    assert_array_equal(ours, theirs)
