"""Signatures of slow faults: they are what residuals do, and T is chi-square without a fault."""

import numpy as np
import pytest

from polar_nav_core.engine.health.conditions import Culprit, Level
from polar_nav_core.engine.health.slow import (
    Evidence,
    pair_of,
    shift_in_sigmas,
    size_of,
    slow_faults,
)
from polar_nav_core.engine.sins.history import make_past
from polar_nav_core.kernels.evidence import slot_to_begin
from polar_nav_core.kernels.sins import consider, shared, signatures
from polar_nav_core.kernels.sins import hypotheses as hy
from polar_nav_core.kernels.sins import state as fs
from polar_nav_core.kernels.sins.update import ACCEL, DR, DV, GYRO, SCALE, N
from polar_nav_core.kernels.sins.work import make_work

STEP, BORN = 0.5, 20
"""Time between measurements [s]; number of the step at which the hypotheses begin."""
ALONE = (hy.SCALE_GROWS, hy.SCALE_STEP, hy.ACCEL_GROWS)
OF_FIXES = (hy.FIX_EAST, hy.FIX_NORTH, hy.STEP_EAST, hy.STEP_NORTH)
WIDE = 1e12 * np.eye(2)
"""Covariance of a position that nothing has moved beyond what is stated [m^2]."""


class Linear:
    """A linear filter of position, velocity, scale and biases, and its bank of hypotheses.

    A fix at every other step, a velocity at the others; fixes share an offset b.
    """

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.Phi = np.eye(N)
        self.Phi[DR : DR + 3, DV : DV + 3] = STEP * np.eye(3)
        self.Phi[DV, GYRO] = self.Phi[DV + 1, GYRO + 1] = 0.1 * STEP
        self.Phi[DV + 2, ACCEL + 2] = STEP
        self.P = np.diag([0.0] * 3 + [0.01] * 3 + [1.0] * 3 + [1e-4] * 3 + [0.0] * 3 + [1e-4] * 9)
        self.q = np.array([0.0] * 3 + [1e-4] * 3 + [0.0] * 3 + [1e-7] * 3 + [0.0] * 12)
        self.x = np.sqrt(np.diagonal(self.P)) * self.rng.standard_normal(N)
        self.sigma = np.zeros(consider.COLUMNS)
        self.sigma[consider.OFFSET : consider.OFFSET + 3] = 0.5
        self.b = np.zeros(consider.COLUMNS)
        own = slice(consider.LEADER)  # a leader that drifts is not in this world
        self.b[own] = self.sigma[own] * self.rng.standard_normal(consider.LEADER)
        self.S = np.zeros((N, consider.COLUMNS))
        self.shared = np.zeros((consider.COLUMNS + 1, consider.COLUMNS))
        self.bank = np.zeros((hy.ROWS, hy.SLOTS * hy.KINDS))
        self.step = 0
        self.changes = []

    def measure(self, fault=-1, size=0.0):
        """One step and one measurement with a fault of one kind; returns the residual."""
        rng, age = self.rng, (self.step - BORN) * STEP
        self.x = self.Phi @ self.x + np.sqrt(self.q) * rng.standard_normal(N)
        self.P = self.Phi @ self.P @ self.Phi.T + np.diag(self.q)
        M = np.zeros((N, hy.SLOTS * hy.KINDS))
        consider.predict_sensitivity(self.S, self.Phi, M)
        hy.advance_signatures(self.bank, self.Phi, STEP, STEP, M)
        if age > 0.0:
            hy.grow(self.bank, 0, STEP)
            self.x[SCALE : SCALE + 3] += size * STEP * (fault == hy.SCALE_GROWS)
            self.x[ACCEL + 2] += size * STEP * (fault == hy.ACCEL_GROWS)
        if age == 0.0:
            hy.begin_slot(self.bank, 0)
            self.x[SCALE : SCALE + 3] += size * (fault == hy.SCALE_STEP)
            self.x[GYRO] += size * (fault == hy.GYRO_X)
            self.x[GYRO + 1] += size * (fault == hy.GYRO_Y)
        self.step += 1
        fix = self.step % 2 == 0
        H, J = np.zeros((3, N)), np.zeros((3, consider.COLUMNS))
        direct = np.zeros((3, hy.SLOTS * hy.KINDS))
        if fix:
            H[:, DR : DR + 3], R = np.eye(3), np.diag([1.0, 1.0, 0.2])
            J[:, consider.OFFSET : consider.OFFSET + 3] = -np.eye(3)
            direct[0, hy.FIX_EAST] = direct[1, hy.FIX_NORTH] = -max(age, 0.0)
            direct[0, hy.STEP_EAST] = direct[1, hy.STEP_NORTH] = -float(age > 0.0)
        else:
            H[:, DV : DV + 3], R = np.eye(3), np.diag([4e-4, 4e-4, 1e-4])
            turn = 0.1 * self.step
            H[0, SCALE], H[1, SCALE + 1] = -3.0 * np.cos(turn), -3.0 * np.sin(turn)
        z = H @ self.x + J @ self.b + np.sqrt(np.diagonal(R)) * rng.standard_normal(3)
        z += size * direct[:, fault] if fault in OF_FIXES else 0.0
        S_zz = H @ self.P @ H.T + R
        K = np.linalg.solve(S_zz, H @ self.P)
        consider.innovation_sensitivity(J, H, self.S, 3)
        wide, moved = np.zeros((3, 3)), J.copy()
        consider.widen(wide, S_zz, J, self.sigma, 3)
        e, V, L, w = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
        learned = np.zeros_like(J)
        shared.residual(e, V, self.shared, J, self.sigma, z, wide, learned, 3)
        shared.whitened(L, V, e, w, 3)
        shared.learn(self.shared, J, L, w, learned, 1.0, 3)
        g, h, X = np.zeros((3, M.shape[1])), np.zeros((3, M.shape[1])), np.zeros((9, 3))
        hy.change_of_innovation(g, self.bank, H, 0.0, 3)
        g += direct
        hy.change_of_residual(h, g, self.bank, J, L, 3)
        hy.add_evidence(self.bank, h, w, 1.0, 3)
        hy.repeated(X, H, K, 1, 3)
        hy.answer(self.bank, 0, K, X, g, -1.0, 3)
        hy.answer(self.bank, hy.LEARNED, learned, X, h, 1.0, 3)
        consider.update_sensitivity(self.S, K, moved, 3)
        self.x = self.x - K.T @ z
        self.P = (np.eye(N) - K.T @ H) @ self.P
        self.changes.append(L @ h)
        return e


