"""The record of fixes: what it refuses, counts, revises, and says about suspicious packets."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from fix_samples import PLACE, S, fix

from polar_nav_core.engine import ledger as ledger_module
from polar_nav_core.engine.health.conditions import Culprit, Level
from polar_nav_core.engine.ledger import Believed, FixLedger
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.receipt_rows import Receipts
from polar_nav_core.engine.results import FixResult, Outcome, chi2_gate
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.kernels.sins.rings import DOF, ENLARGEMENT, OUTCOME

GATE = chi2_gate(0.9999, 3)


def outcome(*, fused=True, nis=3.0, gate=GATE, z=(1.0, -2.0, 0.5), inflation=1.0):
    return Outcome(fused, np.array(z), np.array([1.0, 2.0, 3.0]), nis, 3, gate, inflation)


def result(**of_outcome):
    return FixResult(outcome(**of_outcome), 4)


class Book:
    """A ledger with the counts of an engine; `decide` counts a fix as the engine does."""

    def __init__(self, **params):
        self.verdicts, self.fused = Counter(), Counter()
        self.ledger = FixLedger(EngineParams(**params), self.verdicts, self.fused)

    def decide(self, f, cause=None, *, now_ns=0, **of_outcome):
        receipt = self.ledger.decided(f, cause or f, result(**of_outcome), now_ns)
        self.verdicts[receipt.verdict] += 1
        return receipt

    def keys(self, stamp_s):
        return [c.key for c in self.ledger.conditions(round(stamp_s * S))]


@pytest.fixture
def book():
    return Book()


def verdict_of(ledger, f, stated_ns=None):
    refusal = ledger.refusal(f, f.validity_ns if stated_ns is None else stated_ns)
    return None if refusal is None else refusal[0]


def test_a_fix_is_refused_only_for_what_it_is(book):
    assert book.ledger.refusal(fix(1, 100.0), 100 * S) is None
    not_finite = fix(1, 100.0, r_e=np.full(3, math.nan))
    assert verdict_of(book.ledger, not_finite) is Verdict.NOT_FINITE


@pytest.mark.parametrize(
    ('age_s', 'verdict', 'words'),
    [
        (-0.25, Verdict.FROM_FUTURE, 'valid 0.250 s after'),
        (0.0, None, ''),
        (5.0, None, ''),
        (5.000000001, Verdict.TOO_OLD, '5.00 s old, max_delay_s is 5.00 s'),
        (5.004, Verdict.TOO_OLD, '5.00 s old, max_delay_s is 5.00 s'),
        (7.25, Verdict.TOO_OLD, '7.25 s old, max_delay_s is 5.00 s'),
    ],
)
def test_ages_from_nothing_to_max_delay_are_used(age_s, verdict, words):
    refusal = Book(max_delay_s=5.0).ledger.refusal(fix(1, 100.0, 100.0 + age_s), 100 * S)
    assert (refusal is None) == (verdict is None)
    if refusal is not None:
        assert refusal[0] is verdict
        assert words in refusal[1]
        assert '--' not in refusal[1]


def test_copies_of_fused_fixes_are_refused_by_number_and_by_content(book):
    first = fix(1, 100.0)
    book.ledger.remember(first, first.validity_ns, fused=True)
    number = book.ledger.refusal(fix(1, 100.0, off=5.0), first.validity_ns)
    assert number == (Verdict.DUPLICATE, 'fix 1 of leader came before, with another content')
    same = book.ledger.refusal(first, first.validity_ns)
    assert same == (Verdict.DUPLICATE, 'fix 1 of leader came before')
    again = replace(first, sequence=2, order=2)
    content = book.ledger.refusal(again, first.validity_ns)
    assert content == (Verdict.REPLAYED, 'fix 2 of leader has the content of an earlier one')
    assert verdict_of(book.ledger, fix(1, 101.0)) is None


def test_the_number_of_a_refused_fix_stays_free_and_its_content_does_not(book):
    first = fix(1, 100.0)
    book.ledger.remember(first, first.validity_ns, fused=False)
    assert verdict_of(book.ledger, fix(1, 100.0, off=5.0)) is None
    assert verdict_of(book.ledger, first) is Verdict.DUPLICATE
    assert verdict_of(book.ledger, replace(first, sequence=2)) is Verdict.REPLAYED


def test_copies_are_known_by_the_time_that_their_packet_states(book):
    """It wraps after five days; the engine's own time of validity is another number."""
    first = fix(1, 100.0)
    book.ledger.remember(first, 7 * S, fused=True)
    assert verdict_of(book.ledger, first, 7 * S) is Verdict.DUPLICATE
    assert verdict_of(book.ledger, first) is None


