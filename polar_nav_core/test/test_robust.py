"""Outliers with the gate off: less weight keeps the estimate, and costs little without them."""

import dataclasses

import numpy as np
import pytest
from closed_loop import World, gathered, run

from polar_nav_core import grid
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.engine.sins.robust import inflation
from polar_nav_core.engine.verdicts import Verdict

STRATEGIES = ('tagged', 'back_propagate', 'clone', 'rewind')
THRESHOLD = 7.814727903251179  # chi-square, 3 degrees of freedom, 0.95
SEEDS = range(4)

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def world():
    return World(90.0)


def with_outliers(fixes, rng, share=0.05, size=30.0):
    def away():
        direction = rng.standard_normal(3)
        return size * direction / np.linalg.norm(direction)

    return [
        dataclasses.replace(f, r_e=f.r_e + away()) if rng.random() < share else f for f in fixes
    ]


def inputs(world, seed):
    rng = np.random.default_rng(seed)
    sensors = [*world.imu(), *world.dvl(rng=rng), *world.depth(rng=rng)]
    clean = world.fixes(0.5, 2.0, rng=rng)
    return sensors, clean, with_outliers(clean, rng)


def params(world, strategy, robust):
    return world.params(
        max_fix_sigma=0.0,  # the weights alone
        configuration='custom',
        delay_handling=strategy,
        gate_probability=1.0,
        robust_fixes=robust,
    )


def squared_errors(world, track):
    """Horizontal, after the first quarter."""
    index = {int(s): k for k, s in enumerate(world.stamps)}
    rows = [index[int(s)] for s in track.stamps_ns]
    errors = np.array(
        [
            grid.ecef_to_grid(world.r_e[k]) @ (r_e - world.r_e[k])
            for k, r_e in zip(rows, track.r_e, strict=True)
        ]
    )
    return np.sum(errors[len(errors) // 4 :, :2] ** 2, axis=1)


@pytest.fixture(scope='module')
def rms(world):
    """Pooled RMS by strategy, method and whether there are outliers; made once each."""
    made = {}

    def of(strategy, robust, dirty):
        key = (strategy, robust, dirty)
        if key not in made:
            squares = []
            for seed in SEEDS:
                sensors, clean, soiled = inputs(world, seed)
                given = gathered(sensors + (soiled if dirty else clean))
                ran = engine_run.run(params(world, strategy, robust), given)
                squares.append(squared_errors(world, ran.track))
            made[key] = float(np.sqrt(np.mean(squares)))
        return made[key]

    return of


@pytest.mark.parametrize(('robust', 'most'), [('huber', 1.4), ('mahalanobis', 1.2)])
@pytest.mark.parametrize('strategy', STRATEGIES)
def test_outliers_hardly_matter(rms, strategy, robust, most):
    clean = rms(strategy, 'none', dirty=False)
    assert rms(strategy, 'none', dirty=True) > 2.0 * clean
    assert rms(strategy, robust, dirty=True) < most * clean


@pytest.mark.parametrize('robust', ['huber', 'mahalanobis'])
@pytest.mark.parametrize('strategy', STRATEGIES)
def test_without_outliers_little_is_lost(rms, strategy, robust):
    assert rms(strategy, robust, dirty=False) < 1.03 * rms(strategy, 'none', dirty=False)
    made = [rms(strategy, m, dirty=d) for m in ('none', robust) for d in (False, True)]
    # Seen with pytest -s; docs/integrity.md.
    print(strategy, robust, *(f'{r:.3f}' for r in made))  # noqa: T201


def test_the_weighted_nis_is_the_threshold():
    assert inflation('mahalanobis', THRESHOLD, 3) == pytest.approx(1.0)
    for nis in (8.0, 50.0, 1e4):
        assert nis / inflation('mahalanobis', nis, 3) == pytest.approx(THRESHOLD)
        # Huber: the whitened pull d / lambda is that of the threshold, however large d is.
        assert np.sqrt(nis) / inflation('huber', nis, 3) == pytest.approx(np.sqrt(THRESHOLD))


@pytest.mark.parametrize('name', ['none', 'huber', 'mahalanobis'])
def test_what_fits_keeps_its_weight(name):
    assert inflation(name, 7.8, 3) == 1.0
    assert inflation('none', 1e6, 3) == 1.0


@pytest.mark.parametrize('strategy', STRATEGIES)
def test_receipts_say_how_much_was_taken_off(world, strategy):
    sensors, clean, soiled = inputs(world, 0)
    wrong = {
        f.sequence for f, g in zip(soiled, clean, strict=True) if not np.array_equal(f.r_e, g.r_e)
    }
    engine = Engine(params(world, strategy, 'mahalanobis'))
    out = [o for o in run(engine, sensors + soiled) if isinstance(o, Receipt)]
    assert {r.verdict for r in out} == {Verdict.FUSED}
    less = {r.sequence: r for r in out if 'weight 1/' in r.reason}
    assert wrong <= set(less)
    for r in less.values():
        weight = float(r.reason.split('weight 1/')[1].split(' ')[0])
        assert weight == pytest.approx(r.nis / THRESHOLD, abs=0.051)


def test_a_gate_still_decides_first(world):
    sensors, _, soiled = inputs(world, 0)
    gated = world.params(
        configuration='custom',
        delay_handling='clone',
        gate_probability=0.9999,
        robust_fixes='huber',
    )
    out = [o for o in run(Engine(gated), sensors + soiled) if isinstance(o, Receipt)]
    assert Verdict.GATED in {r.verdict for r in out}
    for r in out:
        assert (r.nis > r.gate) == (r.verdict is Verdict.GATED)


def test_clone_and_rewind_agree_when_fixes_are_down_weighted(world):
    sensors, _, soiled = inputs(world, 2)
    last = {}
    for strategy in ('clone', 'rewind'):
        out = run(Engine(params(world, strategy, 'huber')), sensors + soiled)
        last[strategy] = [o for o in out if isinstance(o, Estimate)][-1]
    sigma = np.sqrt(np.diagonal(last['rewind'].P)[6:9])
    # Not equal: rewind weighs again with what it knows of earlier fixes, clone does not.
    assert np.all(np.abs(last['clone'].r_e - last['rewind'].r_e) < 0.3 * sigma)
    np.testing.assert_allclose(
        np.diagonal(last['clone'].P)[6:9], np.diagonal(last['rewind'].P)[6:9], rtol=0.1
    )
