"""Late fixes of simulated worlds by `clone`: the compiled loop against event by event."""

import numpy as np
import pytest

from polar_nav_core.engine import run as batch
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.world import make_world
from polar_nav_tools.experiments.world_spec import WorldSpec


@pytest.mark.parametrize(
    ('imu', 'dvl_rate_hz', 'robust', 'gate'),
    [('paper_6_2', 5.0, 'none', 1.0), ('tactical', 10.0, 'mahalanobis', 0.95)],
)
def test_same_bits_compiled_and_one_by_one(imu, dvl_rate_hz, robust, gate):
    """With a gate that refuses some: the loop hands those to Python."""
    spec = WorldSpec(
        duration_s=90.0,
        imu=imu,
        dvl_rate_hz=dvl_rate_hz,
        depth_rate_hz=10.0,
        constants='prior',
    )
    fixes = FixSpec(period_s=1.0, delay_kind='uniform', delay_s=30.0, loss=0.1)
    world = make_world(spec, fixes, 9701)
    params = world.params(
        configuration='custom',
        delay_handling='clone',
        noise_adaptation='none',
        gate_probability=gate,
        robust_fixes=robust,
        max_delay_s=25.0,  # some are too old
        history_s=26.0,
    )
    whole = batch.run(params, world.inputs)
    single = batch.run(params, world.inputs, one_by_one=True)
    assert len(whole.verdicts) > 1
    np.testing.assert_array_equal(whole.track.P, single.track.P)
    np.testing.assert_array_equal(whole.track.r_e, single.track.r_e)
    assert [str(r) for r in whole.receipts] == [str(r) for r in single.receipts]
