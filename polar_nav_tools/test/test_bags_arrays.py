"""Truth, estimates and receipts of a vehicle, as a bag gives them."""

import dataclasses
import json
import re

import numpy as np
import pytest
from bag_samples import (
    RECEIPT,
    RUN_INFO,
    START_NS,
    STATE,
    TRUTH,
    TYPES,
    make,
    stamp,
    stamp_ns,
    store,
    truth,
    write_bag,
)

from polar_nav_core import nav_columns
from polar_nav_tools.bags import BagError, BagWriter, arrays, open_bag
from polar_nav_tools.bags.schemas import definition
from polar_nav_tools.series.vehicle import last_revisions


def state(k, **given):
    rng = np.random.default_rng(k)
    a = 0.1 + 0.01 * k
    return make(
        TYPES[STATE],
        **{
            **stamp(stamp_ns(k)),
            'configuration': 'modified_akf',
            'status': 1,
            'r_e': rng.normal(size=3),
            'v_g': rng.normal(size=3),
            'orientation__z': np.sin(a / 2),
            'orientation__w': np.cos(a / 2),
            'position_covariance_g': np.arange(9.0) + k,
            'gyro_bias_b': np.array([1.0, 2.0, 3.0]) * k,
            'fixes_received': k,
            'age_of_last_fix': np.nan,
            **given,
        },
    )


def receipt(k, **given):
    return make(
        TYPES[RECEIPT],
        **{
            **stamp(stamp_ns(k)),
            'sequence': k,
            'verdict': 0,
            'verdict_text': 'FUSED',
            'source': 'leader',
            'topic': '/follower/acomms/rx',
            'age': 4.5,
            'nis': 2.5,
            'validity_time__sec': 100 + k,
            'validity_time__nanosec': 7,
            'receive_time__sec': 105 + k,
            'degrees_of_freedom': 3,
            'gate': np.inf,
            'innovation_g': np.array([1.0, 2.0, 3.0]),
            **given,
        },
    )


@pytest.fixture
def bag(tmp_path):
    with BagWriter(tmp_path / 'b', {}) as writer:
        for topic in (TRUTH, STATE, RECEIPT):
            writer.add_topic(topic, TYPES[topic])
        for k in range(30):
            writer.write(TRUTH, truth(k), stamp_ns(k))
            if k % 3 == 0:
                writer.write(STATE, state(k), stamp_ns(k))
            if k % 10 == 5:
                writer.write(RECEIPT, receipt(k, reason='r' * k), stamp_ns(k))
    return open_bag(tmp_path / 'b')


def test_truth(bag):
    series = arrays.load_truth(bag, 'follower')
    decoded = [store(TYPES[TRUTH]).deserialize_cdr(truth(k), TYPES[TRUTH]) for k in range(30)]
    assert len(series) == 30
    assert series.vehicle == 'follower'
    assert series.stamp_ns.tolist() == [stamp_ns(k) for k in range(30)]
    assert series.sequence.tolist() == list(range(30))
    np.testing.assert_array_equal(series.r_e, [m.r_e for m in decoded])
    np.testing.assert_array_equal(series.v_G, [m.v_g for m in decoded])
    np.testing.assert_array_equal(series.C_b_G[4], np.eye(3) + 4)
    assert np.isnan(series.altitude).all()
    assert series.C_b_G.shape == (30, 3, 3)
    assert series.current_G.shape == (30, 3)


def test_estimates(bag):
    series = arrays.load_estimates(bag, 'follower')
    assert series.configuration == 'modified_akf'
    assert series.configurations == ('modified_akf',)
    assert series.stamp_ns.tolist() == [stamp_ns(k) for k in range(0, 30, 3)]
    assert series.fixes_received.tolist() == list(range(0, 30, 3))
    np.testing.assert_array_equal(series.P_position_G[1], np.arange(9.0).reshape(3, 3) + 3)
    np.testing.assert_array_equal(series.gyro_bias_b[2], [6.0, 12.0, 18.0])
    angle = 0.1 + 0.06
    expected = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    np.testing.assert_allclose(series.C_b_G[2], expected, atol=1e-15)
    assert np.isnan(series.age_of_last_fix).all()


