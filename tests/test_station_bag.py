"""The small bag of a station run: what was published live = its replay by messages = by arrays."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy')

from polar_nav_tools.bags import open_bag
from polar_nav_tools.bags.arrays import (
    estimates_from_cdr,
    load_estimates,
    load_receipts,
    receipts_from_cdr,
)
from polar_nav_tools.bags.model import model_run_from_cdr
from polar_nav_tools.live.run_info import cpu_model, versions
from polar_nav_tools.replay.arrays_from_bag import load_arrays
from polar_nav_tools.replay.by_array import replay_arrays
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.replay.recorded import load_inputs
from polar_nav_tools.series.closeness import closeness

BAG = Path(__file__).parents[1] / 'bags' / 'station'
OUTPUTS = ('nav/state', 'nav/receipt', 'nav/current', 'nav/model', 'nav/identification')


@pytest.fixture(scope='module')
def bag():
    return open_bag(BAG)


@pytest.fixture(scope='module')
def replayed(bag):
    return replay(bag)


def test_the_bag_has_what_it_is_kept_for(bag):
    assert bag.problems == []
    receipts = load_receipts(bag, 'auv')
    assert {r.verdict_text for r in receipts} == {'FUSED', 'BAD_CRC'}
    late_s = [r.age_s for r in receipts if r.verdict_text == 'FUSED']
    assert len(late_s) > 40
    assert 1.0 < min(late_s) < max(late_s) < 3.0
    identified = [m for _, m in bag.read('/auv/nav/identification')]
    assert [m.verdict_text for m in identified] == ['TOO_FEW_FIXES', 'NOT_EXCITED']
    assert np.isfinite(identified[1].values).all()


def test_live_is_the_replay_by_messages(bag, replayed):
    """Bit for bit where it was recorded; elsewhere to a millionth of sigma, same verdicts."""
    live = load_inputs(bag).live
    assert set(live) == set(OUTPUTS)
    recorded = (bag.run_info['cpu'], bag.run_info['versions'])
    if all(live[topic] == replayed.of(topic) for topic in OUTPUTS):
        return
    assert recorded != (cpu_model(), versions()), 'same processor and versions, other bytes'
    found = closeness(load_estimates(bag, 'auv'), estimates_from_cdr(replayed.of('nav/state'), ''))
    assert found.close, found
    verdicts = [
        [r.verdict for r in receipts_from_cdr(messages)]
        for messages in (live['nav/receipt'], replayed.of('nav/receipt'))
    ]
    assert verdicts[0] == verdicts[1]


@pytest.mark.parametrize('name', [None, 'published', 'tagged', 'clone'])
def test_arrays_give_the_bits_of_the_messages(bag, replayed, name):
    slow = replayed if name is None else replay(bag, configuration=name)
    fast = replay_arrays(load_arrays(bag), configuration=name)
    assert (fast.taken, fast.verdicts) == (slow.taken, slow.verdicts)
    assert_same(fast.estimates, estimates_from_cdr(slow.of('nav/state'), 'auv'))
    model = model_run_from_cdr(slow.of('nav/model'), slow.of('nav/identification'), None)
    assert_same(fast.model.estimated, model.estimated)
    assert len(model.identified) >= 2
    for one, other in zip(fast.model.identified, model.identified, strict=True):
        assert repr(one) == repr(other)  # floats in full; NaN like NaN
    receipts = receipts_from_cdr(slow.of('nav/receipt'))
    assert len(fast.receipts) == len(receipts) > 40
    for one, other in zip(fast.receipts, receipts, strict=True):
        assert_same(one, other)


def assert_same(one, other):
    """All fields of two dataclasses, to the last bit."""
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, float | np.ndarray):
            np.testing.assert_array_equal(a, b, err_msg=field.name)
        else:
            assert a == b, field.name
