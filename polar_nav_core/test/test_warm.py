"""What set-up compiles is what the engine calls: no kernel is compiled a second time."""

import numba
import numpy as np
import pytest
from closed_loop import World, run

from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.params import DELAY_HANDLING
from polar_nav_core.kernels import filter as kf
from polar_nav_core.kernels import filter_clone, filter_imu, filter_rows, filter_walk
from polar_nav_core.kernels.warm import warm_filter


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='nothing is compiled')
def test_the_engine_needs_no_kernel_that_set_up_has_not_compiled():
    warm_filter()
    world = World(5.0)
    fixes = world.fixes(1.0, 1.0, rng=np.random.default_rng(0))
    events = [*world.imu(), *world.dvl(), *world.depth(), *fixes]
    for name in DELAY_HANDLING:
        run(Engine(world.params(configuration='custom', delay_handling=name)), events)
    compiled = [
        k
        for m in (kf, filter_clone, filter_imu, filter_rows, filter_walk)
        for n, k in vars(m).items()
        if hasattr(k, 'signatures') and n[0] != '_'
    ]
    assert len(compiled) > 10
    assert {k.__name__: len(k.signatures) for k in compiled if len(k.signatures) > 1} == {}
