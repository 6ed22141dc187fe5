"""The engine with errors that measurements share: covered by what is published, to first order."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core.engine import run as engine_run
from polar_nav_core.error_model import X

STRATEGIES = ('ignore', 'back_propagate', 'clone', 'rewind')


@pytest.fixture(scope='module')
def world():
    return World(30.0)


def run(world, inputs, **changes):
    usual = {'configuration': 'custom', 'delay_handling': 'clone', 'gate_probability': 1.0}
    return engine_run.run(world.params(**{**usual, **changes}), inputs)


def last_change(one, other):
    """Error vectors: position (ECEF) and velocity of one run's end less the other's."""
    a, b = one.track, other.track
    return a.r_e[-1] - b.r_e[-1], a.v_G[-1] - b.v_G[-1]


@pytest.mark.parametrize('strategy', STRATEGIES)
def test_stating_common_errors_changes_no_estimate(world, strategy):
    inputs = inputs_of(world, world.fixes(1.0, lambda _: 0.7, first_s=1.0))
    without = run(world, inputs, delay_handling=strategy)
    stated = run(
        world,
        inputs,
        delay_handling=strategy,
        fix_offset_sigma=1.0,
        fix_range_scale_sigma=0.01,
        fix_clock_sigma=0.1,
        dvl_misalignment_sigma_deg=1.0,
        dvl_lever_sigma=0.2,
        depth_offset_sigma=0.5,
    )
    for name in ('r_e', 'v_G', 'C_b_G', 'sensor_errors'):
        np.testing.assert_array_equal(
            getattr(without.track, name), getattr(stated.track, name), name
        )
    sigma = [np.sqrt(np.trace(r.track.P[-1, X.dr_e, X.dr_e])) for r in (without, stated)]
    assert sigma[1] > np.hypot(sigma[0], 1.0)


@pytest.mark.parametrize('strategy', STRATEGIES)
@pytest.mark.parametrize('kind', ['turned DVL', 'offset', 'depth'])
def test_the_engine_is_off_by_what_is_published(world, strategy, kind):
    """One common error of one stated sigma: the published covariance grows by its square."""
    delay = 0.0 if strategy == 'ignore' else 0.7
    inputs = inputs_of(world, world.fixes(1.0, lambda _: delay, first_s=1.0))
    if kind == 'turned DVL':
        b = np.radians(0.3)
        off = replace(inputs, dvl_v_m=inputs.dvl_v_m + np.cross([0.0, 0.0, b], inputs.dvl_v_m))
        stated = {'dvl_misalignment_sigma_deg': 0.3}
    elif kind == 'depth':
        off, stated = replace(inputs, depth=inputs.depth + 0.5), {'depth_offset_sigma': 0.5}
    else:
        up_e = inputs.fixes[0].r_e / np.linalg.norm(inputs.fixes[0].r_e)
        east_e = np.cross([0.0, 1.0, 0.0], up_e)
        east_e /= np.linalg.norm(east_e)
        moved = tuple(replace(f, r_e=f.r_e + 0.5 * east_e) for f in inputs.fixes)
        off, stated = replace(inputs, fixes=moved), {'fix_offset_sigma': 0.5}
    clean = run(world, inputs, delay_handling=strategy)
    wrong = run(world, off, delay_handling=strategy)
    told = run(world, inputs, delay_handling=strategy, **stated)
    dr_e, dv_G = last_change(wrong, clean)
    added = told.track.P[-1] - clean.track.P[-1]
    # What is added is S B S^T: of full rank 1 for the depth, 2 for yaw and pitch, 3 for offsets.
    for error, block in ((dr_e, X.dr_e), (dv_G, X.dv_G)):
        size = np.linalg.norm(error)
        if size < 1e-4:
            continue
        along = error / size
        sigma = np.sqrt(along @ added[block, block] @ along)
        assert sigma == pytest.approx(size, rel=0.05 if strategy != 'clone' else 0.1)
