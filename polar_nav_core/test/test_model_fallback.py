"""DVL lost for five minutes inside a polar mission: what the vehicle's model is worth, five seeds.

`pytest -s` prints the table of docs/model-aiding.md.
"""

import sys
from dataclasses import dataclass

import numpy as np
import pytest
from model_twin import LOW_COST, PAPER, Voyage
from scipy.stats import chi2

from polar_nav_core.engine import run as engine_run

# Of the simulated vehicle, in the slow ring: polar_nav_tools/test/test_experiments_model_aiding.
pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]

SEEDS = range(5)
GAP = (600.0, 900.0)
CONSTANT = {'current_walk': 1e-6}
"""For a current that is known to be about constant."""


@pytest.fixture(scope='module')
def voyage():
    return Voyage(940.0)


@pytest.fixture(scope='module')
def slow_voyage():
    return Voyage(940.0, slow_current=True)


@dataclass
class Measured:
    """Of five seeds pooled: RMS before and in the gap [m], errors and NEES (2 dof) at its end."""

    before: float
    gap: float
    ends: np.ndarray
    nees_end: float
    nees_gap: float
    models: list
    tracks: list

    @property
    def end(self):
        return float(np.sqrt(np.mean(self.ends**2)))

    def is_honest(self):
        lo, hi = chi2.ppf([0.0005, 0.9995], 2 * len(self.ends))
        return lo < self.nees_end < hi


def measure(voyage, name, imu, *, fixes, **changes):
    squares, nees, models, tracks = [], [], [], []
    for seed in SEEDS:
        rng = np.random.default_rng(1000 + seed)
        params = voyage.params(imu, rng, **changes)
        inputs = voyage.inputs(rng, imu, gap=GAP, fix_gap=None if fixes else GAP)
        result = engine_run.run(params, inputs)
        assert not result.divergence
        error, P, t = voyage.errors(result.track)
        squares.append(np.sum(error**2, axis=1))
        nees.append(np.einsum('ti,tij,tj->t', error, np.linalg.inv(P), error))
        models.append(result.track.model)
        tracks.append(result.track)
    squares, nees = np.array(squares), np.array(nees)
    inside, end = (t >= GAP[0]) & (t < GAP[1]), np.searchsorted(t, GAP[1] - 0.1)
    m = Measured(
        float(np.sqrt(squares[:, (t >= 300.0) & (t < GAP[0])].mean())),
        float(np.sqrt(squares[:, inside].mean())),
        np.sqrt(squares[:, end]),
        float(nees[:, end].sum()),
        float(nees[:, inside].mean()),
        models,
        tracks,
    )
    sys.stdout.write(
        f'{name:44s} before {m.before:.2f} m, gap {m.gap:.2f} m ({m.gap / m.before:.2f}), at its'
        f' end {m.end:.2f} m, worst {m.ends.max():.2f} m; NEES {m.nees_end:.1f},'
        f' {m.nees_gap:.2f}\n'
    )
    return m


def test_polar_sensors_with_fixes(voyage):
    m = measure(voyage, 'polar IMU, fixes', PAPER, fixes=True, model_aiding=True)
    assert m.gap <= 1.5 * m.before
    assert m.is_honest()


def test_polar_sensors_without_anything(voyage):
    m = measure(voyage, 'polar IMU, no fix', PAPER, fixes=False, model_aiding=True, **CONSTANT)
    assert m.ends.max() <= 3.0
    assert m.is_honest()


def test_a_thousandfold_worse_imu_with_fixes(voyage):
    without = measure(voyage, 'low-cost IMU, fixes, no model', LOW_COST, fixes=True)
    m = measure(voyage, 'low-cost IMU, fixes', LOW_COST, fixes=True, model_aiding=True, **CONSTANT)
    assert m.gap <= 1.5 * m.before
    assert m.gap < 0.6 * without.gap
    assert m.is_honest()


def test_a_thousandfold_worse_imu_without_anything(voyage):
    without = measure(voyage, 'low-cost IMU, no fix, no model', LOW_COST, fixes=False)
    m = measure(
        voyage, 'low-cost IMU, no fix', LOW_COST, fixes=False, model_aiding=True, **CONSTANT
    )
    assert m.end <= 3.0
    assert without.end > 30.0 * m.end
    assert m.is_honest()


def test_what_is_learnt_of_drag_and_current(voyage):
    """From 15, 90 N s/m to the true drag in the range of speeds that there was."""
    m = measure(voyage, 'low-cost IMU, fixes', LOW_COST, fixes=True, model_aiding=True, **CONSTANT)
    k = 8990
    for model in m.models:
        current, sigma = model[k, 12:14], np.sqrt(model[k, [15, 19]])
        assert np.all(np.abs(current - (0.4, 0.25)) < 4.0 * sigma)
        assert np.all(sigma < 0.02)
        for u in (0.9, 1.1, 1.3):
            drag = (model[k, 24] + model[k, 26] * u) * u
            assert drag == pytest.approx((25.0 + 19.0 * u) * u, rel=0.05)


def test_a_slowly_changing_current_needs_its_walk(slow_voyage):
    """30 % and 0.6 rad in 30 minutes: honest with the default q_c, not with a hundredth of it."""
    m = measure(
        slow_voyage, 'low-cost IMU, no fix, current changes', LOW_COST, fixes=False,
        model_aiding=True,
    )  # fmt: skip
    stiff = measure(
        slow_voyage, 'the same, current_walk 1e-7', LOW_COST, fixes=False, model_aiding=True,
        current_walk=1e-7,
    )  # fmt: skip
    assert m.is_honest()
    assert not stiff.is_honest()
    with_fixes = measure(
        slow_voyage, 'low-cost IMU, fixes, current changes', LOW_COST, fixes=True,
        model_aiding=True,
    )  # fmt: skip
    assert with_fixes.is_honest()
    assert with_fixes.gap < 1.0


def test_the_covariance_goes_on_without_a_jump(voyage):
    """At the loss of lock no variance changes by more than a step's share."""
    m = measure(
        voyage, 'low-cost IMU, no fix', LOW_COST, fixes=False, model_aiding=True, **CONSTANT
    )
    for track in m.tracks:
        rows = slice(6005, 6400)  # from half a second after the last ping on
        velocity = np.trace(track.P[rows, 3:6, 3:6], axis1=1, axis2=2)
        steps = np.diff(velocity) / velocity[:-1]
        assert np.abs(steps).max() < 0.1
        locked = track.model[:, -1] > 0.5
        assert locked[:6000].all()
        assert not locked[6020:8990].any()
        assert locked[9010:].all()
