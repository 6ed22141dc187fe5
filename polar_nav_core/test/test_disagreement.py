"""Refused fixes: those that show a wrong heading are believed, displaced ones are not."""

import dataclasses
import math

import numpy as np
import pytest
from closed_loop import World, inputs_of, run

from polar_nav_core.attitude import matrix_from_euler
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.disagreement import Present, Refused, RefusedRow, Unlearnt, turn_of
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Command, CommandKind
from polar_nav_core.engine.health.heading import heading_lost, heading_unknown
from polar_nav_core.engine.health.watchdog import Level
from polar_nav_core.engine.integrity import IntegrityMonitor
from polar_nav_core.engine.sins.turned import forget, free_since_ns
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.kernels.sins import state as fs
from polar_nav_core.kernels.sins import update as kf

pytestmark = pytest.mark.slow

MEMS = Unlearnt(heading=0.6, scale=0.03, gyro_bias=0.01)
TACTICAL = Unlearnt(heading=0.0015, scale=0.004, gyro_bias=5e-6)
SIGMA, PERIOD_S = 2.0, 5.0
TIME_S = PERIOD_S * np.arange(10)


def row(offset, track, seed=1):
    """Refused fixes by their offsets from an estimated track, both east + i north."""
    rng = np.random.default_rng(seed)
    noise = SIGMA * (rng.standard_normal(10) + 1j * rng.standard_normal(10))
    offset = offset + noise
    return [
        Refused(
            round(t * 1e9),
            np.array([(d + o).real, (d + o).imag, 0.0]),
            SIGMA**2 * np.eye(3),
            np.array([o.real, o.imag, 0.0]),
        )
        for t, d, o in zip(TIME_S, track, offset, strict=True)
    ]


def turned(track, angle, rate):
    """A track that is turned by an angle at its end, which grows at a rate."""
    middle_s = 0.5 * (TIME_S[1:] + TIME_S[:-1]) - TIME_S[-1]
    pieces = np.diff(track) * np.exp(1j * (angle + rate * middle_s))
    return track[0] + np.concatenate([[0.0], np.cumsum(pieces)])


def present(track, age_s=0.0, bent=None):
    """The estimate some time after the newest fix, whose track goes on as it was."""
    velocity = (track[-1] - track[-2]) / PERIOD_S
    here = track[-1] + velocity * age_s
    stamp_ns = round((TIME_S[-1] + age_s) * 1e9)
    way = None if bent is None else np.append(bent, 0.0)
    return Present(stamp_ns, np.array([here.real, here.imag, 0.0]), lambda _: way)


STRAIGHT = 2.0 * TIME_S * np.exp(0.3j)
CORNER = np.where(TIME_S < 25.0, 2.0 * TIME_S, 50.0 + 2.0j * (TIME_S - 25.0))


@pytest.mark.parametrize('track', [STRAIGHT, CORNER])
@pytest.mark.parametrize(('angle', 'rate'), [(1.2, 0.0), (-0.7, 0.012)])
def test_a_turned_track_is_found(track, angle, rate):
    found = turn_of(
        row(turned(track, angle, rate) - track + 30.0, track), np.eye(3), present(track), MEMS
    )
    assert found is not None
    sigma = np.sqrt(np.diagonal(found.covariance))
    assert abs(found.angle - angle) < 3.0 * sigma[0] < 0.7
    assert abs(found.rate - rate) < 3.0 * sigma[1] < 0.1


def test_a_turn_that_the_start_does_not_contain_is_no_explanation():
    fixes = row(turned(STRAIGHT, 1.2, 0.0) - STRAIGHT, STRAIGHT)
    assert turn_of(fixes, np.eye(3), present(STRAIGHT), TACTICAL) is None


@pytest.mark.parametrize('sigmas', [MEMS, TACTICAL])
def test_displaced_fixes_are_no_turn(sigmas):
    assert turn_of(row(40.0 + 0j * TIME_S, STRAIGHT), np.eye(3), present(STRAIGHT), sigmas) is None


@pytest.mark.parametrize('sigmas', [MEMS, TACTICAL])
def test_displaced_fixes_beside_a_position_that_was_corrected_are_no_turn(sigmas):
    """A jump of the estimate among them bends the offsets, and not dead reckoning."""
    estimated = STRAIGHT + np.where(TIME_S < 22.0, 0.0, 40.0j)
    refused = row(STRAIGHT + 60.0 - estimated, estimated)
    now = present(estimated, bent=STRAIGHT[-1] - STRAIGHT)
    assert turn_of(refused, np.eye(3), now, sigmas) is None


