"""Receipts of a long run: those that lie in columns are those that were added."""

import dataclasses

import numpy as np
import pytest

from polar_nav_core.engine import receipt_rows
from polar_nav_core.engine.configurations import CONFIGURATIONS
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.receipt_rows import Receipts
from polar_nav_core.engine.receipts import FusedFixes, decided_receipt
from polar_nav_core.engine.results import FixResult, Outcome, chi2_gate
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.kernels.sins import rings

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


def fused(k, count):
    """Fixes that the compiled loop has fused, some of them with a weight, and their receipts."""
    rng = np.random.default_rng(k)
    fixes = [
        Fix(
            order=1,
            arrival=k,
            receive_ns=10**18 + 10 * k + i,
            validity_ns=10**18 + 10 * k + i - 5,
            transmit_ns=10**18 + 10 * k + i - 3,
            sequence=100 * k + i,
            source=f'leader {k % 2}',
            topic='packets',
            r_e=np.ones(3),
            covariance_e=np.eye(3),
        )
        for i in range(count)
    ]
    outcomes = rng.normal(size=(count, rings.OUTCOME))
    outcomes[:, rings.DOF], outcomes[:, rings.ENLARGEMENT] = 3.0, 1.0 + (np.arange(count) % 2)
    notes = rng.integers(10**9, size=(count, 3))
    chosen = CONFIGURATIONS['default' if k % 3 else 'modified_akf']
    one_by_one = [
        decided_receipt(
            fix,
            fix,
            FixResult(
                Outcome(
                    fused=True,
                    z=row[2:5],
                    variance=row[5:8],
                    nis=float(row[1]),
                    gate=chi2_gate(chosen.gate_probability, 3),
                    dof=3,
                    inflation=float(row[rings.ENLARGEMENT]),
                ),
                int(note[0]),
            ),
            int(note[1]),
            0,
            chosen,
        )
        for fix, row, note in zip(fixes, outcomes, notes, strict=True)
    ]
    return FusedFixes(fixes, outcomes, notes, chosen), one_by_one


def test_receipts_of_fused_fixes_are_those_of_one_after_the_other():
    found, added = Receipts(), []
    for k in range(12):
        fixes, receipts = fused(k, 1 + k % 4)
        found.extend_fused(fixes)
        added += receipts
        if k % 4 == 1:
            found.append(receipt(k))
            added.append(receipt(k))
        assert len(found) == len(added)
        if k % 3 == 0:
            assert bits(found[-1]) == bits(added[-1])
    assert [bits(one) for one in found] == [bits(one) for one in added]
    np.testing.assert_array_equal(found.columns('nis')['nis'], [one.nis for one in added])


def test_few_receipts_are_held():
    held = [receipt(k) for k in range(COUNT)]
    found = Receipts(held)
    assert sum(one is other for one, other in zip(found, held, strict=True)) <= 20
    assert not Receipts()
