"""The mismatch experiment: faults do what they state, J is a likelihood, few rows at two seeds."""

import inspect
import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.health import watchdog
from polar_nav_core.engine.health.conditions import Culprit
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_core.kernels.sins import hypotheses as hy
from polar_nav_sim.offline_station import StationScenario
from polar_nav_tools.experiments.catalog import experiment_named
from polar_nav_tools.experiments.experiment import Request, run
from polar_nav_tools.experiments.mismatch import (
    dvl_faults,
    faults,
    fix_faults,
    imu_faults,
    station_faults,
    worlds,
)
from polar_nav_tools.experiments.mismatch.faults import Fault
from polar_nav_tools.experiments.mismatch.fix_faults import Both
from polar_nav_tools.experiments.mismatch.health import NAMES, health_history
from polar_nav_tools.experiments.mismatch.judge import BEYOND_STATED, HealthReport
from polar_nav_tools.experiments.mismatch.plan import MISMATCH, reserve
from polar_nav_tools.experiments.mismatch.random_rows import KINDS
from polar_nav_tools.experiments.mismatch.random_station_rows import KINDS as STATION_KINDS
from polar_nav_tools.experiments.mismatch.row import SINS, STATION, WORLD, Row, texts, warm_scene
from polar_nav_tools.experiments.mismatch.rows import ROWS, rows_named
from polar_nav_tools.experiments.mismatch.runs import VISIBLE, MismatchResult
from polar_nav_tools.experiments.mismatch.scenes import SinsScene, StationScene
from polar_nav_tools.experiments.mismatch.station_faults import StationBoth
from polar_nav_tools.experiments.mismatch.table import tables
from polar_nav_tools.experiments.mismatch.visible import SMALL, information, visibility
from polar_nav_tools.experiments.request import Size
from polar_nav_tools.experiments.schedule import FixSpec

SHORT = SinsScene(
    WORLD.__class__(duration_s=120.0, dvl_rate_hz=5.0, depth_rate_hz=5.0),
    FixSpec(period_s=2.0, first_s=2.0, delay_s=2.0),
)


def sentences(row: Row):
    return row.doc and (row.size or row.is_control) and (row.culprits or row.is_control)


def test_the_catalogue_has_rows_of_both_modes_with_words_and_culprits():
    faulty = [row for row in ROWS.values() if not row.is_control]
    assert len(faulty) >= 45
    assert {row.mode for row in faulty} == {'sins', 'station'}
    assert {row.mode for row in ROWS.values() if row.is_control} == {'sins', 'station'}
    # Only late fixes, where nothing is wrong but the way to treat them, have no culprit.
    assert {row.name for row in ROWS.values() if not sentences(row)} == {
        name for name in ROWS if name.startswith('delay_')
    }


def test_rows_and_reports_have_the_same_names_of_culprits():
    assert NAMES.keys() == {bit for bit in Culprit if bit}
    assert {name for row in ROWS.values() for name in row.culprits} <= {*NAMES.values()}


@pytest.mark.parametrize(
    ('name', 'attribute', 'parameter'),
    [
        ('fix_offset_0.6m_start', 'offset_m', 'fix_offset_sigma'),
        ('range_1pc_formation', 'scale', 'fix_range_scale_sigma'),
        ('array_turned_0.6deg_formation', 'turn_deg', 'fix_heading_sigma_deg'),
        ('clock_20ms_straight', 'offset_s', 'fix_clock_sigma'),
        ('dvl_turned_0.6deg_no_heading', 'turn_deg', 'dvl_misalignment_sigma_deg'),
        ('dvl_lever_0.2m_level', 'lever_b', 'dvl_lever_sigma'),
        ('dvl_lag_0.1s_level', 'lag_s', 'dvl_latency_sigma'),
        ('depth_zero_1m', 'bias_m', 'depth_offset_sigma'),
    ],
)
def test_invisible_rows_are_at_twice_the_stated_sigma(name, attribute, parameter):
    row = ROWS[name]
    size = np.max(getattr(row.fault, attribute))
    assert size == pytest.approx(2.0 * getattr(EngineParams(), parameter))
    assert row.invisible
    assert not row.beyond_stated


def test_every_text_belongs_to_a_row():
    assert texts().keys() == ROWS.keys()


