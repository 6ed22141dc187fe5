"""Fixes without a height: two numbers in scores, reports and stories, though the filter has three.

With a vertical sigma of 10 km the third row of an innovation weighs nothing: NIS has the
distribution of two degrees of freedom.
"""

from dataclasses import replace

import numpy as np
import pytest
from test_scoring_fixes import receipt

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.health.statistics import statistics
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.error_model import X
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.kernels import watch
from polar_nav_core.level import LEVEL_SIGMA
from polar_nav_ros import receipt_fields
from polar_nav_tools.experiments.calibrate.rows import world_of
from polar_nav_tools.scoring import nis_by_source
from polar_nav_tools.scoring.verdicts import VerdictSeries
from polar_nav_tools.series.vehicle import ReceiptRecord
from polar_nav_tools.why.words import _receipt

SIGMAS = np.array([1.5, 1.5, LEVEL_SIGMA])


def read(sequence, innovation, sigmas=SIGMAS, dof=2):
    """A receipt as it is read from a bag or a replay."""
    one = receipt(sequence, validity=1.0)
    names = [n for n in (*receipt_fields.VALUES, *receipt_fields.AXES) if n != 'dof']
    names += [*receipt_fields.TIMES, 'stamp_ns', 'verdict', 'verdict_text', 'age_s']
    values = {name: getattr(one, name) for name in names}
    variance = sigmas**2
    known = np.isfinite(variance)
    nis = float((innovation[known] ** 2 / variance[known]).sum())
    moved = {
        'innovation_G': innovation,
        'innovation_variance_G': variance,
        'nis': nis,
        'gate': 21.1,
    }
    return ReceiptRecord.of({**values, **moved, 'dof': dof})


def test_a_fix_without_height_is_two_numbers():
    level = read(1, np.array([1.5, -1.5, 30.0]))
    assert (level.degrees_of_freedom, level.axes.tolist()) == (2, [True, True, False])
    whole = read(1, np.array([1.5, -1.5, 3.0]), np.array([1.5, 1.5, 300.0]), dof=3)
    assert (whole.degrees_of_freedom, whole.axes.tolist()) == (3, [True, True, True])
    station = read(1, np.array([1.5, -1.5, 0.0]), np.array([1.5, 1.5, np.nan]), dof=2)
    assert (station.degrees_of_freedom, station.axes.tolist()) == (2, [True, True, False])
    none = read(1, np.full(3, np.nan), np.full(3, np.nan), dof=0)
    assert none.degrees_of_freedom == 0
    printed = read(1, np.array([1.5, -1.5, 3.0]), np.array([1.5, 1.5, 300.0]), dof=6)
    assert printed.axes.tolist() == [True, True, True]


@pytest.mark.parametrize(
    ('sigma_up', 'stated', 'dof'), [(LEVEL_SIGMA, 3, 2), (300.0, 3, 3), (np.nan, 2, 2)]
)
def test_an_older_receipt_is_counted_by_its_variance(sigma_up, stated, dof):
    receipt = read(1, np.array([1.5, -1.5, 30.0]), np.array([1.5, 1.5, sigma_up]), dof=stated)
    assert receipt.degrees_of_freedom == stated
    assert receipt.counted_by_variance() == replace(receipt, degrees_of_freedom=dof)


def test_the_nis_of_honest_fixes_without_height_is_one():
    rng = np.random.default_rng(4)
    innovations = rng.normal(size=(2000, 3)) * np.array([1.5, 1.5, 5.0])
    series = VerdictSeries.of([read(k, z) for k, z in enumerate(innovations)])
    found = nis_by_source(series)['leader']
    assert found.dof == 2.0
    assert found.band_low < found.mean_per_dof < found.band_high
    assert found.mean_per_dof == pytest.approx(1.0, abs=0.05)  # two thirds, counted as three


