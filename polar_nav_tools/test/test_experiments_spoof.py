"""The experiment `spoof`: what its packets are, and the verdicts and warnings of a few."""

import pytest

from polar_nav_tools.experiments.catalog import experiment_named
from polar_nav_tools.experiments.mismatch.plan import as_stated
from polar_nav_tools.experiments.mismatch.row import SINS
from polar_nav_tools.experiments.request import Request
from polar_nav_tools.experiments.spoof import (
    SPOOF,
    SPOOFS,
    START_S,
    SpoofJob,
    _tables,
    run_job,
)


@pytest.fixture(scope='module')
def world():
    return SINS.make(1)


@pytest.mark.parametrize('spoof', SPOOFS, ids=lambda s: s.name)
def test_packets_come_in_order_and_begin_in_time(world, spoof):
    fixes = spoof.applied(world).inputs.fixes
    keys = [f.key for f in fixes]
    assert keys == sorted(set(keys))
    before = world.truth.start_ns + round(START_S * 1e9)
    genuine = {f.sequence: f for f in world.inputs.fixes}
    for f in fixes:
        if f.receive_ns < before:
            assert (f.r_e == genuine[f.sequence].r_e).all()


def test_drifts_come_with_each_class_of_imu():
    scenes = {s.name.rsplit('_', 1)[1]: s.scene for s in SPOOFS if s.scene is not SINS}
    assert {name: scene.world.imu for name, scene in scenes.items()} == {
        'navigation': 'navigation',
        'fog': 'fog',
        'stim300': 'stim300',
        'mems': 'bmi088',
    }
    assert sum(s.scene is not SINS for s in SPOOFS) == 16


@pytest.mark.slow
def test_a_few_of_its_runs():
    stated = as_stated('sins')
    jobs = [
        SpoofJob(name, column, 1, {**stated, 'configuration': column})
        for name, column in (
            ('packet_5km', 'modified_akf'),
            ('burnt_numbers', 'default'),
            ('replay_20', 'default'),
            ('indefinite', 'default'),
        )
    ]
    results = [run_job(job) for job in jobs]
    assert all(r.metrics['most_m'] < 1.5 for r in results)
    assert all(0.0 < r.metrics['warned_s'] < 5.0 for r in results)
    verdicts = [set(r.verdicts) - {'FUSED'} for r in results]
    assert verdicts == [{'IMPLAUSIBLE'}, {'GATED'}, {'REPLAYED'}, {'NOT_FINITE'}]
    (table,) = _tables(results, SPOOF.quick, Request())
    assert [row['warned'] for row in table.rows] == ['1/1'] * 4
    assert all(0.0 < float(str(row['warned_m'])) < 1.0 for row in table.rows)
    assert all(row['latest_s'] == row['warned_s'] for row in table.rows)
    assert experiment_named('spoof') is SPOOF
