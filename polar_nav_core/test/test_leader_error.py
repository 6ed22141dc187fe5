"""Fixes that share their leader's error: split, smoothed sigmas, what the engine makes of it."""

import dataclasses
import math

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core import earth, grid
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.methods import DELAY_HANDLING
from polar_nav_core.engine.sins.leader import (
    FAST_S,
    FAST_SHARE,
    Growth,
    LeaderError,
    Smooth,
    columns,
)
from polar_nav_core.engine.sins.leader_drift import Link
from polar_nav_core.link.fields import SIGMA_RATIO

LEADER_E = np.asarray(earth.ecef_from_geodetic(math.radians(84.0), 1.0, -60.0))
C_e_G = np.asarray(grid.ecef_to_grid(LEADER_E))


def fix_of(line_G, leader_e=LEADER_E, sigma=5.0, heading=0.01, white=None, number=1):
    turn = heading * np.array([-line_G[1], line_G[0], 0.0])
    white_G = np.diag([0.7, 0.9, 0.1]) if white is None else white
    P_G = white_G + np.diag([sigma**2, sigma**2, 0.0]) + np.outer(turn, turn)
    C = np.asarray(grid.ecef_to_grid(leader_e))
    relative_e = C.T @ line_G
    now_ns = 1_000_000_000 * number
    return Fix(
        now_ns, now_ns, now_ns, 'leader', number, number, number,
        leader_e + relative_e, C.T @ P_G @ C, relative_e=relative_e,
        leader_sigma=sigma, leader_heading_sigma=heading,
    )  # fmt: skip


def test_parts_add_up_to_the_covariance_of_a_fix():
    fix = fix_of(np.array([800.0, -600.0, 20.0]))
    split = LeaderError(3600.0).split(fix)
    whole = split.columns_e @ split.columns_e.T + split.covariance_e
    # What is left of the turn beyond its sure share counts twice, on the safe side.
    turn_e = C_e_G.T @ np.array([6.0, 8.0, 0.0])
    np.testing.assert_allclose(
        whole, fix.covariance_e + (1.0 - 1.0 / 1.13) * np.outer(turn_e, turn_e), atol=1e-6
    )
    assert np.linalg.eigvalsh(split.covariance_e)[0] > 0.09


def test_a_leader_without_error_changes_nothing():
    fix = fix_of(np.array([800.0, -600.0, 20.0]), sigma=0.0, heading=0.0)
    for tau in (3600.0, 0.0):
        split = LeaderError(tau).split(fix)
        assert split.covariance_e is fix.covariance_e
        assert not split.columns_e.any()


def test_switched_off_all_of_the_error_is_the_fix_s_own():
    fix = fix_of(np.array([800.0, -600.0, 20.0]))
    split = LeaderError(0.0).split(fix)
    assert split.covariance_e is fix.covariance_e
    assert not split.columns_e.any()


@pytest.mark.parametrize('rounding', [1.0, 0.97])
def test_what_is_left_is_definite_when_the_link_has_rounded(rounding):
    line_G = np.array([2000.0, 10.0, 20.0])
    fix = fix_of(line_G, heading=0.01)
    turn_e = C_e_G.T @ (0.01 * np.array([-10.0, 2000.0, 0.0]))
    shrunk = fix.covariance_e - (1.0 - rounding) * np.outer(turn_e, turn_e)
    split = LeaderError(3600.0).split(dataclasses.replace(fix, covariance_e=shrunk))
    assert np.linalg.eigvalsh(split.covariance_e)[0] > 0.05


def test_a_covariance_without_the_leader_s_part_stays_whole():
    fix = dataclasses.replace(fix_of(np.array([800.0, 0.0, 0.0])), covariance_e=np.eye(3))
    split = LeaderError(3600.0).split(fix)
    np.testing.assert_array_equal(split.covariance_e, np.eye(3))
    assert split.columns_e.any()


def test_what_the_heading_explains_comes_on_top_of_the_stated_variance():
    turn, drift = np.array([0.0, 0.0, 0.0]), np.array([300.0, 400.0, 0.0])
    A = columns(6.0, 0.01, turn, drift, 1.0)
    np.testing.assert_allclose(A[:, 2], 0.01 * drift)
    half = columns(6.0, 0.01, turn, drift, 0.5)
    np.testing.assert_allclose(half[:, 2], 0.005 * drift)
    # The states of position keep their scale wherever the leader turns.
    for way in (drift, np.array([-30.0, 10.0, 0.0]), np.zeros(3)):
        np.testing.assert_array_equal(columns(6.0, 0.01, turn, way, 1.0)[:2, :2], 6.0 * np.eye(2))
    # Not more of it than a sigma of the position.
    np.testing.assert_allclose(np.linalg.norm(columns(4.8, 0.01, turn, drift, 1.0)[:, 2]), 4.8)


