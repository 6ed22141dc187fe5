"""Signature of a changing current in station mode: chi-square without one, found where it is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import station_twin as twin

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.health.conditions import Culprit, Level
from polar_nav_core.engine.health.slow import sizes_of
from polar_nav_core.engine.health.station import _size
from polar_nav_core.engine.station import arrays
from polar_nav_core.kernels.station import signatures
from polar_nav_core.kernels.station import state as ss
from polar_nav_core.kernels.station.common import transform
from polar_nav_core.kernels.station.step import slopes

SECONDS, FIXES, RUNS = 5, 40, 300
"""Between two fixes; fixes of a run, from the first one's hypotheses on; runs."""
NS = 1_000_000_000


class Linear:
    """Innovations of a filter whose fixes measure x and y, and what each fault adds."""

    def __init__(self):
        self.settings = arrays.make_settings(twin.params(current_method='single'))
        self.work = w = arrays.make_work(1)
        w.C_A[:], w.up[:] = np.eye(3), [0.0, 0.0, 1.0]
        self.at = np.zeros((1, ss.N))
        self.at[0, [0, ss.DRAG]] = 1.2, 4.0
        second = np.eye(ss.N)
        transform(second, 1.0, *slopes(self.at[0], self.settings, w), w)
        Phi = np.linalg.matrix_power(second, SECONDS)
        rate = np.zeros((ss.N, ss.KINDS))  # what each fault does in a second
        rate[ss.CURRENT, ss.GROWS] = rate[ss.CURRENT + 1, ss.GROWS + 1] = -1.0
        rate[ss.HEADING, ss.TURNS] = -1.0
        drive = np.zeros((ss.N, ss.KINDS))
        for _ in range(SECONDS):
            drive = second @ drive + rate
        self.H, R = np.zeros((2, ss.N)), np.diag([4.0, 9.0])
        self.H[:, ss.POSITION : ss.POSITION + 2] = [[1.0, 0.2], [0.0, 1.0]]
        P = np.diag([0.01] * 3 + [1.0] * 3 + [0.01] * 2 + [1e-4] * 4)
        Q = np.diag([1e-4] * 3 + [1e-2] * 3 + [1e-5] * 2 + [0.0] * 4)
        self.steps, u = [], np.zeros((ss.N, ss.KINDS))
        u[ss.CURRENT, ss.BEGINS] = u[ss.CURRENT + 1, ss.BEGINS + 1] = u[ss.DRAG, ss.DRAGS] = -1.0
        for k in range(FIXES):
            if k > 0:
                P, u = Phi @ P @ Phi.T + Q, Phi @ u + drive
            S = self.H @ P @ self.H.T + R
            g = -self.H @ u
            g[0, ss.RANGES] += SECONDS * k
            g[1, ss.BEARINGS] += SECONDS * k
            self.steps.append((S, self.H @ P, g))
            u = u + P @ self.H.T @ np.linalg.solve(S, g)
            P = P - P @ self.H.T @ np.linalg.solve(S, self.H @ P)
            P = 0.5 * (P + P.T)

    def information(self, kind):
        """J of a fault of unit size from the first fix on."""
        return sum(g[:, kind] @ np.linalg.solve(S, g[:, kind]) for S, _, g in self.steps)

    def run(self, rng, size=0.0, kind=ss.GROWS):
        """Bank after a run with a fault of ``size`` from the first fix on."""
        b, w = arrays.make_bank(1), self.work
        b.counters[ss.SIGNATURES_NS] = NS
        now = NS
        for S, HP, g in self.steps:
            z = np.linalg.cholesky(S) @ rng.standard_normal(2) + size * g[:, kind]
            outcome = np.zeros(ss.OUTCOME)
            outcome[[ss.DECIDED, ss.Z0, ss.Z1, ss.INFLATION]] = [ss.FUSED, *z, 1.0]
            outcome[[ss.S00, ss.S01, ss.S11]] = w.S[0] = S[0, 0], S[0, 1], S[1, 1]
            w.z[0], w.wide[0] = z, w.S[0]
            w.H[:], w.PHt[0], w.inflation[0] = self.H, HP, 1.0
            signatures.note_signatures(b, self.settings, w, outcome, now)
            for _ in range(SECONDS):
                now += NS
                signatures.advance_signatures(b, self.settings, w, self.at, now)
        return b


