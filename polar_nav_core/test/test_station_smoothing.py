"""Smoothing in station mode: dense least squares, honesty, hindsight, order of arrival."""

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import station_twin as twin

from polar_nav_core import grid
from polar_nav_core.engine import run, smoothing
from polar_nav_core.engine.station import arrays
from polar_nav_core.engine.station.nodes import Nodes
from polar_nav_core.engine.station_backwards import Adjoint, Residuals, judge
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.errors import ConfigError
from polar_nav_core.kernels.station import state as ss
from polar_nav_core.kernels.station import tape as kernels
from polar_nav_core.kernels.station.common import transform

N, C = ss.N, ss.COMMON
STEPS, FIXES = 14, (3, 7, 10)
SIGMAS = np.array([0.3, 0.5, 0.7, 0.0, 0.4])
COMMON_ERRORS = {
    'station_range_scale_sigma': 0.005,
    'station_turn_sigma_deg': 0.5,
    'station_position_sigma': 5.0,
}


class Linear:
    """A linear problem of some members, as nodes and as one matrix each; depths on the way.

    Unknowns: start, noise of each step, of each measurement, common errors. The fix number
    ``refused`` is not fused, and no part of the matrix.
    """

    def __init__(self, members, refused=-1):
        rng = np.random.default_rng(4)
        self.members = [self._member(np.random.default_rng([m, 7])) for m in range(members)]
        work, tape = arrays.make_work(members), arrays.make_tape(members)
        self.nodes, self.states = Nodes(members), []
        self._note(tape, begins=True)
        fix = 0
        for step in range(STEPS):
            h, slopes = 0.1 * rng.uniform(0.5, 1.0), rng.uniform(-1.0, 1.0, 4)
            work.F[:], work.R[:] = rng.standard_normal((2, 3, 3))
            e = 0.97
            Phi = np.eye(N)
            transform(Phi, h, *slopes, work)
            Phi[ss.STATION] *= e
            for m, member in enumerate(self.members):
                self._step(member, Phi, step, rng)
                kernels.tape_step(tape, m, h, e, *slopes, work)
            if step in FIXES:
                self._fix(tape, fix, step, rng, fused=fix != refused)
                fix += 1
            else:
                self._depth(tape, work, step, rng)
        self._note(tape)

    def _member(self, rng):
        P = np.diag(rng.uniform(0.5, 2.0, N) ** 2)
        size = N + STEPS * N + 2 * STEPS + C
        G = np.zeros((N, size))
        G[:, :N] = np.eye(N)
        prior = np.zeros(size)
        prior[:N], prior[-C:] = np.diagonal(P), SIGMAS**2
        return SimpleNamespace(x=np.zeros(N), P=P, S=np.zeros((N, C)), G=G, prior=prior, rows=[])

    def _note(self, tape, begins=False):
        record = self.nodes.new()
        record['begins'] = begins
        for m, member in enumerate(self.members):
            record['x'][m], record['P'][m], record['S'][m] = member.x, member.P, member.S
        self._append(tape, record)

    def _append(self, tape, record):
        for name in ('Psi', 'vector', 'information'):
            record[name] = getattr(tape, name)
        record['stamp'] = len(self.nodes)
        self.nodes.append(record)
        tape.Psi[:] = np.eye(N)
        tape.vector[:], tape.information[:] = 0.0, 0.0
        self.states.append([one.G.copy() for one in self.members])

    def _step(self, member, Phi, step, rng):
        q = rng.uniform(0.01, 0.1, N)
        at = slice(N + step * N, N + (step + 1) * N)
        member.G = Phi @ member.G
        member.G[:, at] += np.eye(N)
        member.prior[at] = q
        member.x, member.S = Phi @ member.x, Phi @ member.S
        member.P = Phi @ member.P @ Phi.T + np.diag(q)

    def _measure(self, member, H, R, J, y, step, fused):
        """Update of a member; returns z, S, gain and J less what the state has taken."""
        z, left = y - H @ member.x, J - H @ member.S
        S = H @ member.P @ H.T + R
        K = np.linalg.solve(S, H @ member.P).T
        at = N + STEPS * N + 2 * step
        member.prior[at : at + len(H)] = np.diagonal(R)
        row = H @ member.G
        row[:, at : at + len(H)] += np.eye(len(H))
        row[:, -C:] += J
        member.rows.append((row, y, fused))
        if fused:
            member.x, member.S = member.x + K @ z, member.S + K @ left
            member.P = (np.eye(N) - K @ H) @ member.P
        return z, S, K, left

    def _depth(self, tape, work, step, rng):
        up, R = rng.standard_normal(3), np.array([[rng.uniform(0.2, 0.5)]])
        H = np.zeros((1, N))
        H[0, ss.POSITION : ss.CURRENT] = up
        J, y = rng.standard_normal((1, C)), rng.standard_normal(1)
        for m, member in enumerate(self.members):
            PHt = member.P @ H[0]
            z, S, _, left = self._measure(member, H, R, J, y, step, True)
            work.z[m, 0], work.S[m, 0] = z[0], S[0, 0]
            work.PHt[m, 0], work.J[m, 0] = PHt, left[0]
            kernels.tape_depth(tape, m, up, work, True)

    def _fix(self, tape, number, step, rng, *, fused):
        record = self.nodes.new()
        H, J = rng.standard_normal((2, N)), rng.standard_normal((2, C))
        R, y = np.diag(rng.uniform(0.3, 0.6, 2)), rng.standard_normal(2)
        for m, member in enumerate(self.members):
            record['x'][m], record['P'][m], record['S'][m] = member.x, member.P, member.S
        for m, member in enumerate(self.members):
            z, S, K, left = self._measure(member, H, R, J, y, step, fused)
            record['H'][m], record['K'][m], record['z'][m] = H, K, z
            record['S_z'][m], record['J'][m], record['inflation'][m] = S, left, 1.0
        record['fix'], record['fused'] = number, fused
        record['outcome'][ss.DISTANCE] = 1.0  # so that x, y are the two rows
        self._append(tape, record)

    def dense(self, m, G, without=-1):
        """Mean and covariance of G u by least squares over all fused measurements of a member."""
        member = self.members[m]
        prior = member.prior.copy()
        prior[-C:] = 0.0
        used = [r for k, r in enumerate(member.rows) if r[2] and k != without]
        A = np.concatenate([row for row, _, _ in used])
        y = np.concatenate([value for _, value, _ in used])
        Q = np.diag(prior)
        gain = np.linalg.solve(A @ Q @ A.T, A @ Q).T
        u = gain @ y
        P = Q - gain @ A @ Q
        moved = -gain @ A[:, -C:] + np.eye(len(prior))[:, -C:]  # of the truth less the estimate
        return G @ u, G @ P @ G.T, G @ moved


