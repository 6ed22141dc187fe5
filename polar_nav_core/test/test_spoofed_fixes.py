"""Forged packets: numbers used up, contents repeated, a leader that counts anew, one far off."""

import dataclasses

import numpy as np
import pytest
from closed_loop import World, inputs_of, run

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.engine.verdicts import Verdict

pytestmark = pytest.mark.slow

UNGATED = ('modified_akf', 'conventional_akf')


@pytest.fixture(scope='module')
def world():
    return World(60.0)


@pytest.fixture(scope='module')
def fixes(world):
    return world.fixes(1.0, 1.5, rng=np.random.default_rng(3))


def driven(world, fixes, **changes):
    """Last estimate, and the verdicts of fixes by number of arrival, event by event."""
    inputs = inputs_of(world, sorted(fixes, key=lambda f: f.key))
    out = run(Engine(world.params(**changes)), inputs.events())
    receipts = [o for o in out if isinstance(o, Receipt)]
    whole = engine_run.run(world.params(**changes), inputs)
    assert [(r.verdict, r.reason) for r in receipts] == [
        (r.verdict, r.reason) for r in whole.receipts
    ]
    newest = [o for o in out if isinstance(o, Estimate)][-1]
    assert np.array_equal(newest.r_e, whole.track.r_e[-1])
    return newest, receipts


def arriving(fixes):
    """Fixes numbered as they arrive."""
    order = sorted(fixes, key=lambda f: (f.receive_ns, f.order))
    return [dataclasses.replace(f, arrival=k) for k, f in enumerate(order)]


def test_numbers_cannot_be_used_up(world, fixes):
    """Forged packets with the numbers of fixes to come are gated, and cost none of them."""
    forged = [
        dataclasses.replace(
            f,
            validity_ns=fixes[10].validity_ns + k * 100_000,
            receive_ns=fixes[10].receive_ns + k * 1000,
            r_e=f.r_e + 5000.0,
        )
        for k, f in enumerate(fixes[11:], start=1)
    ]
    clean, _ = driven(world, fixes, configuration='default')
    newest, receipts = driven(world, arriving(fixes + forged), configuration='default')
    assert np.array_equal(newest.r_e, clean.r_e)
    verdicts = [r.verdict for r in receipts]
    assert verdicts.count(Verdict.GATED) == len(forged)
    assert verdicts.count(Verdict.FUSED) == len(fixes)


@pytest.mark.parametrize('configuration', ['default', 'modified_akf'])
def test_content_under_another_number_is_no_new_fix(world, fixes, configuration):
    copies = [
        dataclasses.replace(f, sequence=1000 * n + f.sequence, receive_ns=f.receive_ns + n * 10**8)
        for f in fixes[:-2]
        for n in range(1, 4)
    ]
    clean, _ = driven(world, fixes, configuration=configuration)
    newest, receipts = driven(world, arriving(fixes + copies), configuration=configuration)
    assert np.array_equal(newest.P, clean.P)
    replayed = [r for r in receipts if r.verdict is Verdict.REPLAYED]
    assert len(replayed) == len(copies)
    assert replayed[0].reason == 'fix 1000 of leader has the content of an earlier one'
    inputs = inputs_of(world, arriving(fixes + copies))
    params = world.params(configuration=configuration)
    watched = engine_run.run(params, inputs, look_every_s=1.0).health
    (first, *_) = [h for h in watched if 'somebody repeats them' in h.sentence]
    assert first.stamp_ns - copies[0].receive_ns <= 2 * 10**9


def test_copies_of_a_gated_fix_are_no_further_evidence(world, fixes):
    off = dataclasses.replace(fixes[20], r_e=fixes[20].r_e + 3000.0)
    copies = [
        dataclasses.replace(off, sequence=n, receive_ns=off.receive_ns + n)
        for n in range(500, 540)
    ]
    kept = [f for f in fixes if f is not fixes[20]]
    _, receipts = driven(world, arriving([*kept, off, *copies]), configuration='default')
    verdicts = [r.verdict for r in receipts]
    assert verdicts.count(Verdict.GATED) == 1
    assert verdicts.count(Verdict.REPLAYED) == len(copies)


def test_a_leader_that_counts_from_zero_again_is_heard(world, fixes):
    half = len(fixes) // 2
    again = [
        dataclasses.replace(f, sequence=f.sequence - half, order=f.order - half)
        for f in fixes[half:]
    ]
    _, receipts = driven(world, arriving(fixes[:half] + again), configuration='default')
    assert {r.verdict for r in receipts} == {Verdict.FUSED}


@pytest.mark.parametrize('configuration', UNGATED)
def test_one_fix_far_off_moves_no_ungated_filter(world, fixes, configuration):
    """Unbounded, modified_akf moved by 2.6 km for one fix 5 km off."""
    far = dataclasses.replace(fixes[40], r_e=fixes[40].r_e + np.array([3000.0, 3000.0, 3000.0]))
    changed = [*fixes[:40], far, *fixes[41:]]
    newest, receipts = driven(world, changed, configuration=configuration)
    refused = [r for r in receipts if r.verdict is not Verdict.FUSED]
    assert [r.verdict for r in refused] == [Verdict.IMPLAUSIBLE]
    assert 'beyond max_fix_sigma, and farther than max_speed' in refused[0].reason
    assert float(np.linalg.norm(newest.r_e - world.r_e[-1])) < 10.0
    moved, _ = driven(world, changed, configuration=configuration, max_fix_sigma=0.0)
    assert float(np.linalg.norm(moved.r_e - world.r_e[-1])) > 20.0


def test_a_displaced_leader_is_believed_where_there_is_no_gate(world, fixes):
    """Not before the vehicle could have gone that way at max_speed: 300 m take 15 s."""
    moved = [dataclasses.replace(f, r_e=f.r_e + np.array([0.0, 300.0, 0.0])) for f in fixes[20:]]
    _, receipts = driven(world, fixes[:20] + moved, configuration='modified_akf')
    verdicts = [r.verdict for r in receipts]
    assert 12 <= verdicts.index(Verdict.FUSED, 20) - 20 <= 15
    assert set(verdicts[20:]) == {Verdict.FUSED, Verdict.IMPLAUSIBLE}