def test_a_fused_fix_is_counted_once(book):
    receipt = book.decide(fix(1, 100.0), now_ns=101 * S)
    book.decide(fix(2, 99.0))  # older than the first
    assert receipt.verdict is Verdict.FUSED
    assert (receipt.revision, receipt.fused_ns) == (0, 101 * S)
    assert book.ledger.counts() == (0, 2, 100 * S)
    assert book.verdicts == {Verdict.FUSED: 2}
    np.testing.assert_array_equal(receipt.innovation_G, [-1.0, 2.0, -0.5])


def test_a_gated_fix_is_no_fused_one(book):
    receipt = book.decide(fix(1, 100.0), fused=False, nis=30.0)
    assert receipt.verdict is Verdict.GATED
    assert receipt.reason == 'NIS 30.0 is above the gate of 21.1'
    assert book.ledger.counts() == (0, 0, 0)
    assert book.keys(101.5) == []


def test_decisions_that_a_later_fix_changes_move_the_counts(book):
    """Of a gated fix that is fused after all, and gated again."""
    early, late, last = fix(1, 100.0), fix(2, 99.0, 103.0), fix(3, 98.0, 104.0)
    book.decide(early, fused=False)
    book.decide(late)
    taken = book.decide(early, late)
    assert (taken.verdict, taken.revision) == (Verdict.FUSED, 1)
    assert taken.stamp_ns == late.receive_ns
    assert 'decided anew after fix 2' in taken.reason
    assert book.ledger.counts()[1] == 2
    assert +book.verdicts == {Verdict.FUSED: 2}
    back = book.decide(early, last, fused=False)
    assert (back.verdict, back.revision) == (Verdict.GATED, 2)
    assert book.ledger.counts()[1] == 1
    assert +book.verdicts == {Verdict.FUSED: 1, Verdict.GATED: 1}


def test_a_fused_fix_that_is_gated_after_all_is_no_fused_one(book):
    first, cause = fix(1, 100.0), fix(2, 99.0, 103.0)
    book.decide(first)
    assert book.decide(first, cause, fused=False).revision == 1
    assert book.ledger.counts()[1] == 0
    assert +book.verdicts == {Verdict.GATED: 1}


def test_revisions_are_counted_for_each_fix_by_itself(book):
    cause = fix(9, 99.0, 110.0)
    fixes = [fix(1, 100.0), fix(1, 101.0), fix(2, 100.0)]
    for expected in (1, 2):
        for f in fixes:
            assert book.decide(f, cause).revision == expected


def test_the_revisions_of_the_oldest_fix_are_forgotten_when_there_are_too_many(monkeypatch):
    monkeypatch.setattr(ledger_module, '_REFUSED_KEPT', 3)
    book, cause = Book(), fix(9, 99.0, 110.0)
    fixes = [fix(k, 100.0 + k) for k in range(4)]
    for f in fixes[:3]:
        book.decide(f, cause)
    assert book.decide(fixes[0], cause).revision == 2  # three are kept, and it is the newest now
    book.decide(fixes[3], cause)
    assert [book.decide(f, cause).revision for f in (fixes[0], fixes[3])] == [3, 2]
    assert book.decide(fixes[1], cause).revision == 1


def test_room_is_for_as_many_fixes_as_stated():
    """Five days of fused ones at one per 1.6 s, whatever is refused meanwhile."""
    assert ledger_module._FUSED_KEPT * 1.6 >= 4.85 * 86400
    assert ledger_module._REFUSED_KEPT == 4096


