"""Current, drag and heading bias against their truth, in scores, tables and the report."""

import dataclasses
import math

import numpy as np
import pytest

from polar_nav_core.grid import ecef_to_grid
from polar_nav_tools.report import FixPositions, StationRanges
from polar_nav_tools.report.example import example_truth
from polar_nav_tools.report.example_model import example_with_model
from polar_nav_tools.report.figures import Clock, current_arrow
from polar_nav_tools.report.write import render
from polar_nav_tools.scoring import compare
from polar_nav_tools.scoring.model import (
    CURRENT_X,
    CURRENT_Y,
    HEADING,
    LINEAR,
    QUADRATIC,
    TOTAL,
    model_errors,
    score_model,
    true_current,
)

DATA = example_with_model(minutes=4.0)
NAME = 'modified_akf'
TRUTH = DATA.runs[NAME][0]
RUN = DATA.models[NAME]


def off_by(run, **errors):
    """The same run with estimates that are off from the truth by so much."""
    changed = {name: getattr(run.truth, name) + error for name, error in errors.items()}
    return dataclasses.replace(run, estimated=dataclasses.replace(run.estimated, **changed))


def test_errors_are_estimate_minus_truth_in_the_units_of_people():
    run = off_by(
        RUN,
        current_G=np.array([0.01, -0.02, 0.0]),
        drag_linear=2.0,
        drag_quadratic=-1.0,
        heading_bias=math.radians(0.5),
    )
    late = score_model(run, TRUTH).windows['second_half'].quantities
    assert late[CURRENT_X].error.rms == pytest.approx(0.01)
    assert late[CURRENT_Y].error.mean == pytest.approx(-0.02)
    assert late[CURRENT_X].truth == pytest.approx(0.4)
    assert late[LINEAR].error.mean == pytest.approx(2.0)
    assert late[QUADRATIC].error.mean == pytest.approx(-1.0)
    # 2 v - v^2 at the mean speed of 1.1 m/s
    assert late[TOTAL].error.mean == pytest.approx(2.0 * 1.1 - 1.1**2)
    assert late[TOTAL].truth == pytest.approx(25.0 * 1.1 + 19.0 * 1.1**2)
    assert late[HEADING].error.mean == pytest.approx(0.5)
    assert late[HEADING].unit == '°'


def test_opposite_drag_errors_leave_little_of_the_total_and_of_its_sigma():
    found = model_errors(RUN.estimated, RUN.truth, TRUTH)
    a, b = RUN.estimated.drag_linear_sigma, RUN.estimated.drag_quadratic_sigma
    both = np.hypot(1.1 * a, 1.1**2 * b)
    assert (found[TOTAL].sigma < 0.2 * both).all()
    direct = np.array([1.1, 1.1**2])
    P = np.array([[a[-1] ** 2, -0.99 * a[-1] * b[-1]], [-0.99 * a[-1] * b[-1], b[-1] ** 2]])
    assert found[TOTAL].sigma[-1] == pytest.approx(math.sqrt(direct @ P @ direct))


def test_nees_of_errors_of_one_sigma_each_is_one_per_degree_of_freedom():
    e = RUN.estimated
    n = len(e)
    uncorrelated = dataclasses.replace(
        e,
        P_current_G=np.tile(np.diag([1e-4, 4e-4, 0.0]), (n, 1, 1)),
        drag_correlation=np.zeros(n),
        current_G=RUN.truth.current_G + np.array([0.01, 0.02, 0.0]),
        drag_linear=RUN.truth.drag_linear + e.drag_linear_sigma,
        drag_quadratic=RUN.truth.drag_quadratic - e.drag_quadratic_sigma,
        heading_bias=RUN.truth.heading_bias - e.heading_bias_sigma,
    )
    nees = score_model(dataclasses.replace(RUN, estimated=uncorrelated), TRUTH)
    for one in nees.windows['whole'].nees.values():
        assert one.mean_per_dof == pytest.approx(1.0)


