"""The DVL's scale beside a noisy IMU: none where there is none, and within its sigma."""

import numpy as np
import pytest

from polar_nav_core.engine import run as engine_run
from polar_nav_core.kernels.sins.rows import SCALE
from polar_nav_tools.experiments.evidence import mems
from polar_nav_tools.experiments.mismatch.plan import as_stated
from polar_nav_tools.experiments.mismatch.row import TACTICAL

pytestmark = pytest.mark.slow

SEEDS = range(99001, 99007)


def scales(sigma):
    """Scales at the end of runs of 900 s, instrument axes, and their sigmas."""
    found = []
    for seed in SEEDS:
        world = TACTICAL.make(seed)
        stated = {**as_stated('sins'), **TACTICAL.changes, 'configuration': 'default'}
        stated |= {'dvl_scale_sigma': sigma, 'dvl_markov_sigma': 0.02}
        track = engine_run.run(TACTICAL.params(world, stated), world.inputs).track
        P = track.P[-1]
        sigmas = np.sqrt(np.diagonal(P)[SCALE : SCALE + 3])
        found.append((track.sensor_errors[-1, 6:9], sigmas))
    return np.array(found).transpose(1, 0, 2)


@pytest.mark.parametrize('sigma', [0.004, 0.02])
def test_a_noisy_imu_pulls_no_scale(sigma):
    """The predicted velocity pulls it along track, to -0.30 and -0.99 % (seeds 88001 to 88006)."""
    scale, sigmas = scales(sigma)
    off = np.abs(scale.mean(axis=0))
    assert (off < 4.0 * scale.std(axis=0) / np.sqrt(len(SEEDS))).all()
    assert (np.abs(scale) < 3.0 * sigmas).all()
    assert sigmas[:, 0].max() < 0.9 * sigma  # along track fixes tell


def test_vibration_pulls_no_vertical_scale():
    """Its DVL is of the class of 1 %; predicted velocities find -18 to -20 % and claim 3 %."""
    case = next(c for c in mems.cases(1200.0) if c.name == 'vibration')
    found = []
    for seed in (99101, 99102, 99103):
        world = case.shape(case.scene.make(seed))
        params = case.scene.params(world, case.columns['default'])
        track = engine_run.run(params, world.inputs).track
        sigma = np.sqrt(track.P[-1, SCALE + 2, SCALE + 2])
        found.append((track.sensor_errors[-1, 8], sigma))
    assert all(abs(scale) < 3.0 * np.hypot(0.01, sigma) for scale, sigma in found)
