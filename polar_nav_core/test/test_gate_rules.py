"""Rules by which a gate opens again, and what it makes of the covariance, kernel by kernel.

Whole runs with gates that open: test_reopen.py.
"""

import numpy as np
import pytest

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.sins.history import make_past
from polar_nav_core.engine.sins.log import make_log
from polar_nav_core.engine.sins.settings import make_settings
from polar_nav_core.kernels import watch
from polar_nav_core.kernels.sins import enlarged, reopen
from polar_nav_core.kernels.sins import state as fs
from polar_nav_core.kernels.sins.carried import carried_heading_rows
from polar_nav_core.kernels.sins.judge import judge_rows
from polar_nav_core.kernels.sins.update import N
from polar_nav_core.kernels.sins.work import make_work

S = 1_000_000_000
NOW_NS, SHUT_S = 2_000 * S, 10
DVL, DEPTH, FIX = fs.DVL_ROW, fs.DEPTH_ROW, fs.FIX_ROW
SETTINGS = make_settings(EngineParams())._replace(reopen_ns=SHUT_S * S)


def note(s, stream, memory, *, weight=30.0, share=1.0, agreement=1.0):
    """A memory of so many attempts, refused in this share, whose squared mean has this share."""
    row = s.memories[stream, memory]
    row[watch.WEIGHT], row[watch.REFUSED] = weight, share * weight
    row[watch.GATE : watch.GATE + 3] = weight * np.array([2.0, -1.0, 0.5])
    row[watch.GATE_SQUARE : watch.GATE_SQUARE + 3] = weight * np.array([4.0, 1.0, 0.25])
    row[watch.GATE_SQUARE : watch.GATE_SQUARE + 3] /= agreement


def refused(stream=DVL, short=None, long=None):
    """State in which a sensor that was believed is refused, and the last fix is long ago."""
    s = fs.make_state()
    s.counters[fs.STAMP] = NOW_NS
    s.counters[fs.OPENED_NS : fs.OPENED_NS + 3] = NOW_NS - 1000 * S
    s.counters[fs.USES : fs.USES + 3] = 1000
    note(s, stream, watch.SHORT, **(short or {}))
    note(s, stream, watch.LONG, **{'weight': 100.0, **(long or {})})
    return s


def vouch(s, stream, *, share=0.0, weight=30.0):
    """Let another sensor be heard just now, and refused in a share."""
    s.counters[fs.USED_NS + stream] = NOW_NS
    note(s, stream, watch.SHORT, weight=weight, share=share)


def opens(s, stream=DVL, **changes):
    return bool(reopen.opens(s, SETTINGS._replace(**changes), stream))


@pytest.mark.parametrize('stream', [DVL, DEPTH])
def test_a_local_sensor_that_agrees_for_long_is_heard_again(stream):
    assert opens(refused(stream), stream)
    assert not opens(refused(stream), stream, reopen_ns=0)


def test_fixes_are_the_matter_of_others():
    assert not opens(refused(FIX), FIX)


@pytest.mark.parametrize(
    ('openings', 'since_ns', 'expected'),
    [
        (0, SHUT_S * S, True),
        (0, SHUT_S * S - 1, False),
        (2, 599 * S, True),
        (3, 600 * S - 1, False),
        (3, 600 * S, True),
        (4, 599 * S, False),
    ],
)
def test_three_chances_and_then_one_every_ten_minutes(openings, since_ns, expected):
    s = refused()
    s.counters[fs.OPENED_NS + DVL] = NOW_NS - since_ns
    s.counters[fs.OPENINGS + DVL] = openings
    assert opens(s) is expected


@pytest.mark.parametrize(
    ('short', 'expected'),
    [
        ({'weight': 20.0}, True),
        ({'weight': 19.9}, False),
        ({'share': 0.71}, True),
        ({'share': 0.69}, False),
    ],
)
def test_most_of_twenty_attempts_must_have_been_refused(short, expected):
    assert opens(refused(short=short)) is expected


@pytest.mark.parametrize(
    ('long', 'expected'),
    [
        ({'weight': 60.0}, True),
        ({'weight': 59.9}, False),
        ({'agreement': 0.51}, True),
        ({'agreement': 0.49}, False),
    ],
)
def test_they_must_have_agreed_for_sixty(long, expected):
    assert opens(refused(long=long)) is expected


