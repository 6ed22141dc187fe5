"""Whole runs scored and compared, against numbers computed here from the same series."""

import dataclasses
import json

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from polar_nav_tools.report.example import (
    estimate_with_errors,
    example_input,
    example_truth,
)
from polar_nav_tools.scoring import Window, compare, score
from polar_nav_tools.scoring.consistency import consistency_of_sums
from polar_nav_tools.series.vehicle import last_revisions

RUNS = example_input(minutes=2.0).runs
SCORES = compare(RUNS)


def local(truth, estimate):
    """Position error in the plane of the mean grid axes, by a formula of its own."""
    u = np.stack(
        [
            np.cos(truth.latitude) * np.cos(truth.longitude),
            np.cos(truth.latitude) * np.sin(truth.longitude),
            np.sin(truth.latitude),
        ],
        axis=1,
    )
    north = np.cross(u, [0.0, 1.0, 0.0])
    north /= np.linalg.norm(north, axis=1)[:, None]
    east = np.cross(north, u)
    d = estimate.r_e - truth.r_e
    return np.stack([(d * axis).sum(1) for axis in (east, north, u)], axis=1)


@pytest.mark.parametrize('name', RUNS)
def test_rms_of_the_demo_table(name):
    truth, estimate, _ = RUNS[name]
    dr = local(truth, estimate)
    phi = -Rotation.from_matrix(estimate.C_b_G @ truth.C_b_G.transpose(0, 2, 1)).as_rotvec() * (
        180 * 60 / np.pi
    )
    dv = estimate.v_G - truth.v_G

    def rms(x):
        return np.sqrt(np.mean(x * x))

    row = SCORES.to_dict()[name]['summary']
    expected = {
        'phi_x_arcmin': rms(phi[:, 0]),
        'phi_y_arcmin': rms(phi[:, 1]),
        'phi_z_arcmin': rms(phi[:, 2]),
        'v_x': rms(dv[:, 0]),
        'v_y': rms(dv[:, 1]),
        'r_x': rms(dr[:, 0]),
        'r_y': rms(dr[:, 1]),
    }
    for key, value in expected.items():
        assert row[key] == pytest.approx(value, rel=1e-6), key
    half = truth.stamp_ns >= (truth.stamp_ns[0] + truth.stamp_ns[-1]) // 2
    assert row['horizontal_second_half'] == pytest.approx(
        rms(np.hypot(dr[half, 0], dr[half, 1])), rel=1e-6
    )


@pytest.mark.parametrize('name', RUNS)
def test_lag_expected_is_speed_times_mean_delay(name):
    truth, _, receipts = RUNS[name]
    late = SCORES.scores[name].second_half
    middle = (truth.stamp_ns[0] + truth.stamp_ns[-1]) // 2
    ages = [
        (r.receive_ns - r.validity_ns) * 1e-9
        for r in last_revisions(receipts)
        if r.verdict_text == 'FUSED' and middle <= r.receive_ns <= truth.stamp_ns[-1]
    ]
    assert late.lag.fixes == len(ages) > 20
    assert late.lag.mean_delay == pytest.approx(np.mean(ages))
    assert late.lag.expected == pytest.approx(3.0 * np.mean(ages), rel=1e-9)


def test_a_run_that_lags_by_the_delay_is_found_to():
    assert SCORES.scores['conventional_akf'].second_half.lag.ratio == pytest.approx(1.0, abs=0.1)
    assert SCORES.scores['conventional_akf'].second_half.lag.along_mean < 0.0
    assert SCORES.scores['modified_akf'].second_half.lag.ratio < 0.1


def test_nees_of_known_errors():
    truth = example_truth('f', 80.0, 120.0, 0.5)
    one = np.ones((len(truth), 3))
    estimate = estimate_with_errors(
        truth,
        'c',
        dr_G=np.array([2.0, 0.0, 3.0]) * one,
        dv_G=0 * one,
        phi_G=np.array([0.0, 0.0, 0.02]) * one,
        sigma_r=np.array([1.0, 1.0, 0.5]) * one,
        sigma_v=one,
        sigma_phi=0.01 * one,
    )
    whole = score('c', truth, estimate, []).whole
    assert whole.nees_position.mean == pytest.approx(4.0 + 36.0)
    assert whole.nees_horizontal.mean == pytest.approx(4.0)
    assert whole.nees_position.mean_per_dof == pytest.approx(40.0 / 3.0)
    assert whole.nees_horizontal.mean_per_dof == pytest.approx(2.0)
    assert whole.components['r_z'].normalized_rms == pytest.approx(6.0)
    assert whole.components['r_z'].within_3_sigma == 0.0
    assert whole.components['grid_heading'].normalized_rms == pytest.approx(2.0, rel=1e-3)
    assert whole.components['grid_heading'].unit == 'arcmin'
    assert whole.components['true_heading'].error.rms == pytest.approx(np.rad2deg(0.02), rel=1e-3)
    assert np.isnan(whole.components['along'].sigma_rms)
    assert whole.lag.fixes == 0
    assert np.isnan(whole.lag.expected)


