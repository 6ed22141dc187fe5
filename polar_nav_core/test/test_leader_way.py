"""The shape of a leader's position error by its way, against the covariance of the true errors."""

import numpy as np
import pytest

from polar_nav_core.engine.sins.leader import columns
from polar_nav_core.engine.sins.leader_drift import Drift
from polar_nav_core.engine.sins.leader_way import ALIKE, SLOW_MPS, SLOW_S, Way

TAU_S = 4000.0
ORIGIN_E = np.array([100.0, -200.0, 6.357e6])
HEADING = 0.005
LEVEL = np.eye(3)
"""Grid axes that are those of ECEF: the way is short."""


def true_covariance(velocity_G, dt):
    """Covariance (3, 3) of position and heading of a leader that was turned by that alone."""
    keeps = np.exp(-dt / TAU_S)
    P = np.diag([0.0, 0.0, HEADING**2])
    for x, y in velocity_G:
        Phi = np.array([[1.0, 0.0, -y * dt], [0.0, 1.0, x * dt], [0.0, 0.0, keeps]])
        P = Phi @ P @ Phi.T + np.diag([0.0, 0.0, HEADING**2 * (1.0 - keeps**2)])
    return P


def legs(count, dt):
    """Velocities (n, 2) of three legs that turn and come back near the start."""
    leg = np.repeat([[2.0, 0.5], [0.3, -2.0], [-2.2, 0.9]], count, axis=0)
    return leg, np.vstack([np.zeros(2), np.cumsum(leg * dt, axis=0)])


def driven(places_G, sigmas, *, heading=HEADING, dt=4.0, way=None, drift=None, linked=1.0):
    """Columns (n, 3, 3) of a leader at places (n, 2)."""
    way, drift = way or Way(TAU_S), drift or Drift()
    out = []
    for k, (place, sigma) in enumerate(zip(places_G, sigmas, strict=True), 1):
        leader_e = ORIGIN_E + np.array([*place, 0.0])
        stamp_ns = round(k * dt * 1e9)
        drift.columns(stamp_ns, leader_e, LEVEL, sigma, heading)
        args = stamp_ns, leader_e, LEVEL, np.zeros(3), (sigma, heading), linked, drift
        out.append(way.columns(*args))
    return np.array(out)


def test_what_a_heading_has_turned_is_the_covariance_of_the_true_errors():
    velocity_G, places_G = legs(400, 4.0)
    P = true_covariance(velocity_G, 4.0)
    way = Way(TAU_S)
    A = driven(places_G, np.linspace(0.5, 20.0, len(places_G)), way=way)
    np.testing.assert_allclose(HEADING**2 * way._turned, P[:2, :2], rtol=1e-9)
    np.testing.assert_allclose(HEADING * way._faded, P[:2, 2] / HEADING, rtol=1e-9)
    np.testing.assert_allclose(A[-1, :2, 2], P[:2, 2] / HEADING, rtol=1e-9)


def test_the_error_lies_across_the_way_as_far_as_the_heading_of_before_has_turned_it():
    velocity_G, places_G = (
        np.tile([0.0, 2.0], (900, 1)),
        np.outer(np.arange(901) * 8.0, [0.0, 1.0]),
    )
    P = true_covariance(velocity_G, 4.0)
    slow, gained = slow_variance(3600.0), float(P[0, 0])
    sigmas = np.sqrt(0.25 + np.linspace(0.0, 1.0, 901) ** 2 * gained)
    A = driven(places_G, sigmas)[-1, :2, :2]
    (xx, xy), (_, yy) = ((A @ A.T) - ALIKE * sigmas[-1] ** 2 * np.eye(2)) / (1.0 - ALIKE)
    assert xy == pytest.approx(0.0, abs=1e-9)
    before = gained - P[0, 2] ** 2 / HEADING**2
    by_way = gained - slow
    assert yy == pytest.approx(0.25 + slow + by_way, rel=1e-6)
    assert by_way < HEADING**2 * 7200.0**2  # nothing across but what the heading explains
    assert xx == pytest.approx(0.25 + slow + before, rel=1e-6)


def slow_variance(time_s):
    """Of the integral of a Markov velocity, in closed form [m^2]."""
    return 2.0 * (SLOW_MPS * SLOW_S) ** 2 * (time_s / SLOW_S - 1.0 + np.exp(-time_s / SLOW_S))


def test_the_slow_error_is_the_integral_of_a_markov_velocity():
    for dt in (7.0, 90.0):
        _, places_G = legs(100, dt)
        way = Way(TAU_S)
        driven(places_G, np.linspace(0.5, 9.0, len(places_G)), dt=dt, way=way)
        assert SLOW_MPS**2 * way._slow == pytest.approx(slow_variance(300.0 * dt), rel=1e-9)


