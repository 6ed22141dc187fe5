"""DVL and depth counted per estimate: how many, how many gated, and the sum of their NIS."""

import dataclasses

import numpy as np
import pytest
from closed_loop import World, run
from scipy.stats import chi2

from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.outputs import LOCAL_DOF, LOCAL_GATED, NIS_SUM, UPDATES, Estimate

DVL, DEPTH = (list(LOCAL_DOF).index(name) for name in ('dvl', 'depth'))


@pytest.fixture(scope='module')
def world():
    return World(60.0)


def sensors(world, seed=3):
    rng = np.random.default_rng(seed)
    return [*world.imu(), *world.dvl(rng=rng), *world.depth(rng=rng)]


def run_with(world, events, **changes):
    changes = {'configuration': 'custom', **changes}
    return run(Engine(world.params(**changes)), events)


def statistics(out):
    return np.array([o.local_statistics for o in out if isinstance(o, Estimate)])


def test_every_measurement_is_counted_in_the_estimate_after_it(world):
    rows = statistics(run_with(world, sensors(world)))
    # 5 Hz and 10 Hz against estimates at 10 Hz: at most one of each per estimate.
    assert set(np.unique(rows[:, :, UPDATES])) == {0.0, 1.0}
    total = rows.sum(axis=0)
    assert total[DVL, UPDATES] + total[DVL, LOCAL_GATED] == len(world.dvl())
    assert total[DEPTH, UPDATES] + total[DEPTH, LOCAL_GATED] == len(world.depth())
    # Without a measurement there is no sum.
    quiet = rows[:, DVL, UPDATES] == 0.0
    assert quiet.sum() > 100
    assert (rows[quiet, DVL, NIS_SUM] == 0.0).all()


def test_sums_are_chi_square_with_the_noise_that_is_stated(world):
    """The DVL's Markov error is in the model and not in this world: its NIS is below."""
    out = run_with(world, sensors(world), dvl_markov_sigma=1e-6, dvl_scale_sigma=1e-9)
    total = statistics(out).sum(axis=0)
    for row, dof in enumerate(LOCAL_DOF.values()):
        n = total[row, UPDATES] * dof
        low, high = chi2.ppf([0.0005, 0.9995], n)
        assert low < total[row, NIS_SUM] < high


def test_a_wrong_noise_shows(world):
    events = sensors(world)
    louder = [
        dataclasses.replace(e, depth=e.depth + 0.2 * (-1) ** k) if hasattr(e, 'depth') else e
        for k, e in enumerate(events)
    ]
    total = statistics(run_with(world, louder, gate_probability=1.0)).sum(axis=0)
    assert total[DEPTH, NIS_SUM] > 5.0 * total[DEPTH, UPDATES]


def test_gated_ones_are_counted_apart_and_not_summed(world):
    events = [
        dataclasses.replace(e, depth=e.depth + 50.0)
        if hasattr(e, 'depth') and e.sequence in (300, 301, 400)
        else e
        for e in sensors(world)
    ]
    total = statistics(run_with(world, events)).sum(axis=0)
    assert total[DEPTH, LOCAL_GATED] >= 3
    assert total[DEPTH, NIS_SUM] < 2.0 * total[DEPTH, UPDATES]


@pytest.mark.parametrize('handling', ['back_propagate', 'clone', 'rewind'])
def test_a_late_fix_does_not_count_anything_twice(world, handling):
    rng = np.random.default_rng(4)
    events = [*sensors(world), *world.fixes(2.0, 5.0, rng=rng)]
    total = statistics(run_with(world, events, delay_handling=handling)).sum(axis=0)
    assert total[DVL, UPDATES] + total[DVL, LOCAL_GATED] == len(world.dvl())
    assert total[DEPTH, UPDATES] + total[DEPTH, LOCAL_GATED] == len(world.depth())
