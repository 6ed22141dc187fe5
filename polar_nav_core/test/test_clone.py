"""`clone` against a filter with explicitly augmented states, overlapping delays among them."""

import dataclasses

import numpy as np
import pytest
from closed_loop import World, run
from hypothesis import given, settings
from hypothesis import strategies as st

from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.engine.results import FixResult, Outcome
from polar_nav_core.engine.sins import clone as clone_module
from polar_nav_core.engine.sins.clone import Clone
from polar_nav_core.engine.sins.fusion import Fusion
from polar_nav_core.engine.verdicts import Verdict


class Augmented(Fusion):
    """Every position that a fix will be about is a state of its own, from its time on.

    Plain NumPy: cross-covariance X (24, 3n), covariance Q (3n, 3n) of the clones, and for each the
    innovation of its fix, moved by all that is learnt of the clone.
    """

    def __init__(self, params, initial, stamp_ns, schedule):
        super().__init__(params, initial, stamp_ns)
        self.waiting = sorted(schedule, key=lambda f: (f.validity_ns, f.order))
        self.clones = []
        self.X = np.zeros((24, 0))
        self.Q = np.zeros((0, 0))

    def add_due(self, before):
        """Clones of all fixes valid before a stamp."""
        while self.waiting and self.waiting[0].validity_ns < before:
            fix, f = self.waiting.pop(0), self.filter
            self._fuse_at(fix, self._present(), fix.validity_ns)
            H = f.work.H.copy()
            H[:, 3:6] = np.eye(3) * ((fix.validity_ns - f.stamp_ns) * 1e-9)
            cross = f.state.P @ H.T
            self.Q = np.block([[self.Q, self.X.T @ H.T], [H @ self.X, H @ cross]])
            self.X = np.hstack([self.X, cross])
            self.clones.append([fix, f.work.z.copy(), f.work.R.copy()])

    def imu(self, sample):
        self.add_due(sample.stamp_ns)
        h = self.filter.history
        step = h.step
        super().imu(sample)
        if h.step != step:
            self.X = h.transitions[h.step % len(h.transitions)] @ self.X

    def local(self, event):
        f = self.filter
        P = f.state.P.copy()
        outcome = super().local(event)
        m = outcome.dof
        H, R, z = f.work.H[:m], f.work.R[:m, :m], f.work.z[:m]
        S = H @ P @ H.T + R
        self._learn(P @ H.T, self.X.T @ H.T, S, z)
        return outcome

    def _learn(self, cross_x, cross_c, S, z):
        """Everybody's share of a measurement with covariances (24, m) and (3n, m) to it."""
        gain_c = cross_c @ np.linalg.inv(S)
        self.X = self.X - cross_x @ gain_c.T
        self.Q = self.Q - gain_c @ S @ gain_c.T
        for i, clone in enumerate(self.clones):
            clone[1] = clone[1] - gain_c[3 * i : 3 * i + 3] @ z

    def fix(self, fix):
        self.add_due(fix.validity_ns + 1)
        f = self.filter
        i = next(i for i, c in enumerate(self.clones) if c[0] is fix)
        block = slice(3 * i, 3 * i + 3)
        _, z, R = self.clones[i]
        S = self.Q[block, block] + R
        cross_x, cross_c = self.X[:, block].copy(), self.Q[:, block].copy()
        K = cross_x @ np.linalg.inv(S)
        f.state.P[:] = f.state.P - K @ S @ K.T
        f.feed_back(np.ascontiguousarray(K @ z))
        self._learn(cross_x, cross_c, S, z)
        nan = np.full(3, np.nan)
        return FixResult(Outcome(True, z, nan, 0.0, 3, np.inf), 0)


@pytest.fixture(scope='module')
def world():
    return World(40.0)


@pytest.fixture(scope='module')
def long_world():
    return World(75.0)


def drive(world, fixes, make, **changes):
    values = {'noise_adaptation': 'none', 'gate_probability': 1.0, **changes}
    params = world.params(configuration='custom', delay_handling='clone', **values)
    engine = Engine(params)
    engine._make_fusion = make
    rng = np.random.default_rng(1)
    out = run(engine, [*world.imu(), *world.dvl(rng=rng), *world.depth(rng=rng), *fixes])
    return [o for o in out if isinstance(o, Estimate)], engine


def compare(world, fixes, limit=1e-9, **changes):
    """Covariances to a limit of the product of sigmas, estimates to 1e-6 sigma."""
    got, engine = drive(world, fixes, Clone, **changes)
    expected, _ = drive(world, fixes, lambda p, i, t: Augmented(p, i, t, fixes), **changes)
    assert engine.fused['fix'] == len(fixes) > 0
    assert len(got) == len(expected)
    for a, b in zip(got, expected, strict=True):
        sigma = np.sqrt(np.diagonal(b.P))
        active = sigma > 0.0
        scale = np.outer(sigma, sigma)[np.ix_(active, active)]
        assert np.abs((a.P - b.P)[np.ix_(active, active)] / scale).max() < limit
        for name, first in (('r_e', 6), ('v_G', 3), ('gyro_bias_b', 9), ('dvl_markov_m', 18)):
            off = np.abs(getattr(a, name) - getattr(b, name))
            assert np.all(off < 1e-6 * sigma[first : first + 3]), name
        off = np.abs(a.usbl_bias_a - b.usbl_bias_a)
        assert np.all(off <= 1e-6 * sigma[21:24])