def test_local_statistics_of_an_estimate():
    said = {'dvl_updates': 3, 'dvl_gated': 1, 'dvl_nis_sum': 7.5}
    said |= {'depth_updates': 5, 'depth_gated': 2, 'depth_nis_sum': 4.25}
    series = arrays.estimates_from_cdr([state(0), state(1, **said)], 'follower')
    np.testing.assert_array_equal(series.local_statistics[0], np.zeros((2, 3)))
    np.testing.assert_array_equal(series.local_statistics[1], [[3, 1, 7.5], [5, 2, 4.25]])


def test_a_bag_of_before_local_statistics_has_none(tmp_path):
    now = definition(TYPES[STATE])
    new = re.compile(r'\w+ (dvl|depth)_(updates|gated|nis_sum)\b')
    lines = now.text.splitlines()
    text = '\n'.join(line for line in lines if not new.match(line))
    assert len(lines) - len(text.splitlines()) == 6
    old = dataclasses.replace(now, text=text)
    with BagWriter(tmp_path / 'old', {}) as writer:
        writer.add_topic(STATE, TYPES[STATE], described=old)
        for k in range(5):
            data = state(k, dvl_updates=9)[:-32]  # the six numbers are the last ones
            writer.write(STATE, data, stamp_ns(k))
    series = arrays.load_estimates(open_bag(tmp_path / 'old'), 'follower')
    assert series.fixes_received.tolist() == list(range(5))
    np.testing.assert_array_equal(series.local_statistics, np.zeros((5, 2, 3)))


def test_receipts(bag):
    found = arrays.load_receipts(bag, 'follower')
    assert [r.sequence for r in found] == [5, 15, 25]
    first = found[0]
    assert first.stamp_ns == stamp_ns(5)
    assert first.verdict_text == 'FUSED'
    assert first.reason == 'rrrrr'
    assert first.validity_ns == 105_000_000_007
    assert first.receive_ns == 110_000_000_000
    assert first.transmit_ns is None
    assert first.fused_ns is None
    assert (first.age_s, first.nis, first.gate, first.degrees_of_freedom) == (4.5, 2.5, np.inf, 3)
    assert first.innovation_G.tolist() == [1.0, 2.0, 3.0]
    assert type(first.sequence) is int
    assert arrays.load_receipts(bag, 'nobody') == []


@pytest.mark.parametrize(
    ('versions', 'dof'), [((), 2), ((None,), 2), ((13,), 2), ((14,), 3), ((14, 13), 2)]
)
def test_degrees_of_freedom_are_read_as_their_engine_meant_them(tmp_path, versions, dof):
    """Three rows of 10 km of vertical sigma: older engines counted all rows of any fix."""
    with BagWriter(tmp_path / 'b', {}) as writer:
        for topic in (RUN_INFO, RECEIPT):
            writer.add_topic(topic, TYPES[topic])
        for k, version in enumerate(versions):
            said = {'node': f'/follower/node_{k}', 'engine_version': version}
            writer.write(RUN_INFO, make(TYPES[RUN_INFO], data=json.dumps(said)), stamp_ns(0))
        writer.write(RECEIPT, receipt(1, innovation_variance_g=np.array([1.0, 1.0, 1e8])), 1)
    (found,) = arrays.load_receipts(open_bag(tmp_path / 'b'), 'follower')
    assert found.degrees_of_freedom == dof


def test_slices_of_a_series(bag):
    series = arrays.load_truth(bag, 'follower')
    part = series.between(stamp_ns(10), stamp_ns(20))
    assert part.sequence.tolist() == list(range(10, 20))
    assert part.vehicle == 'follower'
    assert series.rows(np.array([3, 1])).sequence.tolist() == [3, 1]


def test_serialized_messages_from_elsewhere():
    messages = [state(k) for k in range(5)]
    messages.append(state(5, configuration='conventional_akf'))
    series = arrays.estimates_from_cdr(messages, 'follower')
    assert series.configurations == ('modified_akf', 'conventional_akf')
    assert len(arrays.truth_from_cdr([truth(0)], 'v')) == 1
    assert arrays.receipts_from_cdr([receipt(3)])[0].sequence == 3
    assert len(arrays.estimates_from_cdr([], 'follower')) == 0


