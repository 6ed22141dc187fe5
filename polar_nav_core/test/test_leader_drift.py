"""Constant errors of a leader that dead reckons: columns from sigmas, what they do to a track."""

import dataclasses
import math

import numpy as np
import pytest
from closed_loop import World, inputs_of
from compiled import jit_only

from polar_nav_core import earth, grid
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.sins.leader import LeaderError
from polar_nav_core.engine.sins.leader_drift import COLUMNS, Drift, link
from polar_nav_core.kernels.sins import consider

START_E = np.asarray(earth.ecef_from_geodetic(math.radians(84.0), 1.0, -60.0))
C_e_G = np.asarray(grid.ecef_to_grid(START_E))
TURN, SCALE, EAST, NORTH = range(4)


class Leader:
    """Heard at places of its way, in metres along grid axes from where it began."""

    def __init__(self, heading=0.0):
        self.drift, self.heading, self.second = Drift(), heading, 0

    def at(self, place, sigma, most=1.0):
        self.second += 10
        leader_e = START_E + C_e_G.T @ np.array([*place, 0.0])
        stamp_ns = self.second * 10**9
        return self.drift.columns(stamp_ns, leader_e, C_e_G, sigma, self.heading, most)


def test_columns_are_changes_of_a_way_that_is_turned_and_scaled():
    leader = Leader()
    leader.at((0.0, 0.0), 1.0)
    leader.at((600.0, 0.0), 3.0)
    way = np.array([600.0, 800.0])
    found = leader.at(way, 6.0)
    rate = math.sqrt(6.0**2 - 1.0) / 1000.0

    def reckoned(turn, scale):
        c, s = math.cos(turn), math.sin(turn)
        return (1.0 + scale) * np.array([[c, -s], [s, c]]) @ way

    step = 1e-6
    for column, change in ((TURN, (step, 0.0)), (SCALE, (0.0, step))):
        slope = (reckoned(*change) - way) / step
        np.testing.assert_allclose(found[:2, column], rate * slope, rtol=1e-5, atol=1e-5)
    assert not found[2].any()


def test_at_the_farthest_place_each_axis_has_grown_as_stated():
    leader = Leader()
    leader.at((0.0, 0.0), 2.0)
    found = leader.at((300.0, -400.0), 5.0)
    np.testing.assert_allclose(found[:2, :2] @ found[:2, :2].T, 21.0 * np.eye(2), atol=1e-9)


def test_back_at_its_start_only_the_error_of_the_start_is_left():
    leader = Leader()
    leader.at((0.0, 0.0), 2.0)
    leader.at((3000.0, 0.0), 10.0)
    found = leader.at((0.0, 0.0), 10.0)
    assert np.abs(found[:, :2]).max() < 1e-6
    start = 2.0 * math.sqrt(1.0 - 0.04)
    np.testing.assert_allclose(found[:2, 2:], start * np.eye(2))
    again = leader.at((1500.0, 0.0), 10.0)
    np.testing.assert_allclose(np.hypot(*again[:2, TURN]), math.sqrt(96.0) / 2.0)


def test_a_leader_that_does_not_drift_has_no_constant_errors():
    leader = Leader()
    for k in range(5):
        assert not leader.at((100.0 * k, 0.0), 3.0).any()
    assert not leader.at((0.0, 0.0), 0.0).any()


def test_the_turn_of_a_leader_that_is_kept_as_unlinked_is_all_constant():
    """Its heading of now, among the states, has turned nothing of its way."""
    turns = []
    for most in (1.0, 0.0):
        leader = Leader(heading=0.005)
        leader.at((0.0, 0.0), 1.0)
        found = leader.at((600.0, 800.0), 6.0, most)
        turns.append(np.hypot(*found[:2, TURN]))
    assert turns[1] == pytest.approx(math.sqrt(35.0))
    assert turns[0] == pytest.approx(math.sqrt(35.0 - 25.0))


def test_a_fix_of_the_leader_begins_a_new_drift():
    leader = Leader()
    leader.at((0.0, 0.0), 1.0)
    leader.at((5000.0, 0.0), 20.0)
    assert not leader.at((5010.0, 0.0), 2.0).any()
    found = leader.at((5110.0, 0.0), 3.0)
    np.testing.assert_allclose(found[:2, SCALE], [math.sqrt(5.0), 0.0], atol=1e-9)