def test_drift_is_in_percent_of_the_way():
    truth = example_truth('f', 80.0, 120.0, 0.5)  # 90 m
    one = np.ones((len(truth), 3))
    ramp = np.linspace(0.0, 0.9, len(truth))[:, None] * np.array([1.0, 0.0, 0.0])
    estimate = estimate_with_errors(
        truth,
        'c',
        dr_G=ramp,
        dv_G=0 * one,
        phi_G=0 * one,
        sigma_r=one,
        sigma_v=one,
        sigma_phi=one,
    )
    drift = score('c', truth, estimate, []).drift
    assert drift.distance == pytest.approx(90.0, rel=1e-3)
    assert drift.final_percent == pytest.approx(1.0, rel=1e-3)


def test_phases_are_scored_beside_the_standard_windows():
    name, (truth, estimate, receipts) = next(iter(RUNS.items()))
    start = int(truth.stamp_ns[0])
    one = score(
        name, truth, estimate, receipts, phases=[Window('dive', start, start + 30 * 10**9)]
    )
    assert list(one.windows) == ['whole', 'second_half', 'dive']
    assert one.windows['dive'].components['r_x'].error.count == 301
    with pytest.raises(ValueError, match="phase 'whole'"):
        score(name, truth, estimate, receipts, phases=[Window('whole', 0, 1)])


def test_order_in_the_bag_does_not_matter():
    name, (truth, estimate, receipts) = next(iter(RUNS.items()))
    rng = np.random.default_rng(1)
    statistics = rng.integers(0, 3, (len(estimate), 2, 3)).astype(float)
    estimate = with_local(estimate, statistics)
    mixed = estimate.rows(rng.permutation(len(estimate)))
    one = score(name, truth, estimate, receipts)
    other = score(name, truth.rows(rng.permutation(len(truth))), mixed, receipts)
    assert other.to_dict() == one.to_dict()


def test_a_silent_filter_does_not_look_whole():
    name, (truth, estimate, receipts) = next(iter(RUNS.items()))
    n = len(estimate)
    gone = np.arange(n) >= n // 4
    r_e = np.where(gone[:, None], np.nan, estimate.r_e)
    status = np.where(gone, 2, 1).astype(np.uint8)
    one = score(name, truth, dataclasses.replace(estimate, r_e=r_e, status=status), receipts)
    assert one.availability.share == pytest.approx(0.25, abs=0.01)
    assert one.second_half.components['r_x'].error.count == 0
    assert np.isnan(one.second_half.rms('horizontal'))
    row = compare({name: (truth, dataclasses.replace(estimate, r_e=r_e, status=status), receipts)})
    shown = dict(zip([c.key for c in row.table().columns], row.table().cells()[0], strict=True))
    assert shown['horizontal_second_half'] == '–'
    assert shown['available_percent'].startswith('25')


def test_everything_is_json():
    text = json.dumps(SCORES.to_dict(), allow_nan=False)
    assert json.loads(text)['modified_akf']['verdicts']['total'] == len(
        last_revisions(RUNS['modified_akf'][2])
    )


def test_all_tables_in_all_dresses():
    for table in SCORES.tables():
        markdown, csv = table.to_markdown(), table.to_csv()
        for name in RUNS:
            assert name in markdown
            assert name in csv
        assert len(csv.splitlines()) == len(table.rows) + 1
        assert len(table.to_rich().columns) == len(table.columns)
        json.dumps(table.to_dict(), allow_nan=False)


def test_verdicts_add_up_in_the_table():
    table = SCORES.verdict_table()
    for row in table.rows:
        named = sum(row[c.key] for c in table.columns if c.key.isupper())
        assert named == row['total']


def test_unknown_statistic_and_nothing_to_compare():
    with pytest.raises(ValueError, match="statistic='mode'"):
        SCORES.error_table(statistic='mode')
    with pytest.raises(ValueError, match='nothing to compare'):
        compare({})