def backward(problem):
    """Smoothed members at each node, and the residuals of the fixes."""
    adjoint = Adjoint(len(problem.members), 1.0)
    residuals = Residuals()
    f = SimpleNamespace(settings=SimpleNamespace(common=SIGMAS))
    out = []
    with problem.nodes:
        for node in problem.nodes.backwards():
            if node['fix'] >= 0:
                judge(residuals, node, adjoint, f)
                if node['fused']:
                    adjoint.before_fix(node)
            PL = np.einsum('mij,mjk->mik', node['P'], adjoint.vector)
            P_s = node['P'] - node['P'] @ adjoint.information @ node['P']
            out.append((node['x'] - PL[:, :, 0], P_s, node['S'] - PL[:, :, 1:]))
            adjoint.before_way(node)
    return out[::-1], residuals.judged()


def test_it_is_least_squares_over_everything_for_each_member():
    problem = Linear(2)
    for (x, P, S), G in zip(backward(problem)[0], problem.states, strict=True):
        for m in range(2):
            mean, covariance, moved = problem.dense(m, G[m])
            np.testing.assert_allclose(x[m], mean, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(P[m], covariance, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(S[m], -moved, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize('refused', [-1, 1])
def test_what_all_others_say_of_a_fix_is_least_squares_without_it(refused):
    problem = Linear(1, refused)
    judged = backward(problem)[1]
    assert judged.fused.tolist() == [k != refused for k in range(len(FIXES))]
    for k, step in enumerate(FIXES):
        row, y, _ = problem.members[0].rows[step]
        mean, covariance, moved = problem.dense(0, row, without=step)
        V = covariance + np.einsum('ik,jk->ij', moved * SIGMAS, moved * SIGMAS)
        np.testing.assert_allclose(judged.residuals[k, :2], mean - y, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(judged.covariances[k, :2, :2], V, rtol=0.0, atol=1e-9)


@cache
def truth():
    return twin.truth(400.0)


@cache
def smoothed(seed, **changes):
    x = twin.inputs(truth(), seed)
    return x, smoothing.smooth(twin.params(**changes), x)


def nees(track):
    """Errors and mean NEES per degree of freedom, horizontal, from 30 s on."""
    t, e, _ = twin.errors(track, truth())
    k = t > 30.0
    P = np.einsum('ij,njk,lk->nil', twin.C_E_A, track.P[k, 6:9, 6:9], twin.C_E_A)[:, :2, :2]
    white = np.linalg.solve(np.linalg.cholesky(P), e[k, :2, None])
    return math.sqrt(np.mean(np.sum(e[k, :2] ** 2, axis=1))), float(np.mean(white**2))


@pytest.mark.slow
def test_it_is_nearer_to_the_truth_and_honest():
    seeds = [nees(smoothed(seed)[1].track) for seed in (1, 2, 3)]
    before = [nees(run.run(twin.params(), smoothed(seed)[0]).track) for seed in (1, 2, 3)]
    rms, was = (math.sqrt(np.mean([s[0] ** 2 for s in x])) for x in (seeds, before))
    assert rms < 0.6 * was
    assert 0.2 < np.mean([s[1] for s in seeds]) < 2.0


@pytest.mark.slow
def test_at_the_end_the_first_pass_is_the_filter():
    x = twin.inputs(truth(), 1)
    params = twin.params(gate_probability=1.0, robust_fixes='none', configuration='custom')
    one = smoothing.smooth(params, x, passes=1).track
    fixes = tuple(replace(f, receive_ns=f.validity_ns, transmit_ns=f.validity_ns) for f in x.fixes)
    filtered = run.run(replace(params, output_period_s=1.0), replace(x, fixes=fixes)).track
    at = filtered.stamps_ns.tolist().index(one.stamps_ns[-1])
    np.testing.assert_allclose(one.x[-1], filtered.x[at], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(one.P_x[-1], filtered.P_x[at], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(one.r_e[-1], filtered.r_e[at], rtol=0.0, atol=1e-6)


@pytest.mark.slow
def test_any_arrival_gives_the_same_bits():
    x, found = smoothed(1)
    late = tuple(replace(f, receive_ns=f.receive_ns + 15_000_000_000) for f in x.fixes)
    again = smoothing.smooth(twin.params(), replace(x, fixes=late))
    np.testing.assert_array_equal(again.track.x, found.track.x)
    np.testing.assert_array_equal(again.track.P_x, found.track.P_x)


@pytest.mark.slow
def test_each_second_has_an_estimate_where_fixes_are_valid_at_whole_seconds():
    """And from a filter that was lost on the way, and began anew."""
    x, _ = smoothed(1)
    whole = tuple(
        replace(f, validity_ns=round(f.validity_ns, -9)) for f in x.fixes if f.sequence % 2
    )
    force_b = x.force_b.copy()
    force_b[20_000] = 1e300
    for changed in (x, replace(x, force_b=force_b)):
        params = twin.params(thrust_limit_n=1e300)
        track = smoothing.smooth(params, replace(changed, fixes=whole)).track
        assert np.all(np.diff(track.stamps_ns) == 1_000_000_000)
        assert np.isfinite(track.P).all()
        assert len(track.stamps_ns) == 400


@pytest.mark.slow
def test_a_fix_that_the_filter_believed_goes_with_hindsight():
    x, _ = smoothed(1)
    first = x.fixes[0]
    wrong = replace(first, polar=replace(first.polar, range=first.polar.range + 25.0))
    params = twin.params(initial_sigma_position=100.0)
    found = smoothing.smooth(params, replace(x, fixes=(wrong, *x.fixes[1:])))
    (revision,) = [r for r in found.revisions if r.number == first.sequence]
    assert (revision.before, revision.after) == (Verdict.FUSED, Verdict.GATED)
    (receipt,) = [r for r in found.receipts if r.revision == 1 and r.sequence == first.sequence]
    assert receipt.verdict is Verdict.GATED
    assert receipt.dof == 2
    assert receipt.reason.startswith('with hindsight: NIS ')
    clean = smoothing.smooth(params, x)
    _, e, _ = twin.errors(found.track, truth())
    _, e_clean, _ = twin.errors(clean.track, truth())
    assert np.linalg.norm(e[5, :2] - e_clean[5, :2]) < 2.0


@pytest.mark.slow
def test_common_errors_enlarge_what_is_stated_and_move_nothing_but_the_gate():
    x, found = smoothed(1)
    shared = smoothing.smooth(twin.params(**COMMON_ERRORS), x)
    assert np.all(np.trace(shared.track.P[:, 6:9, 6:9], axis1=1, axis2=2) > 20.0)
    np.testing.assert_allclose(shared.track.r_e, found.track.r_e, rtol=0.0, atol=0.5)


@pytest.mark.slow
def test_velocity_in_grid_axes_is_that_of_the_state():
    _, found = smoothed(1)
    track = found.track
    C_G_A = grid.ecef_to_grid(track.r_e) @ twin.C_E_A.T
    t, _, _ = twin.errors(track, truth())
    v = np.einsum('nij,nj->ni', C_G_A, truth().v[np.round(t * 100).astype(int)])
    assert np.sqrt(np.mean((track.v_G - v)[60:, :2] ** 2)) < 0.03


@pytest.mark.slow
def test_the_model_is_loose_from_when_it_began_to_fail():
    """The filter finds that a minute late; a pass with hindsight is right before that, too."""
    x, _ = smoothed(1)
    failed = (x.imu_stamps_ns - x.imu_stamps_ns[0]) * 1e-9 > 200.0
    force_b = x.force_b.copy()
    force_b[failed, 0] += 80.0  # what is stated more than there is
    wrong = []
    for passes in (1, 3):
        found = smoothing.smooth(twin.params(), replace(x, force_b=force_b), passes=passes)
        t, e, _ = twin.errors(found.track, truth())
        P = np.einsum('ij,njk,lk->nil', twin.C_E_A, found.track.P[:, 6:9, 6:9], twin.C_E_A)
        sigmas = np.abs(e[:, :2]) / np.sqrt(np.einsum('nii->ni', P)[:, :2])
        wrong.append(np.mean(sigmas[t > 30.0].max(axis=1) > 4.0))
    assert wrong[0] > 0.05
    assert wrong[1] < 0.01


@pytest.mark.slow
def test_the_published_filter_is_refused():
    params = twin.params(station_filter='published', configuration='default')
    with pytest.raises(ConfigError, match='station_filter published'):
        smoothing.smooth(params, smoothed(1)[0])
