"""Station mode: gate that opens again, limits of thrust, back_propagate's reach, the watchdog."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import station_twin as twin

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.health.conditions import Culprit, Level
from polar_nav_core.engine.health.station import StationView, StationWatchdog
from polar_nav_core.engine.health.view import Envelope
from polar_nav_core.engine.health.watchdog import FIX
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.kernels import watch
from polar_nav_core.kernels.station import state as ss

pytestmark = pytest.mark.slow

SECONDS = 90.0
JUMP_S = 30.0
S = np.diag([9.0, 9.0, 1.0])


@cache
def world():
    return twin.inputs(twin.truth(SECONDS), 4, depth_every=10)


def moved(offset):
    """World whose station states an offset (n) -> metres along x from `JUMP_S` on."""
    start_ns = twin.START_NS + round(JUMP_S * 1e9)
    fixes = tuple(
        fix
        if fix.validity_ns < start_ns
        else replace(
            fix,
            polar=replace(
                fix.polar, station=fix.polar.station + np.array([offset(fix.sequence), 0.0, 0.0])
            ),
        )
        for fix in world().fixes
    )
    return replace(world(), fixes=fixes)


def run(inputs, *, one_by_one=False, **changes):
    params = twin.params(**{'identify_method': 'none', 'reopen_after_s': 10.0, **changes})
    return engine_run.run(params, inputs, one_by_one=one_by_one)


def fused_after(result):
    return [r.verdict is Verdict.FUSED for r in result.receipts if r.source][13:]


@pytest.mark.parametrize('name', ['rewind', 'clone', 'back_propagate', 'tagged'])
def test_fixes_refused_to_one_side_are_believed_at_last(name):
    custom = {'configuration': 'custom', 'delay_handling': name, 'robust_fixes': 'mahalanobis'}
    inputs = moved(lambda _: 300.0)
    shut = run(inputs, **custom, reopen_after_s=0.0)
    assert not any(fused_after(shut))
    found = run(inputs, **custom, one_by_one=True)
    assert not any(fused_after(found)[:6])
    assert all(fused_after(found)[-5:])
    # The position follows; the drag is not blamed for it.
    x, x_shut = found.track.x[-1], shut.track.x[-1]
    assert x[3] - x_shut[3] == pytest.approx(300.0, abs=40.0)
    assert abs(x[ss.DRAG] - x_shut[ss.DRAG]) < 1.0
    # Whether the gate opened by the covariance or by a jump: it is said for good.
    assert 'fixes followed' in {p.condition.key for p in found.health[-1].present}


def test_a_jump_of_the_fixes_moves_the_position_and_no_velocity():
    usual, found = run(world()), run(moved(lambda _: 300.0), one_by_one=True)
    x, x_usual = found.track.x[-1], usual.track.x[-1]
    assert x[3] - x_usual[3] == pytest.approx(300.0, abs=15.0)
    sigma = np.sqrt(np.diagonal(usual.track.P_x[-1]))
    of_velocity = [*range(3), *range(ss.CURRENT, ss.CURRENT + 2)]
    assert (np.abs(x - x_usual) < 2.0 * sigma)[of_velocity].all()
    last = {p.condition.key: p.condition for p in found.health[-1].present}
    followed = last['fixes followed']
    assert (followed.level, followed.culprit) == (Level.ERROR, Culprit.FIXES)
    assert followed.sentence.startswith('fixes jumped 3')
    # It stands for good: nothing that comes later shows which of the two places is right.
    since_s = (found.health[-1].stamp_ns - twin.START_NS) * 1e-9 - JUMP_S
    assert since_s > 50.0


def test_a_jump_that_ends_is_no_condition_any_more():
    back_ns = twin.START_NS + round(60e9)
    there_and_back = tuple(
        now if now.validity_ns >= back_ns else far
        for far, now in zip(moved(lambda _: 300.0).fixes, world().fixes, strict=True)
    )
    found = run(replace(world(), fixes=there_and_back), one_by_one=True)
    said = [any(p.condition.key == 'fixes followed' for p in h.present) for h in found.health]
    assert any(said)
    assert not said[-1]


def test_fixes_that_drift_faster_than_any_current_are_an_error():
    found = run(moved(lambda n: 10.0 * n), one_by_one=True)
    assert any(p.condition.key == 'current' for p in found.health[-1].present)


def test_bearings_of_the_other_side_do_not_lead_off_for_good():
    """A jump by a large angle: rows of range and bearing at the old place do not reach it."""
    since_ns, until_ns = (twin.START_NS + round(s * 1e9) for s in (JUMP_S, 60.0))
    fixes = tuple(
        replace(f, polar=replace(f.polar, bearing=math.remainder(f.polar.bearing + 2.0, math.tau)))
        if since_ns <= f.validity_ns < until_ns
        else f
        for f in world().fixes
    )
    usual = run(world()).track.x
    for delay_handling in ('clone', 'rewind'):
        custom = {'configuration': 'custom', 'delay_handling': delay_handling}
        found = run(replace(world(), fixes=fixes), **custom).track.x
        off = np.linalg.norm((found - usual)[:, ss.HORIZONTAL], axis=1)
        assert 1000.0 < off.max() < 2500.0
        assert off[-1] < 30.0


def test_the_gate_opens_alike_event_by_event_and_says_so():
    inputs = moved(lambda _: 300.0)
    a, b = run(inputs), run(inputs, one_by_one=True)
    assert np.array_equal(a.track.x, b.track.x)
    worst = [h for h in b.health if h.level is Level.ERROR]
    assert worst[-1].resets >= 1
    assert any('used again with enlarged covariance' in h.sentence for h in worst)
    assert worst[-1].culprit & Culprit.MODEL
    assert worst[-1].culprit & Culprit.FIXES


def test_fixes_refused_to_changing_sides_never_open_the_gate():
    result = run(moved(lambda n: 300.0 * (-1.0) ** n))
    assert not any(fused_after(result))


def test_one_absurd_thrust_changes_nothing_and_gets_a_receipt():
    usual = run(world())
    force_b = world().force_b.copy()
    force_b[4000, 0] = 1e6
    found = run(replace(world(), force_b=force_b))
    odd = [r for r in found.receipts if r.verdict is Verdict.IMPLAUSIBLE]
    assert len(odd) == 1
    assert 'thrust_limit_n is 1000 N' in odd[0].reason
    np.testing.assert_allclose(found.track.x, usual.track.x, atol=1e-3)  # 10 ms of the one before
    again = run(replace(world(), force_b=force_b), one_by_one=True)
    assert np.array_equal(found.track.x, again.track.x)


def silent(from_s):
    keep = world().control_stamps_ns < twin.START_NS + round(from_s * 1e9)
    return replace(
        world(),
        control_stamps_ns=world().control_stamps_ns[keep],
        force_b=world().force_b[keep],
    )


def test_thrust_that_ends_is_held_with_the_noise_of_a_guess():
    usual, found = run(world()).track, run(silent(60.0), one_by_one=True)
    row = int(np.searchsorted(usual.stamps_ns, twin.START_NS + 61_500_000_000))
    assert np.array_equal(found.track.P_x[: row - 20], usual.P_x[: row - 20])
    sigma = np.sqrt(np.stack([found.track.P_x[:, 0, 0], usual.P_x[:, 0, 0]]))
    np.testing.assert_allclose(sigma[0, row], sigma[1, row], rtol=0.05)
    assert sigma[0, -1] > 3.0 * sigma[1, -1]
    said = [h for h in found.health if any('no thrust' in p.condition.sentence for p in h.present)]
    assert said[0].stamp_ns - twin.START_NS == pytest.approx(62e9, abs=1.1e9)
    assert found.health[-1].level is Level.WARN
    assert found.health[-1].culprit == Culprit.MODEL


def test_back_propagate_refuses_what_its_inverse_cannot_bring_forward():
    """Before, the state was not a number from here on, and was published."""
    late = tuple(replace(fix, receive_ns=fix.receive_ns + 15_000_000_000) for fix in world().fixes)
    inputs = replace(world(), fixes=late)
    name = {'configuration': 'custom', 'delay_handling': 'back_propagate'}
    result = run(inputs, **name)
    assert np.isfinite(result.track.x).all()
    assert np.isfinite(result.track.P).all()
    refused = [r for r in result.receipts if r.verdict is Verdict.TOO_OLD]
    assert 'back_propagate reaches back' in refused[0].reason
    assert {r.verdict for r in run(inputs).receipts} == {Verdict.FUSED}


# -- the watchdog ---------------------------------------------------------------------------------


def memories():
    return np.zeros((watch.STREAMS, watch.MEMORIES, watch.WIDTH))


def feed(kept, z, course, *, fused=True):
    z3 = np.array([*z, 0.0]) * 3.0
    nis = float(np.sum(np.square(z)))
    watch.observe(kept[FIX], z3, S, nis, 2, fused, np.cos(course), np.sin(course), z3, S)


def view(kept, **changes):
    usual = {
        'stamp_ns': 10**12,
        'opened_ns': np.zeros(3, dtype=np.int64),
        'used_ns': np.zeros(3, dtype=np.int64),
        'speed': 1.2,
        'depth': 20.0,
        'P_horizontal': np.eye(2),
        'resets': 0,
        'share': 0.5,
        'share_sigma': 0.1,
        'drag_ratio': -0.5,
        'drag_sigma': 0.1,
        'thrust_age_s': 0.1,
        'thrust_timeout_s': 2.0,
    }
    return StationView(memories=kept, **{**usual, **changes})


def look(kept, **changes):
    return StationWatchdog(Envelope(20.0, 6000.0)).look(view(kept, **changes), [])


def test_silent_on_white_innovations():
    rng, kept = np.random.default_rng(2), memories()
    for k in range(20_000):
        feed(kept, rng.standard_normal(2), 1e-2 * k)
        if k % 20 == 0:
            assert not look(kept).present


def only(**changes):
    """The one condition of a view in which nothing else is wrong; None for none."""
    found = [p.condition for p in look(memories(), **changes).present]
    assert len(found) <= 1
    return found[0] if found else None


def test_fixes_that_are_followed_are_an_error_where_they_jumped():
    """Fixes that a vehicle refused while it was held are right; but no vehicle jumps."""
    far = {'followed': np.array([40.0, 0.0])}
    said = only(**far)
    assert (said.key, said.level) == ('fixes followed', Level.WARN)
    said = only(**far, jumped=True)
    assert (said.key, said.level) == ('fixes followed', Level.ERROR)
    assert only(followed=np.array([0.5, 0.0]), jumped=True) is None


def test_a_current_that_there_is_not_is_an_error():
    limits = Envelope(20.0, 6000.0, max_current=3.0)
    views = [view(memories(), current=np.array([0.0, speed])) for speed in (2.9, 3.1)]
    weak, strong = (StationWatchdog(limits).look(one, []).present for one in views)
    assert not weak
    (said,) = (p.condition for p in strong)
    assert (said.key, said.level) == ('current', Level.ERROR)
    assert said.culprit == Culprit.FIXES | Culprit.MODEL
    assert '3.1 m/s is stronger than max_current 3.0 m/s' in said.sentence
    assert only(current=np.array([99.0, 0.0])) is None  # as much as there is


def test_fixes_behind_on_every_course_are_a_vehicle_that_does_not_obey_its_model():
    rng, kept = np.random.default_rng(3), memories()
    for k in range(60):
        course = 0.1 * k
        back = 2.0 * np.array([np.cos(course), np.sin(course)])
        feed(kept, back + rng.standard_normal(2), course)  # estimate ahead of the fix
    health = look(kept)
    assert health.level is Level.ERROR
    assert health.culprit is Culprit.MODEL
    assert 'does not obey its model: fixes lie behind it on every course' in health.sentence


def test_fixes_to_one_side_of_the_map_may_be_either():
    rng, kept = np.random.default_rng(4), memories()
    for k in range(60):
        feed(kept, np.array([1.5, 0.0]) + rng.standard_normal(2), 0.1 * k)
    assert look(kept).culprit == Culprit.MODEL | Culprit.FIXES


@pytest.mark.parametrize(
    ('number', 'nis', 'told'),
    [(60.0, 1.5, False), (60.0, 1.65, True), (12.0, 2.0, False), (12.0, 2.3, True)],
)
def test_a_scatter_is_told_where_its_number_shows_it(number, nis, told):
    """1.6 times the stated variance, and three sigmas of so many fixes."""
    kept = memories()
    row = kept[FIX, watch.SHORT]
    row[watch.WEIGHT] = row[watch.WEIGHT_2] = number
    row[watch.NIS] = number * nis
    row[watch.SQUARE : watch.SQUARE + 3] = number
    found = [p.condition for p in look(kept).present]
    assert [c.level for c in found] == [Level.WARN] * told


@pytest.mark.parametrize(
    ('kind', 'limit'),
    [
        (ss.GROWS, 20.0),
        (ss.DEVIATES, 20.0),
        (ss.DRAGS, 17.0),
        (ss.TURNS, 17.0),
        (ss.BEARINGS, 17.0),
    ],
)
@pytest.mark.parametrize(
    ('factor', 'level'), [(1.0, None), (1.01, Level.WARN), (4.01, Level.ERROR)]
)
def test_a_slow_fault_is_told_from_a_limit_on(kind, limit, factor, level):
    statistic = factor * limit
    signatures = np.zeros((2, ss.SIGNATURE_ROWS, ss.KINDS * ss.SLOTS))
    signatures[:, [ss.LAMBDA, ss.ZETA]] = 1.0
    signatures[-1, ss.STATISTIC, kind] = signatures[-1, ss.OWN, kind] = statistic
    born_ns = np.full(ss.SLOTS, 10**11)
    found = only(signatures=signatures, weight=np.ones(1), born_ns=born_ns)
    assert (found and found.level) == level


@pytest.mark.parametrize(
    ('kind', 'stays'), [(ss.GROWS, True), (ss.RANGES, True), (ss.DEVIATES, False)]
)
def test_what_fixes_may_have_done_stays_said_once_its_evidence_has_faded(kind, stays):
    """Ranges that drift are a current to the filter, and it follows; a compass is none."""
    watchdog, second = StationWatchdog(Envelope(20.0, 6000.0)), 10**9
    signatures = np.zeros((2, ss.SIGNATURE_ROWS, ss.KINDS * ss.SLOTS))
    signatures[:, [ss.LAMBDA, ss.ZETA]] = 1.0
    signatures[-1, [ss.STATISTIC, ss.OWN], kind] = 25.0
    rows = {
        'signatures': signatures,
        'weight': np.ones(1),
        'born_ns': np.full(ss.SLOTS, 600 * second),
    }
    said = []
    for k in range(1, 1000):
        changed = {'current': np.array([0.0, 0.1 if k > 600 else 0.0])}
        shown = rows if 620 < k < 640 else {}
        one = view(memories(), stamp_ns=k * second, **changed, **shown)
        present = watchdog.look(one, []).present
        said.append({p.condition.key for p in present})
    assert 'slow fault' in said[630]
    assert said[-1] == ({'current or fixes'} if stays else set())


def test_outliers_are_scatter_and_a_warning():
    rng, kept = np.random.default_rng(5), memories()
    for k in range(200):
        wild = k % 3 == 0
        feed(kept, (8.0 if wild else 1.0) * rng.standard_normal(2), 0.1 * k, fused=not wild)
    health = look(kept)
    assert health.level is Level.WARN
    assert health.culprit is Culprit.FIXES
    assert 'scatter' in health.sentence


def test_fixes_that_scatter_much_less_than_stated_are_named():
    rng, kept = np.random.default_rng(6), memories()
    for k in range(600):
        feed(kept, 0.5 * rng.standard_normal(2), 0.1 * k)
    assert 'their stated errors are too large' in look(kept).sentence


@pytest.mark.parametrize(
    ('changes', 'level', 'says'),
    [
        ({'share': -0.5}, Level.WARN, 'the quadratic drag of surge comes out negative'),
        ({'share': 1.5}, Level.WARN, 'the linear drag of surge comes out negative'),
        ({'share': -0.2}, Level.OK, ''),
        ({'drag_ratio': 2.0}, Level.WARN, '7.4 times the stated one'),
        ({'drag_ratio': 2.0, 'drag_sigma': 0.5}, Level.OK, ''),
        ({'thrust_age_s': 30.0}, Level.WARN, 'no thrust for 30 s'),
        ({'thrust_age_s': np.inf}, Level.WARN, 'no thrust yet'),
        ({'speed': 50.0}, Level.ERROR, 'faster than max_speed'),
    ],
)
def test_states_that_this_vehicle_cannot_be_in(changes, level, says):
    health = look(memories(), **changes)
    assert health.level is level
    assert says in health.sentence
