"""A leader that dead reckons beside the follower, and the packets that it sends.

Its position error grows by its heading error, the scale and the slowly varying error of its DVL;
the heading error turns the range, too. What a packet states is the covariance of that model,
rounded as on the link. Nothing here knows how the follower's filter treats it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.link.fields import SIGMA_RATIO
from polar_nav_sim.randomness import stream
from polar_nav_sim.trajectory import TruthState

from ..mismatch.worlds import move_fixes, truth_of_fixes, validities
from ..schedule import FixSpec
from ..world import World, make_world
from ..world_spec import WorldSpec

FIX = FixSpec(
    period_s=2.0, first_s=2.0, delay_kind='uniform', delay_least_s=1.5, delay_s=4.0, loss=0.1
)
POSITION, HEADING, SCALE, SLOW, TURN, SIZE = slice(0, 2), 2, 3, slice(4, 6), 6, 7
"""Errors of a leader: position (2), heading, DVL scale, slow velocity (2), turn of its array."""


@dataclass(frozen=True)
class Leader:
    """Errors of a leader, 1-sigma, and where it is.

    Attributes
    ----------
    heading_deg : float
        Of the heading that it dead reckons with.
    scale : float
        Of its DVL.
    slow_mps, slow_s : float
        Its DVL's slowly varying velocity, and the correlation time of that.
    start_m : float
        Position per axis at the start.
    heading_s : float
        Correlation time of the heading errors [s].
    array_deg : float or None
        Of a heading of its own that turns the range; None: that of dead reckoning.
    range_m : float
        From the leader to the follower.
    place : str
        Where the leader is: 'abeam' to starboard, 'ahead', 'circling' once in 30 min, or to grid
        'east' on every course.
    """

    heading_deg: float = 0.034
    scale: float = 4e-4
    slow_mps: float = 0.002
    slow_s: float = 300.0
    start_m: float = 1.0
    heading_s: float = 5000.0
    array_deg: float | None = None
    range_m: float = 1000.0
    place: str = 'abeam'

    def drift(self, share: float) -> Leader:
        """Return one that drifts by this share of distance: 70 % of the variance by heading."""
        return replace(
            self, heading_deg=math.degrees(share * math.sqrt(0.7)), scale=share * math.sqrt(0.3)
        )


@dataclass(frozen=True)
class Broadcasts:
    """What k packets say beside their fix, and what they are off by, grid axes.

    Attributes
    ----------
    error_G : (k, 3) array
        Of the fixes, without white noise [m].
    line_G : (k, 3) array
        Leader to follower [m].
    sigma, heading_sigma : (k,) arrays
        Of the leader's position per horizontal axis [m], and of its heading [rad].
    """

    error_G: Array
    line_G: Array
    sigma: Array
    heading_sigma: Array


def lines(leader: Leader, time_s: Array, truth: TruthState) -> Array:
    """Leader to follower at times, (k, 3), grid axes [m]."""
    ahead = truth.v_G[:, :2] / np.linalg.norm(truth.v_G[:, :2], axis=1)[:, None]
    angle = {'abeam': 90.0, 'ahead': 180.0, 'circling': 0.0, 'east': 90.0}[leader.place]
    turn = np.full(len(time_s), math.radians(angle))
    if leader.place == 'circling':
        turn = turn + 2.0 * math.pi * time_s / 1800.0
    if leader.place in ('circling', 'east'):
        ahead = np.tile([0.0, 1.0], (len(time_s), 1))  # as seen from outside
    c, s = np.cos(turn), np.sin(turn)
    flat = np.column_stack(
        [c * ahead[:, 0] - s * ahead[:, 1], s * ahead[:, 0] + c * ahead[:, 1], np.zeros(len(c))]
    )
    return np.asarray(leader.range_m * flat)


def broadcasts(
    leader: Leader, time_s: Array, truth: TruthState, rng: np.random.Generator
) -> Broadcasts:
    """Errors drawn for one run, and what the packets state of them."""
    start = sigmas_of(leader)
    x = start * rng.standard_normal(SIZE)
    P = np.diag(start**2)
    turning = HEADING if leader.array_deg is None else TURN
    line_G = lines(leader, time_s, truth)
    error_G = np.zeros((len(time_s), 3))
    stated = np.zeros((len(time_s), 2))
    before, line = 0.0, line_G[0]
    for k, now in enumerate(time_s):
        # The leader sails its own way: that of the follower less how it moves round it.
        v_G = truth.v_G[k] - (line_G[k] - line) / (now - before)
        Phi, Q = step(leader, start, v_G, now - before)
        x = Phi @ x + np.sqrt(Q) * rng.standard_normal(SIZE)
        P = Phi @ P @ Phi.T + np.diag(Q)
        before, line = now, line_G[k]
        error_G[k, :2] = x[POSITION] + x[turning] * np.array([-line_G[k, 1], line_G[k, 0]])
        stated[k, 0] = math.sqrt(float(np.linalg.eigvalsh(P[POSITION, POSITION])[-1]))
        stated[k, 1] = math.sqrt(P[turning, turning])
    return Broadcasts(error_G, line_G, rounded(stated[:, 0]), rounded(stated[:, 1]))


def sigmas_of(leader: Leader) -> Array:
    """1-sigma of its errors at the start, (SIZE,)."""
    heading = math.radians(leader.heading_deg)
    own = 0.0 if leader.array_deg is None else math.radians(leader.array_deg)
    slow = [leader.slow_mps] * 2
    return np.array([*[leader.start_m] * 2, heading, leader.scale, *slow, own])


def step(leader: Leader, start: Array, v_G: Array, dt: float) -> tuple[Array, Array]:
    """Transition of the leader's errors over dt [s], and the variances that come in."""
    Phi = np.eye(SIZE)
    Phi[0, HEADING], Phi[1, HEADING] = -v_G[1] * dt, v_G[0] * dt
    Phi[POSITION, SCALE] = v_G[:2] * dt
    Phi[0, 4] = Phi[1, 5] = dt
    decay = np.ones(SIZE)
    decay[[HEADING, TURN]] = math.exp(-dt / leader.heading_s)
    decay[SLOW] = math.exp(-dt / leader.slow_s)
    for i in range(HEADING, SIZE):
        Phi[i, i] = decay[i]
    return Phi, start**2 * (1.0 - decay**2)


