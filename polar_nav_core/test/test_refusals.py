"""What is usable by columns is what is usable event by event."""

from unittest import mock

import numpy as np
from compiled import jit_only
from hypothesis import given
from hypothesis import strategies as st
from slow_imu_sequence import SlowSequence

from polar_nav_core import spilled
from polar_nav_core.engine import imu_sequence, refusals
from polar_nav_core.engine.events import ControlSample, DepthSample, DvlPing, ImuSample
from polar_nav_core.engine.imu_sequence import ImuSequence
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.verdicts import Verdict

SINS = EngineParams()
STATION = EngineParams(mode='station', configuration='default')
NUMBERS = st.sampled_from(
    [0.0, 1.0, -1.0, 0.5, 5e-324, 30.0, 1e6, 1e300, -1e308, np.nan, np.inf, -np.inf]
)


def columns(draw, n, *shape):
    """Mostly good numbers, so that rows that are good altogether occur."""
    values = np.ones((n, *shape))
    for _ in range(draw(st.integers(0, 4)) if n else 0):
        values.reshape(-1)[draw(st.integers(0, values.size - 1))] = draw(NUMBERS)
    return values


def matrices(draw, n):
    """Mostly unit matrices with a few other numbers, some on both sides of the diagonal."""
    values = np.tile(np.eye(3), (n, 1, 1))
    for _ in range(draw(st.integers(0, 4)) if n else 0):
        k, i, j = (draw(st.integers(0, m - 1)) for m in (n, 3, 3))
        values[k, i, j] = draw(NUMBERS)
        if draw(st.booleans()):
            values[k, j, i] = values[k, i, j]
    return values


def one_by_one(params, events):
    """Scalar form, with the stamp of the last usable IMU sample as the engine keeps it."""
    usable, last_ns = [], None
    sequence, slow = ImuSequence(params), SlowSequence(params)
    for event in events:
        good = refusals.unusable_local(params, event, last_ns) is None
        if good and isinstance(event, ImuSample):
            refused = sequence.refusal(event.stamp_ns, event.omega_ib_b, event.f_b)
            values = event.omega_ib_b.tolist(), event.f_b.tolist()
            assert refused == slow.refusal(event.stamp_ns, *values)
            good = refused is None
        usable.append(good)
        if good:
            last_ns = event.stamp_ns
    return usable


@given(st.data())
def test_imu(data):
    n = data.draw(st.integers(0, 20))
    stamps = np.cumsum([0, *data.draw(st.lists(st.integers(0, 1), min_size=n, max_size=n))])[1:]
    omega_ib_b, f_b = (columns(data.draw, n, 3) for _ in range(2))
    C_b_G = matrices(data.draw, n)
    samples = [ImuSample(int(stamps[k]), k, omega_ib_b[k], f_b[k]) for k in range(n)]
    usable, refused = refusals.usable_imu(SINS, stamps, omega_ib_b, f_b)
    assert usable.tolist() == one_by_one(SINS, samples)
    assert not usable[list(refused)].any()
    samples = [
        ImuSample(int(stamps[k]), k, omega_ib_b[k], np.zeros(3), C_b_G[k]) for k in range(n)
    ]
    usable, refused = refusals.usable_imu(STATION, stamps, omega_ib_b, C_b_G)
    assert usable.tolist() == one_by_one(STATION, samples)
    assert not refused


@given(st.data())
def test_dvl(data):
    n = data.draw(st.integers(0, 8))
    valid = np.array(data.draw(st.lists(st.booleans(), min_size=n, max_size=n)), dtype=bool)
    v_m, covariance_m = columns(data.draw, n, 3), matrices(data.draw, n)
    pings = [DvlPing(k, k, bool(valid[k]), v_m[k], covariance_m[k]) for k in range(n)]
    assert refusals.usable_dvl(SINS, valid, v_m, covariance_m).tolist() == one_by_one(SINS, pings)


