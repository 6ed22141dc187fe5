"""A receipt is the same as an event, as a message, and as a row of a bag."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip('rclpy')

from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.navigation_outputs import receipt_from_msg, receipt_to_msg
from polar_nav_tools.bags.arrays import receipts_from_cdr
from polar_nav_tools.series.estimates import receipts_of

STAMPS = st.integers(0, 2**31 * 10**9 - 1)  # seconds of a message are int32
WORDS = st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=20)
NUMBERS = st.floats(width=64)
AXES = st.lists(NUMBERS, min_size=3, max_size=3).map(np.array)
RECEIPTS = st.builds(
    Receipt,
    stamp_ns=STAMPS,
    verdict=st.sampled_from(Verdict),
    reason=WORDS,
    topic=WORDS,
    source=WORDS,
    sequence=st.integers(0, 2**32 - 1),
    validity_ns=STAMPS,
    transmit_ns=STAMPS,
    receive_ns=STAMPS,
    fused_ns=STAMPS,
    delay_handling=WORDS,
    steps_rolled_back=st.integers(0, 2**31 - 1),
    innovation_G=AXES,
    innovation_variance_G=AXES,
    nis=NUMBERS,
    dof=st.integers(0, 3),
    gate=NUMBERS,
    revision=st.integers(0, 2**16 - 1),
)


def assert_same(a, b):
    assert type(a) is type(b)
    for field in dataclasses.fields(a):
        np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name), field.name)


@settings(deadline=None)
@given(RECEIPTS)
def test_event_message_and_row_have_the_same_content(receipt):
    message = receipt_to_msg(receipt)
    assert_same(receipt_from_msg(message), receipt)
    (row,) = receipts_from_cdr([to_bytes(message)])
    assert_same(row, *receipts_of([receipt]))
