"""What is withheld never enters the filter; its prediction is exact, and its coverage honest."""

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_tools.cli import main
from polar_nav_tools.cli.withhold import _scored
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.world import make_world
from polar_nav_tools.experiments.world_spec import WorldSpec
from polar_nav_tools.replay.withhold import Predicted, Withhold, parse, withhold
from polar_nav_tools.scoring.withheld import withheld_score

REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'
FIXES = FixSpec(period_s=1.0, first_s=0.37, delay_s=3.0)
NOISY = WorldSpec(duration_s=120.0, constants='prior', dvl_rate_hz=5.0)
EXACT = WorldSpec(
    duration_s=60.0, noisy=False, constants='none', initial_errors='none', dvl_rate_hz=5.0
)


def run(world, *texts, seed=1, inputs=None, **params):
    found, divergence = withhold(
        world.params(**params), inputs or world.inputs, [parse(t) for t in texts], seed
    )
    assert not divergence
    return found


def test_forms():
    assert parse('fixes:50%') == Withhold('fixes', share=0.5)
    assert parse('dvl:60s') == Withhold('dvl', gap_s=60.0)
    assert parse('depth:12.5%').text == 'depth:12.5%'
    for bad in ('dvl', 'dvl:60', 'fixes:0%', 'fixes:101%', 'imu:50%', 'dvl:0s'):
        with pytest.raises(ConfigError, match='--withhold'):
            parse(bad)


def test_without_noise_predictions_are_exact():
    world = make_world(EXACT, FIXES, 1)
    fixes, dvl, depth = run(world, 'fixes:50%', 'dvl:10s', 'depth:50%')
    assert (len(fixes.error), fixes.offered) == (28, 57)
    assert len(dvl.error) == 3 * 50
    assert len(depth.error) == 300
    assert np.abs(fixes.error).max() < 2e-3
    assert np.abs(dvl.error).max() < 2e-4
    assert np.abs(depth.error).max() < 2e-3


def test_what_is_withheld_never_enters():
    """Another value of one of them changes its own difference by as much, and nothing else."""
    world = make_world(NOISY, FIXES, 2)
    (first,) = run(world, 'fixes:50%')
    stamp_ns = int(first.stamp_ns[7])
    off_e = np.array([30.0, -40.0, 0.0])
    moved = tuple(
        dataclasses.replace(f, r_e=f.r_e + off_e) if f.validity_ns == stamp_ns else f
        for f in world.inputs.fixes
    )
    (second,) = run(world, 'fixes:50%', inputs=dataclasses.replace(world.inputs, fixes=moved))
    np.testing.assert_array_equal(second.covariance, first.covariance)
    others = np.arange(len(first.stamp_ns)) != 7
    np.testing.assert_array_equal(second.error[others], first.error[others])
    assert np.linalg.norm(second.error[7] - first.error[7]) == pytest.approx(50.0)


def test_the_choice_depends_on_the_seed_only():
    world = make_world(NOISY, FIXES, 3)
    one, same, other = (run(world, 'fixes:50%', seed=s)[0].stamp_ns for s in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert set(one) != set(other)
    assert len(one) == len(other)


def test_a_packet_that_came_twice_is_withheld_twice():
    world = make_world(NOISY, FIXES, 4)
    again = tuple(
        dataclasses.replace(f, receive_ns=f.receive_ns + 10**8, arrival=f.arrival + 10**6)
        for f in world.inputs.fixes
    )
    twice = dataclasses.replace(world.inputs, fixes=(*world.inputs.fixes, *again))
    (once,), (both,) = run(world, 'fixes:50%'), run(world, 'fixes:50%', inputs=twice)
    assert (len(both.error), both.offered) == (len(once.error), once.offered)
    np.testing.assert_array_equal(np.sort(both.stamp_ns), np.sort(once.stamp_ns))
    assert both.error.std() == pytest.approx(once.error.std(), rel=0.2)


def pooled(kind, size=1.0, gap='dvl:20s'):
    """Score of predictions in several worlds whose noise is stated ``size`` times too large."""
    errors, covariances = [], []
    for seed in range(101, 109):
        world = make_world(NOISY, FIXES, seed)
        x = world.inputs
        fixes = tuple(
            dataclasses.replace(f, covariance_e=size**2 * f.covariance_e) for f in x.fixes
        )
        stated = dataclasses.replace(x, fixes=fixes, dvl_covariance_m=size**2 * x.dvl_covariance_m)
        (found,) = run(world, 'fixes:50%' if kind == 'fixes' else gap, inputs=stated)
        errors.append(found.error)
        covariances.append(found.covariance)
    return withheld_score(
        kind, '', len(errors), np.concatenate(errors), np.concatenate(covariances)
    )


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['fixes', 'dvl'])
def test_coverage_of_an_honest_world(kind):
    one = pooled(kind)
    assert one.coverage[0.68] == pytest.approx(0.68, abs=0.07)
    assert one.coverage[0.95] == pytest.approx(0.95, abs=0.035)
    assert one.nis.mean_per_dof == pytest.approx(1.0, abs=0.12)


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['fixes', 'dvl'])
def test_coverage_shows_a_sigma_that_was_stated_wrong(kind):
    small = pooled(kind, 0.5)
    assert small.coverage[0.68] < 0.35
    assert small.coverage[0.95] < 0.8
    assert small.judgement == 'optimistic'
    large = pooled(kind, 3.0)
    assert large.coverage[0.68] > 0.9
    assert large.judgement == 'pessimistic'


@pytest.fixture
def polar(monkeypatch, capsys):
    monkeypatch.setenv('COLUMNS', '200')

    def call(*arguments):
        monkeypatch.setattr(sys, 'argv', ['polar', 'score', *map(str, arguments)])
        status = main()
        out = capsys.readouterr()
        return status, out.out, out.err

    return call


def test_the_command_on_the_reference_bag(polar, tmp_path):
    command = (REFERENCE, '--withhold', 'fixes:50%', '--withhold', 'dvl:5s', '--json')
    status, out, _ = polar(*command)
    assert status == 0
    said = json.loads(out)
    horizontal, up, dvl = said['withheld']['default']
    assert (horizontal['count'], horizontal['offered'], said['seed']) == (6, 13, 1)
    assert (horizontal['what'], up['what']) == ('fixes:50%, horizontal', 'fixes:50%, up')
    assert (dvl['count'], dvl['offered'], dvl['judgement']) == (75, 151, 'honest')
    assert dvl['coverage']['95 %'] == pytest.approx(0.95, abs=0.05)
    status, text, _ = polar(*command[:-1])
    assert status == 0
    assert 'Withheld measurements, predicted' in text
    assert polar(REFERENCE, '--withhold', 'imu:1s')[0] == 2
    assert polar(REFERENCE, '--map', tmp_path / 'm.yaml')[0] == 2


def test_fixes_without_a_height_are_scored_in_the_plane_only():
    errors = np.ones((3, 3))
    S = np.tile(np.diag([4.0, 4.0, 1e8 + 1.0]), (3, 1, 1))
    what = parse('fixes:50%')
    stamps = np.arange(3)
    (only,) = _scored(Predicted(what, 3, stamps, errors, S, np.ones(3, dtype=bool)))
    assert only.what == 'fixes:50%, horizontal'
    S[1, 2, 2] = 9.0
    both = _scored(Predicted(what, 3, stamps, errors, S, np.array([True, False, True])))
    assert [score.what for score in both] == ['fixes:50%, horizontal', 'fixes:50%, up']
    assert [score.count for score in both] == [3, 1]
