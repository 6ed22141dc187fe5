"""The experiment `leader-error`: its leaders, and the linear model beside the engine."""

import dataclasses
import math

import numpy as np
import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid
from polar_nav_tools.experiments.leader_error import experiment, nearer, two_vehicles
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


def test_a_leader_at_one_side_sails_the_follower_s_way():
    spec = WorldSpec(duration_s=900.0, mission='racetrack')
    world = make_leader_world(spec, Leader(place='east'), 1)
    fixes = world.inputs.fixes
    truth = world.truth.state(np.array([f.validity_ns for f in fixes]))
    courses = np.degrees(np.arctan2(truth.v_G[:, 0], truth.v_G[:, 1]))
    assert np.ptp(courses) > 150.0
    C_e_G = np.asarray(ecef_to_grid(truth.r_e))
    line_G = np.einsum('nij,nj->ni', C_e_G, np.array([f.relative_e for f in fixes]))
    np.testing.assert_allclose(line_G, np.tile([-1000.0, 0.0, 0.0], (len(fixes), 1)), atol=1e-6)


def test_rounding_is_upwards_and_at_most_a_step():
    sigma = np.array([0.0, 1e-4, 0.5, 3.0])
    found = rounded(sigma)
    assert found[0] == 0.0
    assert np.all(found >= sigma)
    assert np.all(found[1:] <= 1.06 * sigma[1:])


@pytest.mark.parametrize('name', ['0.07 %, 30 min', '0.5 %, 30 min'])
def test_packets_are_honest_and_near_the_filter_of_both_vehicles(name):
    scenario = _scenario(name)
    found = two_vehicles.run(dataclasses.replace(scenario, duration_s=1200.0))
    best, given, packets, independent = (
        found[key] for key in ('centralised', 'structured', 'packets', 'independent')
    )
    assert 0.7 < packets.position < 1.3
    assert 0.8 < packets.heading < 1.4
    assert packets.rms < 1.1 * best.rms
    assert best.rms <= given.rms < packets.rms
    assert best.position == pytest.approx(1.0)
    assert best.said == pytest.approx(best.rms)
    assert independent.position > 5.0


def test_the_turn_of_the_way_of_a_leader_is_in_what_is_published():
    """A follower that knows the errors of its own DVL reads its heading off the leader's way."""
    scenario = _scenario('gyrocompass, 2 km')
    scenario = dataclasses.replace(scenario, duration_s=2400.0)
    found = two_vehicles.run(scenario, own_sigmas=two_vehicles.CALM)
    packets, published = found['packets'], found['published']
    assert packets.heading > 1.6
    assert 0.4 < published.heading < 1.0
    assert 0.6 < published.position < 1.3
    assert published.rms == packets.rms


def test_what_is_expected_is_what_draws_show():
    """Errors drawn from the true model, and the filter's own arithmetic on their fixes."""
    scenario = dataclasses.replace(_scenario('0.5 %, racetrack'), duration_s=1200.0)
    sigmas = two_vehicles.CALM
    fixes = two_vehicles.moments(scenario, sigmas)
    true = two_vehicles.both(scenario.leader, fixes)
    f = two_vehicles.three_states(fixes)
    rng = np.random.default_rng(5)
    x = rng.standard_normal((400, 14)) * np.concatenate([sigmas, true.sigmas])
    P = np.diag(np.concatenate([sigmas, f.sigmas]) ** 2)
    found = np.zeros((len(x), len(P)))
    squares = []
    for k, (t, r) in enumerate(zip(true.rows, f.rows, strict=True), 1):
        x = x @ t.Phi.T + rng.standard_normal(x.shape) * np.sqrt(t.Q)
        z = x @ t.H.T + rng.standard_normal((len(x), 2))
        found, P = found @ r.Phi.T, r.Phi @ P @ r.Phi.T + np.diag(r.Q)
        K = P @ r.H.T @ np.linalg.inv(r.H @ P @ r.H.T + r.R)
        found, P = found + (z - found @ r.H.T) @ K.T, P - K @ r.H @ P
        if 2 * k > len(fixes):
            squares.append(np.sum((found - x[:, : len(P)])[:, :2] ** 2, axis=1))
    each = np.mean(squares, axis=0)
    expected = two_vehicles.run(scenario, sigmas)['packets'].rms ** 2
    assert abs(each.mean() - expected) < 3.5 * each.std() / math.sqrt(len(each))


