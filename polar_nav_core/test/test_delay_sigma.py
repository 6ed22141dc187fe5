"""Fixes whose delay varies and is not stated: their covariance grows along the velocity."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.verdicts import Verdict

pytestmark = pytest.mark.slow

LAG = 0.8
"""1-sigma of the lag [s]."""


@pytest.fixture(scope='module')
def world():
    return World(120)


def late(world, seed=5):
    """Fixes of 0.2 m, valid by a random lag earlier than they say."""
    rng = np.random.default_rng(seed)
    found = []
    for fix in world.fixes(2.0, 5.0, sigma=0.2, rng=rng, first_s=4.0):
        k = int(np.searchsorted(world.stamps, fix.validity_ns))
        then = max(0, k - round(100 * rng.normal(0.0, LAG)))
        then = min(then, len(world.r_e) - 1)
        found.append(replace(fix, r_e=fix.r_e + world.r_e[then] - world.r_e[k]))
    return found


def run(world, fixes, *, one_by_one=False, **changes):
    params = replace(world.params(), **changes)
    return engine_run.run(params, inputs_of(world, fixes), one_by_one=one_by_one)


def nis(result):
    return np.array([r.nis for r in result.receipts if r.nis > 0.0])


def test_nis_is_that_of_the_stated_lag(world):
    fixes = late(world)
    plain = run(world, fixes)
    stated = run(world, [replace(fix, delay_sigma=LAG) for fix in fixes])
    assert stated.verdicts[Verdict.FUSED] == len(fixes)
    assert 0.5 * 3.0 < nis(stated).mean() < 1.5 * 3.0
    assert plain.verdicts.get(Verdict.GATED, 0) > 0 or nis(plain).mean() > 6.0


@pytest.mark.parametrize('handling', ['ignore', 'tagged', 'back_propagate', 'clone', 'rewind'])
def test_event_by_event_equals_the_arrays(world, handling):
    changes = {'configuration': 'custom', 'delay_handling': handling}
    fixes = [replace(f, delay_sigma=LAG if f.sequence % 3 else 0.0) for f in late(world)]
    a = run(world, fixes, **changes)
    b = run(world, fixes, one_by_one=True, **changes)
    np.testing.assert_array_equal(a.track.r_e, b.track.r_e)
    np.testing.assert_array_equal(nis(a), nis(b))
    assert len(nis(a)) > 30


def test_the_content_of_a_fix_stays_what_was_received(world):
    """A copy under another number is recognised, though the vehicle moved on."""
    fixes = [replace(fix, delay_sigma=LAG) for fix in late(world)]
    copy = fixes[10]
    again = replace(copy, sequence=900, order=900, receive_ns=copy.receive_ns + 3 * 10**9)
    result = run(world, [*fixes, again])
    assert result.verdicts[Verdict.REPLAYED] == 1


def test_it_grows_along_the_velocity_only(world):
    fix = late(world)[20]
    result = run(world, [fix])
    wide = run(world, [replace(fix, delay_sigma=LAG)])
    k = int(np.searchsorted(world.stamps, fix.validity_ns))
    direction = world.v_G[k] / np.linalg.norm(world.v_G[k])
    added = [np.array(r.receipts[0].innovation_variance_G) for r in (result, wide)]
    expected = np.square(LAG * np.linalg.norm(world.v_G[k]) * direction)
    np.testing.assert_allclose(added[1] - added[0], expected, rtol=0.05, atol=1e-3)