def test_the_current_is_known_between_the_samples_of_the_truth():
    truth = dataclasses.replace(TRUTH, current_G=np.outer(np.arange(len(TRUTH)), [0.1, 0.2, 0.0]))
    stamp_ns = truth.stamp_ns[3] + np.array([0, 40_000_000])
    np.testing.assert_allclose(
        true_current(stamp_ns, truth), [[0.3, 0.6, 0.0], [0.34, 0.68, 0.0]], atol=1e-12
    )


def test_without_a_true_model_the_current_is_still_scored():
    score = score_model(dataclasses.replace(RUN, truth=None), TRUTH)
    late = score.windows['second_half']
    assert math.isfinite(late.quantities[CURRENT_X].error.rms)
    assert math.isnan(late.quantities[LINEAR].error.rms)
    assert late.nees['drag d1x and d2x, 2 dof'].count == 0


def test_tables_have_model_and_identifications_only_where_there_is_a_model():
    with_model = compare(DATA.runs, models=DATA.models)
    titles = [t.title for t in with_model.tables()]
    assert titles[1:3] == ['Water and drag, second half', 'Identifications']
    assert 'Water and drag, second half' not in [t.title for t in compare(DATA.runs).tables()]
    assert 'model' in with_model.to_dict()[NAME]
    found = {r['what'] for r in with_model.consistency_table().rows if r['configuration'] == NAME}
    assert {'NEES current, 2 dof', 'NEES drag d1x and d2x, 2 dof'} <= found
    (rows,) = [t.rows for t in with_model.tables() if t.title == 'Identifications']
    assert [r['at'] for r in rows[:2]] == pytest.approx([72.0, 144.0], abs=1.5)


def test_the_current_is_drawn_as_an_arrow_with_its_ellipse_and_said_in_words():
    clock = Clock(int(TRUTH.stamp_ns[0]), int(TRUTH.stamp_ns[-1]))
    picture = current_arrow(NAME, 1, score_model(RUN, TRUTH), TRUTH, clock)
    estimate = RUN.estimated.current_G[-1]
    assert f'at the end {estimate[0]:.3f} to grid east' in picture.alt
    assert 'true 0.400 to grid east and 0.250 to grid north m/s' in picture.alt
    assert picture.svg.count('<path') > 20


@pytest.mark.slow
def test_a_report_with_a_model_has_a_section_for_it():
    page = render(DATA)
    assert 'id="water"' in page
    for run in ('conventional_akf', 'modified_akf'):
        assert f'Parameters estimated by {run} at the end of the run: drag d1x' in page
    assert 'id="water"' not in render(dataclasses.replace(DATA, models={}))


def test_ranges_and_bearings_of_a_station_put_the_follower_on_the_map():
    truth = example_truth('auv', 89.5, 60.0, 1.0)
    station = example_truth('station', 89.5, 60.0, 1.0, offset=(500.0, -200.0))
    station = station.rows(np.zeros(2, dtype=np.intp))
    origin_e = station.r_e[0]
    C_e_s = ecef_to_grid(origin_e)
    rows = np.array([0, 100, 300])
    true_s = (truth.r_e[rows] - origin_e) @ C_e_s.T
    moved = np.array([[0.0, 0.0, 0.0], [5.0, 1.0, 2.0], [9.0, 2.0, -1.0]])
    away = true_s - moved
    heading = np.array([0.3, 0.3, 0.4])
    fixes = FixPositions.from_ranges(
        source='station',
        sequence=np.arange(3),
        stamp_ns=truth.stamp_ns[rows],
        ranges=StationRanges(
            station=moved,
            heading=heading,
            range=np.linalg.norm(away, axis=1),
            bearing=np.arctan2(away[:, 1], away[:, 0]) - heading,
        ),
        station=station,
        truth=truth,
    )
    np.testing.assert_allclose(fixes.r_e, truth.r_e[rows], atol=1e-6)