def test_rows_are_chosen_by_patterns():
    assert [row.name for row in rows_named('gravity_1mgal, gravity_3*')] == [
        'gravity_1mgal',
        'gravity_3mgal',
        'gravity_30mgal',
        'gravity_3mgal_no_dvl',
        'gravity_30mgal_no_dvl',
    ]
    with pytest.raises(ConfigError, match="no row matches 'gravy'"):
        rows_named('gravy')


def test_further_faults_are_found_by_their_prefix_or_their_whole_name():
    table, further = rows_named(None), rows_named('more:*')
    assert len(table) + len(further) == len(ROWS)
    assert len(further) > 100
    assert not any(row.more for row in (*table, *rows_named('*'), *rows_named('station_*')))
    assert [row.name for row in rows_named('more:imu_bursts_80ms_*, start_swapped')] == [
        'imu_bursts_80ms_racetrack',
        'imu_bursts_80ms_tactical',
        'start_swapped',
    ]
    assert all(not row.is_control for row in further)
    with pytest.raises(ConfigError, match="no row matches 'more:control_demo'"):
        rows_named('more:control_demo')


@pytest.mark.parametrize(
    ('prefix', 'name'), [('random', 'random'), ('random-station', 'random_station')]
)
def test_random_rows_are_those_of_their_numbers(prefix, name):
    first, second = rows_named(f'{prefix}:7-8')
    both = rows_named(f'{prefix}:8,{prefix}:7')
    assert [row.name for row in both] == [f'{name}_8', f'{name}_7']
    assert (rows_named(f'{prefix}:8')[0], first.name) == (second, f'{name}_7')
    assert first.fault != second.fault
    for wrong in ('', 'x', '-3', '1.5'):
        with pytest.raises(ConfigError, match='has no number'):
            rows_named(f'{prefix}:{wrong}')
    with pytest.raises(ConfigError, match='ends before it begins'):
        rows_named(f'{prefix}:8-7')


@pytest.mark.parametrize(
    ('prefix', 'kinds', 'both', 'scenes'),
    [('random', KINDS, Both, 6), ('random-station', STATION_KINDS, StationBoth, 4)],
)
def test_random_rows_reach_every_kind_of_fault_and_every_scene(prefix, kinds, both, scenes):
    rows = rows_named(f'{prefix}:1-1500')
    one_by_one = [
        single
        for row in rows
        for single in (
            (row.fault.one, row.fault.other) if isinstance(row.fault, both) else (row.fault,)
        )
    ]
    assert {type(fault) for fault in one_by_one} == {kind for kind, _ in kinds}
    assert 0.2 < (len(one_by_one) - len(rows)) / len(rows) < 0.3
    assert len({row.size.rpartition('(')[2] for row in rows}) == scenes
    assert all(row.fault.start_s <= row.scene.duration_s / 2.0 for row in rows)


def test_only_engine_parameters_can_be_set():
    suite = experiment_named('mismatch').suite
    assert suite.read(['engine.accel_bias_walk=3e-6'], ['default'])
    with pytest.raises(ConfigError, match='PARAMETER only'):
        suite.read(['speed_mps=2'], None)
    with pytest.raises(ConfigError, match='no filter'):
        suite.read([], ['nonsense'])


@pytest.mark.slow
@pytest.mark.parametrize(
    'row',
    [
        # Further faults on request: they would take as long again.
        pytest.param(row, id=row.name, marks=[pytest.mark.long] if row.more else [])
        for row in ROWS.values()
        if not row.is_control
    ],
)
def test_every_fault_changes_its_world_and_nothing_before_it_begins(row):
    row = until(row, row.fault.start_s + 180.0)
    same, other = (row.fault.applied(row.scene.make(1), scale) for scale in (0.0, 1.0))
    changed = first_change_s(row, same, other)
    assert row.fault.start_s - 5.0 <= changed < row.scene.duration_s


def until(row, end_s):
    """The row in a world that ends sooner, if it does not already."""
    scene, name = row.scene, 'scenario' if row.mode == 'station' else 'world'
    world = getattr(scene, name)
    shorter = replace(world, duration_s=min(world.duration_s, end_s))
    return replace(row, scene=replace(scene, **{name: shorter}))