@pytest.mark.parametrize('sigmas', [MEMS, TACTICAL])
def test_scattered_fixes_are_no_turn(sigmas):
    far = 20.0 * np.exp(2j * np.pi * np.random.default_rng(2).random(10))
    assert turn_of(row(far, STRAIGHT), np.eye(3), present(STRAIGHT), sigmas) is None


@pytest.mark.parametrize('speed', [0.3, 1.0])
def test_drifting_fixes_move_no_good_navigation(speed):
    assert (
        turn_of(row(speed * TIME_S * 1j, STRAIGHT), np.eye(3), present(STRAIGHT), TACTICAL) is None
    )


@pytest.fixture(scope='module')
def world():
    return World(150.0, leg_s=40.0)


def start(world, **changes):
    """Parameters of a filter that starts 150 deg off, of 50 deg stated, and locks there."""
    heading = world.params().initial_grid_heading_deg
    values = {
        'configuration': 'default',
        'initial_grid_heading_deg': heading + 150.0,
        'initial_sigma_heading_deg': 50.0,
        'gyro_bias_sigma': 1e-3,
        'initial_sigma_position': 5.0,
        'dvl_turn_velocity': 'known',
    }
    return world.params(**{**values, **changes})


def fixes_of(world, delay_s=1.0):
    rng = np.random.default_rng(4)
    return world.fixes(2.0, lambda i: delay_s + 0.3 * (i % 4), rng=rng)


def last_error(world, track):
    return float(np.linalg.norm(track.r_e[-1] - world.r_e[-1]))


@pytest.mark.parametrize('velocity', ['known', 'carried'])
def test_fixes_turn_a_heading_that_has_locked(world, velocity):
    inputs = inputs_of(world, fixes_of(world))
    chosen = {'dvl_turn_velocity': velocity}
    shut = engine_run.run(start(world, reopen_after_s=0.0, **chosen), inputs, look_every_s=1.0)
    assert shut.verdicts[Verdict.GATED] > 60
    assert last_error(world, shut.track) > 2.0 * shut.health[-1].radius_95
    found = engine_run.run(start(world, **chosen), inputs, look_every_s=1.0)
    assert found.verdicts[Verdict.GATED] < 20
    assert last_error(world, found.track) < 2.0
    assert found.health[-1].resets >= 1
    said = [p.condition for h in found.health for p in h.present]
    assert any(c.key == 'fixes reopened' and c.level is Level.ERROR for c in said)


def leaping(world, heading_deg, *, rate=3.0, sigma_deg=1.3):
    """Engine at the ping in a fast turn that contradicts its heading, with common errors of a DVL.

    An IMU that lacks a sample where the turn begins leaves such a sigma.
    """
    common = {'configuration': 'default', 'dvl_latency_sigma': 0.05, 'dvl_lever_sigma': 0.1}
    engine = Engine(world.params(**common))
    pings = world.dvl(rng=np.random.default_rng(2))[:150]
    ping = pings.pop()
    before = [
        e for e in [*world.imu()[:2998], *pings, *world.depth()] if e.stamp_ns < ping.stamp_ns
    ]
    run(engine, before)
    state = engine.fusion.filter.state
    turn = matrix_from_euler(math.radians(heading_deg), 0.0, 0.0)
    state.C_b_G[:] = turn @ state.C_b_G
    state.P[2, 2] += math.radians(sigma_deg) ** 2
    for sample in world.imu()[2998:3000]:
        omega = sample.omega_ib_b + np.array([0.0, 0.0, rate])
        list(engine.process(dataclasses.replace(sample, omega_ib_b=omega)))
    list(engine.process(ping))
    list(engine.process(world.imu()[3000]))
    return engine


def test_a_ping_that_leaps_frees_the_heading_and_is_an_error(world):
    engine = leaping(world, 12.0)
    f = engine.fusion.filter
    assert f.state.counters[fs.REFUSED_ROW + fs.DVL_ROW] == 0
    assert f.state.counters[fs.LEAPT_NS] == f.state.counters[fs.USED_NS + fs.DVL_ROW]
    assert free_since_ns(f) == f.state.counters[fs.LEAPT_NS]
    (leapt,) = [p.condition for p in engine.look().present if p.condition.key == 'DVL leapt']
    assert leapt.level is Level.ERROR