def run(seed, steps, fault=-1, size=0.0):
    """Filter after so many steps, and its residuals."""
    world = Linear(seed)
    return world, np.array([world.measure(fault, size) for _ in range(steps)])


@pytest.mark.parametrize('kind', range(hy.KINDS))
def test_a_fault_changes_residuals_by_its_signature(kind):
    """Without approximations: the same noise with and without a fault."""
    size = 0.1
    plain, before = run(3, 300)
    _, after = run(3, 300, kind, size)
    changes = np.array(plain.changes)[:, :, kind]
    assert np.abs(changes).max() > 1e-3
    np.testing.assert_allclose(after - before, size * changes, rtol=1e-8, atol=1e-9)


@pytest.mark.slow
def test_without_a_fault_the_statistic_is_chi_square():
    """Common errors drawn; one degree of freedom, two for pairs."""
    found = np.array([run(seed, 400)[0].bank[hy.STATISTIC, : hy.KINDS] for seed in range(400)])
    freedom = np.array([1.0 if k in ALONE else 2.0 for k in range(hy.KINDS)])
    np.testing.assert_allclose(found.mean(axis=0), freedom, atol=4.0 * np.sqrt(2.0 * 2.0 / 400))
    variance = found.var(axis=0) / (2.0 * freedom)
    np.testing.assert_allclose(variance, 1.0, atol=0.6)


