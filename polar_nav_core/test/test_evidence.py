"""How evidence of slow faults is gathered: residuals by window, beginnings, and a twin of `note`.

What a fault does to residuals, and the level of what is found: test_signatures.py.
"""

import numpy as np
import pytest

from polar_nav_core.attitude import matrix_from_euler
from polar_nav_core.engine.sins.history import make_past
from polar_nav_core.kernels.evidence import pair_statistic, slot_to_begin
from polar_nav_core.kernels.sins import consider, signatures
from polar_nav_core.kernels.sins import hypotheses as hy
from polar_nav_core.kernels.sins import state as fs
from polar_nav_core.kernels.sins.update import COUPLED, DR, DV, MARKOV, USBL, N
from polar_nav_core.kernels.sins.work import make_work

S = 1_000_000_000
NOW_NS = 10_000 * S
DVL, DEPTH, FIX = fs.DVL_ROW, fs.DEPTH_ROW, fs.FIX_ROW
OLDEST_NS = 2_400 * S


def test_an_empty_slot_is_taken_first():
    assert slot_to_begin(np.array([5, 0, 7, 0]), 100, 1000, np.zeros(8), 14.0) == 1


@pytest.mark.parametrize(
    ('born', 'expected'),
    [
        ([10, 50, 90, 95], 1),  # ages of 90 and 10 beside it, 50 and 5 beside the next: 9, 10
        ([10, 50, 92, 95], 2),  # 90 and 8, 50 and 5
        ([10, 20, 80, 90], 1),
        ([90, 80, 20, 10], 2),
        ([60, 10, 95, 30], 3),
        ([10, 60, 60, 90], 1),  # of two that are alike the first
        ([10, 20, 50, 52], 2),  # 90 and 50, 80 and 48: 1.8, 1.7
        ([1, 20, 25, 90], 1),  # of an age as old as the clock
    ],
)
def test_the_beginning_makes_room_whose_neighbours_are_closest(born, expected):
    """In the ratio of their ages; the oldest and the newest have one neighbour only."""
    assert slot_to_begin(np.array(born), 100, 1000, np.zeros(8), 14.0) == expected


@pytest.mark.parametrize(('oldest', 'expected'), [(90, 1), (89, 0)])
def test_a_beginning_that_is_too_old_is_the_first_to_make_room(oldest, expected):
    """It has the most evidence, too: that does not keep it."""
    statistic = np.array([0.0, 20.0] + [0.0] * 6)
    assert slot_to_begin(np.array([10, 20, 25, 90]), 100, oldest, statistic, 14.0) == expected


def test_of_beginnings_that_are_all_too_old_the_oldest_makes_room():
    assert slot_to_begin(np.array([90, 20, 25, 10]), 100, 5, np.zeros(8), 14.0) == 3


@pytest.mark.parametrize(('statistic', 'expected'), [(14.0, 1), (14.1, 2)])
def test_the_beginning_with_most_evidence_makes_no_room(statistic, expected):
    evidence = np.zeros(12)
    evidence[1 * 3 + 2], evidence[2 * 3] = statistic, 13.9
    assert slot_to_begin(np.array([10, 20, 25, 90]), 100, 1000, evidence, 14.0) == expected
    evidence[3 * 3 + 1] = statistic + 1.0  # the newest has more: the others may go
    assert slot_to_begin(np.array([10, 20, 25, 90]), 100, 1000, evidence, 14.0) == 1


def test_the_statistic_of_a_pair_is_that_of_both_sizes_together():
    M, z = np.array([[3.0, -1.2], [-1.2, 2.0]]), np.array([1.5, -0.7])
    found = pair_statistic(M[0, 0], M[1, 1], M[0, 1], z[0], z[1])
    assert found == pytest.approx(z @ np.linalg.solve(M, z), rel=1e-12)


@pytest.mark.parametrize(('apart', 'known'), [(2e-6, True), (0.5e-6, False)])
def test_two_sizes_that_cannot_be_told_apart_have_none(apart, known):
    found = pair_statistic(4.0, 9.0, 6.0 * np.sqrt(1.0 - apart), 1.0, 2.0)
    assert bool(found > 0.0) is known