def test_all_axes_count_for_the_agreement():
    """Half of the squares lie in one direction: enough on an axis by itself, not on all."""
    for axis in range(3):
        s = refused()
        row = s.memories[DVL, watch.LONG]
        row[watch.GATE : watch.GATE + 3] = row[watch.GATE_SQUARE : watch.GATE_SQUARE + 3] = 0.0
        row[watch.GATE + axis], row[watch.GATE_SQUARE + axis] = 100.0, 100.0
        assert opens(s)
        row[watch.GATE_SQUARE + (axis + 1) % 3] = 101.0
        assert not opens(s)


@pytest.mark.parametrize(('uses', 'expected'), [(9, True), (10, False)])
def test_a_fix_vouches_against_a_sensor_that_was_believed(uses, expected):
    s = refused()
    vouch(s, FIX)
    s.counters[fs.USES + DVL] = uses
    assert opens(s) is expected


@pytest.mark.parametrize(
    ('age_ns', 'share', 'expected'),
    [(60 * S, 0.0, False), (60 * S + 1, 0.0, True), (0, 0.49, False), (0, 0.5, True)],
)
def test_a_fix_vouches_for_a_minute_and_if_most_are_used(age_ns, share, expected):
    s = refused()
    vouch(s, FIX, share=share)
    s.counters[fs.USED_NS + FIX] = NOW_NS - age_ns
    assert opens(s) is expected


def test_fixes_that_were_never_heard_vouch_for_nothing():
    s = refused()
    s.counters[fs.USED_NS + FIX] = NOW_NS
    assert opens(s)


def test_a_dvl_vouches_against_depths_and_depths_against_no_dvl():
    depth, dvl = refused(DEPTH), refused(DVL)
    vouch(depth, DVL)
    vouch(dvl, DEPTH)
    assert not opens(depth, DEPTH)
    assert opens(dvl, DVL)
    fix = refused(DEPTH)
    vouch(fix, FIX)
    assert not opens(fix, DEPTH)


@pytest.mark.parametrize(
    ('depths', 'expected'),
    [
        ({'weight': 20.0}, True),
        ({'weight': 19.9}, False),
        ({'share': 0.71}, True),
        ({'share': 0.69}, False),
    ],
)
def test_depths_that_are_refused_back_a_dvl_at_once(depths, expected):
    """Agreement of the newest twenty pings is enough then, though a fix vouches."""
    s = refused(short={'weight': 20.0}, long={'weight': 20.0, 'agreement': 0.1})
    vouch(s, FIX)
    vouch(s, DEPTH, **{'share': 1.0, **depths})
    assert opens(s) is expected
    alone = SETTINGS._replace(most_excess=1.0)
    assert bool(reopen.may_begin_anew(s, alone, DVL)) is expected
    note(s, DVL, watch.SHORT, weight=20.0, agreement=0.1)
    assert not opens(s)


def test_a_dvl_backs_no_depth():
    s = refused(DEPTH, long={'weight': 20.0})
    vouch(s, DVL, share=1.0)
    assert not opens(s, DEPTH)
    assert not reopen.may_begin_anew(s, SETTINGS._replace(most_excess=0.0), DEPTH)


@pytest.mark.parametrize(
    ('row', 'uses', 'expected'), [(3, 10, True), (2, 10, False), (3, 9, False)]
)
def test_fixes_refused_in_a_row_back_a_dvl_that_was_believed(row, uses, expected):
    s = refused(long={'weight': 20.0})
    s.counters[fs.REFUSED_ROW + FIX] = row
    s.counters[fs.USES + DVL] = uses
    assert opens(s) is expected


@pytest.mark.parametrize(
    ('leapt_s', 'opened_s', 'expected'),
    [
        (12, 1000, True),
        (599, 1000, True),
        (600, 1000, False),
        (12, 11, False),
        (12, 12, False),
        (2000, 1000, False),
    ],
)
def test_fixes_do_not_vouch_for_a_heading_after_a_ping_that_leapt(leapt_s, opened_s, expected):
    """They hold velocity and position of an attitude that has turned, with ERROR, for good."""
    s = refused()
    vouch(s, FIX)
    s.counters[fs.LEAPT_NS] = NOW_NS - leapt_s * S
    s.counters[fs.OPENED_NS + DVL] = NOW_NS - opened_s * S
    assert opens(s) is expected