def first_change_s(row, same, other):
    """Time of the first difference of the inputs [s]; initial parameters are at 0."""
    if row.mode == 'sins' and same.initial != other.initial:
        return 0.0
    if row.fault.for_all and not row.fault.obvious and same.inputs is other.inputs:
        return 0.0
    start_ns = row.scene.start_ns(same)
    found = [np.inf]
    pairs = (
        ('imu_stamps_ns', ('omega_ib_b', 'f_b', 'C_b_G')),
        ('dvl_stamps_ns', ('dvl_v_m', 'dvl_valid')),
        ('depth_stamps_ns', ('depth',)),
        ('control_stamps_ns', ('force_b',)),
        ('heading_stamps_ns', ('headings',)),
    )
    for stamps, names in pairs:
        a, b = same.inputs, other.inputs
        if not hasattr(a, stamps):
            continue
        t = (getattr(a, stamps) - start_ns) * 1e-9
        n = min(len(getattr(a, stamps)), len(getattr(b, stamps)))
        differs = getattr(a, stamps)[:n] != getattr(b, stamps)[:n]
        for name in (x for x in names if hasattr(a, x)):
            x, y = getattr(a, name)[:n], getattr(b, name)[:n]
            differs = differs | (x != y).any(axis=tuple(range(1, x.ndim)))
        if differs.any():
            found.append(float(t[:n][differs][0]))
        elif len(t) != len(getattr(b, stamps)):
            found.append(float(t[n]))
    fixes = {f.sequence: f for f in other.inputs.fixes}
    for f in same.inputs.fixes:
        g = fixes.get(f.sequence)
        if g is None or parts(f) != parts(g):
            found.append((f.validity_ns - start_ns) * 1e-9)
    return min(found)


def parts(fix: Fix):
    polar = fix.polar
    seen = () if polar is None else (polar.range, polar.bearing, *polar.station)
    return (fix.validity_ns, *np.nan_to_num(fix.r_e), *seen)


@pytest.mark.slow
def test_information_is_that_of_innovations_taken_event_by_event():
    """J from sums of squares equals g' S^-1 g of innovations that the engine's fusion shows."""
    fault = dvl_faults.DepthError(bias_m=0.1, start_s=40.0)
    time_s, J = information(SHORT, fault, 1)
    assert J[time_s < 40.0].max() < 1e-3
    quiet = SHORT.quiet(1)
    params = quiet.params(output_period_s=1.0, **SHORT.best)
    total = 0.0
    for world in (fault.applied(quiet, SMALL),):
        engine = Engine(params)
        for event in world.inputs.events():
            outputs = list(engine.process(event))
            total += sum(r.nis for r in outputs if hasattr(r, 'nis'))
            total += sum(
                float(e.local_statistics[:, 2].sum())
                for e in outputs
                if hasattr(e, 'local_statistics')
            )
        total += sum(float(e.local_statistics[:, 2].sum()) for e in engine.finish())
    assert J[-1] == pytest.approx(total / SMALL**2, rel=1e-3)


@pytest.mark.slow
def test_information_of_a_depth_offset_has_the_bound_of_its_own_noise():
    """Depths of a known trajectory would give n / sigma^2; the filter has less, not nothing."""
    fault = dvl_faults.DepthError(bias_m=0.1, start_s=60.0)
    _, J = information(SHORT, fault, 1)
    most = 300 * (0.1 / 0.05) ** 2
    assert 0.01 * most < J[-1] < most


@pytest.mark.slow
def test_a_fault_of_twice_the_size_has_twice_the_sigmas():
    sigmas = [
        visibility(SHORT, faults.ImuStep(accel_ug=ug, start_s=30.0), 1).sigmas
        for ug in (5.0, 10.0)
    ]
    assert sigmas[1] == pytest.approx(2.0 * sigmas[0], rel=1e-3)


@pytest.mark.slow
def test_the_information_predicts_what_a_noisy_world_shows():
    """NIS with the fault minus NIS without has the mean J and a scatter of 2 sqrt(J)."""
    # A turn: a scale would make the noise longer, too.
    fault = dvl_faults.DvlGain(turn_deg=0.3)
    _, J = information(SHORT, fault, 1)
    grown = []
    for seed in range(1, 13):
        world = SHORT.make(seed)
        with_it, without = (
            total_nis(SHORT.run(fault.applied(world, s), SHORT.best)) for s in (1.0, 0.0)
        )
        grown.append(with_it - without)
    error = 2.0 * np.sqrt(J[-1] / len(grown))
    assert abs(np.mean(grown) - J[-1]) < 4.0 * error