@pytest.mark.parametrize(
    ('kind', 'size', 'culprit', 'words'),
    [
        (hy.FIX_EAST, 0.2, Culprit.FIXES, 'fixes drift by 0.'),
        (hy.FIX_NORTH, -0.2, Culprit.FIXES, 'fixes drift by 0.'),
        (hy.STEP_EAST, 6.0, Culprit.FIXES, 'fixes have moved by '),
        (hy.STEP_NORTH, -6.0, Culprit.FIXES, 'fixes have moved by '),
        (hy.SCALE_GROWS, 3e-4, Culprit.DVL, 'the scale of the DVL changes by +'),
        (hy.SCALE_STEP, 0.04, Culprit.DVL, 'the scale of the DVL is +'),
        (hy.GYRO_X, 0.06, Culprit.IMU, 'the bias of the horizontal gyros has changed by'),
        (hy.ACCEL_GROWS, 3e-4, Culprit.IMU, 'the bias of the vertical accelerometer grows by +'),
    ],
)
def test_a_fault_is_found_with_its_size_and_named(kind, size, culprit, words):
    world, _ = run(4, 400, kind, size)
    slot = world.bank[:, : hy.KINDS]
    sigma = 1.0 / np.sqrt(slot[hy.LAMBDA, kind])
    found = size_of(slot, kind)
    if kind not in ALONE:
        first = kind - kind % 2
        found = pair_of(slot, first)[kind - first]
    assert found == pytest.approx(size, abs=3.0 * sigma)
    (condition,) = judged(world)
    assert condition.culprit & culprit
    assert condition.sentence.startswith(words)
    assert condition.sentence.count('since about 5 min') >= 1


@pytest.mark.parametrize(
    ('kind', 'size'),
    [
        (hy.FIX_EAST, 0.1),
        (hy.FIX_NORTH, -0.3),
        (hy.STEP_NORTH, 8.0),
        (hy.SCALE_STEP, 0.05),
        (hy.GYRO_X, 0.1),
    ],
)
def test_a_fault_that_has_moved_the_position_is_an_error(kind, size):
    """By how much is the difference of two runs with the same noise, to the size's own sigma."""
    plain, _ = run(4, 400)
    world, _ = run(4, 400, kind, size)
    d = (world.x - plain.x)[DR : DR + 2]
    P = (world.P + world.S * world.sigma**2 @ world.S.T)[DR : DR + 2, DR : DR + 2]
    moved = np.sqrt(d @ np.linalg.solve(P, d))
    (condition,) = judged(world, P)
    statistic = world.bank[hy.STATISTIC, kind]
    assert statistic > 45.0
    assert (condition.level is Level.ERROR) == (
        moved > 3.0 or statistic > 4.0 * (25.0 if kind in ALONE else 27.0)
    )
    (condition,) = judged(world, P * (moved / 12.0) ** 2)
    assert condition.level is Level.ERROR
    words = condition.sentence.split(', which has moved the position by ')[1].split()
    assert float(words[0]) == pytest.approx(12.0, rel=3.0 / np.sqrt(statistic))


def judged(world, P=None):
    """Conditions by the evidence of a world whose position is known to 1000 km, or to P."""
    born_ns = np.array([10**9] + [0] * (hy.SLOTS - 1))
    evidence = Evidence(world.bank, born_ns, world.bank[DR : DR + 2])
    return slow_faults(evidence, 301 * 10**9, WIDE if P is None else P)


