"""Copies of fixes: what makes one, and that no number can be used up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.fix_record import FixRecord, content_of
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.link.fields import TICK_NS, WRAP

WRAP_NS = WRAP * TICK_NS


def fix(number: int, validity_ns: int, place: float = 1.0, source: str = 'leader') -> Fix:
    """Fix valid then, received 1 s later."""
    r_e = np.array([6.37e6, place, 0.0])
    received_ns = validity_ns + 10**9
    return Fix(
        validity_ns, received_ns, received_ns, source, number, number, 0, r_e, np.eye(3),
        array_heading=0.5,
    )  # fmt: skip


def copy_of(record: FixRecord, f: Fix, *, numbers: bool = True) -> Verdict | None:
    return record.copy_of(f, f.validity_ns, numbers=numbers)


@pytest.fixture
def record() -> FixRecord:
    record = FixRecord(100)
    f = fix(7, 5 * 10**9)
    record.add(f, f.validity_ns)
    return record


def test_the_same_fix_again_is_a_duplicate(record):
    assert copy_of(record, fix(7, 5 * 10**9)) is Verdict.DUPLICATE


def test_other_content_under_its_number_and_time_is_a_duplicate(record):
    assert copy_of(record, fix(7, 5 * 10**9, 2.0)) is Verdict.DUPLICATE
    # Unless the stored one was refused: then it may be the genuine one.
    assert copy_of(record, fix(7, 5 * 10**9, 2.0), numbers=False) is None


def test_other_content_under_its_number_and_time_contradicts_it(record):
    assert record.contradicts(fix(7, 5 * 10**9, 2.0), 5 * 10**9)
    assert not record.contradicts(fix(7, 5 * 10**9), 5 * 10**9)
    assert not record.contradicts(fix(8, 5 * 10**9, 2.0), 5 * 10**9)
    assert not record.contradicts(fix(7, 6 * 10**9, 2.0), 6 * 10**9)


def test_its_content_under_another_number_is_a_replay(record):
    assert copy_of(record, fix(8, 5 * 10**9)) is Verdict.REPLAYED
    assert copy_of(record, fix(8, 5 * 10**9, source='somebody')) is Verdict.REPLAYED


def test_its_number_at_another_time_is_another_fix(record):
    """A leader that was restarted counts from 0 again; 16 bits wrap."""
    assert copy_of(record, fix(7, 6 * 10**9)) is None


def test_another_source_may_have_the_same_number_at_that_time(record):
    assert copy_of(record, fix(7, 5 * 10**9, 2.0, source='ship')) is None


def test_its_bytes_after_the_wrap_of_time_are_a_replay(record):
    assert copy_of(record, fix(7, 5 * 10**9 + WRAP_NS)) is Verdict.REPLAYED
    assert copy_of(record, fix(7, 5 * 10**9 + WRAP_NS, 2.0)) is None


def test_fixes_may_be_added_in_any_order():
    record = FixRecord(100)
    fixes = [fix(k, t * 10**9, k) for k, t in enumerate((5, 3, 9, 3, 7))]
    for f in fixes:
        record.add(f, f.validity_ns)
    assert all(copy_of(record, f) is Verdict.DUPLICATE for f in fixes)
    assert copy_of(record, fix(9, 3 * 10**9, 1.0)) is Verdict.REPLAYED


def test_it_is_bounded_and_drops_the_oldest():
    record = FixRecord(100)
    for k in range(5000):
        record.add(fix(k, k * 10**9), k * 10**9)
    assert 100 <= len(record) <= 1200
    assert copy_of(record, fix(4999, 4999 * 10**9)) is Verdict.DUPLICATE
    assert copy_of(record, fix(0, 0)) is None


def test_it_survives_packing(record):
    other = FixRecord(100)
    other.unpack(record.pack())
    assert copy_of(other, fix(8, 5 * 10**9)) is Verdict.REPLAYED
    assert len(other) == 1
    with pytest.raises(ValueError, match='length'):
        other.unpack(record.pack()[:-1])
    late = fix(1, 9 * 10**9)
    record.add(late, late.validity_ns)
    swapped = record.pack()
    with pytest.raises(ValueError, match='order'):
        other.unpack(swapped[8:16] + swapped[:8] + swapped[16:])


@pytest.mark.parametrize(
    'changes',
    [
        {'r_e': np.array([6.37e6, 1.0, 1e-9])},
        {'covariance_e': 2.0 * np.eye(3)},
        {'relative_e': np.ones(3)},
        {'array_heading': 0.6},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_content_is_what_the_filter_uses(changes):
    f = fix(1, 10**9)
    assert content_of(replace(f, **changes)) != content_of(f)
    assert content_of(replace(f, sequence=2, receive_ns=7, source='x')) == content_of(f)
