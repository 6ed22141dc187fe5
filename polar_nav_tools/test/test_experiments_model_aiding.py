"""DVL lost for five minutes inside a polar mission of a vehicle with six degrees of freedom.

Truth, IMU, DVL and fixes are the simulation's; navigation has the DVL-less paper's wrong model.
The same with a low-cost IMU, and what is learnt: polar_nav_core/test/test_model_fallback.py.
`pytest -s` prints the rows of docs/model-aiding.md.
"""

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from polar_nav_core.engine import run as engine_run
from polar_nav_tools.experiments.errors import track_errors
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.world import make_world
from polar_nav_tools.experiments.world_spec import WorldSpec

pytestmark = pytest.mark.slow

SEEDS = range(5)
GAP_S = (600.0, 900.0)
FIXES = FixSpec(period_s=2.5, first_s=1.0, delay_s=2.0)
MISSION = """
duration_s: 920.0
path: {kind: straight, latitude_deg: 89.9, longitude_deg: 60.0}
vehicles:
  leader: {role: leader, depth_m: 5.0, fixed: true}
  auv: {role: follower, depth_m: 20.0, dynamics: {}}
"""


@pytest.fixture(scope='module')
def mission(tmp_path_factory):
    path = tmp_path_factory.mktemp('mission') / 'polar.yaml'
    path.write_text(MISSION)
    return str(path)


def spec_of(mission, imu):
    return WorldSpec(
        duration_s=920.0, mission=mission, imu=imu, imu_rate_hz=100.0, constants='prior',
        dvl_rate_hz=5.0,
    )  # fmt: skip


def with_gap(world, *, fixes):
    """Inputs with thrust, and without the DVL in the gap; without fixes either, if so."""
    x, start_ns = world.inputs, world.truth.start_ns
    first, last = (start_ns + round(t * 1e9) for t in GAP_S)
    stamps = start_ns + 10**8 * np.arange(9200, dtype=np.int64)
    force_b = np.array([world.truth.thrust(int(s))[:3] for s in stamps])
    return replace(
        x,
        dvl_valid=(x.dvl_stamps_ns < first) | (x.dvl_stamps_ns >= last),
        fixes=tuple(f for f in x.fixes if fixes or not first <= f.validity_ns < last),
        control_stamps_ns=stamps,
        control_force_b=force_b,
        control_torque_b=np.zeros((len(stamps), 3)),
    )


def measure(spec, name, *, fixes, **changes):
    """RMS before and in the gap, errors at its end [m], NEES (3 dof a run) there."""
    squares, ends, nees = [], [], 0.0
    for seed in SEEDS:
        world = make_world(spec, FIXES, seed)
        params = world.params(configuration='default', **changes)
        result = engine_run.run(params, with_gap(world, fixes=fixes))
        assert not result.divergence
        e = track_errors(world, result.track)
        end = np.searchsorted(e.time_s, GAP_S[1] - 0.1)
        squares.append(e.horizontal**2)
        ends.append(e.horizontal[end])
        nees += e.nees_position()[end]
    squares, t = np.array(squares), e.time_s
    before = np.sqrt(squares[:, (t >= 300.0) & (t < GAP_S[0])].mean())
    gap = np.sqrt(squares[:, (t >= GAP_S[0]) & (t < GAP_S[1])].mean())
    sys.stdout.write(
        f'{name:28s} before {before:.2f} m, gap {gap:.2f} m ({gap / before:.2f}), at its end'
        f' {np.sqrt(np.mean(np.square(ends))):.2f} m, worst {max(ends):.2f} m; NEES {nees:.1f}\n'
    )
    lo, hi = chi2.ppf([0.0005, 0.9995], 3 * len(SEEDS))
    assert lo < nees < hi
    return before, gap, ends


def test_the_polar_mission_of_the_paper(mission):
    spec = spec_of(mission, 'paper_6_1')
    before, gap, _ = measure(spec, '6.1, fixes', fixes=True, model_aiding=True)
    assert gap <= 1.5 * before
    _, _, ends = measure(spec, '6.1, no fix', fixes=False, model_aiding=True)
    assert max(ends) <= 3.0


def test_the_accelerometer_that_the_paper_measured(mission):
    """Velocity random walk of 0.5 mm/s/sqrt(s): no gap of 1.5 times, see docs/model-aiding.md."""
    spec = spec_of(mission, 'paper_6_2')
    aided = {'model_aiding': True, 'current_walk': 1e-6}
    _, without, _ = measure(spec, '6.2, fixes, no model', fixes=True)
    _, gap, _ = measure(spec, '6.2, fixes', fixes=True, **aided)
    assert gap < 0.95 * without
    _, _, drifted = measure(spec, '6.2, no fix, no model', fixes=False)
    _, _, ends = measure(spec, '6.2, no fix', fixes=False, **aided)
    assert np.sqrt(np.mean(np.square(ends))) <= 3.0
    assert np.mean(np.square(drifted)) > 9.0 * np.mean(np.square(ends))


@pytest.mark.xfail(strict=True, reason='1.66 on five seeds: a known miss, docs/model-aiding.md')
def test_a_gap_of_half_as_much_again_with_that_accelerometer(mission):
    spec = spec_of(mission, 'paper_6_2')
    before, gap, _ = measure(spec, '6.2, fixes', fixes=True, model_aiding=True, current_walk=1e-6)
    assert gap <= 1.5 * before
