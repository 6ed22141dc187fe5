"""A start known to kilometres: the first late fixes place the vehicle, and none is refused."""

from dataclasses import replace

import numpy as np
import pytest

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_tools.experiments.mismatch.row import SINS

pytestmark = pytest.mark.slow

METRES_PER_DEG = 111e3


@pytest.mark.parametrize('sigma', [1000.0, 3000.0, 10000.0])
@pytest.mark.parametrize('delay', ['clone', 'rewind'])
@pytest.mark.parametrize('seed', [401, 402])
def test_late_fixes_place_a_vehicle_whose_start_is_known_to_kilometres(sigma, delay, seed):
    scene = replace(SINS, world=replace(SINS.world, duration_s=60.0))
    world = scene.make(seed)
    changes = {'configuration': 'custom', 'noise_adaptation': 'none', 'delay_handling': delay}
    params = scene.params(world, {**changes, 'initial_sigma_position': sigma})
    north, east = sigma * np.random.default_rng(seed).uniform(-2.0, 2.0, 2) / METRES_PER_DEG
    latitude = params.initial_latitude_deg
    params = replace(
        params,
        initial_latitude_deg=latitude + north,
        initial_longitude_deg=params.initial_longitude_deg + east / np.cos(np.radians(latitude)),
    )
    result = engine_run.run(params, world.inputs)
    if sigma < 10_000.0:  # `clone` has not the digits for 10 km beside millimetres of height
        assert set(result.verdicts) == {Verdict.FUSED}
    track = result.track
    late = track.stamps_ns - track.stamps_ns[0] > 30_000_000_000
    truth = world.truth.state(track.stamps_ns[late]).r_e
    assert np.linalg.norm(track.r_e[late] - truth, axis=1).max() < 4.0