def test_what_is_missing_or_wrong(tmp_path, bag):
    with pytest.raises(BagError, match='has no topic /nobody/truth; it has /follower/nav/receipt'):
        arrays.load_truth(bag, 'nobody')
    with BagWriter(tmp_path / 'x', {}) as writer:
        writer.add_topic(TRUTH, TYPES[STATE])
        writer.write(TRUTH, state(0), START_NS)
        writer.add_topic(STATE, TYPES[STATE])
        writer.write(STATE, state(0)[:99], START_NS)
        writer.add_topic('/empty/truth', TYPES[TRUTH])
    other = open_bag(tmp_path / 'x')
    with pytest.raises(BagError, match=f'x: {TRUTH} is a {TYPES[STATE]}, not a {TYPES[TRUTH]}'):
        arrays.load_truth(other, 'follower')
    with pytest.raises(BagError, match=f'x: {STATE}: a message of 99 bytes ends before'):
        arrays.load_estimates(other, 'follower')
    with pytest.raises(BagError, match='no message on /empty/truth'):
        arrays.load_truth(other, 'empty')


def test_quaternions():
    rng = np.random.default_rng(5)
    q = rng.normal(size=(50, 4))
    C = nav_columns.rotations(q)
    np.testing.assert_allclose(
        C @ C.transpose(0, 2, 1), np.tile(np.eye(3), (50, 1, 1)), atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.det(C), 1.0, atol=1e-14)
    # v' = q v q* by hand, for one vector
    x, y, z, w = q[0] / np.linalg.norm(q[0])
    u, v = np.array([x, y, z]), np.array([1.0, -2.0, 0.5])
    t = 2.0 * np.cross(u, v)
    np.testing.assert_allclose(C[0] @ v, v + w * t + np.cross(u, t), atol=1e-14)
    assert np.isnan(nav_columns.rotations(np.zeros((1, 4)))).all()


def test_last_revisions_decide():
    found = arrays.receipts_from_cdr(
        [
            receipt(0),
            receipt(1),
            receipt(1, verdict=2, verdict_text='DUPLICATE'),
            receipt(0, revision=1, verdict=1, verdict_text='GATED'),
            receipt(1, receive_time__sec=300, verdict=2, verdict_text='DUPLICATE'),
            receipt(0, revision=2, verdict=0, verdict_text='FUSED'),
        ]
    )
    final = last_revisions(found)
    assert [(r.sequence, r.verdict_text, r.revision) for r in final] == [
        (0, 'FUSED', 2),
        (1, 'FUSED', 0),
        (1, 'DUPLICATE', 0),
        (1, 'DUPLICATE', 0),
    ]


def last_by_message(receipts):
    """Last revisions, by a table of messages."""
    final, firsts = {}, {}
    for one in receipts:
        if one.revision == 0:
            firsts[one.key] = firsts.get(one.key, -1) + 1
            final[(one.key, firsts[one.key])] = one
        elif (one.key, 0) not in final or final[(one.key, 0)].revision <= one.revision:
            final[(one.key, 0)] = one
    return list(final.values())


def test_last_revisions_in_any_order():
    rng = np.random.default_rng(5)
    for count in (0, 1, *rng.integers(2, 12, 200)):
        drawn = zip(rng.integers(0, 3, count), rng.integers(0, 3, count), strict=True)
        found = arrays.receipts_from_cdr([receipt(int(k), revision=int(r)) for k, r in drawn])
        expected, last = last_by_message(found), last_revisions(found)
        assert [id(one) for one in last] == [id(one) for one in expected]
        assert len(last) == len(expected)
        assert [id(one) for one in last[1:]] == [id(one) for one in expected[1:]]


def test_large_series_is_read_in_batches(tmp_path):
    bag = open_bag(write_bag(tmp_path / 'b', 300))
    assert arrays.load_truth(bag, 'follower').sequence.tolist() == list(range(300))
