"""Outages and jumps of the leader: refused, told, over when they are over, and the sigma honest.

On "the error stays within 3 sigma": an honest sigma is passed for 0.27 % of the time on each axis.
Errors change slowly, so that share comes as a few excursions in a few runs: some 15 independent
looks on two axes in ten minutes make one run in ten. A test that allowed none would pass only for
chosen seeds or a sigma that is too large. Asked here, of seeds that nobody chose, on each
horizontal axis from the beginning of the trouble to the first fixes after it:

- no more runs with any excursion beyond 3 sigma than one in ten gives by chance (99.9 %),
- beyond 3 sigma for at most 2 % of the time, all runs together, and never beyond 4.5 sigma,
- the errors at the end of the trouble, two independent ones a run, inside the 99.9 % chi-square
  band: neither too large nor, because sigma was blown up, too small.
"""

import dataclasses

import numpy as np
import pytest
from scipy.stats import binom, chi2

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.health.conditions import Level
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.grid import ecef_to_grid
from polar_nav_tools.experiments.errors import track_errors
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.world import make_world
from polar_nav_tools.experiments.world_spec import WorldSpec

PERIOD_S, DELAY_S = 2.0, 5.0
JUMP_G = np.array([300.0, 400.0, 0.0])
SEEDS = {'default': range(30), 'clone': range(10), 'rewind': range(10)}
AFTER_S = 10.0
CHANCE = 0.1
"""Share of runs with an excursion beyond 3 sigma that an honest filter has."""

pytestmark = pytest.mark.slow


def settings(name):
    if name == 'default':
        return {'configuration': 'default'}
    return {'configuration': 'custom', 'delay_handling': name}


def world_of(seed, seconds):
    spec = WorldSpec(duration_s=seconds, constants='prior')
    return make_world(spec, FixSpec(period_s=PERIOD_S, first_s=PERIOD_S, delay_s=DELAY_S), seed)


def valid_s(world, fix):
    return (fix.validity_ns - world.truth.start_ns) * 1e-9


def without_fixes(world, start_s, end_s):
    return world.with_fixes(
        tuple(f for f in world.inputs.fixes if not start_s <= valid_s(world, f) < end_s)
    )


def with_jump(world, start_s, end_s):
    def moved(f):
        return dataclasses.replace(f, r_e=f.r_e + ecef_to_grid(f.r_e).T @ JUMP_G)

    return world.with_fixes(
        tuple(moved(f) if start_s <= valid_s(world, f) < end_s else f for f in world.inputs.fixes)
    )


class Runs:
    """Several seeds of one situation."""

    def __init__(self, name, world_for, start_s, end_s):
        self.ratios, self.at_end, self.verdicts = [], [], []
        for seed in SEEDS[name]:
            world = world_for(seed)
            result = engine_run.run(world.params(**settings(name)), world.inputs)
            errors = track_errors(world, result.track)
            C_e_G = ecef_to_grid(result.track.r_e)
            P_G = C_e_G @ result.track.P[:, 6:9, 6:9] @ np.swapaxes(C_e_G, 1, 2)
            ratio = errors.dr_G / np.sqrt(np.diagonal(P_G, axis1=1, axis2=2))
            last = int(np.searchsorted(errors.time_s, end_s)) - 1
            dr, S = errors.dr_G[last, :2], P_G[last, :2, :2]
            trouble = (errors.time_s >= start_s) & (errors.time_s < end_s + AFTER_S)
            self.ratios.append(np.abs(ratio[trouble, :2]))
            self.at_end.append(float(dr @ np.linalg.solve(S, dr)))
            start_ns = world.truth.start_ns
            self.verdicts.append(
                [((r.validity_ns - start_ns) * 1e-9, r.verdict) for r in result.receipts]
            )

    def check_sigma(self):
        ratios = np.concatenate(self.ratios)
        n, beyond = len(self.ratios), sum(bool((r > 3.0).any()) for r in self.ratios)
        said = (
            f'{n} runs: {beyond} with an excursion beyond 3 sigma, '
            f'{100.0 * np.mean(ratios > 3.0):.2f} % of the time, at most {ratios.max():.2f}; '
            f'e2/P at the end {sum(self.at_end) / (2 * n):.2f}'
        )
        print(said)  # noqa: T201 - seen with pytest -s; docs/integrity.md
        assert beyond <= binom.ppf(0.999, n, CHANCE)
        assert np.mean(ratios > 3.0) < 0.02
        assert ratios.max() < 4.5
        # Below 1 along the line to the refused fixes: the published covariance reaches to them.
        assert sum(self.at_end) < chi2.ppf(0.9995, 2 * len(self.at_end))

    def verdicts_between(self, start_s, end_s):
        return [{v for t, v in one if start_s <= t < end_s} for one in self.verdicts]


@pytest.mark.parametrize('name', SEEDS)
def test_ten_minutes_without_fixes(name):
    runs = Runs(
        name, lambda seed: without_fixes(world_of(seed, 800.0), 150.0, 750.0), 150.0, 750.0
    )
    runs.check_sigma()
    for one in runs.verdicts:
        after = [v for t, v in sorted(one) if t >= 750.0]
        assert after[0] is Verdict.FUSED
        assert len(after) > 15


@pytest.mark.parametrize('name', SEEDS)
def test_a_leader_that_is_500_m_off_for_a_minute(name):
    runs = Runs(name, lambda seed: with_jump(world_of(seed, 300.0), 150.0, 210.0), 150.0, 210.0)
    runs.check_sigma()
    assert runs.verdicts_between(150.0, 210.0) == [{Verdict.GATED}] * len(runs.verdicts)
    for fused in runs.verdicts_between(210.0, 210.0 + 2.0 * PERIOD_S):
        assert Verdict.FUSED in fused


@pytest.mark.parametrize('name', SEEDS)
def test_a_leader_that_stays_500_m_off_is_an_error_and_never_believed(name):
    jump = (120.0, 460.0)
    world = with_jump(world_of(0, 500.0), *jump)
    engine = Engine(world.params(**settings(name)))
    levels, verdicts = {}, {}
    for event in world.inputs.events():
        receipts = [o for o in engine.process(event) if hasattr(o, 'verdict')]
        if isinstance(event, Fix):
            levels[valid_s(world, event)] = engine.integrity.level
            verdicts |= {r.validity_ns: r.verdict for r in receipts}
    off = [t for t in levels if jump[0] <= t < jump[1]]
    told = [t for t in off if levels[t] is Level.ERROR]
    assert told == [t for t in off if t > jump[0] + 300.0]
    good = [levels[t] for t in levels if t >= jump[1]]
    assert set(good) == {Level.OK}
    start = world.truth.start_ns
    fused = [(ns - start) * 1e-9 for ns, v in verdicts.items() if v is Verdict.FUSED]
    assert not [t for t in fused if jump[0] <= t < jump[1]]
    assert min(t for t in fused if t >= jump[1]) <= jump[1] + 2.0 * PERIOD_S
