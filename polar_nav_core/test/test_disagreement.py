"""Refused fixes: those that show a wrong heading are believed, displaced ones are not."""

import dataclasses

import numpy as np
import pytest
from closed_loop import World, inputs_of, run

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.disagreement import Refused, Turn, Unlearnt, turn_of
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Command, CommandKind
from polar_nav_core.engine.health.heading import heading_unknown
from polar_nav_core.engine.health.watchdog import Level
from polar_nav_core.engine.integrity import IntegrityMonitor
from polar_nav_core.engine.verdicts import Verdict

pytestmark = pytest.mark.slow

MEMS = Unlearnt(heading=0.6, scale=0.03, gyro_bias=0.01)
TACTICAL = Unlearnt(heading=0.0015, scale=0.004, gyro_bias=5e-6)
SIGMA, PERIOD_S = 2.0, 5.0
TIME_S = PERIOD_S * np.arange(10)


def row(offset, track):
    """Refused fixes by their offsets from an estimated track, both east + i north."""
    rng = np.random.default_rng(1)
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


STRAIGHT = 2.0 * TIME_S * np.exp(0.3j)
CORNER = np.where(TIME_S < 25.0, 2.0 * TIME_S, 50.0 + 2.0j * (TIME_S - 25.0))


@pytest.mark.parametrize('track', [STRAIGHT, CORNER])
@pytest.mark.parametrize(('angle', 'rate'), [(1.2, 0.0), (-0.7, 0.012)])
def test_a_turned_track_is_found(track, angle, rate):
    found = turn_of(row(turned(track, angle, rate) - track + 30.0, track), np.eye(3), MEMS)
    assert found is not None
    sigma = np.sqrt(np.diagonal(found.covariance))
    assert abs(found.angle - angle) < 3.0 * sigma[0] < 0.7
    assert abs(found.rate - rate) < 3.0 * sigma[1] < 0.1


def test_a_turn_that_the_start_does_not_contain_is_no_explanation():
    fixes = row(turned(STRAIGHT, 1.2, 0.0) - STRAIGHT, STRAIGHT)
    assert turn_of(fixes, np.eye(3), TACTICAL) is None


@pytest.mark.parametrize('sigmas', [MEMS, TACTICAL])
def test_displaced_fixes_are_no_turn(sigmas):
    assert turn_of(row(40.0 + 0j * TIME_S, STRAIGHT), np.eye(3), sigmas) is None


@pytest.mark.parametrize('sigmas', [MEMS, TACTICAL])
def test_scattered_fixes_are_no_turn(sigmas):
    far = 20.0 * np.exp(2j * np.pi * np.random.default_rng(2).random(10))
    assert turn_of(row(far, STRAIGHT), np.eye(3), sigmas) is None


@pytest.mark.parametrize('speed', [0.3, 1.0])
def test_drifting_fixes_move_no_good_navigation(speed):
    assert turn_of(row(speed * TIME_S * 1j, STRAIGHT), np.eye(3), TACTICAL) is None


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


def fixes_of(world):
    return world.fixes(2.0, lambda i: 1.0 + 0.3 * (i % 4), rng=np.random.default_rng(4))


def last_error(world, track):
    return float(np.linalg.norm(track.r_e[-1] - world.r_e[-1]))


@pytest.mark.parametrize(('velocity', 'off_m'), [('known', 20.0), ('carried', 15.0)])
def test_fixes_turn_a_heading_that_has_locked(world, velocity, off_m):
    inputs = inputs_of(world, fixes_of(world))
    chosen = {'dvl_turn_velocity': velocity}
    shut = engine_run.run(start(world, reopen_after_s=0.0, **chosen), inputs, look_every_s=1.0)
    assert shut.verdicts[Verdict.GATED] > 60
    assert last_error(world, shut.track) > off_m
    found = engine_run.run(start(world, **chosen), inputs, look_every_s=1.0)
    assert found.verdicts[Verdict.GATED] < 20
    assert last_error(world, found.track) < 2.0
    assert found.health[-1].resets >= 1
    said = [p.condition for h in found.health for p in h.present]
    assert any(c.key == 'fixes reopened' and c.level is Level.ERROR for c in said)


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


def test_an_unknown_heading_is_an_error_until_fixes_have_shown_it():
    assert not heading_unknown(0.5, 0.5, 0)
    assert [c.level for c in heading_unknown(1.8, 0.01, 5)] == [Level.ERROR]
    assert heading_unknown(1.8, 0.3, 50)
    assert not heading_unknown(1.8, 0.01, 40)


def test_a_turn_goes_on_after_the_newest_fix():
    turn = Turn(0.1, 0.003, np.diag([1e-4, 1e-8]), 5.0).aged(30.0)
    assert turn.angle == pytest.approx(0.19)
    assert turn.covariance[0, 0] == pytest.approx(1e-4 + 900.0 * 1e-8)
    assert turn.covariance[0, 1] == pytest.approx(30.0 * 1e-8)


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
