"""Gates with hindsight, and passes that are linearized at the track of the one before."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core import attitude, grid
from polar_nav_core.engine import smoothing
from polar_nav_core.engine.results import chi2_gate
from polar_nav_core.engine.sins.recorded import Recorded
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.level import LEVEL_SIGMA

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def world():
    return World(150.0, leg_s=40.0)


def displaced(fixes, numbers, east):
    """Fixes of which some lie so much [m] farther grid east."""
    C_e_G = grid.ecef_to_grid(fixes[0].r_e)
    by = C_e_G.T @ [east, 0.0, 0.0]
    return [replace(f, r_e=f.r_e + by) if f.sequence in numbers else f for f in fixes]


def position_errors(found, world):
    k = np.searchsorted(world.stamps, found.track.stamps_ns)
    return np.linalg.norm(found.track.r_e - np.array(world.r_e)[k], axis=1)


def fixes_of(world, seed=3):
    return world.fixes(5.0, 2.0, rng=np.random.default_rng(seed))


def test_a_run_in_which_all_fits_needs_one_pass(world):
    params = world.params(configuration='default', robust_fixes='none')
    custom = replace(params, configuration='custom', robust_fixes='none', gate_probability=0.9999)
    found = smoothing.smooth(custom, inputs_of(world, fixes_of(world)))
    assert found.passes == 1
    assert not found.revisions
    assert not found.unsettled
    assert all(r.revision == 0 for r in found.receipts)


def test_a_fix_that_misled_the_start_goes_and_those_that_it_kept_out_come_back(world):
    """The start is not known: the first fix is believed, and the good ones after it are not."""
    params = world.params(configuration='default', initial_sigma_position=50.0)
    inputs = inputs_of(world, displaced(fixes_of(world), [0], 60.0))
    once = smoothing.smooth(params, inputs, passes=1)
    verdicts = {r.sequence: r.verdict for r in once.receipts if r.topic == 'acomms/rx'}
    assert verdicts[0] is Verdict.FUSED
    assert verdicts[1] is Verdict.GATED
    found = smoothing.smooth(params, inputs)
    last = {r.sequence: r for r in found.receipts}  # a revision stands behind its first receipt
    assert last[0].verdict is Verdict.GATED
    assert last[0].revision == 1
    assert 'hindsight' in last[0].reason
    assert last[1].verdict is Verdict.FUSED
    assert {(r.number, r.before, r.after) for r in found.revisions} >= {
        (0, Verdict.FUSED, Verdict.GATED),
        (1, Verdict.GATED, Verdict.FUSED),
    }
    assert position_errors(found, world).max() < 2.0
    assert position_errors(once, world).max() > 10.0


@pytest.mark.parametrize(('sigma_up', 'dof'), [(400.0, 3), (LEVEL_SIGMA, 2)])
def test_they_are_judged_by_as_many_numbers_as_they_state(world, sigma_up, dof):
    """In each pass, though the weights of the one before made more than 500 m of 400 m."""
    params = world.params(
        configuration='custom',
        delay_handling='clone',
        noise_adaptation='none',
        robust_fixes='mahalanobis',
        initial_sigma_position=50.0,
    )
    up = np.asarray(grid.ecef_to_grid(world.r_e[0]))[2]
    fixes = [
        replace(f, covariance_e=f.covariance_e + sigma_up**2 * np.outer(up, up))
        for f in displaced(displaced(fixes_of(world), [0], 60.0), [9, 15, 20], 4.0)
    ]
    found = smoothing._Passes(params, inputs_of(world, fixes), 1.0, False)
    first = found._pass(params, None, None)
    plan = first.plan(found._inputs)
    assert any(one.added_G[2, 2] > 0.6 * sigma_up**2 for one in plan.fixes.values())
    stated = replace(found._stated, reopen_after_s=0.0)
    again = found._pass(stated, plan, None, first.moved)
    for one in (first, again):
        judged = one.decisions.judged
        assert set(judged.dof[judged.of_fixes].tolist()) == {dof}
    receipts = [
        r for r in smoothing.smooth(params, inputs_of(world, fixes)).receipts if r.revision
    ]
    assert {(r.dof, r.gate) for r in receipts} == {(dof, chi2_gate(0.9999, dof))}


def test_a_ping_and_a_depth_that_misled_the_start_go(world):
    params = world.params(
        configuration='default', initial_sigma_velocity=0.2, initial_sigma_height=5.0
    )
    inputs = inputs_of(world, fixes_of(world))
    v_m, depth = inputs.dvl_v_m.copy(), inputs.depth.copy()
    v_m[0] += [0.2, 0.0, 0.0]
    depth[0] += 4.0
    found = smoothing.smooth(params, replace(inputs, dvl_v_m=v_m, depth=depth))
    went = {(r.topic, r.stamp_ns) for r in found.revisions if r.after is Verdict.GATED}
    came = [r.topic for r in found.revisions if r.after is Verdict.FUSED]
    assert ('dvl/data', int(inputs.dvl_stamps_ns[0])) in went
    assert ('depth/data', int(inputs.depth_stamps_ns[0])) in went
    assert len(went) <= 4
    assert came.count('depth/data') > 20  # which the first one had kept out
    right = smoothing.smooth(params, inputs)
    np.testing.assert_allclose(found.track.r_e, right.track.r_e, atol=0.05)


def test_a_heading_that_was_unknown_is_linearized_anew(world):
    """Off by half a radian until fixes come: the way until then is turned, and not by a line."""
    params = world.params(
        configuration='default', initial_sigma_heading_deg=40.0, initial_sigma_velocity=3.0
    )
    off = replace(params, initial_grid_heading_deg=params.initial_grid_heading_deg + 30.0)
    fixes = world.fixes(2.0, 2.0, rng=np.random.default_rng(5), first_s=41.0)
    inputs = inputs_of(world, fixes)
    once, found = (smoothing.smooth(off, inputs, covariances=True, passes=n) for n in (1, 3))
    assert once.largest_turn > 0.3
    assert found.largest_turn < 1e-3
    assert not found.unsettled
    assert position_errors(found, world).max() < 0.2 * position_errors(once, world).max()
    k = np.searchsorted(world.stamps, found.track.stamps_ns)
    sigma = np.sqrt(np.einsum('nii->ni', found.track.P))
    off_m = (found.track.r_e - np.array(world.r_e)[k]) / sigma[:, 6:9]
    assert np.abs(off_m).max() < 4.0
    turns = [
        attitude.log(C @ world.C_b_G[j].T)[2] for C, j in zip(found.track.C_b_G, k, strict=True)
    ]
    assert np.abs(turns / sigma[:, 2]).max() < 4.0


def test_what_a_second_pass_is_held_to_is_where_it_ends_up(world):
    """Nothing is nonlinear or revised here: another pass changes nothing of note."""
    params = world.params(configuration='custom', robust_fixes='none')
    inputs = inputs_of(world, fixes_of(world))
    passes = smoothing._Passes(params, inputs, 1.0, True)
    first = passes._pass(passes._stated, None, None)
    again = passes._pass(passes._stated, first.plan(inputs), None)
    P = np.einsum('nii->ni', first.back.track.P)
    assert again.moved < 0.05
    off = again.back.track.r_e - first.back.track.r_e
    assert np.abs(off / np.sqrt(P[:, 6:9])).max() < 0.05
    np.testing.assert_allclose(
        np.einsum('nii->ni', again.back.track.P)[:, :18], P[:, :18], rtol=0.02
    )


def test_where_fixes_arrived_does_not_matter_for_revisions(world):
    params = world.params(configuration='default', initial_sigma_position=50.0)
    fixes = displaced(fixes_of(world), [0, 9], 60.0)
    soon = smoothing.smooth(params, inputs_of(world, fixes))
    rng = np.random.default_rng(1)
    late = [
        replace(f, receive_ns=f.validity_ns + int(d) * 10**9)
        for f, d in zip(fixes, rng.integers(0, 60, len(fixes)), strict=True)
    ]
    rng.shuffle(late)
    found = smoothing.smooth(params, inputs_of(world, late))
    assert found.passes == soon.passes
    assert found.revisions == soon.revisions
    np.testing.assert_array_equal(found.track.r_e, soon.track.r_e)


def test_fixes_in_the_compiled_loop_are_those_one_by_one(world, monkeypatch):
    """Gated ones, those that come back and go with hindsight, and their weights, to the bit."""
    params = world.params(configuration='default', initial_sigma_position=50.0)
    inputs = inputs_of(world, displaced(fixes_of(world), [0], 60.0))
    at_once = smoothing.smooth(params, inputs, covariances=True)
    assert at_once.passes > 1
    taken = []
    monkeypatch.setattr(Recorded, 'takes_fixes', property(lambda _: bool(taken.append(1))))
    by_one = smoothing.smooth(params, inputs, covariances=True)
    assert taken
    said, alone = ([str(r) for r in found.receipts] for found in (at_once, by_one))
    assert said == alone
    assert at_once.revisions == by_one.revisions
    for name in ('r_e', 'C_b_G', 'P', 'sensor_errors'):
        np.testing.assert_array_equal(getattr(at_once.track, name), getattr(by_one.track, name))