@given(st.data())
def test_depth(data):
    n = data.draw(st.integers(0, 8))
    depth, variance = columns(data.draw, n), columns(data.draw, n)
    samples = [DepthSample(k, k, float(depth[k]), float(variance[k])) for k in range(n)]
    assert refusals.usable_depth(SINS, depth, variance).tolist() == one_by_one(SINS, samples)


@given(st.data())
def test_control(data):
    n = data.draw(st.integers(0, 8))
    force_b, torque_b = columns(data.draw, n, 3), columns(data.draw, n, 3)
    samples = [ControlSample(k, k, force_b[k], torque_b[k]) for k in range(n)]
    assert refusals.usable_control(SINS, force_b, torque_b).tolist() == one_by_one(SINS, samples)
    samples = [ControlSample(k, k, force_b[k], np.zeros(3)) for k in range(n)]
    assert refusals.usable_control(SINS, force_b).tolist() == one_by_one(SINS, samples)


def test_an_imu_that_hangs_is_refused_after_five_repeats():
    values = [np.full(3, 0.1)] * 9 + [np.full(3, 0.2)] * 6
    samples = [ImuSample(k, k, v, v) for k, v in enumerate(values)]
    found = one_by_one(SINS, samples)
    assert found == [True] * 6 + [False] * 3 + [True] * 6
    _, refused = refusals.usable_imu(SINS, np.arange(15), np.array(values), np.array(values))
    said = {row: sentence.split(', ')[1] for row, (_, sentence) in refused.items()}
    assert said == {k: f'{k} times so far: it hangs' for k in (6, 7, 8)}
    never = EngineParams(max_imu_repeats=0)
    assert all(one_by_one(never, samples))


RATES = st.sampled_from([0.0, 0.0, 0.0, 0.0, 0.1, 0.45, 0.8, -0.3, 2.0, -4.0])


def columns_are_as_one_by_one(rows):
    """Compare what is refused; a row has the time since the last, a rate and a force."""
    stamps = np.cumsum([dt for dt, _, _ in rows], dtype=np.int64)
    omega_ib_b, f_b = np.zeros((len(rows), 3)), np.zeros((len(rows), 3))
    if rows:
        omega_ib_b[:, 0] = [x for _, x, _ in rows]
        f_b[:, 2] = [z for _, _, z in rows]
    samples = [ImuSample(int(stamps[k]), k, omega_ib_b[k], f_b[k]) for k in range(len(rows))]
    usable, refused = refusals.usable_imu(SINS, stamps, omega_ib_b, f_b)
    assert usable.tolist() == one_by_one(SINS, samples)
    assert not usable[list(refused)].any()


@given(st.lists(st.tuples(st.sampled_from([1, 1, 1, 10_000_000, 30_000_000, 0]), RATES, RATES)))
def test_what_is_odd_in_columns_is_what_is_odd_one_by_one(rows):
    columns_are_as_one_by_one(rows)


@given(
    st.lists(
        st.tuples(st.sampled_from([1, 1, 10_000_000, 0]), RATES, st.sampled_from([0.0, 0.0, 9.8])),
        min_size=8,
        max_size=60,
    )
)
def test_so_it_is_where_columns_are_looked_at_some_rows_at_a_time(rows):
    with mock.patch.object(spilled, 'ROWS', 4):
        columns_are_as_one_by_one(rows)


def leaping(*rates, step_ns=10_000_000, **changes):
    """Which samples of these rates about x [rad/s] are used."""
    samples = [
        ImuSample(k * step_ns, k, np.array([w, 0.0, 0.0]), np.array([0.0, 0.0, 9.8 + 1e-3 * k]))
        for k, w in enumerate(rates)
    ]
    return one_by_one(EngineParams(**changes), samples)


def test_one_sample_whose_rate_leaps_is_refused_and_the_next_is_not():
    assert leaping(0.1, 0.1, 1.2, 0.1, 0.1) == [True, True, False, True, True]
    assert leaping(0.1, 0.1, 0.79, 0.1) == [True] * 4  # 0.5 rad/s and 20 rad/s^2 in 10 ms
    assert leaping(0.1, 0.1, 0.805, 0.1) == [True, True, False, True]
    assert leaping(0.1, 0.1, 0.81, 0.1, step_ns=20_000_000) == [True] * 4
    assert leaping(0.1, 0.1, 1.2, 0.1, max_rate_leap=1e300) == [True] * 4