def filled(seed=1, *, considers=True, born_s=()):
    """State at a stamp with beginnings some time ago, a past with a transition, and scratch."""
    rng = np.random.default_rng(seed)
    s, w, past = fs.make_state(), make_work(), make_past(2.0, 0.1)
    s.counters[fs.STAMP] = s.counters[fs.BANK_NS] = NOW_NS
    s.counters[fs.CLOSED_NS : fs.CLOSED_NS + 3] = NOW_NS
    s.counters[fs.BIRTH_NS] = NOW_NS + 1000 * S
    s.counters[fs.CONSIDERS] = int(considers)
    s.counters[fs.STEPS] = len(past.transitions) + 2
    for slot, age_s in enumerate(born_s):
        s.counters[fs.BORN_NS + slot] = NOW_NS - round(age_s * S)
    s.bank[: hy.LAMBDA] = 0.1 * rng.standard_normal((hy.LAMBDA, s.bank.shape[1]))
    s.bank[hy.LAMBDA] = 1.0
    s.shared[1:] = 0.02 * rng.standard_normal((consider.COLUMNS, consider.COLUMNS))
    Phi = np.eye(N) + 0.02 * rng.standard_normal((N, N))
    Phi[DR : DR + 3, DV : DV + 3] = 0.1 * np.linalg.qr(rng.standard_normal((3, 3)))[0]
    Phi[MARKOV, MARKOV], Phi[USBL, USBL] = 0.97, 0.99
    past.transitions[2] = Phi
    return s, past, w


def measured(w, rng, turn=0.0):
    """Rows, gain, factors and innovation of some update in the scratch.

    ``turn`` [rad] is that of the axes of the DVL's slow error.
    """
    w.H[:], w.z[:] = rng.standard_normal((3, N)), rng.standard_normal(3)
    w.H[:, MARKOV : MARKOV + 3] = -matrix_from_euler(turn, 0.0, 0.0)
    w.K[:] = 0.02 * w.H + 0.004 * rng.standard_normal((3, N))
    w.residual[:] = rng.standard_normal(3)
    w.per_sigma[:] = 0.2 * rng.standard_normal(w.per_sigma.shape)
    for L in (w.L, w.narrow_L):
        L[:] = np.tril(0.3 * rng.standard_normal((3, 3)), -1) + np.diag(rng.uniform(0.8, 2.0, 3))
    w.nis[1], w.age[0] = rng.uniform(1.0, 3.0), rng.uniform(0.0, 2.0)


