"""Fixes without a height: sizes, gates, weights and offsets of two numbers."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of, run
from compiled import jit_only

from polar_nav_core.earth import ecef_from_geodetic
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.integrity import IntegrityMonitor
from polar_nav_core.engine.level import degrees_of_freedom, is_level, levelled
from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.results import chi2_gate
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.kernels import watch
from polar_nav_core.kernels.sins import state as fs
from polar_nav_core.kernels.sins.judge import dof_of
from polar_nav_core.kernels.sins.work import make_work
from polar_nav_core.level import LEVEL_SIGMA


def fix(sigma_up, latitude=1.2):
    r_e = ecef_from_geodetic(latitude, 0.7, 0.0)
    C_e_G = np.asarray(ecef_to_grid(r_e))
    P = C_e_G.T @ np.diag([4.0, 4.0, sigma_up**2]) @ C_e_G
    return Fix(1, 1, 2, 'ugps', 1, 1, 1, r_e=r_e, covariance_e=P)


@pytest.mark.parametrize(
    ('sigma_up', 'level'), [(2.0, False), (300.0, False), (LEVEL_SIGMA, True)]
)
@pytest.mark.parametrize('latitude', [1.2, -1.5707, 0.0])
def test_a_fix_is_as_many_numbers_as_it_states(sigma_up, level, latitude):
    found = fix(sigma_up, latitude)
    assert is_level(found) is level
    assert degrees_of_freedom(found) == (2 if level else 3)
    offset_G = np.array([1.0, 2.0, 300.0])
    assert levelled(offset_G, found).tolist() == [1.0, 2.0, 0.0 if level else 300.0]


def test_wide_level_axes_are_no_height():
    """10 km of sigma along the ground: the height is known, and counts."""
    found = fix(2.0)
    wide = replace(found, covariance_e=found.covariance_e + LEVEL_SIGMA**2 * np.eye(3))
    C_e_G = np.asarray(ecef_to_grid(found.r_e))
    up = C_e_G[2]
    known = wide.covariance_e - LEVEL_SIGMA**2 * np.outer(up, up)
    assert not is_level(replace(found, covariance_e=known))
    assert is_level(wide)


def test_a_fix_that_is_believed_less_states_what_it_did():
    """Weights, delays of unknown length and trials of a larger noise measure the height, too."""
    found = fix(300.0)
    less = found.believed_to(4.0 * found.covariance_e).believed_to(9.0 * found.covariance_e)
    assert (less.covariance_e == 9.0 * found.covariance_e).all()
    assert less.stated_covariance_e is found.covariance_e
    assert degrees_of_freedom(less) == 3
    assert degrees_of_freedom(replace(found, covariance_e=less.covariance_e)) == 2


@pytest.mark.parametrize(
    ('stream', 'm', 'stated', 'dof'),
    [(fs.FIX_ROW, 3, 2, 2), (fs.FIX_ROW, 3, 3, 3), (fs.DVL_ROW, 3, 2, 3), (fs.DEPTH_ROW, 1, 2, 1)],
)
def test_a_stated_number_is_that_of_a_fix_only(stream, m, stated, dof):
    work = make_work()
    work.dof[0] = stated
    assert dof_of(work, stream, m) == dof


HANDLING = ['ignore', 'tagged', 'back_propagate', 'clone', 'rewind']
WAYS = [*((name, 'none') for name in HANDLING), *((name, 'sage_husa') for name in HANDLING[:3])]
"""Ways to treat late fixes, with noise as stated and with one that is adapted in Python."""


def of_height(world, sigma_up, east_m=0.0):
    """A fix of the world with so uncertain a height, so far east of where it was."""
    (found,) = world.fixes(10.0, 0.5, first_s=2.0)
    C_e_G = np.asarray(ecef_to_grid(found.r_e))
    P = C_e_G.T @ np.diag([4.0, 4.0, sigma_up**2]) @ C_e_G
    return replace(found, r_e=found.r_e + east_m * C_e_G[0], covariance_e=P)


def receipt_of(world, params, chosen):
    """Receipt of a fix, and the mean NIS per degree of freedom that the watchdog has of it."""
    engine = Engine(params)
    found = run(engine, [*world.imu(), *world.dvl(), *world.depth(), chosen])
    (receipt,) = (o for o in found if isinstance(o, Receipt))
    return receipt, engine.fusion.filter.state.memories[fs.FIX_ROW, watch.SHORT, watch.NIS]


def with_nis(world, params, sigma_up, nis):
    """Receipt as of `receipt_of` of a fix that is so far off."""
    usual = receipt_of(world, params, of_height(world, sigma_up))[0]
    wanted_m = np.sqrt(nis * usual.innovation_variance_G[0]) - usual.innovation_G[0]
    return receipt_of(world, params, of_height(world, sigma_up, wanted_m))


@pytest.fixture(scope='module')
def world():
    return World(3.0)


def params_of(world, handling, noise='none', **changes):
    return world.params(
        configuration='custom',
        delay_handling=handling,
        noise_adaptation=noise,
        robust_fixes='mahalanobis',
        **changes,
    )


@jit_only
@pytest.mark.parametrize(('handling', 'noise'), WAYS)
def test_the_watchdog_remembers_a_weighted_fix_as_it_was_stated(world, handling, noise):
    """Of 400 m of vertical sigma: three numbers, though its weight made more than 500 m of it."""
    receipt, remembered = with_nis(world, params_of(world, handling, noise), 400.0, 15.0)
    assert receipt.verdict is Verdict.FUSED
    assert 'weight' in receipt.reason
    assert receipt.dof == 3
    assert remembered == pytest.approx(receipt.nis / 3.0)


@jit_only
@pytest.mark.parametrize(('handling', 'noise'), WAYS)
@pytest.mark.parametrize(
    ('sigma_up', 'dof', 'verdict'), [(400.0, 3, Verdict.FUSED), (600.0, 2, Verdict.GATED)]
)
def test_the_outcome_has_the_gate_of_its_numbers(world, handling, noise, sigma_up, dof, verdict):
    """By two it is 18.4, by three 21.1."""
    receipt, remembered = with_nis(world, params_of(world, handling, noise), sigma_up, 19.7)
    assert receipt.nis == pytest.approx(19.7, abs=0.3)
    assert (receipt.dof, receipt.gate) == (dof, chi2_gate(0.9999, dof))
    assert receipt.verdict is verdict
    assert remembered == pytest.approx(receipt.nis / dof)


@jit_only
@pytest.mark.parametrize('handling', HANDLING)
def test_a_whole_run_states_the_same(world, handling):
    params, chosen = params_of(world, handling), of_height(world, LEVEL_SIGMA)
    receipt = receipt_of(world, params, chosen)[0]
    events = inputs_of(world, [chosen])
    for one_by_one in (False, True):
        (found,) = engine_run.run(params, events, one_by_one=one_by_one).receipts
        assert (found.dof, found.gate) == (receipt.dof, receipt.gate) == (2, chi2_gate(0.9999, 2))


@jit_only
@pytest.mark.parametrize(('pings', 'dof'), [(False, 2), (True, 5)])
def test_a_filter_as_printed_counts_the_velocity_beside_it(world, pings, dof):
    params = params_of(world, 'ignore', 'sage_husa_published')
    engine = Engine(params)
    dvl = world.dvl() if pings else []
    found = run(engine, [*world.imu(), *dvl, *world.depth(), of_height(world, LEVEL_SIGMA)])
    (receipt,) = (o for o in found if isinstance(o, Receipt))
    assert (receipt.dof, receipt.gate) == (dof, chi2_gate(0.9999, dof))


def test_scattered_fixes_at_another_height_are_not_believed():
    """Twelve after a start, 20 m around the vehicle and 300 m above it: that is no offset."""
    rng = np.random.default_rng(2)
    level = fix(LEVEL_SIGMA)
    found = {}
    for name, of in (('level', lambda d: levelled(d, level)), ('whole', lambda d: d)):
        monitor = IntegrityMonitor(60.0)
        for k in range(12):
            angle = rng.uniform(0.0, 2.0 * np.pi)
            offset_G = np.array([20.0 * np.cos(angle), 20.0 * np.sin(angle), 300.0])
            monitor.gated(k * 10**9, k * 10**9, of(offset_G))
        found[name] = monitor.contradiction(0, doubted=False, least_s=5.0)
    assert found['level'] is None
    assert found['whole'] is not None
