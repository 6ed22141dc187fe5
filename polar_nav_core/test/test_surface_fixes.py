"""Fixes of an antenna: used at the surface, refused with a receipt while the vehicle dives."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of
from compiled import jit_only

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.verdicts import Verdict


@pytest.mark.parametrize('height', [-0.5, -20.0])
@jit_only
def test_an_antenna_works_at_the_surface_only(height):
    world = World(12.0, height=height)
    fixes = [replace(f, topic='/gnss/fix', surface_depth=2.0) for f in world.fixes(1.0, 0.05)]
    fixes[3] = replace(fixes[3], surface_depth=np.inf)
    params = world.params()
    inputs = inputs_of(world, fixes)
    fast = engine_run.run(params, inputs)
    slow = engine_run.run(params, inputs, one_by_one=True)
    np.testing.assert_array_equal(fast.track.P, slow.track.P)
    assert [repr(r) for r in fast.receipts] == [repr(r) for r in slow.receipts]
    dived = height < -2.0
    for k, receipt in enumerate(fast.receipts):
        refused = dived and k != 3
        assert receipt.verdict is (Verdict.IMPLAUSIBLE if refused else Verdict.FUSED)
        assert ('antenna works above 2 m' in receipt.reason) is refused


@jit_only
def test_a_ping_through_the_water_is_refused_and_no_bottom_lock():
    world = World(6.0)
    inputs = inputs_of(world, [])
    water = np.zeros(len(inputs.dvl_valid), dtype=bool)
    water[10:20] = True
    inputs.dvl_v_m[10:20] += 0.3  # a current
    inputs.dvl_valid[10:20] = False
    params = world.params()
    plain = engine_run.run(params, inputs)
    fast = engine_run.run(params, replace(inputs, dvl_water=water))
    slow = engine_run.run(params, replace(inputs, dvl_water=water), one_by_one=True)
    np.testing.assert_array_equal(fast.track.P, plain.track.P)
    assert [repr(r) for r in fast.receipts] == [repr(r) for r in slow.receipts]
    assert len(fast.receipts) == 10
    assert all(r.verdict is Verdict.NOT_READY for r in fast.receipts)
    assert all('no current is estimated' in r.reason for r in fast.receipts)
    assert not plain.receipts
