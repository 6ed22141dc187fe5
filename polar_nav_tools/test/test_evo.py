"""Absolute and relative errors are those of evo, which others compute with, to 1e-6 m.

evo reads the TUM files that `./polar export` writes, so that those are tested, too. Without evo
its definitions, in matrices and pair by pair, stand in for it.
"""

import dataclasses

import numpy as np
import pytest

from polar_nav_core.grid import ecef_to_grid
from polar_nav_tools.export.formats import trajectory, write_trajectory
from polar_nav_tools.report.example import example_input
from polar_nav_tools.scoring import absolute_errors, align, relative_errors

RUNS = example_input(minutes=2.0).runs
INTERVAL_S = 10.0
AGREE_M = 1e-6


@pytest.fixture(params=RUNS)
def run(request):
    truth, estimate, _ = RUNS[request.param]
    return truth, estimate


@pytest.fixture
def pairs(run):
    return align(*run)


def steps_of(pairs):
    """Samples in one interval, which evo counts by."""
    step_ns = np.diff(pairs.truth.stamp_ns)
    assert (step_ns == step_ns[0]).all()
    return round(INTERVAL_S * 1e9 / step_ns[0])


def pose(r_e, C_b_G):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = ecef_to_grid(r_e).T @ C_b_G, r_e
    return T


def test_definitions(pairs):
    Q = [pose(r, C) for r, C in zip(pairs.truth.r_e, pairs.truth.C_b_G, strict=True)]
    P = [pose(r, C) for r, C in zip(pairs.estimate.r_e, pairs.estimate.C_b_G, strict=True)]
    absolute = [np.linalg.norm(p[:3, 3] - q[:3, 3]) for p, q in zip(P, Q, strict=True)]
    np.testing.assert_allclose(absolute_errors(pairs), absolute, atol=AGREE_M, rtol=0)
    n = steps_of(pairs)
    relative = []
    for i in range(len(Q) - n):
        E = np.linalg.solve(np.linalg.solve(Q[i], Q[i + n]), np.linalg.solve(P[i], P[i + n]))
        relative.append(np.linalg.norm(E[:3, 3]))
    found = relative_errors(pairs, INTERVAL_S)
    assert len(found) > 1000 / n
    np.testing.assert_allclose(found, relative, atol=AGREE_M, rtol=0)


@pytest.mark.parametrize('place', [(0.0, 0.0, 0.0), (0.0, 6378137.0, 0.0), (1e200, 1.0, 1.0)])
def test_an_estimate_where_there_are_no_grid_axes(run, place):
    """Damaged messages can be anywhere; the pairs that need those axes have no relative error."""
    truth, estimate = run
    whole = align(truth, estimate)
    i, n = 200, steps_of(whole)
    at = np.flatnonzero(estimate.stamp_ns == whole.truth.stamp_ns[i])[0]
    r_e = estimate.r_e.copy()
    r_e[at] = place
    found = relative_errors(align(truth, dataclasses.replace(estimate, r_e=r_e)), INTERVAL_S)
    others = np.delete(np.arange(len(found)), [i, i - n])
    np.testing.assert_array_equal(found[others], relative_errors(whole, INTERVAL_S)[others])
    assert not found[i] < 1e6
    assert not found[i - n] < 1e6


@pytest.mark.parametrize('frame', ['ecef', 'grid', 'enu'])
def test_evo(run, pairs, frame, tmp_path):
    pytest.importorskip('evo')
    from evo.core import metrics, sync
    from evo.tools import file_interface

    truth, estimate = (s.rows(np.isin(s.stamp_ns, pairs.truth.stamp_ns)) for s in run)
    tracks = []
    for name, one in (('truth', truth), ('estimate', estimate)):
        path = tmp_path / f'{name}.tum'
        write_trajectory(path, trajectory(one), frame=frame, origin_r_e=truth.r_e[0])
        tracks.append(file_interface.read_tum_trajectory_file(path))
    reference, other = tracks
    reference, other = sync.associate_trajectories(reference, other, max_diff=1e-3)
    assert reference.num_poses == len(pairs.truth.stamp_ns)

    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, other))
    ours = absolute_errors(pairs)
    np.testing.assert_allclose(ape.error, ours, atol=AGREE_M, rtol=0)
    assert ape.get_statistic(metrics.StatisticsType.rmse) == pytest.approx(
        np.sqrt(np.mean(ours**2)), abs=AGREE_M
    )
    rpe = metrics.RPE(
        metrics.PoseRelation.translation_part,
        delta=steps_of(pairs),
        delta_unit=metrics.Unit.frames,
        all_pairs=True,
    )
    rpe.process_data((reference, other))
    np.testing.assert_allclose(rpe.error, relative_errors(pairs, INTERVAL_S), atol=AGREE_M, rtol=0)
    assert np.max(ours) > 0.1  # there is something to agree on
