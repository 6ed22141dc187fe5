"""Columns: vectorised decoding gives the numbers that decoding one by one gives."""

import numpy as np
import pytest
from bag_samples import TYPES, make, stamp, store
from hypothesis import given, settings
from hypothesis import strategies as st

from polar_nav_tools.bags import columns as columns_module
from polar_nav_tools.bags.columns import read_columns
from polar_nav_tools.bags.errors import BagError
from polar_nav_tools.bags.layout import layout_of
from polar_nav_tools.bags.schemas import definition

ACK = 'polar_nav_msgs/msg/LockstepAck'
DVL = 'polar_nav_msgs/msg/Dvl'
RECEIPT = 'polar_nav_msgs/msg/FixReceipt'


def columns(messages, name, fields, **options):
    return read_columns(messages, name, definition(name).text, fields, **options)


def fields_of(name, message):
    """Every field of a message that can be a column."""
    return list(layout_of(store(name), name, message).leaves)


def assert_same(fast, slow):
    assert fast.keys() == slow.keys()
    for name in fast:
        assert fast[name].dtype == slow[name].dtype, name
        assert fast[name].shape == slow[name].shape, name
        if fast[name].dtype == object:
            assert fast[name].tolist() == slow[name].tolist()
        else:
            np.testing.assert_array_equal(fast[name], slow[name])


def receipts(count, rng):
    words = ['', 'a', 'fix 12 s old', 'größer als 3 σ', 'x' * 40]
    return [
        make(
            RECEIPT,
            **stamp(10**18 + k),
            verdict=k % 13,
            verdict_text=str(rng.choice(words)),
            reason=str(rng.choice(words)),
            topic='/f/acomms/rx',
            source=f'v{k % 3}',
            sequence=k,
            age=float(rng.normal()),
            innovation_g=rng.normal(size=3),
            nis=np.nan,
            gate=np.inf,
        )
        for k in range(count)
    ]


@pytest.mark.parametrize('name', [TYPES[t] for t in TYPES] + [DVL, RECEIPT, ACK])
def test_every_field_of_our_messages(name):
    messages = [make(name)] * 3
    fields = fields_of(name, messages[0])
    fast = columns(messages, name, fields)
    assert_same(fast, columns(messages, name, fields, max_layouts=0))
    assert all(len(c) == 3 for c in fast.values())


def test_texts_of_many_lengths_keep_the_order():
    rng = np.random.default_rng(1)
    messages = receipts(500, rng)
    fields = fields_of(RECEIPT, messages[0])
    fast = columns(messages, RECEIPT, fields)
    slow = columns(messages, RECEIPT, fields, max_layouts=0)
    mixed = columns(messages, RECEIPT, fields, max_layouts=5)
    assert_same(fast, slow)
    assert_same(mixed, slow)
    assert fast['sequence'].tolist() == list(range(500))
    assert 'größer als 3 σ' in fast['reason']
    assert fast['sequence'].dtype == np.uint32


def test_batches_are_joined(monkeypatch):
    monkeypatch.setattr(columns_module, 'BATCH', 7)
    messages = receipts(50, np.random.default_rng(2))
    found = columns(messages, RECEIPT, ['sequence', 'source'])
    assert found['sequence'].tolist() == list(range(50))
    assert found['source'].tolist() == [f'v{k % 3}' for k in range(50)]


@settings(max_examples=60, deadline=None)
@given(
    rows=st.lists(
        st.tuples(
            st.text(st.characters(exclude_categories=['Cs'], exclude_characters='\0'), max_size=9),
            st.lists(st.integers(0, 2**64 - 1), max_size=4),
            st.lists(st.integers(0, 2**32 - 1), max_size=3),
            st.lists(st.sampled_from(['', '/a', '/topic']), max_size=3),
        ),
        min_size=1,
        max_size=12,
    )
)
def test_alignment_and_lengths_against_rosbags(rows):
    """Strings, sequences of 4 and 8 byte numbers, empty ones too, in every order of lengths."""
    messages = [
        make(
            ACK,
            node=node,
            sequence=i,
            published_topics=texts,
            published_counts=np.array(longs, np.uint64),
            published_matched=np.array(ints, np.uint32),
        )
        for i, (node, longs, ints, texts) in enumerate(rows)
    ]
    fields = ['node', 'sequence']
    assert_same(columns(messages, ACK, fields), columns(messages, ACK, fields, max_layouts=0))
    for message, (_, longs, ints, texts) in zip(messages, rows, strict=True):
        leaves = layout_of(store(ACK), ACK, message).leaves
        found = columns([message], ACK, list(leaves))
        assert found['published_counts'][0].tolist() == longs
        assert found['published_matched'][0].tolist() == ints
        assert [found[f'published_topics[{i}]'][0] for i in range(len(texts))] == texts