def test_a_leader_better_than_its_heading_is_not_dead_reckoned():
    turn, drift = np.array([0.0, 1000.0, 0.0]), np.array([3000.0, 4000.0, 0.0])
    A = columns(6.0, 0.01, turn, drift, Link(keeps=False).at(50.0, 6.0, 0.0))
    np.testing.assert_array_equal(A, [[6.0, 0.0, 0.0], [0.0, 6.0, 10.0], [0.0, 0.0, 0.0]])


def turned_way(places, sigmas, *, keeps=True, saved_after=None):
    """How far one sigma of heading moves fixes by the leader's way [m], one number per place.

    The leader is that many metres ahead of where it began, with a heading sigma of 0.01 rad.
    """
    leader = LeaderError(3600.0, keeps=keeps, shaped=keeps)
    ahead_e = C_e_G.T @ np.array([0.0, 1.0, 0.0])
    found = []
    for number, (place, sigma) in enumerate(zip(places, sigmas, strict=True), 1):
        leader_e = LEADER_E + place * ahead_e
        fix = fix_of(np.array([800.0, 0.0, 0.0]), leader_e, sigma, number=number)
        turn_e = 0.01 * np.cross(grid.ecef_to_grid(leader_e)[2], fix.relative_e)
        found.append(np.linalg.norm(leader.split(fix).columns_e[:, 2] - turn_e))
        if number == saved_after:
            values = leader.packed()
            leader = LeaderError(3600.0, keeps=keeps, shaped=keeps)
            leader.unpack(values)
    return np.array(found)


OUT_AND_BACK = (0.0, 30.0, 1000.0, 1002.0, 100.0, 0.0, 120.0), (1.0, 1.0, *[2.0] * 5)


def test_a_leader_that_something_else_holds_stays_so_when_it_is_back():
    """Far out its packets show it; near its start they cannot, nor has its heading changed."""
    found = turned_way(*OUT_AND_BACK)
    assert found[1] == pytest.approx(math.sqrt(SIGMA_RATIO - 1.0), rel=1e-3)
    np.testing.assert_allclose(found[2:], 0.0, atol=1e-6)
    np.testing.assert_array_equal(turned_way(*OUT_AND_BACK, saved_after=4), found)


def test_up_to_engine_8_present_packets_alone_tell():
    found = turned_way(*OUT_AND_BACK, keeps=False)
    np.testing.assert_allclose(found[2:], [0.0, 0.0, 1.0, 0.0, 1.2], rtol=1e-3, atol=1e-6)


def test_one_packet_is_no_proof_that_something_else_holds_a_leader():
    places = 0.0, 100.0, 1000.0, 102.0, 1000.0, 104.0, 1000.0, 1000.0, 106.0
    found = turned_way(places, [1.0, *[2.0] * (len(places) - 1)])
    expected = [0.0, 1.0, 0.0, 1.02, 0.0, 1.04, 0.0, 0.0, 0.0]
    # The heading of now turned a little less of the kilometre in between (`Way`).
    np.testing.assert_allclose(found, expected, rtol=7e-3, atol=1e-6)


def test_a_heading_has_brought_about_no_more_than_sigma_has_grown_by():
    places, sigmas = (0.0, 100.0, 150.0, 300.0), (1.0, 1.0, 1.5, 3.4)
    most = [math.sqrt(SIGMA_RATIO * sigma**2 - 1.0) for sigma in sigmas]
    found = turned_way(places, sigmas)
    np.testing.assert_allclose(found, [0.0, most[1], most[2], 3.0], rtol=1e-3, atol=1e-9)
    before = turned_way(places, sigmas, keeps=False)
    np.testing.assert_allclose(before, [0.0, 1.0, 1.5, 3.0], rtol=1e-3, atol=1e-9)


def test_of_a_leader_that_may_be_linked_in_part_nothing_is_kept():
    """A heading that wanders, and smoothed sigmas: as with a leader that dead reckons by it."""
    link = Link(keeps=True)
    degrees = [link.at(by_heading, 10.0, 10.0) for by_heading in (10.0, 15.0, 15.9, 15.0, 10.0)]
    np.testing.assert_allclose(degrees, [1.0, 0.2, 0.02, 0.2, 1.0])
    assert link.most == 1.0