def test_a_packet_out_of_order_changes_no_later_column():
    a, b = Leader(), Leader()
    for leader in (a, b):
        leader.at((0.0, 0.0), 1.0)
        leader.at((1000.0, 0.0), 4.0)
    a.drift.columns(15 * 10**9, START_E + 1e5, C_e_G, 0.5, 0.0)
    np.testing.assert_array_equal(a.at((2000.0, 0.0), 8.0), b.at((2000.0, 0.0), 8.0))


@pytest.mark.parametrize('share', [1.0, 0.5])
def test_the_turn_that_is_among_the_states_is_left_out(share):
    heading = share * math.sqrt(35.0) / 1000.0
    leader = Leader(heading)
    leader.at((0.0, 0.0), 1.0)
    found = leader.at((1000.0, 0.0), 6.0)
    assert link(1000.0 * heading, 6.0) == 1.0
    expected = math.sqrt(35.0 * (1.0 - share**2))
    np.testing.assert_allclose(np.hypot(*found[:2, TURN]), expected, atol=1e-6)
    np.testing.assert_allclose(np.hypot(*found[:2, SCALE]), math.sqrt(35.0))


def test_the_heading_of_an_array_is_no_heading_of_the_way():
    assert link(20.0, 10.0) == 0.0
    assert link(13.5, 10.0) == pytest.approx(0.5)
    leader = Leader(heading=0.1)
    leader.at((0.0, 0.0), 1.0)
    found = leader.at((1000.0, 0.0), 6.0)
    np.testing.assert_allclose(np.hypot(*found[:2, TURN]), math.sqrt(35.0))


def fixes_of(world):
    """Fixes 0.5 to 5 s late of a leader abeam whose sigma grows, with a heading of its own."""
    rng = np.random.default_rng(3)
    out = []
    for k, fix in enumerate(world.fixes(1.0, lambda i: 0.5 + 4.5 * ((7 * i) % 10) / 9.0, rng=rng)):
        C = np.asarray(grid.ecef_to_grid(fix.r_e))
        line_G = np.array([400.0, -400.0, 10.0])
        turn = 0.02 * np.array([-line_G[1], line_G[0], 0.0])
        sigma = 1.0 + 0.2 * k
        added_G = np.diag([sigma**2, sigma**2, 0.0]) + np.outer(turn, turn)
        out.append(
            dataclasses.replace(
                fix,
                relative_e=C.T @ line_G,
                covariance_e=fix.covariance_e + C.T @ added_G @ C,
                leader_sigma=sigma,
                leader_heading_sigma=0.5,
            )
        )
    return out


@jit_only
@pytest.mark.parametrize('name', ['tagged', 'back_propagate', 'clone', 'rewind'])
def test_what_is_published_has_what_such_errors_do_to_a_track(name):
    """Independent of the sensitivities: whole runs with fixes moved by each error."""
    world = World(40.0)
    fixes = fixes_of(world)

    def track(fixes, drift):
        params = world.params(
            configuration='custom',
            delay_handling=name,
            gate_probability=1.0,
            initial_sigma_position=50.0,
            output_period_s=1.0,
            leader_drift_sigma=drift,
        )
        result = engine_run.run(params, inputs_of(world, fixes))
        assert not result.divergence
        return result.track

    plain, published = track(fixes, 0.0), track(fixes, 1.0)
    np.testing.assert_allclose(published.r_e, plain.r_e, rtol=0.0, atol=1e-6)
    # In the order of reception, as the filter hears of them.
    leader = LeaderError(3600.0)
    heard = sorted(fixes, key=lambda fix: (fix.receive_ns, fix.order))
    constants = {fix.order: leader.split(fix).constants_e for fix in heard}
    share = 1e-3
    expected = np.zeros((3, 3))
    for c in range(COLUMNS):
        moved = [
            dataclasses.replace(fix, r_e=fix.r_e + share * constants[fix.order][:, c])
            for fix in fixes
        ]
        off = (track(moved, 0.0).r_e[-1] - plain.r_e[-1]) / share
        expected += np.outer(off, off)
    found = (published.P - plain.P)[-1, 6:9, 6:9]
    assert np.trace(expected) > 0.3
    np.testing.assert_allclose(found, expected, rtol=0.05, atol=0.02 * np.trace(expected))


def test_the_innovation_has_the_opposite_sign_of_a_fix_s_error():
    J, common_e = np.full((3, consider.COLUMNS), 7.0), np.zeros((3, 3 + COLUMNS))
    common_e[:, 3:] = C_e_G.T @ np.arange(12.0).reshape(3, 4)
    consider.fix_common(J, C_e_G, np.zeros(3), np.zeros(3), common_e)
    np.testing.assert_allclose(J[:, consider.LEADER :], -np.arange(12.0).reshape(3, 4), atol=1e-9)
