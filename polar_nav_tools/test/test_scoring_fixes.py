"""Verdicts, balances, NIS per source, delays, age of information, availability."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_tools.report.example import estimate_with_errors, example_truth
from polar_nav_tools.scoring import (
    Window,
    age_of_information,
    availability,
    balances,
    count_verdicts,
    delays,
    nis_by_source,
)
from polar_nav_tools.scoring.timeliness import timed_fixes
from polar_nav_tools.scoring.verdicts import UNKNOWN_NS, VerdictSeries, in_order
from polar_nav_tools.series.estimates import receipts_of
from polar_nav_tools.series.vehicle import ReceiptRecord

S = 1_000_000_000
RX = '/follower/acomms/rx'


def receipt(sequence, verdict='FUSED', *, validity=0.0, receive=5.0, revision=0, **more):
    values = {
        'stamp_ns': int(receive * S),
        'verdict': 0,
        'verdict_text': verdict,
        'reason': '',
        'topic': RX,
        'source': 'leader',
        'sequence': sequence,
        'revision': revision,
        'validity_ns': None if validity is None else int(validity * S),
        'transmit_ns': None,
        'receive_ns': int(receive * S),
        'fused_ns': None,
        'age_s': np.nan,
        'delay_handling': 'rewind',
        'steps_rolled_back': 0,
        'innovation_G': np.full(3, np.nan),
        'innovation_variance_G': np.full(3, np.nan),
        'nis': np.nan,
        'degrees_of_freedom': 0,
        'gate': np.inf,
    }
    return ReceiptRecord(**{**values, **more})


def test_last_revision_counts():
    receipts = [
        receipt(1, 'GATED'),
        receipt(2, 'FUSED'),
        receipt(1, 'FUSED', revision=1),
        receipt(1, 'GATED', revision=2),
        receipt(2, 'DUPLICATE', receive=6.0),
    ]
    counts = count_verdicts(VerdictSeries.of(receipts))
    assert counts.total == 3
    assert counts.by_verdict == {'FUSED': 1, 'GATED': 1, 'DUPLICATE': 1}
    assert counts.by_topic == {RX: counts.by_verdict}
    assert counts.revised == 2
    columns = VerdictSeries.of(receipts)
    assert [list(c) for c in (columns.verdict, columns.receive_ns)] == [
        ['GATED', 'FUSED', 'DUPLICATE'],
        [5 * S, 5 * S, 6 * S],
    ]


@pytest.mark.parametrize('revised', [False, True])
def test_columns_of_a_replay_are_those_of_its_records(revised):
    receipts = [
        Receipt(
            stamp_ns=k * S,
            verdict=Verdict(k % 16),
            reason=f'reason {k}',
            topic=RX if k % 5 else '/other',
            source='leader' if k % 3 else '',
            sequence=k // 2,
            validity_ns=k * S if k % 7 else 0,
            transmit_ns=0,
            receive_ns=k // 2 * S,
            nis=float('nan') if k % 4 else 0.1 * k,
            dof=k % 4,
            revision=k % 2 if revised else 0,
        )
        for k in range(5000)  # more than are kept as objects
    ]
    records = receipts_of(receipts)
    found, expected = VerdictSeries.of(records), VerdictSeries.of(list(records))
    assert found.revised == expected.revised
    assert bool(found.revised) == revised
    for field in dataclasses.fields(VerdictSeries):
        if field.name != 'revised':
            column, other = getattr(found, field.name), getattr(expected, field.name)
            assert column.dtype == other.dtype
            assert_array_equal(column, other)


def test_verdicts_have_one_order():
    assert in_order(['BAD_CRC', 'NEW', 'FUSED', 'FUSED', 'GATED']) == [
        'FUSED',
        'GATED',
        'BAD_CRC',
        'NEW',
    ]


def test_balance_is_per_topic():
    receipts = [
        receipt(1),
        receipt(2, 'BAD_CRC'),
        receipt(0, 'TOO_LATE', topic='/follower/imu/data_raw', source=''),
    ]
    good, bad, none = balances(
        count_verdicts(VerdictSeries.of(receipts)), {'follower/acomms/rx': 2, RX: 3, '/other': 0}
    )
    assert (good.received, good.verdicts, good.balanced) == (2, 2, True)
    assert (bad.received, bad.verdicts, bad.balanced) == (3, 2, False)
    assert none.balanced
    assert bad.to_dict() == {'topic': RX, 'received': 3, 'verdicts': 2, 'balanced': False}


def test_nis_per_source_with_and_without_gated_ones():
    receipts = [
        receipt(1, nis=2.0, degrees_of_freedom=2),
        receipt(2, nis=3.0, degrees_of_freedom=3),
        receipt(3, 'GATED', nis=95.0, degrees_of_freedom=3),
        receipt(4, 'TOO_OLD', nis=1000.0, degrees_of_freedom=3),
        receipt(5, nis=np.nan, degrees_of_freedom=3),
        receipt(6, source='station', nis=4.0, degrees_of_freedom=2),
    ]
    both = nis_by_source(VerdictSeries.of(receipts))
    assert list(both) == ['leader', 'station']
    assert both['leader'].count == 3
    assert both['leader'].mean_per_dof == pytest.approx(100.0 / 8.0)
    fused = nis_by_source(VerdictSeries.of(receipts), ('FUSED',))
    assert fused['leader'].mean_per_dof == pytest.approx(1.0)
    assert fused['station'].mean_per_dof == pytest.approx(2.0)


def test_delays_are_of_fused_fixes_received_in_the_window():
    receipts = [
        receipt(1, validity=0.0, receive=5.0),
        receipt(2, validity=1.0, receive=8.0),
        receipt(3, 'GATED', validity=2.0, receive=30.0),
        receipt(4, validity=3.0, receive=40.0),
        receipt(5, validity=None, receive=9.0),
    ]
    columns = VerdictSeries.of(receipts)
    assert list(columns.validity_ns) == [0, 1 * S, 2 * S, 3 * S, UNKNOWN_NS]
    found = delays(columns, Window('w', 0, 30 * S))
    assert found.count == 2
    assert found.mean == pytest.approx(6.0)
    assert [f.receipt.sequence for f in timed_fixes(receipts)] == [1, 2, 3, 4]


def test_age_of_information_by_brute_force():
    rng = np.random.default_rng(0)
    validity = np.arange(0.0, 60.0, 2.0)
    receive = validity + rng.uniform(0.5, 9.0, len(validity))
    verdicts = rng.choice(['FUSED', 'GATED', 'BAD_CRC'], len(validity), p=[0.7, 0.2, 0.1])
    receipts = [
        receipt(k, v, validity=a, receive=b)
        for k, (a, b, v) in enumerate(zip(validity, receive, verdicts, strict=True))
    ]
    shuffled = [receipts[k] for k in rng.permutation(len(receipts))]
    stamps = rng.integers(0, 70 * S, 200)
    expected = []
    for now in stamps:
        known = [
            r.validity_ns for r in receipts if r.verdict_text == 'FUSED' and r.receive_ns <= now
        ]
        expected.append((now - max(known)) * 1e-9 if known else np.nan)
    assert_allclose(age_of_information(stamps, VerdictSeries.of(shuffled)), expected)
    assert np.isnan(age_of_information(stamps, VerdictSeries.of([]))).all()
    # A fix received at a stamp is in that stamp's estimate.
    at_once = receipt(1, validity=1.0, receive=4.0)
    found = age_of_information(np.array([4 * S - 1, 4 * S]), VerdictSeries.of([at_once]))
    assert np.isnan(found[0])
    assert found[1] == pytest.approx(3.0)


def made_estimate(minutes=1.0):
    truth = example_truth('f', 80.0, 120.0, minutes)
    one = np.ones((len(truth), 3))
    return estimate_with_errors(
        truth,
        'c',
        dr_G=one,
        dv_G=one,
        phi_G=0 * one,
        sigma_r=one,
        sigma_v=one,
        sigma_phi=one,
    )


def test_availability_whole():
    estimate = made_estimate()
    span = Window('whole', int(estimate.stamp_ns[0]), int(estimate.stamp_ns[-1]))
    a = availability(estimate, span)
    assert (a.share, a.longest_outage, a.first_after, a.diverged) == (1.0, 0.0, 0.0, 0)
    one_short = availability(estimate.rows(slice(0, -1)), span)
    assert one_short.share == 1.0


def test_availability_with_late_start_outage_and_divergence():
    estimate = made_estimate()  # 60 s at 10 Hz
    span = Window('whole', int(estimate.stamp_ns[0]), int(estimate.stamp_ns[-1]))
    keep = np.r_[60:200, 300:601]  # from 6 s; silent from 20 s to 30 s
    status = estimate.status.copy()
    status[500:] = 2  # diverged from 50 s on
    a = availability(dataclasses.replace(estimate, status=status).rows(keep), span)
    assert a.first_after == pytest.approx(6.0)
    assert a.diverged == 101
    # Each silence begins 0.25 s after its last good estimate (2.5 intervals).
    assert a.longest_outage == pytest.approx(10.1 - 0.25)
    silent = 6.0 + (10.1 - 0.25) + (10.1 - 0.25)
    assert a.share == pytest.approx(1.0 - silent / 60.0, abs=1e-6)


def test_availability_of_nothing():
    estimate = made_estimate()
    span = Window('whole', int(estimate.stamp_ns[0]), int(estimate.stamp_ns[-1]))
    dead = dataclasses.replace(estimate, status=np.full_like(estimate.status, 2))
    a = availability(dead, span)
    assert (a.share, a.longest_outage, a.diverged) == (0.0, pytest.approx(60.0), 601)
    assert np.isnan(a.first_after)