def rounded(sigma):
    return SIGMA_RATIO ** math.ceil(math.log(sigma) / math.log(SIGMA_RATIO) - 1e-9)


@pytest.mark.parametrize('slope', [0.004, -0.004])
def test_a_smoothed_sigma_never_jumps_and_stays_within_a_step(slope):
    smooth = Smooth(1.0)
    start = 2.0 if slope > 0.0 else 12.0
    found, true = [], []
    for k in range(1200):
        sigma = start + 2.0 * k * slope
        found.append(smooth.at(2_000_000_000 * k, rounded(sigma)))
        true.append(sigma)
    ratio = np.array(found) / np.array(true)
    # Until the second step nobody knows how long a step takes.
    assert np.abs(np.diff(np.log(found[60:]))).max() < 0.012
    assert np.abs(np.log(ratio)).max() < 2.0 * math.log(SIGMA_RATIO)


def test_a_sigma_that_falls_for_a_while_is_held():
    smooth = Smooth(3600.0)
    found = [smooth.at(int(2e9) * k, rounded(12.0 - 0.01 * k)) for k in range(1000)]
    assert found[-1] == pytest.approx(rounded(12.0) * math.exp(-1998.0 / 3600.0), rel=0.05)
    again = [smooth.at(int(2e9) * (1000 + k), rounded(2.0 + 0.01 * k)) for k in range(1200)]
    assert max(again) == pytest.approx(14.0, rel=0.07)


def test_a_sigma_that_falls_at_once_is_believed_at_once():
    smooth = Smooth(1.0)
    assert smooth.at(0, 10.0) == pytest.approx(10.0)
    assert smooth.at(2_000_000_000, 1.0) == pytest.approx(1.0)
    assert smooth.at(4_000_000_000, 0.0) == 0.0
    assert smooth.at(6_000_000_000, 2.0) == pytest.approx(2.0)


def test_a_packet_out_of_order_changes_no_sigma():
    smooth = Smooth(1.0)
    smooth.at(0, 10.0)
    smooth.at(60_000_000_000, 10.0 * SIGMA_RATIO)
    now = smooth.at(90_000_000_000, 10.0 * SIGMA_RATIO)
    smooth.at(30_000_000_000, 10.0)
    assert smooth.at(90_000_000_000, 10.0 * SIGMA_RATIO) == now


def test_an_error_that_does_not_grow_has_no_fast_part():
    growth = Growth(3600.0)
    assert [growth.at(int(2e9) * k, 3.0) for k in range(5)] == [0.0] * 5
    assert growth.at(int(2e9) * 5, 1.0) == 0.0  # the leader got a fix


def test_the_fast_part_of_a_growing_error_is_one_density_at_any_interval():
    for apart_s in (1.0, 4.0):
        growth = Growth(1e9)
        growth.at(0, 3.0)
        found = growth.at(round(apart_s * 1e9), 5.0)
        # 16 m^2 gained, Markov: 2 T q per second.
        assert found * apart_s == pytest.approx(2.0 * FAST_S * FAST_SHARE * 16.0, rel=3e-3)
    growth = Growth(1e15)
    growth.at(0, 3.0)
    assert growth.at(10**12, 5.0) == pytest.approx(FAST_SHARE * 16.0)


def test_the_fast_part_counts_from_the_least_sigma_of_late():
    growth = Growth(100.0)
    growth.at(0, 1.0)
    found = [growth.at(int(2e9) * k, 5.0) for k in range(1, 200)]
    assert found == sorted(found, reverse=True)
    assert (found[0] > 20.0, found[-1]) == (True, 0.0)


def test_a_packet_out_of_order_changes_no_fast_part():
    a, b = Growth(3600.0), Growth(3600.0)
    for growth in (a, b):
        growth.at(0, 3.0)
        growth.at(int(4e9), 4.0)
    assert a.at(int(2e9), 3.5) > 0.0
    assert a.at(int(8e9), 5.0) == b.at(int(8e9), 5.0)


@pytest.fixture(scope='module')
def world():
    return World(40.0)