def test_a_flood_of_refused_fixes_drops_no_fused_one(monkeypatch):
    monkeypatch.setattr(ledger_module, '_REFUSED_KEPT', 2)
    book, first = Book(), fix(1, 100.0)
    book.ledger.remember(first, first.validity_ns, fused=True)
    for k in range(2, 1100):
        other = fix(k, 100.0 + k)
        book.ledger.remember(other, other.validity_ns, fused=False)
    assert verdict_of(book.ledger, first) is Verdict.DUPLICATE
    # The oldest refused one was dropped: more than the room and its spare came after it.
    assert verdict_of(book.ledger, replace(fix(2, 102.0), sequence=2000)) is None


@pytest.mark.parametrize(
    ('verdict', 'words'),
    [
        (Verdict.NOT_FINITE, 'no instrument states'),
        (Verdict.REPLAYED, 'repeats them'),
        (Verdict.IMPLAUSIBLE, 'displaced or forged'),
    ],
)
def test_suspicious_packets_are_reported_for_a_minute(book, verdict, words):
    book.ledger.suspect(verdict, 100 * S)
    book.ledger.suspect(verdict, 130 * S)
    (condition,) = book.ledger.conditions(160 * S)
    assert condition.key == f'packets {verdict.name}'
    assert (condition.level, condition.culprit) == (Level.WARN, Culprit.FIXES)
    assert condition.sentence.startswith('2 packets in a minute ')
    assert words in condition.sentence
    (condition,) = book.ledger.conditions(160 * S + 1)
    assert condition.sentence.startswith('1 packets')
    assert book.keys(190.0) == [condition.key]
    assert book.keys(190.000001) == []


@pytest.mark.parametrize('verdict', [Verdict.DUPLICATE, Verdict.GATED, Verdict.TOO_OLD])
def test_ordinary_verdicts_are_not_suspicious(book, verdict):
    book.ledger.suspect(verdict, 100 * S)
    assert book.keys(100.0) == []


@pytest.mark.parametrize(
    ('off', 'number', 'told'), [(3.0, 3, True), (3.0, 2, False), (0.0, 9, False)]
)
def test_three_packets_with_another_content_are_an_error_for_a_minute(book, off, number, told):
    for k in range(number):
        book.ledger.remember(fix(k, 100.0 + k), (100 + k) * S, fused=True)
        book.ledger.refused(fix(k, 100.0 + k, off=off), Verdict.DUPLICATE, (100 + k) * S)
    found = book.ledger.conditions(110 * S)
    assert [(c.key, c.level) for c in found] == [('packets contradict', Level.ERROR)] * told
    assert book.keys(162.0) == []


def test_a_fix_out_of_reach_is_suspicious_from_its_reception_on(book):
    receipt = book.decide(
        fix(1, 100.0), fused=False, gate=math.inf, z=(3000.0, 4000.0, math.nan), nis=9e5
    )
    assert receipt.verdict is Verdict.IMPLAUSIBLE
    assert '5000 m from the estimate' in receipt.reason
    assert book.keys(161.5) == ['packets IMPLAUSIBLE']
    assert book.keys(161.6) == []


def test_a_turned_dead_reckoning_is_an_error_for_a_minute(book):
    book.ledger.believed(30 * S)
    assert book.keys(30.0) == []
    book.ledger.believed(30 * S, how=Believed.TURNED)
    (condition,) = book.ledger.conditions(72 * S)
    assert (condition.key, condition.level) == ('fixes reopened', Level.ERROR)
    assert condition.culprit == Culprit.HEADING | Culprit.IMU | Culprit.FIXES
    assert 'until 42 s ago' in condition.sentence
    assert book.keys(89.9) == ['fixes reopened']
    assert book.keys(90.0) == book.keys(95.0) == []