def test_the_story_leaves_out_what_was_not_measured():
    text = ' '.join(_receipt(read(1, np.array([1.5, -1.5, 30.0]))))
    assert '(east, north), its 1-sigma 1.500, 1.500 m.' in text
    assert 'NIS 2.00 with 2 degrees of freedom, so 1.00 of what is expected' in text


@pytest.fixture(scope='module')
def world():
    return world_of('lawnmower', 200.0, 2)


def ran(world, moved):
    """A run whose fixes have the height of the surface, 300 m above it, each moved level [m]."""
    fixes = []
    for k, fix in enumerate(world.inputs.fixes):
        axes = np.asarray(ecef_to_grid(fix.r_e))
        wide = fix.covariance_e + LEVEL_SIGMA**2 * np.outer(axes[2], axes[2])
        r_e = fix.r_e + np.array([*moved(k), 300.0]) @ axes
        fixes.append(replace(fix, r_e=r_e, covariance_e=wide))
    params = world.params(configuration='default')
    return engine_run.run(params, replace(world.inputs, fixes=tuple(fixes)))


@pytest.fixture(scope='module')
def deep(world):
    """Four of its fixes are outliers of 200 m."""
    rng, half = np.random.default_rng(5), len(world.inputs.fixes) // 2

    def moved(k):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        off = 200.0 * (half <= k < half + 4)
        return off * np.cos(angle), off * np.sin(angle)

    return ran(world, moved)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('nis', 'verdict', 'weighted'),
    [(19.7, Verdict.GATED, False), (7.0, Verdict.FUSED, True), (5.5, Verdict.FUSED, False)],
)
def test_the_filter_itself_gates_and_weighs_by_two_numbers(world, nis, verdict, weighted):
    """By three it fuses up to 21.1, and weighs from 7.8 on."""
    chosen = len(world.inputs.fixes) // 2
    usual = next(r for r in ran(world, lambda _: (0.0, 0.0)).receipts if r.sequence == chosen)
    wanted = np.array([np.sqrt(nis * usual.innovation_variance_G[0]), 0.0])
    step = wanted - usual.innovation_G[:2]
    found = ran(
        world, lambda k: step if usual.sequence == world.inputs.fixes[k].sequence else (0.0, 0.0)
    )
    receipt = next(r for r in found.receipts if r.sequence == chosen)
    assert receipt.nis == pytest.approx(nis, abs=0.4)
    assert receipt.verdict is verdict
    assert ('weight' in receipt.reason) is weighted


@pytest.mark.slow
def test_the_nis_of_a_run_is_of_two_numbers(deep):
    """And so are gates and weights: what passes has a mean NIS of about two."""
    known = [r for r in deep.receipts if np.isfinite(r.nis) and r.nis < r.gate]
    assert {(r.dof, round(r.gate, 1)) for r in known} == {(2, 18.4)}
    assert np.mean([r.nis for r in known]) == pytest.approx(2.0, abs=0.5)


@pytest.mark.slow
def test_outliers_leave_the_height_alone(deep):
    """Of refused fixes the height counts, too: 300 m of vertical sigma, where depths say 9 mm."""
    t = deep.track
    up = np.asarray(ecef_to_grid(t.r_e))[:, 2]
    variance = np.einsum('ni,nij,nj->n', up, t.P[:, X.dr_e, X.dr_e], up)
    assert np.sqrt(variance[len(variance) // 4 :].max()) < 1.0


def test_the_watchdog_knows_honest_fixes():
    """Mean NIS per degree of freedom; counted as three it would be two thirds."""
    rng, memories = np.random.default_rng(6), np.zeros((watch.MEMORIES, watch.WIDTH))
    S = np.diag(SIGMAS**2)
    for _ in range(2000):
        z = rng.normal(size=3) * np.array([1.5, 1.5, 0.0])
        watch.observe(memories, z, S, float(z @ np.linalg.solve(S, z)), 2, True, 1.0, 0.0, z, S)
    streams = np.broadcast_to(memories, (watch.STREAMS, *memories.shape))
    assert statistics(streams).nis[0, watch.LONG] == pytest.approx(1.0, abs=0.2)
