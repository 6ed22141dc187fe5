"""Station mode: a model that is not obeyed, an AHRS that jumps, a state that is lost."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import station_twin as twin

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.health.conditions import Culprit, Level
from polar_nav_core.kernels.station import state as ss

pytestmark = pytest.mark.slow


@cache
def world():
    return twin.inputs(twin.truth(90.0), 4, depth_every=10)


def run(inputs, *, one_by_one=False, **changes):
    params = twin.params(**{'identify_method': 'none', 'reopen_after_s': 10.0, **changes})
    return engine_run.run(params, inputs, one_by_one=one_by_one)


# -- a model that is not obeyed -------------------------------------------------------------------


def dead_thruster(seconds=300.0, *, from_s=150.0):
    """World whose vehicle drifts from a time on, while its thrust messages go on."""
    truth = twin.truth(seconds)
    t = truth.t
    k = int(from_s * 100)
    v_r = truth.v_r.copy()
    v_r[k:] *= np.exp(-np.arange(len(t) - k)[:, None] * 0.01 / 5.0)
    v = np.einsum('nij,nj->ni', truth.R, v_r) + truth.current
    p = truth.p.copy()
    p[k:, :2] = p[k, :2] + np.cumsum(0.01 * v[k:, :2], axis=0)
    dead = replace(truth, p=p, v_r=v_r)
    return dead, twin.inputs(dead, 4, depth_every=10)


def velocity_in_sigmas(dead, track):
    row = np.searchsorted(dead.t, (track.stamps_ns - twin.START_NS) * 1e-9 - 1e-6)
    row = np.minimum(row, len(dead.t) - 1)
    e = track.v_G[:, :2] - dead.v[row, :2]
    return np.abs(e) / np.sqrt(np.stack([track.P[:, 3, 3], track.P[:, 4, 4]], axis=1))


def test_a_dead_thruster_loosens_the_model_and_the_velocity_follows_the_fixes():
    dead, inputs = dead_thruster()
    obedient, found = (run(inputs, model_doubt=x, output_period_s=1.0) for x in (0.0, 10.0))
    late = found.track.stamps_ns > twin.START_NS + 200_000_000_000
    assert velocity_in_sigmas(dead, obedient.track)[late].max() > 6.0
    assert velocity_in_sigmas(dead, found.track)[late].max() < 4.0
    # Nothing that was known before is given up for it, nor made up.
    before = found.track.stamps_ns < twin.START_NS + 150_000_000_000
    assert np.array_equal(found.track.x[before], obedient.track.x[before])
    assert np.array_equal(found.track.P_x[before], obedient.track.P_x[before])
    assert found.track.P_x[-1, ss.CURRENT, ss.CURRENT] > 0.1
    true_drag = np.log(25.0 * 1.1 + 19.0 * 1.1**2)
    sigma = np.sqrt(found.track.P_x[-1, ss.DRAG, ss.DRAG])
    assert abs(found.track.x[-1, ss.DRAG] - true_drag) < 3.0 * sigma


@pytest.mark.parametrize('name', ['rewind', 'clone', 'back_propagate', 'tagged'])
def test_a_loosened_model_is_reported_alike_event_by_event(name):
    _, inputs = dead_thruster(240.0)
    custom = {'configuration': 'custom', 'delay_handling': name, 'robust_fixes': 'mahalanobis'}
    a = run(inputs, **custom, output_period_s=1.0)
    b = run(inputs, **custom, output_period_s=1.0, one_by_one=True)
    assert np.array_equal(a.track.x, b.track.x)
    assert np.array_equal(a.track.P_x, b.track.P_x)
    said = [h for h in b.health if 'fixes contradicted the model' in h.sentence]
    assert said[0].level is Level.ERROR
    assert said[0].culprit & Culprit.MODEL
    assert 150.0 < (said[0].stamp_ns - twin.START_NS) * 1e-9 < 210.0
    assert said[0].resets >= 1
    assert not any(h.present for h in b.health if h.stamp_ns < said[0].stamp_ns - 10**10)


def test_fixes_in_any_order_loosen_the_model_alike():
    _, inputs = dead_thruster(240.0)
    usual = run(inputs, output_period_s=1.0)
    late = tuple(
        replace(f, receive_ns=f.receive_ns + (7_300_000_000 if f.sequence % 3 == 0 else 0))
        for f in inputs.fixes
    )
    mixed = run(replace(inputs, fixes=late), output_period_s=1.0)
    at = twin.START_NS + 225_000_000_000
    row, other = (int(np.searchsorted(r.track.stamps_ns, at)) for r in (usual, mixed))
    sigma = np.sqrt(usual.track.P_x[row].diagonal())
    # The last fixes are on their way at that time: those of the rest decide alike.
    difference = np.abs(usual.track.x[row] - mixed.track.x[other])
    assert (difference < 1.5 * sigma)[: ss.STATION].all()


def test_heading_of_the_ahrs_that_jumps_against_its_rates_is_estimated_anew():
    jump = np.radians(25.0)
    turn = np.array(
        [[np.cos(jump), -np.sin(jump), 0.0], [np.sin(jump), np.cos(jump), 0.0], [0.0, 0.0, 1.0]]
    )
    truth = twin.truth(300.0)
    inputs = twin.inputs(truth, 4, depth_every=10)
    C_b_G = inputs.C_b_G.copy()
    C_b_G[15_000:] = turn @ C_b_G[15_000:]
    found = run(replace(inputs, C_b_G=C_b_G), one_by_one=True, output_period_s=1.0)
    said = [h for h in found.health if 'turned against its own rates' in h.sentence]
    assert 150.0 < (said[0].stamp_ns - twin.START_NS) * 1e-9 < 152.1
    assert said[0].level is Level.ERROR
    assert said[0].culprit == Culprit.HEADING | Culprit.IMU
    bias = found.track.x[-1, ss.HEADING] - run(inputs).track.x[-1, ss.HEADING]
    sigma = np.sqrt(found.track.P_x[-1, ss.HEADING, ss.HEADING])
    assert abs(bias - jump) < 3.0 * sigma
    assert sigma < 0.5 * jump
    assert not any('turned against' in h.sentence for h in run(inputs, one_by_one=True).health)


# -- a state that is lost -------------------------------------------------------------------------


def _weight(bank):
    bank.weight[1] = np.nan


def _state(bank):
    bank.x[:, 0] = np.inf


def _indefinite(bank):
    bank.P[:, 3, 4] = bank.P[:, 4, 3] = 1e4


@pytest.mark.parametrize('name', ['rewind', 'clone', 'back_propagate'])
@pytest.mark.parametrize('spoil', [_weight, _state, _indefinite])
def test_a_spoiled_state_is_restored_and_reported(name, spoil):
    custom = {'configuration': 'custom', 'delay_handling': name, 'robust_fixes': 'mahalanobis'}
    params = twin.params(identify_method='none', **custom)
    engine, spoiled, after, reports = Engine(params), False, [], []
    for event in world().events():
        if not spoiled and event.stamp_ns > twin.START_NS + 40_300_000_000:
            spoil(engine.fusion.filter.bank)
            spoiled = True
        out = list(engine.process(event))
        after += [o for o in out if spoiled and hasattr(o, 'r_e')]
        reports += [engine.health] if spoiled and engine.health is not None else []
    assert engine.navigating
    assert engine.restored.count == 1
    assert all(np.isfinite(e.r_e).all() and np.isfinite(e.P[:9, :9]).all() for e in after[-300:])
    assert any(h.level is Level.ERROR and 'newest sound state' in h.sentence for h in reports)
    usual = engine_run.run(params, world()).track
    off = np.linalg.norm(after[-1].r_e - usual.r_e[-1])
    assert off < 3.0 * np.sqrt(np.trace(after[-1].P[6:9, 6:9]))
    assert engine.fix_counts()[1] > 25


def test_a_whole_run_is_restored_as_event_by_event():
    """A thrust that makes the state infinite, let in by its limit."""
    force_b = world().force_b.copy()
    force_b[4000, 0] = 1e200
    inputs = replace(world(), force_b=force_b)
    a, b = (run(inputs, thrust_limit_n=1e300, one_by_one=alone) for alone in (False, True))
    assert a.divergence == b.divergence == ''
    assert np.array_equal(a.track.stamps_ns, b.track.stamps_ns)
    assert np.array_equal(a.track.x, b.track.x)
    assert np.array_equal(a.track.P, b.track.P)
    assert np.isfinite(a.track.r_e).all()
    assert np.array_equal([r.verdict for r in a.receipts], [r.verdict for r in b.receipts])
    assert any('newest sound state' in h.sentence for h in b.health)