def with_leader(world, offset_G=(0.0, 0.0, 0.0), growth=0.2, late=1.0):
    """Fixes of a leader 600 m off, 0.5 to 5 s late, out of order, and what its packets state.

    `late` scales the delays.
    """
    rng = np.random.default_rng(3)
    out = []

    def delay_s(i):
        return late * (0.5 + 4.5 * ((7 * i) % 10) / 9.0)

    for k, fix in enumerate(world.fixes(1.0, delay_s, rng=rng)):
        C = np.asarray(grid.ecef_to_grid(fix.r_e))
        line_G = np.array([600.0, 300.0 - 20.0 * k, 10.0])
        turn = 0.002 * np.array([-line_G[1], line_G[0], 0.0])
        sigma = 3.0 + growth * k
        added_G = np.diag([sigma**2, sigma**2, 0.0]) + np.outer(turn, turn)
        out.append(
            dataclasses.replace(
                fix,
                r_e=fix.r_e + C.T @ np.array(offset_G),
                relative_e=C.T @ line_G,
                covariance_e=fix.covariance_e + C.T @ added_G @ C,
                leader_sigma=sigma,
                leader_heading_sigma=0.002,
            )
        )
    return out


def track_of(world, fixes, name, one_by_one=False, **changes):
    params = world.params(
        configuration='custom',
        delay_handling=name,
        initial_sigma_position=50.0,
        output_period_s=1.0,
        **changes,
    )
    result = engine_run.run(params, inputs_of(world, fixes), one_by_one=one_by_one)
    assert not result.divergence
    return result.track


@pytest.mark.parametrize('name', DELAY_HANDLING)
def test_arrays_and_messages_have_the_same_bits(world, name):
    fixes = with_leader(world)
    a, b = (track_of(world, fixes, name, one_by_one=x) for x in (False, True))
    for column in ('r_e', 'v_G', 'C_b_G', 'P', 'sensor_errors'):
        np.testing.assert_array_equal(getattr(a, column), getattr(b, column))


def test_clone_is_rewind_but_for_the_linearization(world):
    clone, rewind = both_ways(world, with_leader(world), 0.0)
    np.testing.assert_allclose(clone.P[-1, 6:9, 6:9], rewind.P[-1, 6:9, 6:9], rtol=1e-3)


def test_what_is_considered_differs_between_clone_and_rewind_as_the_delay(world):
    """It is carried over the delay of a fix to first order (common_errors.md, 3)."""
    off = []
    for late in (0.5, 0.25, 0.125):
        clone, rewind = both_ways(world, with_leader(world, late=late), 1.0)
        off.append(np.abs(clone.P[-1, 6:9, 6:9] / rewind.P[-1, 6:9, 6:9] - 1.0).max())
    assert 0.4 < off[1] / off[0] < 0.6
    assert 0.4 < off[2] / off[1] < 0.6


def both_ways(world, fixes, drift_sigma):
    """Tracks of `clone` and `rewind`, whose estimates are the same."""
    clone, rewind = (
        track_of(world, fixes, name, gate_probability=1.0, leader_drift_sigma=drift_sigma)
        for name in ('clone', 'rewind')
    )
    sigma = np.sqrt(np.diagonal(rewind.P[:, 6:9, 6:9], axis1=1, axis2=2))
    assert np.abs((clone.r_e - rewind.r_e) / sigma).max() < 1e-3
    return clone, rewind


@pytest.mark.parametrize('name', ['tagged', 'back_propagate', 'clone', 'rewind'])
def test_an_error_of_all_fixes_is_inside_what_is_claimed(world, name):
    fixes = with_leader(world, offset_G=(3.0, -2.0, 0.0), growth=0.0)
    shared, independent = (
        track_of(world, fixes, name, leader_error_tau=tau) for tau in (3600.0, 0.0)
    )
    sigma = [np.sqrt(np.trace(t.P[-1, 6:9, 6:9])) for t in (shared, independent)]
    off = [np.linalg.norm(t.r_e[-1] - world.r_e[-1]) for t in (shared, independent)]
    assert off[0] < 1.5 * sigma[0]
    assert sigma[1] < 0.5 * off[1]
    # Not published: a part of the fixes, no error of the USBL.
    assert not shared.P[:, 21:].any()
    assert not shared.sensor_errors[:, 12:].any()


@pytest.mark.parametrize('name', DELAY_HANDLING)
def test_a_leader_without_error_leaves_every_bit(world, name):
    fixes = [
        dataclasses.replace(f, leader_sigma=0.0, leader_heading_sigma=0.0)
        for f in with_leader(world)
    ]
    a, b = (track_of(world, fixes, name, leader_error_tau=tau) for tau in (3600.0, 0.0))
    for column in ('r_e', 'v_G', 'C_b_G', 'P', 'sensor_errors'):
        np.testing.assert_array_equal(getattr(a, column), getattr(b, column))
