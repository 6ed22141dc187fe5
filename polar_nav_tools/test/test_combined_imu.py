"""GTSAM's CombinedImuFactor beside our smoother: what it leaves out is all that differs."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from polar_nav_core import attitude
from polar_nav_core.grid import ecef_to_grid
from polar_nav_tools.cli import main
from polar_nav_tools.experiments.combined_imu import experiment
from polar_nav_tools.experiments.combined_imu.graph import MISSING, Plane, Solved
from polar_nav_tools.experiments.request import Request, Size
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.world import make_world
from polar_nav_tools.experiments.world_spec import WorldSpec


def true_solution(world):
    """Truth at the depths, in the plane of the start."""
    stamps = world.inputs.depth_stamps_ns
    truth = world.truth.state(stamps)
    plane = Plane(world.truth.state(int(world.inputs.imu_stamps_ns[0])).r_e)
    C_G_n = plane.C_e_n @ np.swapaxes(ecef_to_grid(truth.r_e), 1, 2)
    zero = np.zeros((len(stamps), 3))
    v_n = np.einsum('nij,nj->ni', C_G_n, truth.v_G)
    r_n = plane.place(truth.r_e)
    return Solved(plane, stamps, C_G_n @ truth.C_b_G, v_n, r_n, zero, zero, zero)


def flat_earth(plane, omega_b, f_b, dt, C_b_n, v_n):
    """Dead reckoning as the factor does it: nothing turns but the vehicle, gravity is constant."""
    r_n, C_b_n, v_n = np.zeros(3), C_b_n.copy(), v_n.copy()
    turns = attitude.exp(omega_b * dt)
    for turn, f in zip(turns, f_b, strict=True):
        a_n = C_b_n @ f - [0.0, 0.0, plane.gravity]
        r_n = r_n + v_n * dt + 0.5 * a_n * dt**2
        v_n = v_n + a_n * dt
        C_b_n = C_b_n @ turn
    return r_n, v_n, C_b_n


def test_corrected_samples_are_those_of_an_earth_that_does_not_turn():
    """Without noise: the truth of a minute, which the samples as they are miss by metres."""
    spec = WorldSpec(
        **{**experiment._COMMON, 'duration_s': 60.0, 'latitude_deg': 45.0}
        | {'noisy': False, 'constants': 'none', 'initial_errors': 'none', 'depth_rate_hz': 2.0}
    )
    world = make_world(spec, FixSpec(), 1)
    true = true_solution(world)
    plane = true.plane
    start = world.truth.state(int(world.inputs.imu_stamps_ns[0]))
    C_G_n = plane.C_e_n @ ecef_to_grid(start.r_e).T
    missed = []
    for about in (None, true):
        omega_b, f_b = plane.samples(world, about)
        r_n, v_n, C_b_n = flat_earth(
            plane, omega_b[1:], f_b[1:], 0.01, C_G_n @ start.C_b_G, C_G_n @ start.v_G
        )
        turn = attitude.log(C_b_n @ true.C_b_n[-1].T)
        missed.append([np.linalg.norm(x) for x in (r_n - true.r_n[-1], v_n - true.v_n[-1], turn)])
    (r, v, phi), (r_left, v_left, phi_left) = missed
    assert phi == pytest.approx(60.0 * 7.292e-5, rel=0.02)
    assert r > 10.0
    assert r_left < 0.0008 * r
    assert v_left < 0.0005 * v
    assert phi_left < 0.0005 * phi


def test_without_gtsam_it_says_so_before_anything_is_run(monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(sys.modules, 'gtsam', None)
    arguments = ['experiment', 'run', 'combined-imu', '--out', str(tmp_path / 'x')]
    monkeypatch.setattr(sys, 'argv', ['polar', *arguments])
    assert main() == 2
    said = capsys.readouterr()
    assert (said.out, said.err.strip()) == ('', f'polar: {MISSING}')
    assert not (tmp_path / 'x').exists()


def test_rows_are_chosen_by_name():
    plan = experiment.plan(Request(rows='no_*', first_seed=7), Size(120.0, 2), ())
    assert [(job.row, job.seed) for job in plan] == [('no_dvl', 7), ('no_dvl', 8)]


@pytest.mark.slow
def test_what_the_factor_leaves_out_is_all_that_differs():
    """Two seeds: the Earth's rate spoils the heading; told of it, or corrected, it is ours."""
    pytest.importorskip('gtsam', reason=MISSING)
    jobs = experiment.plan(Request(rows='lawnmower'), Size(120.0, 2), ())
    results = [experiment.run_job(job) for job in jobs]
    assert len(results) == 2
    for result in results:
        m = result.metrics
        assert m['corrected.apart'] < 0.02 * m['smoother.sigma']
        for key in ('heading', 'velocity', 'gyro_bias', 'sigma'):
            assert m[f'corrected.{key}'] == pytest.approx(m[f'smoother.{key}'], rel=0.1), key
        assert m['coriolis.apart'] < 0.05 * m['smoother.sigma']
        assert m['neglected.apart'] > 5.0 * m['coriolis.apart']
        assert m['neglected.gyro_bias'] > 2.0
    (table,) = experiment.tables(results, Size(120.0, 2), Request())
    assert [row['way'] for row in table.rows] == list(experiment.WAYS)
    one = replace(results[0], metrics={})
    assert experiment.tables([one], Size(120.0, 1), Request())[0].rows == ()
