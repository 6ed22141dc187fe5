"""Receipts of a long run: those that lie in columns are those that were added."""

import dataclasses

import numpy as np
import pytest

from polar_nav_core.engine import receipt_rows
from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.receipt_rows import Receipts
from polar_nav_core.engine.verdicts import Verdict

COUNT = 100


@pytest.fixture(autouse=True)
def few(monkeypatch):
    monkeypatch.setattr(receipt_rows, '_KEPT', 20)
    monkeypatch.setattr(receipt_rows, '_MADE', 8)
    monkeypatch.setattr(receipt_rows, '_BLOCKS', 2)


def receipt(k):
    rng = np.random.default_rng(k)
    return Receipt(
        stamp_ns=10**18 + k,
        verdict=Verdict(k % len(Verdict)),
        reason='' if k % 7 == 0 else f'{k}: \ud800 grün' * (k % 5),
        topic=f'topic {k % 3}',
        source=f'leader {k % 2}',
        sequence=2**32 - k,
        validity_ns=k,
        delay_handling='clone',
        steps_rolled_back=k,
        innovation_G=np.array([-0.0, np.nan, k]),
        innovation_variance_G=rng.normal(size=3),
        nis=float(rng.normal()),
        dof=k % 4,
        gate=float('inf') if k % 2 else 16.0,
        revision=k % 3,
    )


def bits(one):
    values = (getattr(one, f.name) for f in dataclasses.fields(one))
    return [
        (v.shape, v.dtype, v.tobytes()) if isinstance(v, np.ndarray) else (type(v), repr(v))
        for v in values
    ]


def test_receipts_are_those_that_were_added():
    added = [receipt(k) for k in range(COUNT)]
    found = Receipts(added[:50])
    for one in added[50:60]:
        found.append(one)
    assert bits(found[40]) == bits(added[40])  # of a block that is not full yet
    found.extend(added[60:])
    assert len(found) == COUNT
    assert [bits(one) for one in found] == [bits(one) for one in added]
    assert [bits(found[k]) for k in range(-COUNT, COUNT)] == [bits(r) for r in added + added]
    assert [bits(one) for one in found[90:10:-20]] == [bits(one) for one in added[90:10:-20]]
    assert repr(found) == repr(tuple(added))
    with pytest.raises(IndexError):
        found[COUNT]


def test_few_receipts_are_held():
    held = [receipt(k) for k in range(COUNT)]
    found = Receipts(held)
    assert sum(one is other for one, other in zip(found, held, strict=True)) <= 20
    assert not Receipts()
