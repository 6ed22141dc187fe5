"""Evidence over seeds: references and vices do what they state; two seeds of each experiment."""

from dataclasses import fields, replace

import numpy as np
import pytest

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.params import NO_COMMON_ERRORS, NO_RESERVE, EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_tools.experiments.catalog import experiment_named
from polar_nav_tools.experiments.evidence import late, pooled, price, quiet, runs
from polar_nav_tools.experiments.evidence.drawn import Drawn, world_of
from polar_nav_tools.experiments.experiment import Request, run
from polar_nav_tools.experiments.jobs import RunResult
from polar_nav_tools.experiments.mismatch.judge import Course, Deviation, HealthReport
from polar_nav_tools.experiments.request import Size, rows_matching
from polar_nav_tools.experiments.schedule import FixSpec, clairvoyant
from polar_nav_tools.experiments.world import make_world

NONE = {**NO_COMMON_ERRORS, **NO_RESERVE}


def ran(name, tmp_path, rows, **request):
    asked = Request(rows=rows, seeds=2, first_seed=9001, **request)
    return run(experiment_named(name), asked, tmp_path, lambda *_: None)


def result(seed=1, **metrics):
    return RunResult('case', 'default', seed, metrics, float('nan'), '', {}, 0.0)


def test_time_beyond_three_sigma_counts_until_an_error_is_reported():
    error, one = np.array([0.0, 4.0, 4.0, 2.0]), np.ones(4)
    deviation = Deviation(error[:, None], one[:, None], error**2)
    course = Course(np.arange(4.0), deviation, deviation, deviation, 4.0)
    assert runs.silent_share(course, np.array([0, 0, 0, 0])) == 0.5
    assert runs.silent_share(course, np.array([0, 1, 2, 2])) == 0.25


def test_a_rise_is_a_report_above_the_level_before():
    reports = [HealthReport(k, level, '', '') for k, level in enumerate([0, 1, 1, 2, 1, 2, 0])]
    assert [r.stamp_ns for r in runs.rises(reports)] == [1, 3, 5]


def test_pooled_numbers():
    twice = [result(1, rms=3.0, nees_position=1.0), result(2, rms=4.0, nees_position=9.0)]
    assert pooled.rms(twice) == pytest.approx(np.sqrt(12.5))
    assert pooled.rms([*twice, replace(twice[0], reason='stopped')]) == np.inf
    under = [result(1, rms=3.0), result(2, rms=2.0)]
    assert pooled.spread_of_ratio(twice, under) == '1.00 to 2.00'
    # Six degrees of freedom: 99.9 % of their sum lies between 0.30 and 24.1.
    assert pooled.nees_cells(twice)['nees_position'] == '5.00 *'
    assert pooled.band(2, 3) == pytest.approx((0.0499, 4.018), rel=2e-3)


def test_a_ratio_needs_something_to_compare_with():
    """A reference that was not run, or stopped, is no infinite error that anything is below."""
    over, stopped = [result(rms=2.0)], result()
    assert pooled.ratio_cells(over, [result(rms=1.9)], 1.01)['met'] is False
    assert pooled.ratio_cells(over, [result(rms=2.0)], 1.01) == {'ratio': 1.0, 'met': True}
    assert pooled.ratio_cells([stopped], [result(rms=2.0)], 1.01)['met'] is False
    assert pooled.ratio_cells(over, [stopped], 1.01) == {}
    assert pooled.ratio_cells(over, [], 1.01) == {}


def test_fixes_judged_otherwise_are_counted_by_seed():
    a = [replace(result(1), series={'fused': np.array([1.0, 0.0, 1.0])})]
    b = [replace(result(1), series={'fused': np.array([1.0, 1.0, 1.0])}), result(2)]
    assert late.judged_otherwise(a, b[:1]) == (1, 3)


def test_each_pattern_of_rows_has_to_match():
    """One that is mistyped among others is not left out in silence."""
    names = ('low', 'lower', 'high')
    assert rows_matching(None, names) == list(names)
    assert rows_matching('high, low*', names) == ['low', 'lower', 'high']
    with pytest.raises(ConfigError, match=r'--rows hihg: no such row; there are low; lower; high'):
        rows_matching('low,hihg', names)


def test_only_experiments_with_rows_can_choose_them(tmp_path):
    with pytest.raises(ConfigError, match='table1 has neither'):
        run(experiment_named('table1'), Request(rows='a'), tmp_path, lambda *_: None)
    with pytest.raises(ConfigError, match='--rows nonsense: no such row'):
        ran('late', tmp_path, 'nonsense')
    suite = experiment_named('late').suite
    with pytest.raises(ConfigError, match='PARAMETER only'):
        suite.read(['speed_mps=2'], None)
    with pytest.raises(ConfigError, match='no filter'):
        suite.read([], ['nonsense'])


def test_the_goals_are_covered_by_the_cases():
    names = {case.name for case in late.cases(600.0)}
    assert len(names) == 4 * 2 * 2 * 5
    assert any(case.scene.fixes.longest_delay_s == 60.0 for case in late.cases(600.0))
    scenes = [case.scene for case in quiet.cases(600.0)]
    assert {scene.mode for scene in scenes} == {'sins', 'station'}
    missions = {scene.world.mission for scene in scenes if scene.mode == 'sins'}
    assert missions >= {'demo', 'near_pole', 'over_pole', 'south_pole', 'racetrack', 'shelf'}