@pytest.mark.parametrize(
    ('uses', 'most_excess', 'expected'), [(10, 0.0, True), (9, 0.0, False), (10, 1.0, False)]
)
def test_a_dvl_that_was_believed_may_say_alone_how_fast_the_vehicle_is(
    uses, most_excess, expected
):
    """But where the IMU may be noisier than stated."""
    s = refused()
    s.counters[fs.USES + DVL] = uses
    assert reopen.may_begin_anew(s, SETTINGS._replace(most_excess=most_excess), DVL) == expected


def begun_anew(since_s, attitude=(1e-3, 2e-3, 3e-3), gyro_sigma=0.1, C_b_G=None, uses=300):
    """State and scratch after a ping that is off by (0.3, -0.4, 1.2) m/s, by `begin_anew`."""
    s, w = fs.make_state(), make_work()
    s.counters[fs.STAMP] = NOW_NS
    s.counters[fs.USES + DVL] = uses
    s.C_b_G[:] = np.eye(3) if C_b_G is None else C_b_G
    s.P[:] = np.diag([*attitude, *[0.01] * (N - 3)])
    s.P[9:12, 9:12] = gyro_sigma**2 * np.diag([0.25, 1.0, 0.5])
    s.v_G[:] = 1.0, 2.0, -0.5
    w.z[:] = 0.3, -0.4, 1.2
    w.R[:] = 0.01 * np.eye(3)
    w.H[:] = 1.0
    w.M[:] = s.P
    reopen.begin_anew(s, w, NOW_NS - round(since_s * S))
    return s, w


@pytest.mark.parametrize(
    ('since_s', 'tilt'), [(2.0, 0.5 / (9.8 * 2.0)), (0.1, 0.2), (0.0, 0.2), (1.0, 0.5 / 9.8)]
)
def test_a_ping_that_begins_anew_makes_velocity_way_and_tilt_uncertain(since_s, tilt):
    s, w = begun_anew(since_s, uses=299)
    square = 0.3**2 + 0.4**2 + 1.2**2
    before = [1e-3, 2e-3, 3e-3, *[0.01] * 6, 0.0025, 0.01, 0.005, *[0.01] * (N - 12)]
    grown = np.diagonal(s.P) - before
    np.testing.assert_allclose(grown[:2], tilt**2, rtol=1e-9)
    assert grown[2] == 0.0
    np.testing.assert_allclose(grown[3:6], square, rtol=1e-9)
    np.testing.assert_allclose(grown[6:9], square * since_s**2, rtol=1e-9)
    np.testing.assert_allclose(grown[9:], 0.0, atol=1e-15)
    assert np.count_nonzero(s.P - np.diag(np.diagonal(s.P))) == 0
    np.testing.assert_array_equal(w.H[:, :3], 0.0)
    np.testing.assert_array_equal(w.H[:, 3:], 1.0)


@pytest.mark.parametrize(
    ('turn', 'expected'),
    [
        ((0.19, 0.0, 0.0), False),
        ((0.0, -0.21, 0.0), True),
        ((0.0, 0.0, 0.49), False),
        ((0.0, 0.1, -0.51), True),
    ],
)
def test_a_ping_that_would_turn_the_attitude_too_far_begins_anew(turn, expected):
    """Against the correction that the update itself would make."""
    rng = np.random.default_rng(8)
    w, m = make_work(), 3
    L = rng.normal(size=(N, N))
    P, w.H[:], R = L @ L.T, rng.normal(size=(3, N)), np.eye(3)
    gain = P @ w.H.T @ np.linalg.inv(w.H @ P @ w.H.T + R)
    w.z[:] = np.linalg.solve(gain[:3], turn)
    assert judge_rows(w, P, w.H, R, w.z, m)
    assert bool(reopen.turns_too_far(w, m)) is expected


def test_a_ping_that_begins_anew_takes_back_what_the_gate_has_put_in_doubt():
    """All but the gyros, whose correlations keep the root; the ping adds a tilt of 0.2 rad."""
    rng = np.random.default_rng(4)
    s, w = fs.make_state(), make_work()
    L = rng.normal(size=(N, N))
    w.M[:] = L @ L.T
    s.P[:] = 25.0 * w.M
    reopen.begin_anew(s, w, 0)
    grown = s.P - w.M
    others = np.r_[0:9, 12:N]
    tilt = np.diag([0.04, 0.04, *[0.0] * (N - 5)])
    np.testing.assert_allclose(grown[np.ix_(others, others)], tilt, atol=1e-12)
    np.testing.assert_allclose(s.P[9:12][:, others], 5.0 * w.M[9:12][:, others], rtol=1e-12)
    np.testing.assert_allclose(s.P[9:12, 9:12], 25.0 * w.M[9:12, 9:12], rtol=1e-12)
    np.testing.assert_allclose(s.P, s.P.T, rtol=1e-13)