@pytest.mark.parametrize(('drift', 'step'), [(45.0, 44.9), (44.9, 45.0), (80.0, 44.0)])
def test_kinds_of_one_culprit_are_named_and_weighed_together(drift, step):
    """Which of them is a hair ahead decides neither the level nor what is said."""
    bank, born_ns = np.zeros((hy.ROWS, hy.SLOTS * hy.KINDS)), np.ones(hy.SLOTS, dtype=np.int64)
    bank[hy.LAMBDA] = 100.0
    bank[hy.ZETA, hy.FIX_EAST] = bank[hy.ZETA, hy.STEP_EAST] = 100.0
    bank[hy.STATISTIC, hy.FIX_EAST], bank[hy.STATISTIC, hy.STEP_EAST] = drift, step
    per_unit_G = np.zeros((2, hy.SLOTS * hy.KINDS))
    per_unit_G[0, hy.FIX_EAST], per_unit_G[0, hy.STEP_EAST] = 4.0, 2.0
    (condition,) = slow_faults(Evidence(bank, born_ns, per_unit_G), 1, np.eye(2))
    assert (condition.level, condition.culprit) == (Level.ERROR, Culprit.FIXES)
    assert 'drift by' in condition.sentence
    assert 'have moved by' in condition.sentence
    assert condition.sentence.endswith('moved the position by 4.0 of its stated sigmas')


@pytest.mark.parametrize(
    ('kind', 'zeta', 'words'),
    [
        (hy.FIX_EAST, (0.03, 0.04), 'fixes drift by 0.050 m/s to grid 037 deg since'),
        (hy.STEP_EAST, (-3.0, 0.0), 'fixes have moved by 3.0 m to grid 270 deg since'),
        (hy.GYRO_X, (3e-7, -4e-7), 'the bias of the horizontal gyros has changed by 0.10 deg/h'),
        (hy.SCALE_GROWS, (-2e-5,), 'the scale of the DVL changes by -0.12 % per minute since'),
        (hy.SCALE_STEP, (0.012,), 'the scale of the DVL is +1.2 % off since'),
        (
            hy.ACCEL_GROWS,
            (9.80665e-7,),
            'the bias of the vertical accelerometer grows by +6.00 ug',
        ),
    ],
)
def test_a_sentence_has_the_size_in_its_unit(kind, zeta, words):
    bank, born_ns = np.zeros((hy.ROWS, hy.SLOTS * hy.KINDS)), np.ones(hy.SLOTS, dtype=np.int64)
    bank[hy.LAMBDA] = 1.0
    which = slice(kind, kind + len(zeta))
    bank[hy.ZETA, which], bank[hy.STATISTIC, which] = zeta, 50.0
    (condition,) = slow_faults(Evidence(bank, born_ns, bank[DR : DR + 2]), 1, WIDE)
    assert condition.sentence.startswith(words)


@pytest.mark.parametrize('kind', range(hy.KINDS))
def test_a_pair_needs_two_more_than_a_kind_alone(kind):
    limit = 25.0 if kind in ALONE else 27.0
    bank, born_ns = np.zeros((hy.ROWS, hy.SLOTS * hy.KINDS)), np.ones(hy.SLOTS, dtype=np.int64)
    bank[hy.LAMBDA] = 1.0
    for statistic in (limit, limit + 0.1):
        bank[hy.STATISTIC, kind] = statistic
        found = slow_faults(Evidence(bank, born_ns, bank[DR : DR + 2]), 1, WIDE)
        assert bool(found) is (statistic > limit)


def test_another_kind_of_the_culprit_is_named_after_one_that_is_less_likely():
    """T of 60, of the DVL 45, of the other kind of fixes 44: a WARN by itself."""
    bank, born_ns = np.zeros((hy.ROWS, hy.SLOTS * hy.KINDS)), np.ones(hy.SLOTS, dtype=np.int64)
    bank[hy.LAMBDA] = 1.0
    for kind, statistic in ((hy.FIX_EAST, 60.0), (hy.SCALE_STEP, 45.0), (hy.STEP_EAST, 44.0)):
        bank[hy.STATISTIC, kind] = statistic
    (condition,) = slow_faults(Evidence(bank, born_ns, bank[DR : DR + 2]), 1, WIDE)
    assert condition.culprit == Culprit.FIXES
    assert 'have moved by' in condition.sentence