def total_nis(ran):
    return sum(r.nis for r in ran.receipts) + float(ran.local[:, :, 2].sum())


@pytest.mark.slow
@pytest.mark.parametrize('oscillating', [True, False])
def test_the_evidence_of_a_drift_is_what_a_filter_that_knows_it_has(monkeypatch, oscillating):
    """The watchdog's approximations cost nothing: without noise T is J, in a swell as in calm."""
    evidence = []

    def kept(found, *_):
        evidence.append(found.bank[hy.STATISTIC, hy.FIX_EAST :: hy.KINDS].max())
        return []

    monkeypatch.setattr(watchdog, 'slow_faults', kept)
    (row,) = rows_named('fix_drift_0.01mps')
    world = replace(row.scene.world, duration_s=760.0, oscillating=oscillating)
    scene = replace(row.scene, world=world)
    known = reserve('sins')
    _, J = information(scene, row.fault, 1, known)
    scene.run(row.fault.applied(scene.quiet(1), 1.0), {'configuration': 'default', **known})
    assert J[-1] > (25.0 if oscillating else 9.0)
    assert evidence[-1] == pytest.approx(J[-1], rel=0.05)


@pytest.mark.slow
def test_health_is_what_the_engine_itself_has_after_every_fix():
    fault = faults.FixOffset(offset_m=30.0, start_s=60.0)
    world = fault.applied(SHORT.make(3), 1.0)
    params = world.params(configuration='default', max_gated_s=20.0)
    engine, seen = Engine(params), []
    for event in world.inputs.events():
        list(engine.process(event))
        if isinstance(event, Fix) and engine.health is not None:
            level = int(engine.health.level)
            if not seen or seen[-1] != level:
                seen.append(level)
    result = engine_run.run(params, world.inputs, look_every_s=1.0)
    end_ns = int(world.inputs.imu_stamps_ns[-1])
    history = health_history(result.health, end_ns)
    assert seen == [0, 1, 2]
    assert [r.level for r in history] == seen
    assert {r.culprit for r in history[1:]} == {'fixes'}


@pytest.mark.slow
def test_two_seeds_of_cheap_rows_go_through_the_whole_experiment(tmp_path):
    request = Request(
        rows='fix_offset_10m_mid,fix_offset_3m_start,control_demo,station_range_1pc',
        seeds=2,
        first_seed=9001,
        jobs=1,
    )
    experiment = experiment_named('mismatch')
    outcome = run(experiment, request, tmp_path, lambda *_: None)
    fault_free, table, counts = outcome.tables
    lines = {(r['row'], r['filter']): r for r in table.records()}
    offset = lines['fix_offset_10m_mid', 'default']
    assert offset['by'] == 'WARN: fixes'
    assert 400.0 < offset['visible_s'] < 460.0
    hidden = lines['fix_offset_3m_start', 'default']
    assert hidden['verdict'] == BEYOND_STATED
    assert hidden['visible_s'] is None
    assert lines['control_demo', 'default']['verdict'] == 'OK'
    assert lines['control_demo', 'best']['verdict'] is None
    assert lines['station_range_1pc', 'published']['wrong'] in ('0/2', '1/2', '2/2')
    assert ('station_range_1pc', 'modified_akf') not in lines
    assert {r['filter'] for r in fault_free.records()} == {'default', 'modified_akf', 'best'}
    assert counts.records()[-1]['verdict'] == 'wrong and unreported'
    manifest = json.loads((tmp_path / 'manifest.json').read_text())
    assert manifest['seeds'] == [9001, 9002]
    assert manifest['groups']['fix_offset_3m_start']['kind'] == 'FixOffset'


def test_a_world_is_never_changed_in_place():
    world = SHORT.make(1)
    before = world.inputs.f_b.copy()
    worlds.add_imu(world, d_f_b=1.0)
    assert np.array_equal(world.inputs.f_b, before)


def test_scenes_of_both_modes_are_there():
    assert (SINS.mode, STATION.mode) == ('sins', 'station')
    assert warm_scene('station').duration_s == 10.0


@pytest.mark.parametrize('module', [dvl_faults, fix_faults, imu_faults, faults, station_faults])
def test_faults_that_a_seed_draws_say_so(module):
    found = (x for x in vars(module).values() if isinstance(x, type) and issubclass(x, Fault))
    for fault in found:
        if fault.__module__ == module.__name__:
            text = inspect.getsource(fault)
            assert fault.DRAWS is ('worlds.drawn(' in text or 'stream(' in text), fault