@pytest.mark.parametrize(
    'changes',
    [{'heading_deg': 2.0}, {'heading_deg': 12.0, 'sigma_deg': 12.0}, {'heading_deg': 60.0}],
)
def test_a_ping_that_is_refused_or_as_expected_does_not_leap(world, changes):
    f = leaping(world, **changes).fusion.filter
    assert f.state.counters[fs.LEAPT_NS] == 0
    assert free_since_ns(f) is None


@pytest.mark.parametrize('handling', ['clone', 'rewind', 'back_propagate'])
def test_whole_runs_turn_as_nodes_do(world, handling):
    inputs = inputs_of(world, fixes_of(world))
    custom = {'configuration': 'custom', 'gate_probability': 0.9999, 'delay_handling': handling}
    params = start(world, **custom)
    whole, single = (
        engine_run.run(params, inputs, one_by_one=k, look_every_s=1.0) for k in (False, True)
    )
    np.testing.assert_array_equal(whole.track.P, single.track.P)
    np.testing.assert_array_equal(whole.track.r_e, single.track.r_e)
    assert whole.health == single.health
    assert whole.health[-1].resets >= 1


@pytest.mark.parametrize('handling', ['clone', 'rewind', 'back_propagate'])
def test_fixes_from_before_a_turn_are_too_old(world, handling):
    """What is stored of then is another track, from where a correction leads nowhere."""
    custom = {'configuration': 'custom', 'gate_probability': 0.9999, 'delay_handling': handling}
    inputs = inputs_of(world, fixes_of(world, delay_s=5.0))
    found = engine_run.run(start(world, **custom), inputs)
    turned_at = next(i for i, r in enumerate(found.receipts) if r.verdict is Verdict.TOO_OLD)
    assert {r.verdict for r in found.receipts[:turned_at]} == {Verdict.FUSED, Verdict.GATED}
    assert 'the stored history reaches back' in found.receipts[turned_at].reason
    assert sum(r.verdict is Verdict.TOO_OLD for r in found.receipts) <= 3
    assert last_error(world, found.track) < 2.0


def test_a_turn_leaves_nothing_of_what_was_known_by_the_wrong_heading():
    """Against samples: states of a covariance, of which heading and position are drawn anew."""
    rng = np.random.default_rng(7)
    state = fs.make_state()
    L = rng.normal(size=(kf.N, kf.N))
    state.P[:] = L @ L.T
    state.sensitivity[:] = rng.normal(size=state.sensitivity.shape)
    before, S = state.P.copy(), state.sensitivity.copy()
    C_e_G = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    forget(state, C_e_G)
    keep = np.r_[0:2, 3:6, 9 : kf.N]
    given_heading = before - np.outer(before[:, 2], before[2]) / before[2, 2]
    np.testing.assert_allclose(state.P[np.ix_(keep, keep)], given_heading[np.ix_(keep, keep)])
    np.testing.assert_array_equal(state.P[2], 0.0)
    level = C_e_G[:2] @ state.P[6:9]
    np.testing.assert_allclose(level, 0.0, atol=1e-12)
    up = C_e_G[2]
    assert up @ state.P[6:9, 6:9] @ up == pytest.approx(up @ given_heading[6:9, 6:9] @ up)
    assert np.linalg.eigvalsh(state.P).min() > -1e-12
    np.testing.assert_allclose(state.sensitivity[2], 0.0, atol=1e-12)
    by_heading = S - np.outer(before[:, 2] / before[2, 2], S[2])
    np.testing.assert_allclose(state.sensitivity[keep], by_heading[keep], atol=1e-12)
    np.testing.assert_array_equal(state.sensitivity[6:9, 6:11], 0.0)
    np.testing.assert_allclose(state.sensitivity[6:9, :6], by_heading[6:9, :6])


@pytest.mark.parametrize(('since_s', 'found'), [(-1.0, True), (22.0, False), (None, False)])
def test_the_newest_fixes_show_a_turn_after_an_attitude_that_ran_away(since_s, found):
    """The first four are valid while the velocity is wrong, behind the opening of the gate."""
    fixes = turned(STRAIGHT, 2.5, 0.0)
    estimated = STRAIGHT - np.where(TIME_S < 20.0, 12.0j * (20.0 - TIME_S), 0.0)
    refused = RefusedRow()
    for one in row(fixes - estimated, estimated):
        refused._row.append(one)
    unknown = dataclasses.replace(TACTICAL, heading=1.8)
    since_ns = None if since_s is None else round(since_s * 1e9)
    turn = refused.turn(np.eye(3), present(estimated), unknown, since_ns)
    assert (turn is not None) == found
    assert turn is None or turn.angle == pytest.approx(2.5, abs=0.3)