@pytest.mark.parametrize('case', ['no heading', 'not linked', 'at rest'])
def test_where_no_heading_explains_it_the_error_is_round(case):
    places_G = np.zeros((30, 2)) if case == 'at rest' else np.outer(np.arange(30), [8.0, 1.0])
    sigmas = np.linspace(1.0, 8.0, 30)
    heading = 0.0 if case == 'no heading' else HEADING
    linked = 0.0 if case == 'not linked' else 1.0
    A = driven(places_G, sigmas, heading=heading, linked=linked)
    for a, sigma in zip(A, sigmas, strict=True):
        round_one = columns(sigma, heading, np.zeros(3), np.zeros(3), linked)
        np.testing.assert_allclose(a, round_one, atol=1e-12)


def test_a_leader_that_turns_back_has_a_round_error_and_a_heading_that_has_turned_its_way():
    """Columns that swing with each leg show themselves to the filter within one."""
    out = np.outer(np.arange(100) * 8.0, [0.0, 1.0])
    places_G = np.vstack([out, out[::-1], out, out[::-1]])
    sigmas = np.linspace(1.0, 8.0, 400)
    A = driven(places_G, sigmas)
    share = np.linalg.norm(A[:, :2, :2] / sigmas[:, None, None] - np.eye(2), axis=(1, 2))
    assert share[95] > 0.1
    assert share[150:].max() < 0.3 * share[95]
    assert np.linalg.norm(A[299, :, 2]) > 0.85 * HEADING * 99.0 * 8.0


def test_a_heading_has_turned_no_more_of_the_way_than_sigma_has_grown_by():
    velocity_G, places_G = legs(200, 4.0)
    del velocity_G
    sigmas = np.linspace(1.0, 2.0, len(places_G))  # 0.005 rad of 1.6 km would be 8 m
    drift = Drift()
    A = driven(places_G, sigmas, drift=drift)
    for a, sigma in zip(A, sigmas, strict=True):
        assert np.linalg.norm(a[:, 2]) <= drift.grown(sigma) * (1.0 + 1e-12)
        assert np.linalg.eigvalsh(a[:2, :2])[-1] < 1.8 * sigma


def test_a_leader_that_gets_a_fix_begins_its_way_there():
    _, places_G = legs(100, 4.0)
    n = len(places_G)
    sigmas = np.linspace(1.0, 9.0, n)
    sigmas[150:] = np.linspace(0.8, 5.0, n - 150)
    whole, fresh = driven(places_G, sigmas), driven(places_G[150:], sigmas[150:])
    np.testing.assert_allclose(whole[150:], fresh, atol=1e-9)


def test_packets_out_of_order_move_nothing():
    _, places_G = legs(100, 4.0)
    sigmas = np.linspace(1.0, 9.0, len(places_G))
    way, drift = Way(TAU_S), Drift()
    driven(places_G, sigmas, way=way, drift=drift)
    before = way.packed()
    driven(places_G[:200], sigmas[:200], way=way, drift=drift)
    assert way.packed() == before


def test_what_it_has_heard_is_known_again():
    _, places_G = legs(100, 4.0)
    sigmas = np.linspace(1.0, 9.0, len(places_G))
    way, drift, again = Way(TAU_S), Drift(), Way(TAU_S)
    driven(places_G[:150], sigmas[:150], way=way, drift=drift)
    again.unpack(way.packed())
    assert again.packed() == way.packed()
    assert again.packed() != Way(TAU_S).packed()


def test_of_a_state_that_knows_nothing_of_the_way_the_error_is_round_at_first():
    """As one that an older version has saved: the drift is known, the way is not."""
    _, places_G = legs(100, 4.0)
    sigmas = np.linspace(1.0, 9.0, len(places_G))
    drift = Drift()
    driven(places_G[:150], sigmas[:150], drift=drift)
    way = Way(TAU_S)
    way.unpack([0.0] * 16)
    stamp_ns, leader_e = round(151 * 4e9), ORIGIN_E + np.array([*places_G[150], 0.0])
    drift.columns(stamp_ns, leader_e, LEVEL, sigmas[150], HEADING)
    args = stamp_ns, leader_e, LEVEL, np.zeros(3), (sigmas[150], HEADING), 1.0, drift
    A = way.columns(*args)
    np.testing.assert_allclose(A[:2, :2], sigmas[150] * np.eye(2), rtol=1e-12)