def test_a_rate_may_leap_about_any_axis():
    stamps, forces = np.arange(4) * 10_000_000, 9.8 + 1e-3 * np.arange(12.0).reshape(4, 3)
    for axis in range(3):
        rates = 1e-3 * np.arange(12.0).reshape(4, 3)
        rates[2, axis] = 1.2
        usable, _ = refusals.usable_imu(SINS, stamps, rates, forces)
        assert usable.tolist() == [True, True, False, True], axis


def test_a_rate_may_change_by_just_what_is_allowed():
    quarter_ns = 250_000_000  # 20 rad/s^2 make 5 rad/s of it, and 0.5 may leap
    assert leaping(0.0, 5.5, 0.0, step_ns=quarter_ns) == [True] * 3
    beyond = float(np.nextafter(5.5, 6.0))
    assert leaping(0.0, beyond, 0.0, step_ns=quarter_ns) == [True, False, True]


def test_a_rate_that_stays_is_believed_from_its_second_sample_on():
    assert leaping(0.1, 1.2, 1.3, 1.2, 0.1, 0.1) == [True, False, True, True, False, True]
    assert leaping(0.0, 2.0, -2.0, 2.0, 0.0) == [True, False, False, False, True]


def test_the_receipt_of_a_leap_says_what_and_how_far():
    rates = np.array([[0.1, 0.0, 0.0], [1.35, 0.0, 0.0], [0.1, 0.0, 0.0]])
    f_b = np.array([[0.0, 0.0, 9.8], [0.0, 0.0, 9.81], [0.0, 0.0, 9.79]])
    _, refused = refusals.usable_imu(SINS, np.array([0, 10, 20]) * 1_000_000, rates, f_b)
    ((row, (verdict, sentence)),) = refused.items()
    assert (row, verdict) == (1, Verdict.IMPLAUSIBLE)
    assert sentence.startswith('a rate 1.25 rad/s off the one before, max_rate_leap is 0.5 rad/s')


SEGMENTS = st.lists(
    st.tuples(
        st.sampled_from(['', '', 'xyz', 'abc', 'xyzabc', 'x', 'yzb', 'xy']),
        st.integers(1, 14),
        st.sampled_from([1, 1, 1, 0]),
        st.sampled_from([0.0, 0.0, 0.0, 0.0, 2.0, 9.0]),
    ),
    max_size=14,
)
"""Axes that repeat their values (xyz: rates, abc: forces), for how many samples, how far apart in
time, and a rate that their last one has besides."""


def segmented(segments):
    """Stamps [ns], rates and forces of an IMU some of whose axes stand still for a while."""
    stamps, values = [0], [np.full(6, 1e-3)]
    for stand, count, step, leap in segments:
        for k in range(count):
            moved = np.array([name not in stand for name in 'xyzabc'])
            stamps.append(stamps[-1] + step * 10_000_000)
            values.append(np.where(moved, 1e-3 * len(stamps), values[-1]))
            values[-1][0] += leap * (k == count - 1)
    values = np.array(values)
    return np.array(stamps), values[:, :3], values[:, 3:]


@given(SEGMENTS, st.integers(0, 5), st.integers(0, 5), st.sampled_from([2, 4, 1 << 13]))
def test_instruments_that_hang_do_so_in_columns_as_one_by_one(segments, most, alone, rows):
    params = EngineParams(max_imu_repeats=most, max_instrument_repeats=alone)
    stamps, omega_ib_b, f_b = segmented(segments)
    samples = [ImuSample(int(t), k, omega_ib_b[k], f_b[k]) for k, t in enumerate(stamps)]
    with (
        mock.patch.object(imu_sequence, 'LIVELY', 9),
        mock.patch.object(spilled, 'ROWS', rows),
    ):
        usable, refused = refusals.usable_imu(params, stamps, omega_ib_b, f_b)
        assert usable.tolist() == one_by_one(params, samples)
    assert not usable[list(refused)].any()