def test_packets_tell_what_kind_of_leader_sent_them():
    def stated(name):
        fixes = two_vehicles.moments(_scenario(name), two_vehicles.SIGMAS)
        return two_vehicles.stated_leader(fixes)

    own = stated('0.5 %, racetrack')
    assert own.array_deg is None
    assert own.heading_deg == pytest.approx(math.degrees(0.005 * math.sqrt(0.7)), rel=0.06)
    compass = stated('gyrocompass, circling')
    assert compass.array_deg == pytest.approx(experiment._OCTANS_DEG, rel=0.06)
    assert 4e-4 < compass.scale < math.radians(0.034)  # scale and wandering heading of its way
    assert compass.scale == pytest.approx(math.radians(compass.heading_deg))
    still = stated('3 m, constant')
    assert 3.0 <= still.start_m < 3.2
    assert (still.heading_deg, still.scale, still.slow_mps, still.array_deg) == (0.0,) * 4


@pytest.mark.slow
@pytest.mark.parametrize('own_sigmas', [two_vehicles.SIGMAS, two_vehicles.CALM])
def test_what_holds_a_leader_far_out_holds_it_back_at_its_start(own_sigmas):
    """Taken for dead reckoned along its array's heading there, it makes a follower too sure."""
    scenario = _scenario('gyrocompass, racetrack')
    fixes = two_vehicles.moments(scenario, own_sigmas)
    kept, present = (
        two_vehicles.expected(
            scenario.leader,
            fixes,
            own_sigmas,
            two_vehicles.three_states(fixes, tau_s=3600.0, keeps=keeps, shaped=False),
        )[1]
        for keeps in (True, False)
    )
    assert kept.rms < 0.85 * present.rms
    assert 0.7 < kept.position < 1.1
    assert present.position > 2.5


def test_nothing_is_kept_of_a_leader_that_dead_reckons_along_its_heading():
    scenario = dataclasses.replace(_scenario('0.5 %, racetrack'), duration_s=2400.0)
    fixes = two_vehicles.moments(scenario, two_vehicles.CALM)
    kept, present = (
        list(two_vehicles.three_states(fixes, keeps=keeps, shaped=False).rows)
        for keeps in (True, False)
    )
    for m, a, b in zip(fixes, kept, present, strict=True):
        np.testing.assert_array_equal(a.constants, b.constants)
        if m.stamp_ns > 400 * 10**9:  # its sigma has grown to four times that of the start
            np.testing.assert_array_equal(a.H, b.H)
        np.testing.assert_allclose(a.H, b.H, atol=0.15)


@pytest.mark.slow
@pytest.mark.parametrize('own_sigmas', [two_vehicles.SIGMAS, two_vehicles.CALM])
@pytest.mark.parametrize('name', ['0.07 %, 30 min', '0.07 %, 2 h', '0.5 %, 30 min', '0.5 %, 2 h'])
def test_three_states_are_within_a_twentieth_of_all_that_packets_tell(name, own_sigmas):
    found = two_vehicles.run(_scenario(name), own_sigmas)
    assert found['packets'].rms < 1.05 * found['structured'].rms
    assert found['packets'].rms < 1.2 * found['centralised'].rms
    assert max(found['published'].position, found['published'].heading) < 1.1


def test_leaders_between_are_judged_by_the_same_ratios():
    scenario = dataclasses.replace(_scenario('0.5 %, 30 min'), duration_s=600.0)
    found = two_vehicles.run(scenario)
    given, best, nees, before = nearer.between(scenario, two_vehicles.SIGMAS)
    assert given == found['packets'].rms / found['structured'].rms
    assert best == found['packets'].rms / found['centralised'].rms
    assert nees == max(found['published'].position, found['published'].heading)
    assert before != given
    assert not {s.name for s in nearer.BETWEEN} & {s.name for s in experiment.SCENARIOS}


@pytest.mark.slow
def test_where_a_leader_turns_back_its_heading_of_now_has_not_turned_its_whole_way():
    """What the three states cannot hold; neither along and across nor finer sigmas replace it."""
    found = nearer.run(_scenario('0.5 %, racetrack'))
    best = found['centralised'][0].rms
    ratio = {name: own.rms / best for name, (own, _) in found.items()}
    assert ratio['structured'] < 1.05
    assert ratio['structured, scale'] < ratio['structured']
    assert ratio['present heading'] > 1.2
    assert 1.2 < ratio['packets'] < ratio['round']
    assert ratio['packets, finer'] == pytest.approx(ratio['packets'], rel=0.03)
    assert ratio['packets, correlated'] < ratio['packets, covariance'] < ratio['packets']


def _scenario(name):
    return next(s for s in experiment.SCENARIOS if s.name == name)


def test_a_follower_of_a_leader_that_drifts_is_not_too_sure():
    scenario = _scenario('0.5 %, 30 min')
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
