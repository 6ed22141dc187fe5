"""Noise out of innovations: the likelihood, its maximum and its bound; what is not shown."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from polar_nav_core.engine.events import Rank
from polar_nav_core.engine.innovations import innovations
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.level import LEVEL_SIGMA
from polar_nav_ros.adapters.noise_classes import IMU_CLASSES, imu_noise
from polar_nav_tools.calibration.verdicts import Verdict
from polar_nav_tools.experiments.calibrate.rows import world_of
from polar_nav_tools.experiments.tune.rows import ROWS, Row
from polar_nav_tools.foreign.recording import Recording
from polar_nav_tools.tuning.classes import GRADES
from polar_nav_tools.tuning.estimate import tune, with_reserve
from polar_nav_tools.tuning.judge import held_out
from polar_nav_tools.tuning.likelihood import Problem, Rows, noisier, plausible
from polar_nav_tools.tuning.parameters import (
    Parameter,
    horizontal_variance,
    own_covariance,
    parameters_of,
    shared_covariance,
)
from polar_nav_tools.tuning.solve import data_sigma, fit
from polar_nav_tools.tuning.verdicts import inseparable, lines_of, problems, sentence

PATH = Path('recording')


class WalkInNoise:
    """A random walk that is measured with white noise: a problem that is known in full."""

    def __init__(self, seed=1, n=200, walk=0.5, noise=2.0):
        rng = np.random.default_rng(seed)
        self.K = np.minimum.outer(np.arange(1, n + 1), np.arange(1, n + 1)).astype(float)
        self.z = walk * np.cumsum(rng.normal(size=n)) + noise * rng.normal(size=n)
        self.runs = 0

    def covariance(self, at):
        return np.exp(2.0 * at[0]) * self.K + np.exp(2.0 * at[1]) * np.eye(len(self.z))

    def rows(self, at):
        self.runs += 1
        L = np.linalg.cholesky(self.covariance(at))
        white, logs = np.zeros((len(self.z), 3)), np.zeros((len(self.z), 3))
        white[:, 0] = np.linalg.solve(L, self.z)
        logs[:, 0] = np.log(np.diag(L))
        ones = np.ones(len(self.z), dtype=np.int64)
        return Rows(np.arange(len(self.z)), ones, ones, white, logs, ones)

    def ln_density(self, at):
        return multivariate_normal(np.zeros(len(self.z)), self.covariance(at)).logpdf(self.z)

    def information(self, at):
        C = np.linalg.inv(self.covariance(at))
        d = [C @ (2.0 * np.exp(2.0 * at[0]) * self.K), C * 2.0 * np.exp(2.0 * at[1])]
        return np.array([[0.5 * np.trace(a @ b) for b in d] for a in d])


@pytest.mark.parametrize('start', [(math.log(0.1), math.log(10.0)), (math.log(5.0), 0.0)])
def test_the_maximum_is_that_of_the_dense_normal_distribution(start):
    problem, prior = WalkInNoise(), np.full(2, math.log(3.0))
    mean = np.array(start)
    found = fit(problem, mean, mean, prior)
    assert found.settled
    assert found.ln_likelihood == pytest.approx(problem.ln_density(found.at), rel=1e-10)

    def negative(at):
        return -problem.ln_density(at) + 0.5 * np.sum(((at - mean) / prior) ** 2)

    best = minimize(negative, np.log([0.5, 2.0]), method='Nelder-Mead', options={'xatol': 1e-6})
    assert (np.abs(found.at - best.x) < 0.1 * found.sigma).all()
    np.testing.assert_allclose(
        found.information, problem.information(found.at), rtol=0.3, atol=0.1 * 200
    )
    bound = np.sqrt(np.diag(np.linalg.inv(problem.information(found.at))))
    np.testing.assert_allclose(found.sigma, bound, rtol=0.25)


@pytest.mark.slow
def test_estimates_scatter_as_their_sigma_states():
    truth, prior = np.log([0.5, 2.0]), np.full(2, math.log(3.0))
    start = truth + math.log(5.0)
    errors = []
    for seed in range(20):
        found = fit(WalkInNoise(seed), start, start, prior)
        errors.append((found.at - truth) / found.sigma)
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=0.5)


def test_the_prior_is_taken_out_of_what_the_data_leave():
    J, prior = np.array([[40.0, 5.0], [5.0, 2.0]]), np.array([1.0, 0.5])
    P = np.linalg.inv(J + np.diag(prior**-2))
    only_first = np.linalg.inv(J + np.diag([0.0, prior[1] ** -2]))
    assert data_sigma(P, prior)[0] == pytest.approx(math.sqrt(only_first[0, 0]))
    nothing = np.linalg.inv(np.diag([40.0, 0.0]) + np.diag(prior**-2))
    assert data_sigma(nothing, prior)[1] > 1e6


def test_two_that_are_known_together_only_are_named():
    prior = np.full(3, 1.0)
    along = np.array([1.0, 1.0, 0.0])
    J = 1e4 * np.outer(along, along) + np.diag([0.1, 0.1, 0.0])
    P = np.linalg.inv(J + np.diag(prior**-2))
    estimated = data_sigma(P, prior) < 0.3
    assert not estimated.any()
    assert inseparable(P, prior, estimated, np.zeros(3)) == {0: 1, 1: 0}
    assert inseparable(P, prior, estimated, np.array([0.4, 0.0, 0.0])) == {1: 0}


def recording(params, inputs):
    return Recording(PATH, 'follower', params, params, inputs)


def row_named(name) -> Row:
    return next(r for r in ROWS if r.name == name)


@pytest.fixture(scope='module')
def straight():
    world = world_of('straight', 60.0, 1)
    return world.params(configuration='default'), world.inputs


def test_noise_is_scaled_where_it_is_stated(straight):
    params, inputs = straight
    parameters = parameters_of(params, inputs)
    at = np.full(len(parameters), math.log(3.0))
    louder, heard = noisier(params, inputs, parameters, at)
    np.testing.assert_allclose(heard.dvl_covariance_m, 9.0 * inputs.dvl_covariance_m)
    np.testing.assert_allclose(heard.depth_variance, 9.0 * inputs.depth_variance)
    for fix, before in zip(heard.fixes, inputs.fixes, strict=True):
        np.testing.assert_allclose(fix.covariance_e, 9.0 * before.covariance_e)
    for parameter in parameters:
        if hasattr(params, parameter.name) and parameter.name not in ('dvl_sigma', 'depth_sigma'):
            assert getattr(louder, parameter.name) == pytest.approx(3.0 * parameter.stated)
    assert {p.name for p in parameters} >= {'gyro_noise_density', 'dvl_markov_sigma', 'fix_sigma'}
    huge = noisier(params, inputs, parameters, np.full(len(parameters), 30.0))[0]
    assert huge.dvl_scale_sigma == 0.5  # the largest that there is


def test_what_fixes_share_is_scaled_apart_from_their_own(straight):
    _, inputs = straight
    first = inputs.fixes[0]
    shared = replace(
        first,
        covariance_e=first.covariance_e,
        leader_sigma=0.5,
        relative_e=np.zeros(3),
    )
    params = straight[0]
    parameters = parameters_of(params, replace(inputs, fixes=(shared,)))
    assert parameters[-1].name == 'fix_slow_sigma'
    assert parameters[-2].stated == pytest.approx(math.sqrt(1.0 - 0.25))
    assert horizontal_variance(shared, shared_covariance(shared)) == pytest.approx(0.25)
    own = parameters[-2].scaled(params, replace(inputs, fixes=(shared,)), 2.0)[1].fixes[0]
    assert horizontal_variance(own, own.covariance_e) == pytest.approx(4.0 * 0.75 + 0.25)
    assert own.leader_sigma == 0.5
    slow = parameters[-1].scaled(params, replace(inputs, fixes=(shared,)), 2.0)[1].fixes[0]
    assert horizontal_variance(slow, own_covariance(slow)) == pytest.approx(0.75, rel=1e-6)
    assert slow.leader_sigma == 1.0


def test_what_is_grossly_wrong_is_left_out_and_nothing_else():
    world = world_of('lawnmower', 120.0, 1)
    params, inputs = world.params(configuration='default'), world.inputs
    v, depth, fixes = inputs.dvl_v_m.copy(), inputs.depth.copy(), list(inputs.fixes)
    v[40::50] += 1.0
    depth[30::40] += 5.0
    fixes[5] = replace(fixes[5], r_e=fixes[5].r_e + 100.0)
    wrong = replace(inputs, dvl_v_m=v, depth=depth, fixes=tuple(fixes))
    for by in (0.2, 1.0):  # stated five times too small, or as it is
        quiet = replace(
            wrong,
            dvl_covariance_m=by**2 * wrong.dvl_covariance_m,
            depth_variance=by**2 * wrong.depth_variance,
        )
        kept = plausible(params, quiet)
        np.testing.assert_array_equal(np.flatnonzero(~kept.dvl), np.arange(len(v))[40::50])
        np.testing.assert_array_equal(np.flatnonzero(~kept.depth), np.arange(len(depth))[30::40])
        assert np.flatnonzero(~kept.fixes).tolist() == [5]
        assert kept.left_out(quiet) == {
            'dvl': len(v[40::50]),
            'depth': len(depth[30::40]),
            'fix': 1,
        }
        assert not kept.of(quiet).dvl_valid[40::50].any()


def test_all_runs_have_the_same_measurements_whatever_their_noise(straight):
    params, inputs = straight
    parameters = parameters_of(params, inputs)
    first, last = int(inputs.imu_stamps_ns[0]), int(inputs.imu_stamps_ns[-1]) + 1
    problem = Problem(params, inputs, parameters, first, last)
    one = problem.rows(np.zeros(len(parameters)))
    other = problem.rows(np.full(len(parameters), -math.log(30.0)))
    assert one.same_measurements(other)
    assert int((one.ranks == Rank.DVL).sum()) > 0.95 * len(inputs.dvl_stamps_ns)


def without_heights(inputs):
    """The same with fixes as a mapping of two dimensions makes them."""
    up = [np.asarray(ecef_to_grid(f.r_e))[2] for f in inputs.fixes]
    flat = [
        replace(f, covariance_e=f.covariance_e + LEVEL_SIGMA**2 * np.outer(u, u))
        for f, u in zip(inputs.fixes, up, strict=True)
    ]
    return replace(inputs, fixes=tuple(flat))


def test_a_fix_without_height_is_two_numbers_whose_noise_is_scaled(straight):
    params, inputs = straight
    flat = without_heights(inputs)
    run = innovations(params, flat)
    fixes = run.ranks == Rank.FIX
    assert (run.dof == np.where(fixes, 2, run.sizes)).all()
    with_heights = innovations(params, inputs)
    assert (with_heights.dof == with_heights.sizes).all()
    (noise,) = (p for p in parameters_of(params, flat) if p.name == 'fix_sigma')
    louder = noise.scaled(params, flat, 3.0)[1].fixes[0]
    before = flat.fixes[0]
    up = np.asarray(ecef_to_grid(before.r_e))[2]
    assert up @ louder.covariance_e @ up == pytest.approx(up @ before.covariance_e @ up)
    assert horizontal_variance(louder, louder.covariance_e) == pytest.approx(
        9.0 * horizontal_variance(before, before.covariance_e), rel=1e-6
    )


@pytest.mark.slow
def test_fixes_without_heights_are_as_noisy_as_those_with():
    world = world_of('lawnmower', 300.0, 2)
    params, found = world.params(configuration='default'), []
    for inputs in (world.inputs, without_heights(world.inputs)):
        lines = lines_of(tune(recording(params, inputs)))
        found += [line for line in lines if line.parameter.name == 'fix_sigma']
    assert found[1].value == pytest.approx(found[0].value, rel=0.1)
    assert found[1].sigma_share > 1.1 * found[0].sigma_share


def judged_rows(sigma, n=4000, seed=3):
    rng = np.random.default_rng(seed)
    white, logs = np.zeros((n, 3)), np.zeros((n, 3))
    white[:, 0] = rng.normal(size=n) / sigma
    logs[:, 0] = math.log(sigma)
    ranks = np.full(n, int(Rank.DEPTH))
    ones = np.ones(n, dtype=np.int64)
    return Rows(np.arange(n), ranks, ones, white, logs, ones)


def test_a_part_held_out_prefers_the_right_noise():
    right, wrong = judged_rows(1.0), judged_rows(1.3)
    found = held_out(wrong, right, 10.0)
    assert found.verdict == 'better'
    assert found.nis[0].inside
    assert found.nis[0].stated == pytest.approx(1.0 / 1.69, rel=0.1)
    assert held_out(right, wrong, 10.0).verdict == 'worse'
    assert not held_out(right, wrong, 10.0).nis[0].inside
    assert held_out(right, right, 10.0).verdict == 'alike'
    assert held_out(None, right, 10.0).verdict == 'better'
    expected = math.log(1.3) - 0.5 * (1.0 - 1.0 / 1.69)
    assert found.gain == pytest.approx(expected, abs=0.02)
    assert 0.0 < found.gain_sigma < 0.02


def test_each_class_has_words():
    assert set(GRADES) == set(IMU_CLASSES)


@pytest.mark.slow
@pytest.mark.parametrize('name', ['low', 'mixed'])
def test_noise_that_is_stated_five_times_wrong_comes_back(name):
    row = row_named(name)
    params, inputs, true = row.stated(300.0, 1)
    found = tune(recording(params, inputs))
    lines = lines_of(found)
    assert not problems(found)
    for line in lines:
        if line.verdict is not Verdict.ESTIMATED:
            continue
        error = math.log(line.value / true[line.parameter.name])
        assert abs(error) < max(0.2, 3.5 * line.sigma_share), line.parameter.name
    sure = [line.parameter.name for line in lines if line.verdict is Verdict.ESTIMATED]
    assert {'gyro_noise_density', 'accel_noise_density', 'dvl_sigma', 'depth_sigma'} <= set(sure)
    assert found.judged.verdict == 'better'
    assert all(n.inside for n in found.judged.nis)
    assert not found.left_out


@pytest.mark.slow
def test_a_mems_vehicle_whose_file_states_a_tactical_imu_is_found_out():
    params, inputs, _ = row_named('mems').stated(300.0, 1)
    assert params.gyro_noise_density == imu_noise('stim300')['gyro_noise_density']
    found = tune(recording(params, inputs))
    words = sentence(found, lines_of(found))
    assert 'like `stim300` (tactical grade)' in words
    assert 'MEMS' in words
    assert found.classes[0].name in ('vn100', 'bmi088', 'icm20948')
    assert found.judged.verdict == 'better'


@pytest.mark.slow
def test_a_short_run_of_a_good_imu_cannot_tell_its_noise(straight):
    params, inputs = straight
    found = tune(recording(params, inputs))
    lines = {line.parameter.name: line for line in lines_of(found)}
    assert lines['gyro_noise_density'].verdict is Verdict.NOT_EXCITED
    assert 'under way' in lines['gyro_noise_density'].why
    assert lines['dvl_sigma'].verdict is Verdict.ESTIMATED
    assert 'the data cannot tell' in sentence(found, tuple(lines.values()))
    assert not lines['gyro_noise_density'].changes


def test_a_recording_with_nothing_to_tune_by_is_refused(straight):
    params, inputs = straight
    none = np.zeros(0)
    stamps = np.zeros(0, dtype=np.int64)
    alone = replace(
        inputs,
        dvl_valid=np.zeros(len(inputs.dvl_valid), dtype=bool),
        depth_stamps_ns=stamps,
        depth=none,
        depth_variance=none,
        fixes=(),
    )
    with pytest.raises(ConfigError, match='nothing to tune by'):
        tune(recording(params, alone))
    world = world_of('straight', 12.0, 1)
    with pytest.raises(ConfigError, match='too short'):
        tune(recording(world.params(configuration='default'), world.inputs))
    with pytest.raises(ConfigError, match='stated noise'):
        tune(recording(replace(params, configuration='modified_akf'), inputs))


def test_no_walk_of_a_bias_is_suggested_below_the_reserve():
    usual = EngineParams().accel_bias_walk

    def least(name, stated):
        parameter = Parameter(name, '', '', stated, lambda p, x, _: (p, x))
        at = with_reserve([parameter], np.array([math.log(1e-3)]))
        return stated * math.exp(at[0])

    assert least('accel_bias_walk', 10.0 * usual) == pytest.approx(usual)
    assert least('accel_bias_walk', 0.5 * usual) == pytest.approx(0.5 * usual)
    assert least('accel_noise_density', 1.0) == pytest.approx(1e-3)