@pytest.mark.parametrize(('step', 'named'), [(26.9, False), (27.1, True)])
def test_another_kind_of_the_culprit_that_is_less_likely_is_named_from_its_own_limit(step, named):
    bank, born_ns = np.zeros((hy.ROWS, hy.SLOTS * hy.KINDS)), np.ones(hy.SLOTS, dtype=np.int64)
    bank[hy.LAMBDA] = 1.0
    bank[hy.STATISTIC, hy.FIX_EAST], bank[hy.STATISTIC, hy.STEP_EAST] = 60.0, step
    (condition,) = slow_faults(Evidence(bank, born_ns, bank[DR : DR + 2]), 1, WIDE)
    assert ('have moved by' in condition.sentence) is named


def test_a_shift_counts_in_sigmas_of_its_direction():
    P, d = np.array([[4.0, 1.5], [1.5, 1.0]]), np.array([3.0, -0.7])
    assert shift_in_sigmas(d, P) == pytest.approx(np.sqrt(d @ np.linalg.solve(P, d)))


def test_levels_and_kinds_that_explain_the_same():
    bank, born_ns = np.zeros((hy.ROWS, hy.SLOTS * hy.KINDS)), np.ones(hy.SLOTS, dtype=np.int64)
    evidence = Evidence(bank, born_ns, bank[DR : DR + 2])
    bank[hy.LAMBDA] = 1.0
    bank[hy.STATISTIC, hy.KINDS + hy.SCALE_GROWS] = 24.9
    bank[hy.STATISTIC, [hy.FIX_EAST, hy.FIX_NORTH]] = 26.9
    assert slow_faults(evidence, 1, WIDE) == []
    assert slow_faults(None, 1, WIDE) == []
    bank[hy.STATISTIC, [hy.FIX_EAST, hy.FIX_NORTH]] = 27.1
    (condition,) = slow_faults(evidence, 1, WIDE)
    assert (condition.level, condition.culprit) == (Level.WARN, Culprit.FIXES | Culprit.DVL)
    bank[hy.STATISTIC, [hy.FIX_EAST, hy.FIX_NORTH]] = 0.0
    bank[hy.STATISTIC, hy.KINDS + hy.SCALE_GROWS] = 25.1
    (condition,) = slow_faults(evidence, 1, WIDE)
    assert (condition.level, condition.culprit) == (Level.WARN, Culprit.DVL)
    bank[hy.STATISTIC, [hy.FIX_EAST, hy.FIX_NORTH]] = 107.9
    (condition,) = slow_faults(evidence, 1, WIDE)
    assert (condition.level, condition.culprit) == (Level.WARN, Culprit.FIXES)
    bank[hy.STATISTIC, [hy.FIX_EAST, hy.FIX_NORTH]] = 108.1
    (condition,) = slow_faults(evidence, 1, WIDE)
    assert (condition.level, condition.culprit) == (Level.ERROR, Culprit.FIXES)
    bank[hy.STATISTIC, hy.KINDS + hy.SCALE_GROWS] = 95.0
    (condition,) = slow_faults(evidence, 1, WIDE)
    assert condition.culprit == Culprit.FIXES | Culprit.DVL
    assert ', or ' in condition.sentence


@pytest.mark.parametrize(
    ('statistic', 'sigma', 'level'),
    [
        (32.9, 0.2, Level.WARN),
        (33.1, 0.2, Level.ERROR),
        (39.0, 0.25, Level.WARN),
        (39.0, 0.2, Level.ERROR),
        (41.0, 0.25, Level.ERROR),
        (41.0, 1.0, Level.WARN),
        (41.0, 0.0, Level.WARN),
        (41.0, np.nan, Level.WARN),
    ],
)
def test_an_error_needs_a_size_that_is_known_and_three_sigmas_or_six(statistic, sigma, level):
    """Fixes drift by 1 m/s to the north-east, which has moved the position by 1 m there."""
    bank, born_ns = np.zeros((hy.ROWS, hy.SLOTS * hy.KINDS)), np.ones(hy.SLOTS, dtype=np.int64)
    both = [hy.FIX_EAST, hy.FIX_NORTH]
    bank[hy.LAMBDA] = bank[hy.ZETA, both] = 1.0
    bank[hy.STATISTIC, both] = statistic
    bank[DR, both[0]] = bank[DR + 1, both[1]] = 1.0
    P = sigma**2 * np.array([[2.0, -1.0], [-1.0, 2.0]])  # variance along the north-east: 1
    (condition,) = slow_faults(Evidence(bank, born_ns, bank[DR : DR + 2]), 1, P)
    assert condition.level is level
    told = f'moved the position by {np.sqrt(2.0) / sigma:.1f} of' if sigma else 'moved the'
    assert (told in condition.sentence) == (level is Level.ERROR)


