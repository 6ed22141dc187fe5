"""Slow faults in whole runs: found by their signature, in every way to run the engine."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core.engine import health_monitor
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.health.conditions import Level
from polar_nav_core.engine.sins.view import view_of
from polar_nav_core.error_model import X
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.kernels.sins import hypotheses as hy

DRIFT_MPS, BEGIN_S = 0.2, 65.0


@pytest.fixture(scope='module')
def world():
    return World(150.0)


def sentences(result):
    """Sentences on slow faults, by look."""
    return {
        h.stamp_ns: p.condition.sentence
        for h in result.health
        for p in h.present
        if p.condition.key == 'slow fault'
    }


def drifting(inputs):
    """The same inputs with fixes that drift to grid east."""
    first_ns = int(inputs.imu_stamps_ns[0])
    moved = []
    for fix in inputs.fixes:
        since_s = max(0.0, (fix.validity_ns - first_ns) * 1e-9 - BEGIN_S)
        east_e = ecef_to_grid(fix.r_e)[0]
        moved.append(replace(fix, r_e=fix.r_e + DRIFT_MPS * since_s * east_e))
    return replace(inputs, fixes=tuple(moved))


@pytest.mark.parametrize('delay_handling', ['clone', 'rewind'])
def test_a_drift_of_fixes_is_found_with_size_and_direction(world, delay_handling):
    inputs = inputs_of(world, world.fixes(1.0, lambda _: 0.5, first_s=1.0))
    params = world.params(configuration='custom', delay_handling=delay_handling)
    clean = engine_run.run(params, inputs, look_every_s=1.0)
    assert sentences(clean) == {}
    looked = engine_run.run(params, drifting(inputs), look_every_s=1.0)
    found = sentences(looked)
    assert found
    words = found[max(found)].split()
    at = words.index('drift')
    assert float(words[at + 2]) == pytest.approx(DRIFT_MPS, rel=0.25)
    assert float(words[at + 6]) == pytest.approx(90.0, abs=15.0)
    last_ns = max(found)
    (level,) = {
        p.condition.level
        for h in looked.health
        for p in h.present
        if h.stamp_ns == last_ns and p.condition.key == 'slow fault'
    }
    assert level is Level.ERROR
    moved = float(found[last_ns].split('moved the position by ')[1].split()[0])
    k = int(np.searchsorted(looked.track.stamps_ns, last_ns, side='right')) - 1
    C_e_G = np.asarray(ecef_to_grid(clean.track.r_e[k]))[:2]
    d = C_e_G @ (looked.track.r_e[k] - clean.track.r_e[k])
    P = C_e_G @ looked.track.P[k, X.dr_e, X.dr_e] @ C_e_G.T
    assert moved == pytest.approx(np.sqrt(d @ np.linalg.solve(P, d)), rel=0.35)


def test_single_steps_find_the_same(world):
    inputs = drifting(inputs_of(world, world.fixes(1.0, lambda _: 0.5, first_s=1.0)))
    params = world.params(configuration='default')
    looked = engine_run.run(params, inputs, look_every_s=1.0)
    single = engine_run.run(params, inputs, one_by_one=True)
    plain = engine_run.run(params, inputs)
    np.testing.assert_array_equal(looked.track.P, plain.track.P)
    found, one_by_one = sentences(looked), sentences(single)
    assert found
    assert list(found.values()) == list(one_by_one.values())


def test_the_shift_of_the_position_is_along_the_grid_axes(world, monkeypatch):
    """Fixes that drift to grid east take the estimate to grid east."""
    views = []

    def seen(*args):
        views.append(view_of(*args))
        return views[-1]

    monkeypatch.setattr(health_monitor, 'view_of', seen)
    inputs = inputs_of(world, world.fixes(1.0, lambda _: 0.5, first_s=1.0))
    engine_run.run(world.params(configuration='default'), inputs, look_every_s=10.0)
    bank, _, per_unit_G = views[-1].evidence
    slot = int(np.argmax(bank[hy.STATISTIC].reshape(hy.SLOTS, hy.KINDS)[:, hy.FIX_EAST]))
    east, north = (per_unit_G[:, slot * hy.KINDS + k] for k in (hy.FIX_EAST, hy.FIX_NORTH))
    assert east[0] > 1.0
    assert north[1] > 1.0
    assert abs(east[1]) < 0.3 * east[0]
    assert abs(north[0]) < 0.3 * north[1]


def seen(monkeypatch, params, inputs):
    """What is known of the common errors, and the bank, at the last look of a run."""
    last = {}

    def look(fusion, stamp_ns, resets):
        view = view_of(fusion, stamp_ns, resets)
        bank, born_ns, _ = view.evidence
        last.update(shared=view.shared[0].copy(), bank=bank.copy(), born_ns=born_ns.copy())
        return view

    with monkeypatch.context() as patched:
        patched.setattr(health_monitor, 'view_of', look)
        engine_run.run(params, inputs, look_every_s=1.0)
    return last


@pytest.mark.parametrize('haste', [1.0, 2.5])
def test_what_a_fault_makes_of_common_errors_is_foreseen_in_a_swing(monkeypatch, haste):
    """A lever arm shows by rates that swing within a window: its rows are not those of the end."""
    swinging = World(200.0, haste=haste)
    common = {
        'dvl_lever_sigma': 0.1,
        'dvl_latency_sigma': 0.05,
        'dvl_misalignment_sigma_deg': 0.3,
    }
    params = swinging.params(configuration='custom', delay_handling='clone', **common)
    inputs = inputs_of(swinging, swinging.fixes(1.0, lambda _: 0.5, first_s=1.0))
    plain = seen(monkeypatch, params, inputs)
    faulty = seen(monkeypatch, params, drifting(inputs))
    changed = faulty['shared'] - plain['shared']
    assert np.abs(changed).max() > 1.0
    begin_ns = int(inputs.imu_stamps_ns[0]) + round(BEGIN_S * 1e9)
    slot = int(np.argmin(np.abs(faulty['born_ns'] - begin_ns)))
    learned = faulty['bank'][hy.LEARNED : hy.LAMBDA, slot * hy.KINDS + hy.FIX_EAST]
    np.testing.assert_allclose(DRIFT_MPS * learned, changed, rtol=0.1, atol=0.05)