def test_an_unknown_heading_is_an_error_until_fixes_have_shown_it():
    assert not heading_unknown(0.5, 0.5, 0)
    assert [c.level for c in heading_unknown(1.8, 0.01, 5)] == [Level.ERROR]
    assert heading_unknown(1.8, 0.3, 50)
    assert not heading_unknown(1.8, 0.01, 40)


def test_a_lost_heading_is_an_error_until_it_was_measured():
    """A small sigma is what a filter may have talked itself into."""
    (condition,) = heading_lost(0.01, 300.0, measured=False)
    assert condition.level is Level.ERROR
    assert condition.sentence.endswith('300 s ago: no DVL, AHRS or compass has shown it')
    assert '17 deg stated' in heading_lost(0.3, 300.0, measured=True)[0].sentence
    assert not heading_lost(0.01, 300.0, measured=True)


@pytest.mark.parametrize('age_s', [0.0, 30.0])
def test_a_turn_is_that_of_the_present(age_s):
    """Angle, rate and way some time after the newest fix; a covariance is four times theirs."""
    angle, rate, velocity = 1.2, 0.004, 2.0 * np.exp(0.3j)
    fixes = turned(STRAIGHT, angle, rate) + 30.0
    later = np.linspace(0.0, age_s, 1001)
    there = fixes[-1] + np.trapezoid(velocity * np.exp(1j * (angle + rate * later)), later)
    moved = there - (STRAIGHT[-1] + velocity * age_s)
    truth = [angle + rate * age_s, rate, moved.real, moved.imag]
    squares = []
    for seed in range(200):
        refused = row(fixes - STRAIGHT, STRAIGHT, seed)
        found = turn_of(refused, np.eye(3), present(STRAIGHT, age_s), MEMS)
        assert found is not None
        error = np.array([found.angle, found.rate, *found.moved]) - truth
        squares.append(error @ np.linalg.solve(found.covariance, error))
    assert 0.8 < np.mean(squares) < 1.2


def test_a_track_that_corrections_have_bent_is_taken_as_it_was_before_them():
    """The heading was corrected by half a radian in the middle, and the position moved by 40 m."""
    fixes = turned(STRAIGHT, 1.2, 0.0)
    bent = np.where(TIME_S < 22.0, STRAIGHT, STRAIGHT[4] + (STRAIGHT - STRAIGHT[4]) * np.exp(0.5j))
    estimated = bent + np.where(TIME_S < 32.0, 0.0, 40.0)
    refused = row(fixes - estimated, estimated)
    assert turn_of(refused, np.eye(3), present(estimated), MEMS) is None
    rigid = (STRAIGHT[-1] - STRAIGHT) * np.exp(0.5j)
    found = turn_of(refused, np.eye(3), present(estimated, bent=rigid), MEMS)
    assert found is not None
    assert found.angle == pytest.approx(0.7, abs=3.0 * np.sqrt(found.covariance[0, 0]))
    moved = fixes[-1] - estimated[-1]
    assert found.moved == pytest.approx([moved.real, moved.imag], abs=6.0)


def test_fixes_from_before_the_newest_used_one_are_no_evidence():
    monitor = IntegrityMonitor(300.0)
    monitor.fused(10, 20)
    assert not monitor.gated(5, 30, np.ones(3))
    assert monitor.gated(15, 40, np.ones(3))


def test_a_saved_heading_is_not_the_one_of_the_start(world):
    """After a restart the heading is as doubtful as it was stated, whatever was learnt since."""
    stated = {'initial_sigma_heading_deg': 180.0}
    engine = Engine(world.params(**stated))
    run(engine, [*world.imu()[:200]])
    assert engine.look().present[0].condition.key == 'heading unknown'
    saved = engine.saved()
    saved = dataclasses.replace(saved, sigma_heading=0.01)
    again = Engine(world.params(**stated))
    list(again.process(Command(saved.stamp_ns, 0, CommandKind.SET_INITIAL_STATE, saved)))
    run(again, world.imu()[201:400])
    assert again.look().present[0].condition.key == 'heading unknown'