def test_estimates_at_the_truth_have_no_error():
    truth, estimate, receipts = RUNS['modified_akf']
    perfect = dataclasses.replace(estimate, r_e=truth.r_e, v_G=truth.v_G, C_b_G=truth.C_b_G)
    whole = score('p', truth, perfect, receipts).whole
    for key in ('r_x', 'r_y', 'r_z', 'v_x', 'v_y', 'v_z'):
        assert whole.rms(key) == 0.0
    assert_allclose([whole.rms(f'phi_{a}') for a in 'xyz'], 0.0, atol=1e-9)


# -- NIS of DVL and depth


def with_local(estimate, statistics):
    return dataclasses.replace(estimate, local_statistics=statistics)


def test_nis_of_local_sensors_is_of_the_window_and_of_those_used():
    truth, estimate, receipts = RUNS['modified_akf']
    n = len(estimate)
    statistics = np.zeros((n, 2, 3))
    statistics[:, 0] = [2.0, 1.0, 12.0]  # two pings, together 12 of 6 degrees of freedom
    statistics[: n // 2, 1] = [1.0, 0.0, 50.0]  # the first half does not count in the second
    statistics[n // 2 :, 1] = [1.0, 0.0, 0.5]
    one = score('x', truth, with_local(estimate, statistics), receipts)
    late = one.second_half
    rows = int(late.window.mask(estimate.stamp_ns).sum())
    dvl, depth = late.nis_local['dvl'], late.nis_local['depth']
    assert (dvl.count, late.gated_local['dvl']) == (2 * rows, rows)
    assert_allclose([dvl.mean, dvl.mean_per_dof], [6.0, 2.0])
    assert_allclose(depth.mean_per_dof, 0.5, atol=1e-12)
    assert one.whole.nis_local['depth'].mean_per_dof > 20.0
    low, high = chi2.ppf([0.025, 0.975], 6 * rows) / (6 * rows)
    assert_allclose([dvl.band_low, dvl.band_high], [low, high], rtol=1e-9)
    assert dvl.judgement == 'optimistic'
    assert depth.judgement == 'pessimistic'
    # 12 lies inside the 95 % band of six degrees of freedom, 0.5 inside that of one.
    assert dvl.share_inside == depth.share_inside == 1.0
    said = json.loads(json.dumps(one.to_dict()))['windows']['second_half']['nis_local']
    assert said['dvl']['gated'] == rows
    assert said['depth']['judgement'] == 'pessimistic'


def test_sums_of_an_honest_filter_are_consistent_and_half_the_noise_is_found():
    rng = np.random.default_rng(11)
    counts = rng.integers(0, 4, 2000).astype(float)
    sums = np.array([rng.chisquare(3 * n) if n else 0.0 for n in counts])
    honest = consistency_of_sums(sums, counts, 3)
    assert honest.judgement == 'consistent'
    assert honest.count == counts.sum()
    assert 0.93 < honest.share_inside < 0.97
    assert consistency_of_sums(4.0 * sums, counts, 3).judgement == 'optimistic'


def test_sums_that_are_not_finite_are_left_out_and_none_is_unknown():
    some = consistency_of_sums([np.nan, 3.0], [2.0, 1.0], 3)
    assert (some.count, some.missing, some.mean) == (1, 2, 3.0)
    none = consistency_of_sums([0.0, 0.0], [0.0, 0.0], 1)
    assert (none.count, none.judgement) == (0, 'unknown')


def test_the_table_has_a_row_per_source_that_was_used():
    truth, estimate, receipts = RUNS['modified_akf']
    silent = with_local(estimate, np.zeros((len(estimate), 2, 3)))
    gated = np.zeros((len(estimate), 2, 3))
    gated[:, 1] = [1.0, 1.0, 1.0]
    runs = {'none': silent, 'both': estimate, 'gated': with_local(estimate, gated)}
    comparison = compare({k: (truth, e, receipts) for k, e in runs.items()})
    rows = [(r['configuration'], r['what']) for r in comparison.consistency_table().rows]
    assert ('both', 'NIS of DVL') in rows
    assert ('both', 'NIS of depth') in rows
    half = int(comparison.scores['gated'].second_half.window.mask(estimate.stamp_ns).sum())
    assert ('gated', f'NIS of depth, {half} gated besides') in rows
    assert not any(name == 'none' and 'DVL' in what for name, what in rows)