@pytest.mark.parametrize(
    ('since_s', 'gyro_sigma', 'bias'),
    [
        (2.0, 0.1, 2.0 * 0.5 / (9.8 * 4.0)),  # b = 2 |z| / (g t^2) of the horizontal 0.5 m/s
        (10.0, 0.1, 2.0 * 0.5 / (9.8 * 100.0)),
        (2.0, 0.5 / 19.6 / 99.5, 0.5 / 19.6),
        (2.0, 0.5 / 19.6 / 100.5, 0.0),  # more than a hundred sigmas of the gyro known least
        (0.0, 0.1, 0.0),
    ],
)
def test_biases_of_gyros_may_be_what_makes_a_ping_begin_anew(since_s, gyro_sigma, bias):
    """That of the vertical one, which shows in nothing yet, has turned the heading since."""
    rng = np.random.default_rng(5)
    C_b_G = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    s, _ = begun_anew(since_s, gyro_sigma=gyro_sigma, C_b_G=C_b_G)
    grown = s.P[9:12, 9:12] - gyro_sigma**2 * np.diag([0.25, 1.0, 0.5])
    close = {'rtol': 0.0, 'atol': 1e-9 * bias**2 * max(1.0, since_s**2) + 1e-18}
    np.testing.assert_allclose(grown, bias**2 * np.eye(3), **close)
    np.testing.assert_allclose(s.P[2, 2] - 3e-3, (bias * since_s) ** 2, **close)
    turned = np.zeros((3, 3))
    turned[2] = -since_s * bias**2 * C_b_G[2]
    np.testing.assert_allclose(s.P[:3, 9:12], turned, **close)
    np.testing.assert_array_equal(s.P[9:12, :3], s.P[:3, 9:12].T)


def test_a_dvl_that_has_not_agreed_for_long_says_nothing_of_gyros():
    s, _ = begun_anew(10.0, uses=299)
    np.testing.assert_allclose(s.P[9:12, 9:12], 0.01 * np.diag([0.25, 1.0, 0.5]), rtol=1e-9)


@pytest.mark.parametrize('attitude', [(5e-3, 2e-3, 3e-3), (1e-3, 4e-3, 3e-3), (1e-3, 2e-3, 9e-3)])
def test_its_noise_gets_what_the_larger_tilt_makes_of_the_velocity(attitude):
    """Not what the heading does: the velocity turns with it (`doubt_heading`)."""
    s, w = begun_anew(2.0, attitude)
    tilt = 0.5 / (9.8 * 2.0)
    turned = (max(attitude[0], attitude[1]) + tilt**2) * np.sum((s.v_G - w.z) ** 2)
    np.testing.assert_allclose(np.diagonal(w.R), 0.01 + turned, rtol=1e-9)
    np.testing.assert_array_equal(w.R - np.diag(np.diagonal(w.R)), 0.0)


@pytest.mark.parametrize('carried', [(0.0, 0.0), (0.3, -0.2)])
def test_an_unknown_heading_is_what_no_ping_shows(carried):
    """By the rows that a ping has in grid axes: H P H^T is that of before."""
    s = fs.make_state()
    rng = np.random.default_rng(6)
    A = rng.normal(size=(N, N))
    s.P[:] = A @ A.T
    s.v_G[:] = 1.0, 2.0, -0.5
    s.carried[:] = carried
    before = s.P.copy()
    reopen.doubt_heading(s)
    H = np.zeros((3, N))
    H[:, 3:6] = np.eye(3)
    carried_heading_rows(H, s.v_G, s.carried)
    np.testing.assert_allclose(H @ s.P, H @ before, atol=1e-12)
    grown = s.P - before
    assert np.linalg.matrix_rank(grown, tol=1e-9) == 1
    assert grown[2, 2] == pytest.approx(0.25)
    np.testing.assert_array_equal(s.P, s.P.T)


@pytest.mark.parametrize(
    ('stream', 'm', 'nis', 'factor'),
    [(DVL, 3, 31.5, 10.5), (DVL, 3, 3.0, 2.0), (DEPTH, 1, 1e4, 100.0), (FIX, 3, 9.0, 3.0)],
)
def test_an_opened_gate_enlarges_the_covariance_by_the_nis_per_row(stream, m, nis, factor):
    s, w = refused(), make_work()
    s.P[:] = np.arange(float(N * N)).reshape(N, N)
    w.nis[0] = nis
    reopen.open_gate(s, w, stream, m)
    np.testing.assert_allclose(s.P, factor * np.arange(float(N * N)).reshape(N, N), rtol=1e-12)