@pytest.mark.slow
def test_the_reference_is_the_filter_in_order_over_what_was_received():
    """The estimate of `in_order` at the end of a run equals that of fixes without any delay."""
    case = next(c for c in late.cases(60.0) if c.name == 'stim300_dvl_north_0-60')
    fixes = replace(case.scene.fixes, delay_s=30.0)
    world = make_world(case.scene.world, fixes, 9001)
    received = world.with_fixes(clairvoyant(world.inputs.fixes))
    assert received.inputs.fixes != world.inputs.fixes
    params = world.params(**late.COLUMNS['in_order'])
    a, b = (engine_run.run(params, w.inputs).track for w in (world, received))
    assert np.array_equal(a.r_e[-1], b.r_e[-1])
    assert np.array_equal(a.P[-1], b.P[-1])


@pytest.fixture(scope='module')
def plain_world():
    return make_world(
        world_of(40.0, mission='racetrack'), FixSpec(period_s=2.0, first_s=2.0, delay_s=2.0), 3
    )


def streams(world):
    i = world.inputs
    fixes = np.array([f.r_e for f in i.fixes]), np.array([f.validity_ns for f in i.fixes])
    return {
        'gyro': i.omega_ib_b, 'accel': i.f_b, 'dvl': i.dvl_v_m, 'depth': i.depth,
        'fixes': fixes[0], 'stamps': fixes[1],
    }  # fmt: skip


@pytest.mark.parametrize(
    ('name', 'stream'),
    [
        ('gyro_bias_walk', 'gyro'),
        ('accel_bias_walk', 'accel'),
        ('dvl_misalignment_sigma_deg', 'dvl'),
        ('dvl_lever_sigma', 'dvl'),
        ('dvl_latency_sigma', 'dvl'),
        ('depth_offset_sigma', 'depth'),
        ('fix_range_scale_sigma', 'fixes'),
        ('fix_heading_sigma_deg', 'fixes'),
        ('fix_offset_sigma', 'fixes'),
        ('fix_clock_sigma', 'stamps'),
    ],
)
def test_each_stated_sigma_is_drawn_into_its_own_stream(plain_world, name, stream):
    stated = EngineParams(**{**NONE, name: getattr(EngineParams(), name)})
    before = streams(Drawn(stated=EngineParams(**NONE))(plain_world))
    after = streams(Drawn(stated=stated)(plain_world))
    changed = {key for key in before if np.abs(after[key] - before[key]).max() > 1e-12}
    assert changed == {stream}


def test_no_stated_sigma_is_left_out():
    assert {*NONE} == {n for n in NONE if getattr(EngineParams(), n) > 0.0}
    drawn = {f.name for f in fields(EngineParams) if f.name in NONE}
    assert drawn == {*NONE}


def test_nothing_drawn_leaves_the_world_alone(plain_world):
    before, after = streams(plain_world), streams(Drawn(stated=EngineParams(**NONE))(plain_world))
    assert all(np.allclose(after[key], before[key], rtol=0.0, atol=1e-9) for key in before)


def test_drawn_offsets_have_the_stated_size(plain_world):
    offset = [
        Drawn()(replace(plain_world, seed=seed)).inputs.depth[0] - plain_world.inputs.depth[0]
        for seed in range(200)
    ]
    assert np.std(offset) == pytest.approx(EngineParams().depth_offset_sigma, rel=0.2)


@pytest.mark.slow
def test_late_fixes_at_two_seeds(tmp_path):
    outcome = ran('late', tmp_path, 'stim300_dvl_*_60, mems_no_dvl_north_0-60', duration_s=200.0)
    rows = outcome.tables[0].rows
    assert len(rows) == 3
    assert all(0.9 < row['ratio'] < 1.1 for row in rows)
    assert (tmp_path / 'late.csv').exists()
    assert 'Seeds 9001 to 9002' in (tmp_path / 'late.md').read_text()


@pytest.mark.slow
def test_the_price_at_two_seeds(tmp_path):
    outcome = ran('price', tmp_path, 'perfect_stim300, drawn_racetrack', duration_s=300.0)
    perfect, drawn = (table.rows[0] for table in outcome.tables)
    assert 0.8 < perfect['ratio'] < 1.3
    assert drawn['met']


def test_settings_leave_the_reference_alone():
    choices = experiment_named('price').suite.read(['engine.accel_bias_walk=1e-4'], None)
    plan = experiment_named('price').plan(
        Request(rows='perfect_dive', **choices),
        experiment_named('price').full,
        ('default', 'exact'),
    )
    assert {job.column: dict(job.engine) for job in plan} == {
        'default': {'accel_bias_walk': 1e-4},
        'exact': {},
    }
    assert price.EXACT['accel_bias_walk'] == 0.0


@pytest.mark.parametrize('rows', [None, 'station, racetrack'])
def test_quiet_hours_share_no_noise(rows):
    """Whatever rows are asked for, a case has the same seeds."""
    experiment = experiment_named('quiet')
    jobs = experiment.plan(Request(rows=rows, first_seed=7), Size(300.0, 3), experiment.columns)
    seeds = {(job.case.name, job.seed) for job in jobs}
    assert len({seed for _, seed in seeds}) == len(seeds) == 3 * len({n for n, _ in seeds})
    cases = [case.name for case in quiet.cases(300.0)]
    assert {s for n, s in seeds if n == 'station'} == {
        7 + 3 * cases.index('station') + k for k in range(3)
    }


@pytest.mark.slow
def test_quiet_hours_at_two_seeds(tmp_path):
    outcome = ran('quiet', tmp_path, 'racetrack, over_pole, station', duration_s=300.0)
    total = outcome.tables[0].rows[-1]
    assert total['hours'] == pytest.approx(0.5, rel=0.01)
    assert (total['warnings'], total['errors'], total['stopped']) == (0, 0, 0)
