"""The experiment `leader-error`: its leaders, and the linear model beside the engine."""

import dataclasses

import numpy as np
import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_tools.experiments.leader_error import experiment, two_vehicles
from polar_nav_tools.experiments.leader_error.leader import Leader, make_leader_world, rounded
from polar_nav_tools.experiments.request import Request, Size
from polar_nav_tools.experiments.world_spec import WorldSpec


def test_fixes_of_leaders_are_off_by_what_their_packets_state():
    spec = WorldSpec(duration_s=60.0)
    leader = Leader(heading_deg=0.6, start_m=3.0, range_m=1500.0)
    squares = []
    for seed in range(1, 21):
        world = make_leader_world(spec, leader, seed)
        fixes = world.inputs.fixes
        truth = world.truth.state(np.array([f.validity_ns for f in fixes]))
        assert all(f.leader_sigma >= 3.0 and f.leader_heading_sigma >= 0.0104 for f in fixes)
        off = np.array([f.r_e for f in fixes])[0] - truth.r_e[0]
        squares.append(off @ np.linalg.solve(fixes[0].covariance_e, off) / 3.0)
        line = np.linalg.norm([f.relative_e for f in fixes], axis=1)
        np.testing.assert_allclose(line, 1500.0)
    assert 0.4 < np.mean(squares) < 1.7  # 60 degrees of freedom, sigmas rounded up


def test_rounding_is_upwards_and_at_most_a_step():
    sigma = np.array([0.0, 1e-4, 0.5, 3.0])
    found = rounded(sigma)
    assert found[0] == 0.0
    assert np.all(found >= sigma)
    assert np.all(found[1:] <= 1.06 * sigma[1:])


@pytest.mark.parametrize('name', ['0.07 %, 30 min', '0.5 %, 30 min'])
def test_packets_are_honest_and_near_the_filter_of_both_vehicles(name):
    scenario = next(s for s in experiment.SCENARIOS if s.name == name)
    found = two_vehicles.run(dataclasses.replace(scenario, duration_s=1200.0))
    best, packets, independent = (found[key] for key in ('centralised', 'packets', 'independent'))
    assert 0.8 < packets.position < 1.3
    assert 0.8 < packets.heading < 1.4
    assert packets.rms < 1.1 * best.rms
    assert independent.position > 5.0


def test_the_turn_of_the_way_of_a_leader_is_in_what_is_published():
    """A follower that knows the errors of its own DVL reads its heading off the leader's way."""
    scenario = next(s for s in experiment.SCENARIOS if s.name == 'gyrocompass, 2 km')
    scenario = dataclasses.replace(scenario, duration_s=2400.0)
    found = two_vehicles.run(scenario, own_sigmas=two_vehicles.CALM)
    packets, published = found['packets'], found['published']
    assert packets.heading > 1.6
    assert 0.4 < published.heading < 1.0
    assert 0.6 < published.position < 1.3
    assert published.rms == packets.rms


def test_a_follower_of_a_leader_that_drifts_is_not_too_sure():
    scenario = next(s for s in experiment.SCENARIOS if s.name == '0.5 %, 30 min')
    results = {
        name: experiment.run_job(experiment.LeaderJob(scenario, name, 1, 300.0))
        for name in ('default', 'independent')
    }
    assert results['default'].metrics['half_position'] < 4.0
    assert results['independent'].metrics['half_position'] > 20.0


def test_rows_choose_leaders():
    """Their names have commas: a pattern stands for what is before one."""
    size = Size(300.0, 2)
    jobs = experiment.plan(Request(rows='gyrocompass*, perfect'), size, ['default'])
    names = dict.fromkeys(job.scenario.name for job in jobs)
    assert list(names) == [
        *(n for n in (s.name for s in experiment.SCENARIOS) if 'gyro' in n),
        'perfect',
    ]
    assert len(jobs) == 2 * len(names)
    with pytest.raises(ConfigError, match='no such row'):
        experiment.plan(Request(rows='gyro'), size, ['default'])