@pytest.mark.parametrize('stream', [DVL, DEPTH, FIX])
def test_an_opened_gate_is_counted_and_its_memories_begin_anew(stream):
    s, w = refused(), make_work()
    s.counters[fs.OPENINGS : fs.OPENINGS + 3] = 1
    s.counters[fs.REFUSED_ROW : fs.REFUSED_ROW + 3] = 7
    s.counters[fs.BORN_NS], s.counters[fs.BIRTH_NS] = NOW_NS, NOW_NS
    for memory in (s.memories, s.shared, s.bank, s.windows):
        memory[:] = 1.0
    reopen.open_gate(s, w, stream, 3)
    for memory in (s.memories[stream], s.shared, s.bank, s.windows):
        np.testing.assert_array_equal(memory, 0.0)
    others = np.arange(3) != stream
    np.testing.assert_array_equal(s.memories[others], 1.0)
    openings, row, opened = (
        s.counters[k : k + 3] for k in (fs.OPENINGS, fs.REFUSED_ROW, fs.OPENED_NS)
    )
    np.testing.assert_array_equal(openings, np.where(others, 1, 2))
    np.testing.assert_array_equal(row, np.where(others, 7, 0))
    np.testing.assert_array_equal(opened, np.where(others, NOW_NS - 1000 * S, NOW_NS))
    assert (s.counters[fs.BORN_NS], s.counters[fs.BIRTH_NS]) == (0, 0)


@pytest.mark.parametrize(
    ('values', 'expected'),
    [
        ({2: 0.11}, True),
        ({2: -0.11}, True),
        ({2: 0.09}, False),
        ({3: 0.4, 4: -0.4}, True),
        ({3: 0.3, 4: -0.3}, False),
        ({0: 1.0, 1: 1.0, 5: 9.0, 6: 9.0}, False),
    ],
)
def test_a_correction_leaps_by_its_turn_about_up_or_its_horizontal_velocity(values, expected):
    x = np.zeros(N)
    for k, value in values.items():
        x[k] = value
    assert reopen.leaps(x) is expected


@pytest.fixture
def stored():
    """State, scratch and a log whose newest step of several has stored another covariance."""
    s, w, log = fs.make_state(), make_work(), make_log(make_past(1.0, 0.1), steps=True)
    rng = np.random.default_rng(1)
    s.P[:], log.step_P[:] = rng.standard_normal((N, N)), rng.standard_normal(log.step_P.shape)
    s.v_G[:] = 1.0, -2.0, 0.5
    w.x[:] = rng.standard_normal(N)
    s.counters[fs.STEPS] = 2 * len(log.step_P) + 3
    return s, w, log


def test_what_a_covariance_has_grown_by_is_told_to_the_newest_step(stored):
    s, w, log = stored
    before, held = log.step_P.copy(), s.P.copy()
    enlarged.hold_covariance(s, w)
    grown = np.random.default_rng(2).standard_normal((N, N))
    s.P[:] = held + grown
    enlarged.tell_enlarged(s, w, log)
    np.testing.assert_allclose(log.step_P[3] - before[3], grown, atol=1e-12)
    np.testing.assert_array_equal(s.P, held + grown)
    others = np.arange(len(before)) != 3
    np.testing.assert_array_equal(log.step_P[others], before[others])


def test_so_is_the_remainder_of_a_large_correction(stored):
    s, w, log = stored
    before = log.step_P.copy()
    enlarged.tell_bend(s, w, log)
    variance = 0.25 * np.sum(w.x[:3] ** 2) ** 2
    added = np.diag([variance] * 3 + [variance * 5.25] * 3 + [0.0] * (N - 6))
    np.testing.assert_allclose(log.step_P[3] - before[3], added, rtol=1e-9, atol=1e-12)
    others = np.arange(len(before)) != 3
    np.testing.assert_array_equal(log.step_P[others], before[others])


def test_a_filter_that_logs_no_steps_is_told_nothing(stored):
    s, w, _ = stored
    log = make_log(make_past(1.0, 0.1))
    enlarged.hold_covariance(s, w)
    enlarged.tell_enlarged(s, w, log)
    enlarged.tell_bend(s, w, log)
    assert log.step_P.shape == (0, N, N)