def test_equal_updates_at_once_are_those_one_by_one():
    rng = np.random.default_rng(6)
    H, K, X = rng.standard_normal((3, N)), np.zeros((3, N)), np.zeros((9, 3))
    K[:] = np.linalg.solve(H @ H.T + 5.0 * np.eye(3), H)
    for m, number in ((3, 1), (3, 7), (1, 5)):
        bank, once = np.zeros((2, hy.ROWS, 4))
        bank[:N] = once[:N] = rng.standard_normal((N, 4))
        g, total, mean = np.zeros((3, 3, 4))
        for _ in range(number):
            hy.change_of_innovation(g, bank, H, 0.0, m)
            total += g
            hy.repeated(X, H, K, 1, m)
            hy.answer(bank, 0, K, X, g, -1.0, m)
        hy.change_of_innovation(g, once, H, 0.0, m)
        hy.repeated(X, H, K, number, m)
        hy.mean_change(mean, X, g, number, m)
        np.testing.assert_allclose(mean[:m], total[:m] / number, rtol=1e-10, atol=1e-12)
        hy.answer(once, 0, K, X, g, -1.0, m)
        np.testing.assert_allclose(once, bank, rtol=1e-10, atol=1e-12)


def evidence_of_window(last_rows):
    """Evidence of one window of two pings, the last of which has these rows."""
    s, w = fs.make_state(), make_work()
    past = make_past(2.0, 0.1)
    s.counters[fs.CONSIDERS] = 1
    s.bank[SCALE, 0] = 1.0
    s.counters[fs.BIRTH_NS] = 10**18
    w.narrow_L[:], w.L[:] = np.eye(3), np.eye(3)
    w.nis[1] = 1.0
    w.residual[:] = w.z[:] = 0.7, 0.2, -0.1
    for stamp_ns, rows in ((500_000_000, np.ones((3, N))), (1_500_000_000, last_rows)):
        w.H[:] = rows
        s.counters[fs.STAMP] = stamp_ns
        signatures.note(s, past, w, fs.DVL_ROW, 3, 0.0)
    assert s.bank[hy.LAMBDA, 0] > 0.0
    return s.bank[hy.LAMBDA : hy.ZETA + 1, 0].tolist()


def test_a_window_is_rated_by_rows_that_know_none_of_it():
    """The estimated velocity, in the rows of the scale, has moved with the window's pings."""
    assert evidence_of_window(np.full((3, N), 1.3)) == evidence_of_window(np.ones((3, N)))


@pytest.mark.parametrize('statistic', [13.0, 15.0])
def test_the_likeliest_beginning_makes_no_room(statistic):
    """One from an hour of beginnings, a minute apart; with enough its age does not matter."""
    minute, kinds = 60 * 10**9, 3
    born_ns, evidence = np.zeros(6, dtype=np.int64), np.zeros(6 * kinds)
    held = 7 * minute
    for now_ns in range(minute, 30 * minute, minute):
        slot = slot_to_begin(born_ns, now_ns, 40 * minute, evidence, 14.0)
        born_ns[slot] = now_ns
        evidence[:] = 0.0
        evidence[kinds * np.flatnonzero(born_ns == held) + 1] = statistic
    assert (held in born_ns) == (statistic > 14.0)
    later_ns = held + 41 * minute
    born_ns[born_ns < held] = held + minute
    if held in born_ns:
        oldest = slot_to_begin(born_ns, later_ns, 40 * minute, evidence, 14.0)
        assert born_ns[oldest] == held