def test_starting_anew_forgets_refusals_and_turns_and_keeps_fixes_and_counts(book):
    first = fix(1, 100.0)
    book.decide(first)
    book.ledger.remember(first, first.validity_ns, fused=True)
    for k in range(2, 8):
        book.decide(fix(k, 100.0 + k), fused=False)
    book.ledger.believed(107 * S, how=Believed.TURNED)
    book.decide(fix(9, 109.0), fused=False)
    assert not book.ledger.integrity.quiet
    book.ledger.start_anew()
    assert book.ledger.integrity.quiet
    assert book.keys(110.0) == []
    assert len(book.ledger.refused_row) == 0
    assert book.ledger.counts()[1] == 1
    assert verdict_of(book.ledger, first) is Verdict.DUPLICATE


def test_believed_fixes_begin_a_new_row_and_name_a_start_that_was_off(book):
    for k in range(1, 5):
        book.decide(fix(k, 100.0 + k), fused=False)
    assert len(book.ledger.refused_row) == 4
    assert book.ledger.integrity.moved == []
    book.ledger.believed(110 * S, 800.0)
    assert book.ledger.integrity.quiet
    assert '800 m' in book.ledger.integrity.moved[0].sentence
    assert len(book.ledger.refused_row) == 0
    # One that was valid before the covariance was enlarged counts no more.
    book.decide(fix(6, 109.0, 112.0), fused=False)
    assert book.ledger.integrity.quiet
    assert Book().ledger.integrity.moved == []


def test_the_start_is_off_by_nothing_unless_stated(book):
    book.ledger.believed(100 * S)
    assert book.ledger.integrity.moved == []


def test_refused_fixes_are_weighed_by_fix_minus_estimate(book):
    for k in range(1, 4):
        book.decide(fix(k, 100.0 + k), fused=False, z=(10.0, -20.0, 0.0))
    np.testing.assert_allclose(book.ledger.integrity.state(104 * S).offset_G, [-10.0, 20.0, 0.0])
    row = book.ledger.refused_row._row
    np.testing.assert_array_equal([r.offset_G for r in row], [[-10.0, 20.0, 0.0]] * 3)
    book.decide(fix(4, 104.0))
    assert len(book.ledger.refused_row._row) == 0


def test_gated_fixes_count_from_when_their_cause_was_received(book):
    """A decision made anew happens when the later fix comes."""
    cause = fix(9, 99.0, 150.0)
    for k in range(1, 4):
        book.decide(fix(k, 100.0 + k), fused=False)
    book.decide(fix(4, 104.0), cause, fused=False)
    assert book.ledger.integrity.state(150 * S).gated_s == pytest.approx(150.0 - 102.5)
    book.decide(fix(5, 105.0), fix(10, 99.0, 160.0))
    assert book.ledger.integrity.state(165 * S).since_fused_s == pytest.approx(5.0)


def test_the_time_of_refusals_is_that_of_the_parameters():
    book = Book(max_gated_s=20.0)
    for k in range(1, 41):
        book.decide(fix(k, 100.0 + k), fused=False)
    assert book.ledger.integrity.lasting(142 * S)
    book.ledger.start_anew()
    for k in range(41, 81):
        book.decide(fix(k, 100.0 + k), fused=False)
    assert book.ledger.integrity.lasting(182 * S)
    assert not Book(max_gated_s=60.0).ledger.integrity.lasting(182 * S)


@pytest.mark.parametrize(
    ('metres', 'after_s', 'leaps'),
    [(30.0, 2.0, False), (51.0, 2.0, False), (52.0, 2.0, True), (70.0, 4.0, False)],
)
def test_a_fix_leaps_that_lies_farther_off_than_the_vehicle_can_have_moved(metres, after_s, leaps):
    """20 m/s, and four sigmas of both fixes together, 11.3 m."""
    book = Book()
    sigma = 4.0 * np.eye(3)
    book.decide(fix(1, 98.0, r_e=PLACE, covariance_e=sigma))
    book.decide(fix(2, 100.0, r_e=PLACE, covariance_e=sigma))
    there = PLACE + np.array([metres, 0.0, 0.0])
    far = fix(3, 100.0 + after_s, r_e=there, covariance_e=sigma)
    book.decide(far, fused=False)
    for k in range(4, 8):
        book.decide(fix(k, 100.0 + after_s + k, r_e=there, covariance_e=sigma), fused=False)
    book.ledger.believed(120 * S)
    book.decide(fix(9, 121.0, r_e=there))
    assert [c.level is Level.ERROR for c in book.ledger.integrity.moved] == [True] * leaps