def rounded(sigma: Array) -> Array:
    """Sigmas as they come out of a packet: up to the next step of 6 %; zero stays."""
    out = np.zeros(len(sigma))
    some = sigma > 0.0
    steps = np.ceil(np.log(sigma[some] / 1e-3) / math.log(SIGMA_RATIO) - 1e-9)
    out[some] = 1e-3 * SIGMA_RATIO**steps
    return out


def make_leader_world(spec: WorldSpec, leader: Leader, seed: int) -> World:
    """World whose fixes come from a leader."""
    world = make_world(spec, FIX, seed)
    truth = truth_of_fixes(world)
    order = np.argsort(validities(world), kind='stable')
    time_s = np.asarray((validities(world)[order] - world.truth.start_ns) * 1e-9)
    ordered = TruthState(*(getattr(truth, name)[order] for name in truth.__dataclass_fields__))
    b = broadcasts(leader, time_s, ordered, stream(seed, 'leader_error'))
    back = np.argsort(order)
    line_G, sigma, heading = b.line_G[back], b.sigma[back], b.heading_sigma[back]
    across = np.column_stack([-line_G[:, 1], line_G[:, 0], np.zeros(len(back))])
    variance_G = (heading**2)[:, None, None] * across[:, :, None] * across[:, None, :]
    variance_G[:, 0, 0] += sigma**2
    variance_G[:, 1, 1] += sigma**2
    world = move_fixes(world, b.error_G[back], variance_G)
    C_e_G = np.asarray(ecef_to_grid(truth.r_e))
    line_e = np.einsum('nji,nj->ni', C_e_G, line_G)
    return world.with_fixes(
        tuple(
            replace(f, relative_e=r, leader_sigma=float(p), leader_heading_sigma=float(h))
            for f, r, p, h in zip(world.inputs.fixes, line_e, sigma, heading, strict=True)
        )
    )