def used(omega_ib_b, f_b, **changes):
    """Which samples at 100 Hz are used, one by one and in columns, and what is said of others."""
    params = EngineParams(**changes)
    stamps = np.arange(len(f_b)) * 10_000_000
    samples = [ImuSample(int(t), k, omega_ib_b[k], f_b[k]) for k, t in enumerate(stamps)]
    usable, refused = refusals.usable_imu(params, stamps, omega_ib_b, f_b)
    assert usable.tolist() == one_by_one(params, samples)
    return usable, [sentence for _, sentence in refused.values()]


def noise(rng, count, lsb):
    """Gyros, or accelerometers, with noise and a resolution [LSB of noise], (count, 3)."""
    return 1e-4 * np.round(rng.standard_normal((count, 3)) * lsb) / lsb


def test_gyros_that_hang_are_refused_while_forces_go_on():
    rng = np.random.default_rng(7)
    rates, forces = noise(rng, 1000, 4.0), 9.8 + noise(rng, 1000, 1e6)
    hung = rates.copy()
    hung[500:600] = hung[499]
    hung[700:730] = hung[699]  # again, sooner than it could be known anew
    for omega_ib_b, f_b, name, other in (
        (hung, forces, 'gyros', 'forces'),
        (forces - 9.8, hung + 9.8, 'accelerometers', 'rates'),
    ):
        usable, said = used(omega_ib_b, f_b)
        assert np.flatnonzero(~usable).tolist() == [*range(505, 600), *range(705, 730)]
        assert said[0] == (
            f'the {name} repeat one sample, 6 times so far, and the {other} go on: they hang'
        )
        assert used(omega_ib_b, f_b, max_instrument_repeats=0)[0].all()


def test_gyros_that_go_on_with_two_axes_as_they_hung_are_still_known_to_hang():
    """An axis that moves again ends the row of repeats of the others, too: those are by chance."""
    rng = np.random.default_rng(11)
    rates, forces = noise(rng, 400, 1e6), 9.8 + noise(rng, 400, 1e6)
    rates[350:363] = rates[349]
    rates[360:363, 0] += [1e-4, 2e-4, 3e-4]
    rates[370:380] = rates[369]
    usable, _ = used(rates, forces)
    assert np.flatnonzero(~usable).tolist() == [*range(355, 360), *range(375, 380)]


def test_what_was_lively_for_less_than_300_samples_may_repeat():
    rng = np.random.default_rng(8)
    forces = 9.8 + noise(rng, 400, 1e6)
    for lively, refused in ((299, 0), (300, 94)):
        rates = noise(rng, 400, 1e6)
        rates[lively + 1 - 6 : lively + 95] = rates[lively + 1 - 6]
        usable, _ = used(rates, forces)
        assert (~usable).sum() == refused


@jit_only
def test_coarse_gyros_at_rest_are_never_refused():
    """An hour at rest, with resolutions from a tenth of the noise to five times the noise."""
    rng = np.random.default_rng(9)
    stamps, forces = np.arange(360_000) * 10_000_000, 9.8 + noise(rng, 360_000, 1e6)
    for lsb in (10.0, 4.0, 2.0, 1.0, 0.5, 0.2):
        usable, _ = refusals.usable_imu(SINS, stamps, noise(rng, 360_000, lsb), forces)
        assert usable.all(), lsb


def test_coarse_gyros_that_come_to_rest_at_once_are_not_refused():
    """They swing by degrees in 3 to 7 s, and stand still from one sample to the next."""
    time_s = 0.01 * np.arange(6000)[:, None]
    swing = 0.1 * np.sin(2.0 * np.pi * time_s / [3.0, 5.0, 7.0] + [0.0, 1.0, 2.0])
    swing[4000:] = 0.0
    forces = 9.8 + noise(np.random.default_rng(10), 6000, 1e6)
    for resolution in (1e-3, 3e-4, 1e-4):
        usable, _ = used(resolution * np.round(swing / resolution), forces)
        assert usable.all(), resolution
