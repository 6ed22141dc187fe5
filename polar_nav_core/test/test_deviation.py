"""Deviation of a compass against the rates of its AHRS: size, and what is none."""

from dataclasses import replace

import numpy as np
import pytest
import station_twin as twin

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.health.conditions import Culprit, Level
from polar_nav_core.engine.health.deviation import Deviation
from polar_nav_core.kernels.station.attitude import MEMORY_S

STEP_S = 0.01
SIGMA = np.radians(0.5)


def looked(
    angle, *, seconds=600.0, scale=0.0, bias=0.0, sigma=SIGMA, noise=1e-3, turns=1.0, jump=0.0
):
    """Conditions at the last look; ``angle`` is the compass's error by its heading [rad]."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, seconds, STEP_S)
    psi = turns * (1.9 * np.sin(0.011 * t) + 0.45 * np.sin(0.037 * t))
    off = angle(psi) + jump * (t > 0.5 * seconds)
    error = off - scale * psi - bias * t
    turn = np.zeros(len(t))
    for k in range(1, len(t)):
        turn[k] = turn[k - 1] * (1.0 - STEP_S / MEMORY_S) + error[k] - error[k - 1]
    watch, found = Deviation(), []
    for k in range(0, len(t), round(1.0 / STEP_S)):
        seen = turn[k] + noise * rng.standard_normal()
        found = watch.look(round(1e9 * (1.0 + t[k])), psi[k] + off[k], seen, sigma)
    return found


def degrees_of(condition):
    return float(condition.sentence.split('deviation of ')[1].split(' deg')[0])


def test_a_deviation_is_found_with_its_size_beside_bias_and_scale_of_the_gyro():
    size = np.radians(8.0)
    (found,) = looked(lambda psi: size * np.sin(psi - 0.4), scale=0.02, bias=1e-3)
    assert (found.level, found.culprit) == (Level.WARN, Culprit.HEADING)
    assert degrees_of(found) == pytest.approx(8.0, abs=1.0)


@pytest.mark.parametrize(
    'world',
    [
        {'scale': 0.05, 'bias': 5e-3},
        {'noise': 1e-2},
        {'turns': 0.0, 'bias': 5e-3},
        {'seconds': 100.0},
    ],
)
def test_a_gyro_that_is_off_is_no_deviation(world):
    assert looked(lambda psi: 0.0 * psi, **world) == []


def test_a_deviation_that_the_published_heading_covers_is_no_condition():
    size = np.radians(2.0)
    assert looked(lambda psi: size * np.sin(psi), sigma=np.radians(0.3))
    assert looked(lambda psi: size * np.sin(psi), sigma=np.radians(1.0)) == []


def test_a_jump_of_the_heading_does_not_hide_a_deviation():
    (found,) = looked(lambda psi: np.radians(8.0) * np.sin(psi), jump=np.radians(20.0))
    assert degrees_of(found) == pytest.approx(8.0, abs=1.0)


def turned(inputs, size):
    """The same AHRS with a deviation."""
    a = size * np.sin(np.arctan2(inputs.C_b_G[:, 1, 0], inputs.C_b_G[:, 0, 0]))
    turn = np.zeros((len(a), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(a)
    turn[:, 1, 0], turn[:, 0, 1] = np.sin(a), -np.sin(a)
    turn[:, 2, 2] = 1.0
    return replace(inputs, C_b_G=turn @ inputs.C_b_G)


@pytest.mark.slow
def test_a_navigation_reports_a_deviation_alike_event_by_event():
    inputs = twin.inputs(twin.truth(300.0), 4, depth_every=10)
    params = twin.params(identify_method='none')

    def said(size, **way):
        result = engine_run.run(params, turned(inputs, size), **way)
        every = [c.condition for h in result.health for c in h.present]
        return [c.sentence for c in every if c.key == 'AHRS deviation']

    whole = said(np.radians(8.0), look_every_s=1.0)
    assert whole
    assert whole[-1] == said(np.radians(8.0), one_by_one=True)[-1]
    assert not said(0.0, look_every_s=1.0)