def random_fixes(world, rng, period_s=0.9, longest_s=9.0, between=False):
    """A third lost, the others in any order, several under way at once; between IMU stamps."""
    fixes = []
    for f in world.fixes(period_s, 0.0, rng=rng):
        validity_ns = f.validity_ns - (int(rng.integers(1, 10**7)) if between else 0)
        receive_ns = f.validity_ns + int(rng.uniform(0.0, longest_s) * 1e9)
        if rng.random() > 0.3 and receive_ns < world.stamps[-1]:
            fixes.append(dataclasses.replace(f, validity_ns=validity_ns, receive_ns=receive_ns))
    return fixes


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32))
def test_random_schedules_give_the_augmented_filter(world, seed):
    compare(world, random_fixes(world, np.random.default_rng(seed)))


@pytest.mark.parametrize(
    ('period_s', 'delay_s'), [(1.0, 0.0), (1.0, 0.05), (12.0, 6.0), (1.0, 5.0), (2.5, 20.0)]
)
def test_constant_delays_alone_and_overlapping(world, period_s, delay_s):
    compare(world, world.fixes(period_s, delay_s, rng=np.random.default_rng(2)))


@pytest.mark.parametrize(('steps', 'period_s'), [(3, 0.9), (10, 0.33), (25, 0.33)])
def test_any_order_and_blocks_of_any_length(world, monkeypatch, steps, period_s):
    monkeypatch.setattr(clone_module, 'STEPS_PER_BLOCK', steps)
    compare(world, random_fixes(world, np.random.default_rng(5), period_s))


def test_fixes_valid_between_imu_samples(world):
    compare(world, random_fixes(world, np.random.default_rng(8), between=True))


def test_a_slow_error_of_the_fixes_is_estimated(world):
    fixes = random_fixes(world, np.random.default_rng(9))
    headed = [dataclasses.replace(f, array_heading=0.1 * f.sequence) for f in fixes]
    # The array's axes turn against grid axes, which are those of the stored epoch, here of the
    # position as corrected since: centimetres on a parallel of 1100 km.
    compare(world, headed, limit=1e-7, usbl_bias_sigma=0.5)


@pytest.mark.slow
def test_a_minute_of_delay_at_one_fix_a_second(long_world):
    fixes = long_world.fixes(1.0, 60.0, rng=np.random.default_rng(3))
    assert len(fixes) == 15
    # Rounding through sixty blocks: metres across and centimetres upwards, in ECEF axes.
    compare(long_world, fixes, limit=3e-9)


def test_a_refused_fix_leaves_nothing(world):
    """One of 200 m among good ones, behind an open gate for all others."""
    fixes = random_fixes(world, np.random.default_rng(6))
    bad = dataclasses.replace(fixes[len(fixes) // 2], r_e=fixes[0].r_e + 200.0, sequence=999)
    bad = dataclasses.replace(bad, order=bad.order + 10_000)
    outputs = []
    for these in (fixes, sorted([*fixes, bad], key=lambda f: f.key)):
        outputs.append(drive(world, these, Clone, gate_probability=1.0 - 1e-12))
    (good, _), (with_bad, engine) = outputs
    assert engine.verdicts[Verdict.GATED] == 1
    np.testing.assert_array_equal(good[-1].P, with_bad[-1].P)
    np.testing.assert_array_equal(good[-1].r_e, with_bad[-1].r_e)


def test_near_rewind_on_the_full_filter(world):
    fixes = world.fixes(1.0, lambda i: 2.0 + 1.7 * (i % 3), rng=np.random.default_rng(4))
    params = {'configuration': 'custom', 'noise_adaptation': 'none', 'gate_probability': 1.0}
    rng = np.random.default_rng(1)
    events = [*world.imu(), *world.dvl(rng=rng), *world.depth(rng=rng), *fixes]
    last = {}
    for name in ('clone', 'rewind'):
        out = run(Engine(world.params(delay_handling=name, **params)), events)
        last[name] = [o for o in out if isinstance(o, Estimate)][-1]
        assert all(r.nis > 0.0 for r in out if isinstance(r, Receipt))
    sigma = np.sqrt(np.diagonal(last['rewind'].P))
    assert np.all(np.abs(last['clone'].r_e - last['rewind'].r_e) < 0.01 * sigma[6:9])
    np.testing.assert_allclose(np.sqrt(np.diagonal(last['clone'].P))[:15], sigma[:15], rtol=0.01)


def test_overlapping_fixes_as_old_as_allowed_find_their_places():
    """The block of the oldest begins before the stated history."""
    world = World(20.0)
    rng = np.random.default_rng(4)
    params = world.params(
        configuration='custom', delay_handling='clone', max_delay_s=6.0, history_s=6.5
    )
    late = world.fixes(2.0, 6.0, rng=rng)
    events = [*world.imu(), *world.dvl(rng=rng), *world.depth(rng=rng), *late]
    receipts = [o for o in run(Engine(params), events) if isinstance(o, Receipt)]
    assert len(receipts) == len(late)
    assert {r.verdict for r in receipts} == {Verdict.FUSED}, [r.reason for r in receipts]