def test_a_fix_leaps_after_fixes_that_were_fused_at_once():
    book = Book()
    outcomes, notes = np.full((2, OUTCOME), 3.0), np.zeros((2, 3), dtype=np.int64)
    book.ledger.fused([fix(2, 100.0), fix(1, 98.0)], outcomes, notes)
    there = PLACE + np.array([60.0, 0.0, 0.0])  # 40 m in 2 s, and not in 4 s
    for k in range(3, 7):
        book.decide(fix(k, 96.0 + 2.0 * k, r_e=there), fused=False)
    book.ledger.believed(120 * S)
    book.decide(fix(9, 121.0, r_e=there))
    assert len(book.ledger.integrity.moved) == 1
    book.ledger.start_anew()
    assert book.ledger.integrity.moved == []


def test_many_fixes_at_once_are_counted_like_one_after_another():
    fixes = [fix(1, 100.0), fix(2, 102.0), fix(3, 101.0, 104.0)]
    one, many = Book(), Book()
    outcomes, notes = np.zeros((3, OUTCOME)), np.zeros((3, 3), dtype=np.int64)
    outcomes[:, 1], outcomes[:, 2:5], outcomes[:, 5:8] = 3.0, [1.0, -2.0, 0.5], [1.0, 2.0, 3.0]
    outcomes[:, ENLARGEMENT], outcomes[:, DOF] = 1.0, 3.0
    notes[:, 0], notes[:, 1] = 4, 105 * S
    singly = []
    for f in fixes:
        one.ledger.received += 1
        singly.append(one.decide(f, now_ns=105 * S))
        one.ledger.remember(f, f.validity_ns, fused=True)
    together = Receipts()
    together.extend_fused(many.ledger.fused(fixes, outcomes, notes))
    assert [repr(r) for r in together] == [repr(r) for r in singly]
    assert many.ledger.counts() == one.ledger.counts() == (3, 3, 102 * S)
    assert many.verdicts == one.verdicts
    assert many.ledger.packed() == one.ledger.packed()
    states = [b.ledger.integrity.state(110 * S) for b in (one, many)]
    assert states[0].since_fused_s == states[1].since_fused_s == pytest.approx(6.0)
    said = []
    for b in (one, many):
        for k in range(3):  # off by as much from the age of the newest
            refuse(b, 10 + k, 106.0 + k, 90.0)
        said += [c.sentence for c in b.ledger.conditions(109 * S) if c.key == 'sender clock']
    assert said[0] == said[1]
    assert said[0].endswith('off by some -87 s')
    # Older ones do not set the newest validity back, and counts add up.
    many.ledger.fused([fix(4, 90.0, 106.0)], outcomes[:1], notes[:1])
    assert many.ledger.counts() == (4, 4, 102 * S)
    assert many.verdicts == {Verdict.FUSED: 4}
    assert verdict_of(many.ledger, fix(4, 90.0, 106.0)) is Verdict.DUPLICATE


def test_fixes_fused_at_once_end_the_row_of_refused_ones(book):
    for k in range(1, 4):
        book.decide(fix(k, 100.0 + k), fused=False)
    outcomes = np.full((1, OUTCOME), 3.0)
    book.ledger.fused([fix(4, 104.0)], outcomes, np.zeros((1, 3), dtype=np.int64))
    assert book.ledger.integrity.state(105 * S).gated_run == 0
    assert len(book.ledger.refused_row._row) == 0