@cache
def linear():
    return Linear()


def test_the_statistic_is_chi_square_where_nothing_changes():
    rng = np.random.default_rng(7)
    found = np.array([linear().run(rng).signatures[-1, ss.STATISTIC, 0] for _ in range(RUNS)])
    assert found.mean() == pytest.approx(2.0, abs=4.0 * 2.0 / np.sqrt(RUNS))
    beyond = np.mean(found > 5.991)  # the 95 % quantile of chi-square (2)
    assert beyond == pytest.approx(0.05, abs=4.0 * np.sqrt(0.05 * 0.95 / RUNS))


def test_a_growing_current_is_found_with_its_size():
    rng, size = np.random.default_rng(8), 0.003
    J = size**2 * linear().information(ss.GROWS)
    assert J > 25.0
    banks = [linear().run(rng, size).signatures[-1, :, :2] for _ in range(RUNS)]
    statistics = np.array([u[ss.STATISTIC, 0] for u in banks])
    assert statistics.mean() == pytest.approx(J + 2.0, rel=0.05)
    sizes = np.array([sizes_of(u[ss.LAMBDA], float(u[ss.CROSS, 0]), u[ss.ZETA]) for u in banks])
    own, both = banks[0][ss.LAMBDA], banks[0][ss.CROSS, 0]
    sigmas = np.sqrt(np.diagonal(np.linalg.inv([[own[0], both], [both, own[1]]])))
    assert np.all(np.abs(sizes.mean(axis=0) - [size, 0.0]) < 4.0 * sigmas / np.sqrt(RUNS))
    assert sizes.std(axis=0) == pytest.approx(sigmas, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('kind', 'dof'),
    [(ss.BEGINS + 1, 2), (ss.DRAGS, 1), (ss.TURNS, 1), (ss.RANGES, 1), (ss.BEARINGS, 1)],
)
def test_each_kind_is_chi_square_without_a_fault_and_found_with_its_size(kind, dof):
    rng, J = np.random.default_rng(10 + kind), 60.0
    quiet = [linear().run(rng).signatures[-1, ss.STATISTIC, kind] for _ in range(RUNS)]
    assert np.mean(quiet) == pytest.approx(dof, abs=4.0 * np.sqrt(2.0 * dof / RUNS))
    size = np.sqrt(J / linear().information(kind))
    banks = [linear().run(rng, size, kind).signatures for _ in range(RUNS)]
    found = np.array([u[-1, ss.STATISTIC, kind] for u in banks])
    assert found.mean() == pytest.approx(J + dof, rel=0.05)
    sizes = np.array([_size(u, np.ones(1), kind - (kind == ss.BEGINS + 1))[0][-1] for u in banks])
    assert sizes.mean() == pytest.approx(size, abs=4.0 * sizes.std() / np.sqrt(RUNS))


def bank_of(weights, likelihoods, own, of_mixture=0.0):
    """Statistic of a bank whose members had weights, and have likelihoods and own statistics."""
    b = arrays.make_bank(len(weights))
    b.signatures[:-1, ss.PRIOR, 0] = np.log(weights)
    b.signatures[:-1, ss.LIKELIHOOD, 0] = likelihoods
    b.signatures[:-1, ss.OWN, 0] = own
    b.signatures[-1, ss.OWN, 0] = of_mixture
    signatures._weigh(b)
    return b.signatures[-1, ss.STATISTIC, 0]


def test_a_fault_in_a_steady_current_is_weighed_against_a_current_that_walks():
    assert bank_of([1.0], [-5.0], [31.0]) == pytest.approx(31.0)
    # The steady member explains it with a fault, the walking one nearly as well without.
    assert bank_of([1.0, 1e-9], [-30.0, -5.0], [80.0, 1.0]) == pytest.approx(30.0, abs=1e-3)
    assert bank_of([1.0, 1e-9], [-45.0, -5.0], [80.0, 1.0]) == pytest.approx(0.0, abs=0.1)
    # A current that walked before cannot have been steady but for a fault.
    assert bank_of([1e-12, 1.0], [-30.0, -5.0], [80.0, 1.0]) < 1.1