class Twin:
    """The same evidence, in matrices."""

    def __init__(self, s, past):
        self.bank, self.shared = s.bank.copy(), s.shared[1:].copy()
        self.past, self.counters = past, s.counters.copy()
        self.windows = [[] for _ in range(3)]

    def note(self, now_ns, w, stream, m, delay):
        """Add a residual; answers the window with it where that is over."""
        c, considers = self.counters, self.counters[fs.CONSIDERS] == 1
        e, L = (w.residual, w.narrow_L) if considers else (w.z, w.L)
        L = L[:m, :m].copy()
        weight = 1.0 / w.nis[1] if considers else 1.0
        row = weight, np.linalg.solve(L @ L.T, e[:m]), w.H[:m].copy(), w.per_sigma[:m].copy()
        self.windows[stream].append(row)
        axes = slice(MARKOV, MARKOV + 3)
        turned = np.linalg.norm(row[2][:, axes] - self.windows[stream][0][2][:, axes])
        young = now_ns - c[fs.CLOSED_NS + stream] < S
        if stream != FIX and young and turned <= 0.01 * np.sqrt(2.0):
            return
        self._move(now_ns)
        rows, self.windows[stream] = self.windows[stream], []
        c[fs.CLOSED_NS + stream] = now_ns
        number, (_, _, H, J) = sum(r[0] for r in rows), rows[0]
        g = H @ self.bank[:N] - delay * self.bank[DV : DV + m]
        born_ns = c[fs.BORN_NS : fs.BORN_NS + hy.SLOTS]
        for slot in np.flatnonzero(born_ns):
            since = max((now_ns - born_ns[slot]) * 1e-9 - w.age[0], 0.0)
            if stream == FIX:
                g[0, slot * hy.KINDS + hy.FIX_EAST] -= since
                g[1, slot * hy.KINDS + hy.FIX_NORTH] -= since
                g[0, slot * hy.KINDS + hy.STEP_EAST] -= since > 0.0
                g[1, slot * hy.KINDS + hy.STEP_NORTH] -= since > 0.0
        times = max(1, min(50, int(np.floor(number + 0.5))))
        K, one = w.K[:m], np.eye(m)
        X = sum(np.linalg.matrix_power(one - w.H[:m] @ K.T, i) for i in range(times))
        h = np.linalg.solve(L, X @ g / times - J @ self.bank[hy.LEARNED : hy.LAMBDA])
        white = L.T @ sum(r[0] * r[1] for r in rows)
        self.bank[hy.LAMBDA] += number * np.sum(h**2, axis=0)
        self.bank[hy.ZETA] += white @ h
        self._cross(number, h)
        self._statistics(now_ns - born_ns)
        self.bank[:N] -= K.T @ X @ g
        if considers:
            A = np.linalg.solve(L, J)
            B = A - A @ self.shared
            X = sum(np.linalg.matrix_power(one - A @ B.T, i) for i in range(times))
            self.bank[hy.LEARNED : hy.LAMBDA] += weight * B.T @ X @ h

    def _move(self, now_ns):
        c = self.counters
        dt = (now_ns - c[fs.BANK_NS]) * 1e-9
        if dt >= 0.1:
            Phi = self.past.transitions[c[fs.STEPS] % len(self.past.transitions)]
            rate = (Phi - np.eye(N))[: hy.NAV, :COUPLED] / 0.1
            self.bank[: hy.NAV] += dt * rate @ self.bank[:COUPLED]
            self.bank[MARKOV : MARKOV + 3] *= Phi[MARKOV, MARKOV] ** (dt / 0.1)
            self.bank[USBL : USBL + 3] *= Phi[USBL, USBL] ** (dt / 0.1)
            for slot in np.flatnonzero(c[fs.BORN_NS : fs.BORN_NS + hy.SLOTS]):
                column = slot * hy.KINDS + hy.SCALE_GROWS
                self.bank[hy.SCALE : hy.SCALE + 3, column] += dt
                self.bank[hy.ACCEL + 2, slot * hy.KINDS + hy.ACCEL_GROWS] += dt
            c[fs.BANK_NS] = now_ns

    def _cross(self, number, h):
        for i in range(0, self.bank.shape[1], hy.KINDS):
            for k in hy.PAIRS:
                self.bank[hy.CROSS, i + k] += number * h[:, i + k] @ h[:, i + k + 1]

    def _statistics(self, ages_ns):
        b = self.bank
        b[hy.STATISTIC] = b[hy.ZETA] ** 2 / b[hy.LAMBDA]
        for i in range(0, b.shape[1], hy.KINDS):
            for k in hy.PAIRS:
                two = slice(i + k, i + k + 2)
                M = np.diag(b[hy.LAMBDA, two]) + b[hy.CROSS, i + k] * np.eye(2)[::-1]
                b[hy.STATISTIC, two] = b[hy.ZETA, two] @ np.linalg.solve(M, b[hy.ZETA, two])
            if ages_ns[i // hy.KINDS] < 30 * S:
                b[hy.STATISTIC, i : i + hy.KINDS] = 0.0
            if ages_ns[i // hy.KINDS] > 300 * S:
                b[hy.STATISTIC, [i + hy.STEP_EAST, i + hy.STEP_NORTH]] = 0.0


@pytest.mark.parametrize('considers', [True, False])
def test_evidence_is_that_of_the_matrix_equations(considers):
    """Pings every 0.4 s, depths every 0.1 s, a fix now and then; the vehicle turns at last."""
    s, past, w = filled(considers=considers, born_s=(900.0, 31.0, 28.0, 0.5))
    twin, rng, now_ns = Twin(s, past), np.random.default_rng(2), NOW_NS
    for k in range(24):
        stream, m, step_s = ((DVL, 3, 0.3), (DEPTH, 1, 0.1))[k % 2]
        if k % 8 == 7:
            stream, m = FIX, 3
        now_ns += round(step_s * S)
        s.counters[fs.STAMP] = now_ns
        measured(w, rng, 0.004 * max(0, k - 12))
        delay = 1.5 if stream == FIX else 0.0
        twin.note(now_ns, w, stream, m, delay)
        signatures.note(s, past, w, stream, m, delay)
        np.testing.assert_allclose(s.bank, twin.bank, rtol=1e-9, atol=1e-9)
    moved = [fs.BANK_NS, *range(fs.CLOSED_NS, fs.CLOSED_NS + 3)]
    np.testing.assert_array_equal(s.counters[moved], twin.counters[moved])
    assert s.bank[hy.STATISTIC, 3 * hy.KINDS] == 0.0
    assert s.bank[hy.STATISTIC, 2 * hy.KINDS] > 0.0
    for stream, rows in enumerate(twin.windows):
        assert s.windows[stream, 3] == pytest.approx(sum(r[0] for r in rows))


def noted(s, past, w, since_ns, stream=FIX, m=3, turn=0.0):
    """The counters after a residual that comes so long after `NOW_NS`."""
    measured(w, np.random.default_rng(3), turn)
    s.counters[fs.STAMP] = NOW_NS + since_ns
    signatures.note(s, past, w, stream, m, 0.0)
    return s.counters


@pytest.mark.parametrize('stream', [DVL, DEPTH])
def test_pings_and_depths_are_added_up_for_a_second(stream):
    s, past, w = filled()
    m = 3 if stream == DVL else 1
    assert noted(s, past, w, S - 1, stream, m)[fs.CLOSED_NS + stream] == NOW_NS
    assert s.windows[stream, 3] > 0.0
    assert noted(s, past, w, S, stream, m)[fs.CLOSED_NS + stream] == NOW_NS + S
    np.testing.assert_array_equal(s.windows[:, : hy.FIRST_H], 0.0)


@pytest.mark.parametrize(('turn', 'closed_ns'), [(0.0099, NOW_NS), (0.0101, NOW_NS + 2)])
def test_pings_are_added_up_until_the_vehicle_has_turned(turn, closed_ns):
    """A sway within a second tells the DVL's slow error from a velocity."""
    s, past, w = filled()
    noted(s, past, w, 1, DVL, turn=0.3)
    assert noted(s, past, w, 2, DVL, turn=0.3 - turn)[fs.CLOSED_NS + DVL] == closed_ns


def test_fixes_are_not_added_up():
    s, past, w = filled()
    assert noted(s, past, w, 1)[fs.CLOSED_NS + FIX] == NOW_NS + 1
    np.testing.assert_array_equal(s.windows[:, : hy.FIRST_H], 0.0)


def test_signatures_move_on_a_tenth_of_a_second_later():
    s, past, w = filled()
    assert noted(s, past, w, S // 10 - 1)[fs.BANK_NS] == NOW_NS
    assert noted(s, past, w, S // 10)[fs.BANK_NS] == NOW_NS + S // 10


def test_before_the_first_step_signatures_stay_and_count_from_now():
    for bank_ns, step in ((0, True), (NOW_NS, False)):
        s, past, w = filled(born_s=(100.0,))
        s.counters[fs.BANK_NS] = bank_ns
        if not step:
            past.transitions[2] = np.eye(N)
        grows = s.bank[hy.SCALE, hy.SCALE_GROWS]
        w.K[:] = 0.0
        s.counters[fs.STAMP] = NOW_NS + S
        w.L[:] = w.narrow_L[:] = np.eye(3)
        signatures.note(s, past, w, FIX, 3, 0.0)
        assert s.counters[fs.BANK_NS] == NOW_NS + S
        assert s.bank[hy.SCALE, hy.SCALE_GROWS] == grows


def test_every_twenty_seconds_hypotheses_begin_in_an_empty_slot():
    s, past, w = filled(born_s=(100.0,))
    s.counters[fs.BIRTH_NS] = NOW_NS + S
    births = [int(noted(s, past, w, k)[fs.BIRTH_NS]) for k in (S - 1, S, 21 * S - 1, 21 * S)]
    assert births == [NOW_NS + k * S for k in (1, 21, 21, 41)]
    born_ns = s.counters[fs.BORN_NS : fs.BORN_NS + hy.SLOTS]
    assert born_ns.tolist() == [NOW_NS + k * S for k in (-100, 1, 21)] + [0] * (hy.SLOTS - 3)


@pytest.mark.parametrize(('oldest_ns', 'slot'), [(OLDEST_NS, 0), (OLDEST_NS + 1, 3)])
def test_forty_minutes_are_the_oldest_beginning(oldest_ns, slot):
    s, past, w = filled(born_s=(1400, 1300, 600, 0, 300, 100, 60, 30, 15, 7, 3.5, 1.5))
    s.counters[fs.BIRTH_NS] = NOW_NS
    s.counters[fs.BORN_NS + 3] = NOW_NS + S - oldest_ns
    assert noted(s, past, w, S)[fs.BORN_NS + slot] == NOW_NS + S
    assert s.bank[hy.SCALE, slot * hy.KINDS + hy.SCALE_STEP] == pytest.approx(1.0, abs=0.3)


def test_a_beginning_is_judged_after_half_a_minute():
    s, past, w = filled(born_s=(29.0, 28.999999999))
    noted(s, past, w, S)
    statistic = s.bank[hy.STATISTIC].reshape(hy.SLOTS, hy.KINDS)
    assert (statistic[0] > 0.0).all()
    np.testing.assert_array_equal(statistic[1], 0.0)


def test_a_step_of_fixes_is_judged_for_five_minutes():
    """The filter has followed it; whether they have gone back since is another step."""
    s, past, w = filled(born_s=(299.0, 299.000000001))
    noted(s, past, w, S)
    statistic = s.bank[hy.STATISTIC].reshape(hy.SLOTS, hy.KINDS)
    assert (statistic[0] > 0.0).all()
    steps = [hy.STEP_EAST, hy.STEP_NORTH]
    np.testing.assert_array_equal(statistic[1, steps], 0.0)
    assert (np.delete(statistic[1], steps) > 0.0).all()


def test_evidence_that_is_cleared_begins_anew():
    s, _, _ = filled(born_s=(100.0,) * hy.SLOTS)
    s.windows[:] = 1.0
    signatures.clear_evidence(s)
    np.testing.assert_array_equal(s.bank, 0.0)
    np.testing.assert_array_equal(s.windows, 0.0)
    np.testing.assert_array_equal(s.counters[fs.BORN_NS : fs.BORN_NS + hy.SLOTS], 0)
    assert s.counters[fs.BIRTH_NS] == 0