def test_a_restored_ledger_knows_fixes_and_counts(book):
    fused, refused = fix(1, 100.0), fix(2, 101.0)
    book.decide(fused)
    book.ledger.received = 2
    book.ledger.remember(fused, fused.validity_ns, fused=True)
    book.ledger.remember(refused, refused.validity_ns, fused=False)
    later = Book()
    later.decide(fix(7, 50.0), fix(8, 49.0, 60.0))
    later.ledger.restore(book.ledger.counts(), book.ledger.packed())
    assert later.ledger.counts() == (2, 1, 100 * S)
    assert later.ledger.integrity.state(103 * S).since_fused_s == 3.0
    assert verdict_of(later.ledger, replace(fused, r_e=PLACE + 50.0)) is Verdict.DUPLICATE
    assert verdict_of(later.ledger, refused) is Verdict.DUPLICATE
    assert verdict_of(later.ledger, fix(2, 101.0, off=5.0)) is None
    assert later.decide(fix(7, 50.0), fix(8, 49.0, 60.0)).revision == 1


def test_a_ledger_that_had_used_no_fix_knows_none_after_a_restart(book):
    book.ledger.restore((2, 0, 0), book.ledger.packed())
    assert book.ledger.counts() == (2, 0, 0)
    assert math.isnan(book.ledger.integrity.state(103 * S).since_fused_s)


def test_what_comes_is_counted_though_it_was_switched_off(book):
    book.ledger.came(fix(1, 100.0), wanted=False)
    assert book.ledger.counts() == (1, 0, 0)
    book.ledger.came(fix(2, 101.0))
    assert book.ledger.counts() == (2, 0, 0)


@pytest.mark.parametrize('damaged', [0, 1])
def test_records_that_are_none_change_nothing(book, damaged):
    book.ledger.remember(fix(1, 100.0), 100 * S, fused=True)
    book.ledger.remember(fix(2, 101.0), 101 * S, fused=False)
    before = book.ledger.packed()
    records = [b'', b'']
    records[damaged] = b'x'
    with pytest.raises(ValueError, match='wrong length'):
        book.ledger.restore((5, 4, 3), (records[0], records[1]))
    assert book.ledger.packed() == before
    assert book.ledger.counts() == (0, 0, 0)


def refuse(book, number, received_s, age_s):
    """A fix of an age, refused as the engine does; verdict."""
    f = fix(number, received_s - age_s, receive_ns=round(received_s * S))
    verdict = verdict_of(book.ledger, f)
    book.ledger.refused(f, verdict, f.validity_ns)
    return verdict


@pytest.mark.parametrize(
    ('age_s', 'verdict', 'words'),
    [
        (62.0, Verdict.TOO_OLD, '3 packets in a row are 62.1 s old, .* off by some -60 s'),
        (-58.0, Verdict.FROM_FUTURE, '57.9 s ahead of their reception, .* off by some \\+60 s'),
        (-0.309, Verdict.FROM_FUTURE, ' 0.209 s ahead of their reception, .* off by some \\+2 s'),
    ],
)
def test_a_sender_whose_clock_stepped_is_named(book, age_s, verdict, words):
    usable = fix(1, 98.0, receive_ns=100 * S)
    assert verdict_of(book.ledger, usable) is None
    book.decide(usable)
    for number in (2, 3, 4):
        assert 'sender clock' not in book.keys(100.0 + number)
        received_s = 100.0 + number
        assert refuse(book, number, received_s, age_s + 0.1 * (number - 2)) is verdict
    (found,) = (c for c in book.ledger.conditions(105 * S) if c.key == 'sender clock')
    assert re.search(words, found.sentence)
    assert found.level is Level.WARN
    assert found.culprit is Culprit.FIXES
    # It ends with the next that can be used, or when nothing comes for a minute.
    assert 'sender clock' in book.keys(163.9)
    assert 'sender clock' not in book.keys(164.1)
    book.decide(fix(5, 108.0, receive_ns=110 * S))
    assert 'sender clock' not in book.keys(111.0)


def test_packets_of_different_ages_are_held_up(book):
    for number, age_s in enumerate((70.0, 90.0, 120.0)):
        refuse(book, number, 200.0 + number, age_s)
    (found,) = book.ledger.conditions(203 * S)
    assert 'held up on their way' in found.sentence