def test_the_statistic_of_the_mixture_counts_where_it_is_larger():
    assert bank_of([1.0], [-5.0], [10.0], 12.0) == 12.0


def test_members_that_know_no_better_count_against_a_fault():
    each = 2.0 * np.log(4.0)
    assert bank_of([0.25] * 4, [-5.0] * 4, [20.0] * 4) == pytest.approx(20.0 - each)


SPAN_S, FROM_S, GROWS = 300.0, 60.0, 0.2 / 60.0


def fixes_of(inputs, growth):
    """Fixes as from a vehicle in a current that grows along x from `FROM_S` on [m/s^2]."""

    def moved(fix):
        age_s = max(0.0, (fix.validity_ns - twin.START_NS) / NS - FROM_S)
        shift = np.array([0.5 * growth * age_s**2, 0.0, 0.0])
        return replace(fix, polar=replace(fix.polar, station=fix.polar.station + shift))

    return replace(inputs, fixes=tuple(map(moved, inputs.fixes)))


@cache
def ran(growth, one_by_one=False):
    """Run whose current is stated to walk slowly: a young bank of densities follows any."""
    inputs = twin.inputs(twin.truth(SPAN_S), 4, depth_every=10)
    params = twin.params(identify_method='none', current_method='single')
    look_every_s = 0.0 if one_by_one else 1.0
    return engine_run.run(
        params, fixes_of(inputs, growth), one_by_one=one_by_one, look_every_s=look_every_s
    )


def about_current(result):
    return [h for h in result.health if 'the current changes by' in h.sentence]


def test_a_current_that_grows_is_reported_by_its_signature():
    found = about_current(ran(GROWS))
    assert found
    assert found[0].level >= Level.WARN
    assert found[0].culprit & Culprit.MODEL
    assert found[0].culprit & Culprit.FIXES
    assert found[0].stamp_ns > twin.START_NS + FROM_S * NS
    assert not about_current(ran(0.0))


@pytest.mark.slow
def test_the_evidence_is_the_same_event_by_event():
    whole, single = about_current(ran(GROWS)), about_current(ran(GROWS, one_by_one=True))
    assert whole
    assert [h.sentence for h in whole] == [h.sentence for h in single]


def test_a_younger_hypothesis_has_no_statistic():
    """One fix has a statistic of any size; half a minute of them is asked for."""
    b = linear().run(np.random.default_rng(9), 10.0)
    newest = int(np.argmax(b.counters[ss.BORN_NS : ss.BIRTH_NS]))
    age_ns = NS * (1 + SECONDS * FIXES) - b.counters[ss.BORN_NS + newest]
    assert (b.signatures[-1, ss.STATISTIC, ss.KINDS * newest] > 28.0) == (
        age_ns - SECONDS * NS >= signatures.JUDGED_NS
    )


def turned(inputs, angle):
    """The same AHRS with its heading off by an angle of its time [s] and heading [rad]."""
    t = (inputs.imu_stamps_ns - twin.START_NS) / NS
    a = angle(t, np.arctan2(inputs.C_b_G[:, 1, 0], inputs.C_b_G[:, 0, 0]))
    turn = np.zeros((len(a), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(a)
    turn[:, 1, 0], turn[:, 0, 1] = np.sin(a), -np.sin(a)
    turn[:, 2, 2] = 1.0
    return replace(inputs, C_b_G=turn @ inputs.C_b_G)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('angle', 'words'),
    [
        (lambda _, psi: np.radians(20.0) * np.sin(psi), 'has a deviation of'),
        (lambda t, _: np.radians(0.06) * np.maximum(t - 300.0, 0.0), 'AHRS drifts by'),
    ],
)
def test_an_ahrs_that_goes_wrong_slowly_is_named(angle, words):
    inputs = twin.inputs(twin.truth(900.0), 4, depth_every=10)
    params = twin.params(identify_method='none')
    found = engine_run.run(params, turned(inputs, angle), look_every_s=1.0)
    slow = [c for h in found.health for c in h.present if c.condition.key == 'slow fault']
    assert slow
    assert words in slow[-1].condition.sentence
    assert slow[-1].condition.culprit & Culprit.HEADING
