"""The smoother with a vehicle's model in the filter: through a time without DVL and fixes."""

from importlib.resources import files

import numpy as np
import pytest

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine import smoothing
from polar_nav_tools.experiments.evidence import aiding
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.world import make_world
from polar_nav_tools.experiments.world_spec import WorldSpec

GAP_S = (60.0, 160.0)


@pytest.fixture(scope='module')
def runs():
    """World, filtered and smoothed track."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(aiding, 'GAP_S', GAP_S)
        spec = WorldSpec(
            duration_s=220.0,
            mission=str(files(aiding.__package__).joinpath('aiding.yaml')),
            imu='paper_6_2',
            imu_rate_hz=100.0,
            constants='prior',
            dvl_rate_hz=5.0,
        )
        fixes = FixSpec(period_s=2.5, first_s=1.0, delay_s=2.0)
        world = aiding.Gap(fixes=False)(make_world(spec, fixes, 3))
    params = world.params(configuration='default', model_aiding=True, output_period_s=1.0)
    return (
        world,
        engine_run.run(params, world.inputs).track,
        smoothing.smooth(params, world.inputs, covariances=True),
    )


def errors(world, track):
    """Time [s], position errors (k, 3) [m], ECEF."""
    truth = world.truth.state(track.stamps_ns).r_e
    return (track.stamps_ns - world.truth.start_ns) * 1e-9, track.r_e - truth


@pytest.mark.slow
def test_what_came_after_the_gap_bears_on_what_is_in_it(runs):
    world, filtered, found = runs
    rms, sigma = [], []
    for track in (filtered, found.track):
        t, e = errors(world, track)
        rows = (t > GAP_S[0] + 50.0) & (t < GAP_S[1])
        rms.append(np.sqrt(np.mean(np.sum(e[rows] ** 2, axis=1))))
        sigma.append(np.sqrt(np.einsum('nii->n', track.P[rows][:, 6:9, 6:9]).mean()))
    assert rms[1] < 0.6 * rms[0]
    assert sigma[1] < 0.6 * sigma[0]
    assert rms[1] < 3.0 * sigma[1]
    assert found.passes == 1


@pytest.mark.slow
def test_drag_and_current_are_smoothed_too(runs):
    _, filtered, found = runs
    model = found.track.model
    assert model.shape == (len(found.track.stamps_ns), filtered.model.shape[1])
    # What is constant ends where the filter ends, and was there before.
    drag = 24
    np.testing.assert_allclose(model[-1, drag], filtered.model[-1, drag], rtol=0.02)
    assert np.ptp(model[:, drag]) < 0.3 * np.ptp(filtered.model[:, drag])