def test_agrees_with_what_rclpy_sends():
    serialization = pytest.importorskip('rclpy.serialization')
    from polar_nav_msgs.msg import LockstepAck

    for longs, ints in (([], []), ([], [1]), ([1, 2], []), ([5], [6, 7])):
        message = LockstepAck(
            node='/n',
            sequence=3,
            published_topics=['/abc'] * len(longs),
            published_counts=longs,
            published_matched=ints,
            taken_topics=['x'],
            taken_counts=[2**40],
            taken_matched=[9],
        )
        data = serialization.serialize_message(message)
        found = columns([data], ACK, fields_of(ACK, data))
        assert found['published_counts'][0].tolist() == longs
        assert found['published_matched'][0].tolist() == ints
        assert found['taken_counts'][0].tolist() == [2**40]
        assert found['taken_topics[0]'][0] == 'x'
        assert found['taken_matched'][0].tolist() == [9]


def test_nested_arrays_of_messages():
    unit = type(store(DVL).types['geometry_msgs/msg/Vector3'](x=0.0, y=0.0, z=0.0))
    beams = [unit(x=float(i), y=0.5, z=-1.0) for i in range(4)]
    messages = [make(DVL, beam_unit_vec=beams, num_good_beams=3, beam_ranges_valid=True)] * 2
    fields = ['beam_unit_vec[2].x', 'beam_unit_vec[3].x', 'beam_ranges_valid', 'num_good_beams']
    found = columns(messages, DVL, fields)
    assert [found[f][1] for f in fields] == [2.0, 3.0, 1, 3]
    assert_same(found, columns(messages, DVL, fields, max_layouts=0))


def test_big_endian():
    name = RECEIPT
    types = store(name)
    little = receipts(4, np.random.default_rng(3))
    big = [
        types.serialize_cdr(types.deserialize_cdr(m, name), name, little_endian=False).tobytes()
        for m in little
    ]
    assert big[0][1] == 0
    fields = fields_of(name, little[0])
    assert_same(columns(big, name, fields), columns(little, name, fields))
    both = [m for pair in zip(little, big, strict=True) for m in pair]
    assert columns(both, name, ['sequence'])['sequence'].tolist() == [0, 0, 1, 1, 2, 2, 3, 3]


def test_no_message():
    assert len(columns([], RECEIPT, ['sequence'])['sequence']) == 0


@pytest.mark.parametrize('options', [{}, {'max_layouts': 0}])
def test_what_is_refused(options):
    good = receipts(3, np.random.default_rng(4))
    fields = ['sequence']
    for bad, sentence in (
        (good[0][:50], 'ends before|is no'),
        (b'', 'less than its encapsulation'),
        (b'\0\3\0\0' + good[0][4:], 'not plain CDR'),
    ):
        with pytest.raises(BagError, match=sentence):
            columns([bad], RECEIPT, fields, **options)
    with pytest.raises(BagError, match='there is no field speed'):
        columns(good, RECEIPT, ['speed'], **options)
    acks = [make(ACK, taken_counts=np.arange(n, dtype=np.uint64)) for n in (1, 2)]
    with pytest.raises(BagError, match='taken_counts has rows of different length'):
        columns(acks, ACK, ['taken_counts'], **options)


def test_what_cannot_be_a_column():
    for text, sentence in (
        ('wstring w\n', 'lacks a/msg/wstring'),
        ('', 'no definition'),
        ('uint8 = =', 'not understood'),
        ('b/Missing m\n', 'lacks b/msg/Missing'),
        ('uint8 x\n', 'no field y'),
    ):
        with pytest.raises(BagError, match=sentence):
            read_columns([b'\0\1\0\0' + bytes(16)], 'a/msg/A', text, ['y'])
