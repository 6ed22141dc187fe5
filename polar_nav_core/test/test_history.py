"""Looking up epochs in a ring that has come round, against a plain search."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polar_nav_core.engine.sins.history import History, make_past
from polar_nav_core.kernels.sins import state as fs


@pytest.mark.parametrize('count', [0, 1, 2, 11, 12, 13, 30, 36])
@given(offset=st.integers(-3, 420))
def test_the_epoch_before_a_stamp(count, offset):
    past, state = make_past(0.04, 0.1), fs.make_state()
    length = len(past.stamps)
    assert length == 12
    stamps = 1000 + 10 * np.arange(count)
    for number, stamp in enumerate(stamps):
        past.stamps[number % length] = stamp
        past.positions[number % length] = (6.4e6, number, 0.0)
    state.counters[fs.EPOCHS] = count
    epoch = History(past, state).before(1000 + offset)
    kept = range(max(0, count - length), count)
    expected = [n for n in kept if stamps[n] <= 1000 + offset]
    if expected and stamps[kept[0]] <= 1000 + offset:
        assert (epoch.number, epoch.stamp_ns) == (expected[-1], stamps[expected[-1]])
    else:
        assert epoch is None