def test_two_faults_are_drawn_where_one_is():
    plain, drawn = faults.ImuStep(accel_ug=1.0), faults.FixColoured(sigma=1.0)
    assert [fix_faults.both(*p).is_drawn() for p in ((plain, plain), (plain, drawn))] == [
        False,
        True,
    ]


def test_a_drawn_fault_is_visible_at_each_seed_when_it_is():
    """Reports 70 s after the first seed's time, of which the second seed sees the fault later."""
    request = Request(rows='fix_coloured,imu_temperature', seeds=2, first_seed=7)
    size = Size(1200.0, 2)
    asked = [j for j in MISMATCH.plan(request, size, ['default']) if j.column == VISIBLE]
    assert sorted((j.row.name, j.seed) for j in asked) == [
        ('fix_coloured', 7), ('fix_coloured', 8), ('imu_temperature', 7),
    ]  # fmt: skip
    at = {('fix_coloured', 7): 100.0, ('fix_coloured', 8): 150.0, ('imu_temperature', 7): 100.0}
    seen = [visible_at(j.row.name, j.seed, at[j.row.name, j.seed]) for j in asked]
    names = 'fix_coloured', 'imu_temperature'
    runs = [reported_at(name, seed, 170.0) for name in names for seed in (7, 8)]
    _, table, _ = tables([*seen, *runs], size, request)
    lines = {r['row']: r for r in table.records()}
    assert (lines['fix_coloured']['visible_s'], lines['fix_coloured']['after_s']) == (125.0, 45.0)
    assert lines['imu_temperature']['after_s'] == 70.0
    never = visible_at('fix_coloured', 8, math.nan)
    later = [*(r for r in seen if r.seed == 7), never, *runs]
    _, table, _ = tables(later, size, request)
    assert {r['row']: r for r in table.records()}['fix_coloured']['after_s'] == 70.0


def visible_at(name, seed, from_s):
    """Result of the job that says when a fault is visible at a seed."""
    metrics = {'visible_s': from_s, 'visible_sigmas': 6.0}
    return MismatchResult(name, VISIBLE, seed, metrics, math.nan, '', {}, 0.0)


def reported_at(name, seed, stamp_s):
    """Result of a run that is wrong and says so at a time."""
    metrics = dict.fromkeys(('rms', 'end', 'said', 'wrong', 'covered', 'warnings', 'errors'), 1.0)
    metrics |= {'wrong_s': 60.0, 'named_s': stamp_s, 'first_s': stamp_s}
    said = HealthReport(round(stamp_s * 1e9), 1, 'something', 'imu|fixes')
    more = {'said_first': said, 'said_right': said}
    return MismatchResult(name, 'default', seed, metrics, math.nan, '', {}, 0.0, **more)


def test_faults_of_a_station_come_in_any_order():
    """One may take messages away that the other changes."""
    scene = StationScene(StationScenario(duration_s=60.0))
    world = scene.make(3)
    begins = {'start_s': 20.0}
    ahrs = (
        station_faults.AhrsOut(length_s=5.0, **begins),
        station_faults.AhrsHeading(offset_deg=3.0, **begins),
        station_faults.AhrsDeviation(deg=3.0, **begins),
    )
    thrust = (
        station_faults.ThrustGlitch(silent_s=5.0, **begins),
        station_faults.ThrustStated(factor=2.0, **begins),
        station_faults.ThrustLate(late_s=3.0, **begins),
    )
    for kinds in (ahrs, thrust):
        for one, other in itertools.permutations(kinds, 2):
            made = StationBoth(one=one, other=other).applied(world, 1.0).inputs
            assert len(made.C_b_G) == len(made.omega_ib_b) == len(made.imu_stamps_ns)
            assert len(made.force_b) == len(made.control_stamps_ns)
            np.testing.assert_allclose(np.linalg.det(made.C_b_G), 1.0)
        twice = StationBoth(one=kinds[0], other=kinds[0]).applied(world, 1.0)
        once = kinds[0].applied(world, 1.0)
        np.testing.assert_array_equal(twice.inputs.imu_stamps_ns, once.inputs.imu_stamps_ns)
