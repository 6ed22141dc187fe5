"""The experiment `tune`: its rows state noise wrong, and its table judges what is found."""

import math

import numpy as np
import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_ros.adapters.noise_classes import imu_noise
from polar_nav_tools.experiments.catalog import experiment_named
from polar_nav_tools.experiments.jobs import RunResult
from polar_nav_tools.experiments.request import Request, Size
from polar_nav_tools.experiments.tune.experiment import (
    TUNE,
    TuneJob,
    is_back,
    plan,
    run_job,
    tables,
)
from polar_nav_tools.experiments.tune.rows import ROWS, TUNED, WALKS

SIZE = Size(300.0, 2)


def test_it_has_a_job_for_each_row_and_seed():
    assert experiment_named('tune') is TUNE
    assert len(plan(Request(), SIZE, ())) == 2 * len(ROWS)
    few = plan(Request(rows='low,mems', first_seed=7), SIZE, ())
    assert [(j.group, j.seed) for j in few] == [('low', 7), ('low', 8), ('mems', 7), ('mems', 8)]
    with pytest.raises(ConfigError, match='no such row'):
        plan(Request(rows='nothing'), SIZE, ())


def test_rows_state_noise_five_times_wrong():
    by_name = {row.name: row for row in ROWS}
    params, inputs, true = by_name['right'].stated(30.0, 1)
    wrong, heard, same = by_name['mixed'].stated(30.0, 1)
    assert true == same
    assert true['gyro_bias_walk'] == params.gyro_bias_walk == WALKS['gyro_bias_walk']
    assert wrong.gyro_noise_density == pytest.approx(5.0 * params.gyro_noise_density)
    assert wrong.gyro_bias_walk == pytest.approx(params.gyro_bias_walk / 5.0)
    assert set(by_name['mixed'].factors.values()) == {5.0, 0.2}
    assert set(TUNED) < set(true)
    ratio = heard.dvl_covariance_m[0, 0, 0] / inputs.dvl_covariance_m[0, 0, 0]
    assert ratio == pytest.approx(by_name['mixed'].factors['dvl_sigma'] ** 2)
    np.testing.assert_array_equal(heard.omega_ib_b, inputs.omega_ib_b)
    mems = by_name['mems'].stated(30.0, 1)[0]
    assert mems.gyro_bias_sigma == imu_noise('stim300')['gyro_bias_sigma']


@pytest.mark.slow
def test_a_job_says_what_was_found_and_how_it_was_judged():
    result = run_job(TuneJob('dvl_sigma_low', 120.0, 1))
    assert not result.reason
    assert is_back(result.metrics['dvl_sigma.ratio'], result.metrics['dvl_sigma.sigma'])
    assert result.metrics['held_out.better'] == 1.0
    noises, judged = tables([result], Size(120.0, 1), Request(rows='dvl_sigma_low'))
    assert [row['name'] for row in noises.rows] == ['dvl_sigma']
    assert noises.rows[0]['back'] == '1 of 1'
    assert judged.rows[0]['better'] == '1 of 1'


def test_rows_of_other_faults_state_the_noise_right():
    by_name = {row.name: row for row in ROWS}
    params, inputs, _ = by_name['wrong_delay_5s'].stated(30.0, 1)
    turned_params, turned, _ = by_name['wrong_dvl_yaw_90'].stated(30.0, 1)
    assert turned_params == params
    np.testing.assert_array_equal(turned.dvl_covariance_m, inputs.dvl_covariance_m)
    np.testing.assert_allclose(turned.dvl_v_m[:, 1], inputs.dvl_v_m[:, 0], atol=1e-12)
    _, sooner, _ = by_name['wrong_delay_1.6s'].stated(30.0, 1)
    both = zip(inputs.fixes, sooner.fixes, strict=True)
    assert {a.validity_ns - b.validity_ns for a, b in both} == {3_400_000_000}
    _, upside, _ = by_name['wrong_depth_sign'].stated(30.0, 1)
    np.testing.assert_allclose(upside.depth, -inputs.depth)


def test_its_table_of_other_faults_counts_what_was_said():
    sentence = 'the recording is as if the DVL were turned (ln likelihood +9), and so on'
    runs = [
        RunResult(
            'wrong_dvl_yaw_90', 'tuned', seed, {'instead': said, 'suggested': most}, math.nan,
            reason, {}, 0.0,
        )
        for seed, said, most, reason in ((1, 0.0, 3.0, 'more than half'), (2, 1.0, 0.0, sentence))
    ]  # fmt: skip
    (others,) = tables(runs, Size(600.0, 2), Request())
    assert others.rows == (
        {
            'group': 'wrong_dvl_yaw_90', 'not_well': '2 of 2', 'instead': '1 of 2',
            'suggested': '3', 'words': 'the DVL were turned',
        },
    )  # fmt: skip


@pytest.mark.parametrize(
    ('ratio', 'sigma', 'back'),
    [
        (1.19, 0.01, True),
        (1.25, 0.01, False),
        (1.25, 0.08, True),
        (0.7, 0.08, False),
        (math.exp(-0.5), 0.2, True),
    ],
)
def test_back_is_within_a_fifth_or_three_sigmas_of_what_is_not_surer(ratio, sigma, back):
    assert is_back(ratio, sigma) is back


def result(seed, ratio, verdict, inside=1.0):
    metrics = {
        'held_out.gain': 0.1, 'held_out.better': 1.0, 'held_out.worse': 0.0, 'class.mems': 0.0,
        'class.gain': 0.0, 'nis.dvl': 1.0, 'nis.dvl.inside': inside, 'dvl_sigma.ratio': ratio,
        'dvl_sigma.sigma': 0.05, 'dvl_sigma.verdict': float(verdict),
    }  # fmt: skip
    return RunResult('dvl_sigma_low', 'tuned', seed, metrics, math.nan, '', {}, 0.0)


def test_its_table_counts_what_is_estimated_only():
    runs = [result(1, 1.1, 0), result(2, 1.4, 0, 0.0), result(3, 9.0, 1)]
    noises, judged = tables(runs, Size(600.0, 3), Request())
    (row,) = noises.rows
    assert row['back'] == '1 of 2'
    assert row['ratio'] == pytest.approx(math.sqrt(1.1 * 1.4))
    assert '2 ESTIMATED' in row['verdicts']
    assert judged.rows[0]['inside'] == '2 of 3'
