"""The linear model of leader and follower in the plane, and filters of the follower.

``python -m polar_nav_tools.experiments.leader_error.two_vehicles`` prints two tables: of a
follower whose DVL has a slow error, and of one that knows its own (`CALM`). They share no code
with the engine but the columns of the leader's error. `centralised` is the Kalman filter of
both vehicles, which knows the errors of both; no filter of the same fixes can be better.
`structured` has the states of a leader that dead reckons, too, but their sizes from packets
(`stated_leader`): the best filter given the same packets is between the two. `packets` has the
engine's three states, and `published` the constant errors of the leader in the covariance
besides; `independent` takes each fix's error for its own.

All of it is linear, so that nothing is drawn: numbers are expectations over all runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.sins.leader import Growth, Smooth, columns
from polar_nav_core.engine.sins.leader_drift import COLUMNS, Drift, Link, link
from polar_nav_core.engine.sins.leader_way import Way

from . import leader as lead
from .experiment import SCENARIOS, Scenario
from .leader import Leader, rounded, sigmas_of, step

_DT = 4.0
_SPEED = 3.0
_LEG_S = 900.0
"""Of the way there and back that stands for a racetrack."""
TAU_S = 5400.0
"""`leader_error_tau`, the follower's default."""
OWN = 7
"""The follower's errors: position (2), heading, gyro bias, DVL scale, slow velocity (2)."""
SIGMAS = np.array([5.0, 5.0, math.radians(5.0 / 60.0), 1.45e-7, 0.004, 0.005, 0.005])
CALM = np.array([*SIGMAS[:3], 1e-8, 5e-4, 3e-4, 3e-4])
"""Of a follower whose attitude oscillates: its IMU shows the errors of its DVL."""
_SLOW_S = 300.0
_ORIGIN_E = np.array([0.0, 0.0, 1.0])
"""Any place but the origin, which to the engine is none."""
WHITE = np.eye(2)
"""Covariance of the white error of a fix [m^2]."""


class Line(NamedTuple):
    """What is expected of a filter in the second half of the dive.

    Attributes
    ----------
    rms, said : float
        Error of position and its sigma [m].
    position, heading : float
        NEES per degree of freedom.
    """

    rms: float
    said: float
    position: float
    heading: float


class Moment(NamedTuple):
    """One fix, and what happened since the one before.

    Attributes
    ----------
    stamp_ns : int
        [ns]
    own : tuple of (7, 7) and (7,) arrays
        Transition of the follower's errors and the variances that come in.
    v_leader, way, line : (2,) arrays
        Leader's velocity [m/s], its place since the start, from it to the follower [m].
    sigma, heading : float
        What the packet states: of the leader's position [m], of its heading [rad].
    hidden : (2, 2), (2,) arrays and float
        What packets have no fields for: covariance of the leader's position [m^2], of position
        and stated heading [m rad], variance of the latter [rad^2].
    """

    stamp_ns: int
    own: tuple[Array, Array]
    v_leader: Array
    way: Array
    line: Array
    sigma: float
    heading: float
    hidden: tuple[Array, Array, float]


Shape = Callable[[Moment, float, float, Array], Array]
"""Columns (2, 3) of a moment in place of the engine's, from its sigmas of position and heading."""


class Rows(NamedTuple):
    """A filter's model of one fix: transition, variances, rows, noise, constant errors or None."""

    Phi: Array
    Q: Array
    H: Array
    R: Array
    constants: Array | None = None


class Filter(NamedTuple):
    """A filter of the follower's errors and of others: sigmas of these, rows of each fix."""

    sigmas: Array
    rows: Iterable[Rows]


def moments(scenario: Scenario, own_sigmas: Array) -> list[Moment]:
    """All fixes of a scenario, for sigmas (7,) of the follower's errors."""
    leader, start = scenario.leader, sigmas_of(scenario.leader)
    turning = _turning(leader)
    P = np.diag(start**2)
    way = np.zeros(2)
    found = []
    for k in range(1, int(scenario.duration_s / _DT) + 1):
        v = _velocity(scenario, (k - 1) * _DT)
        line = _line(leader, k * _DT)
        # The leader's own way: the follower's less how it moves round it.
        v_leader = v - (line - _line(leader, (k - 1) * _DT)) / _DT
        way = way + v_leader * _DT
        Phi, Q = step(leader, start, v_leader, _DT)
        P = Phi @ P @ Phi.T + np.diag(Q)
        hidden = P[:2, :2].copy(), P[:2, turning].copy(), float(P[turning, turning])
        largest = float(np.linalg.eigvalsh(hidden[0])[-1])
        sigma, heading = rounded(np.sqrt([largest, hidden[2]])).tolist()
        own = _own_step(v, own_sigmas)
        stamp_ns = round(k * _DT * 1e9)
        found.append(Moment(stamp_ns, own, v_leader, way, line, sigma, heading, hidden))
    return found


def both(leader: Leader, fixes: Sequence[Moment]) -> Filter:
    """Filter of both vehicles that takes the leader for this one."""
    start, turning = sigmas_of(leader), _turning(leader)

    def rows() -> Iterator[Rows]:
        for m in fixes:
            Phi, Q = step(leader, start, m.v_leader, _DT)
            H = np.hstack([np.eye(2, OWN), -np.eye(2, lead.SIZE)])
            H[:, OWN + turning] -= across(m.line)
            Q = np.concatenate([m.own[1], Q])
            yield Rows(joined(m.own[0], Phi), Q, H, WHITE)

    return Filter(start, rows())


def stated_leader(fixes: Sequence[Moment]) -> Leader:
    """Leader that dead reckons and states what these packets do.

    Its position grows by one rate along and across: a packet has one sigma for both. The slow
    error of its DVL is that of our own leader's preset, the heading errors' correlation time the
    follower's default. Sizes come from all packets of the dive, those still to come included,
    which is more than a filter can have.
    """
    sigma = np.array([m.sigma for m in fixes])
    farthest = max(math.hypot(*m.way) for m in fixes)
    first, widest = float(sigma[0]), float(sigma.max())
    heading = fixes[0].heading
    rate = math.sqrt(widest**2 - first**2) / farthest
    still = Leader(0.0, 0.0, 0.0, start_m=first, heading_s=TAU_S, array_deg=math.degrees(heading))
    if rate == 0.0:
        return still
    drifting = replace(still, scale=rate, slow_mps=Leader.slow_mps)
    if link(heading * farthest, widest) < 0.5:
        return replace(drifting, heading_deg=math.degrees(rate))
    return replace(drifting, heading_deg=math.degrees(heading), array_deg=None)


def three_states(
    fixes: Sequence[Moment],
    shape: Shape | None = None,
    *,
    tau_s: float = TAU_S,
    keeps: bool = True,
    shaped: bool = True,
) -> Filter:
    """Filter with the engine's three states; ``shape``: other columns (rest: `LeaderError`)."""
    smooth = Smooth(tau_s), Smooth(tau_s)
    growth, drift, held, way = Growth(tau_s), Drift(), Link(keeps=keeps), Way(tau_s)
    decay = math.exp(-_DT / tau_s)

    def rows() -> Iterator[Rows]:
        for m in fixes:
            sigma = smooth[0].at(m.stamp_ns, m.sigma)
            heading = smooth[1].at(m.stamp_ns, m.heading)
            turn, turned_way = _level(across(m.line)), _level(across(m.way))
            by_heading = heading * math.hypot(*m.way)
            linked = held.at(by_heading, sigma, drift.grown(sigma)) if sigma > 0.0 else 0.0
            place = m.stamp_ns, _level(m.way) + _ORIGIN_E, np.eye(3)
            constants = drift.columns(*place, sigma, heading, held.most)[:2]
            if shaped and sigma > 0.0:
                A = way.columns(*place, turn, (sigma, heading), linked, drift)[:2]
            else:
                A = columns(sigma, heading, turn, turned_way, linked)[:2]
            if shape is not None:
                A = shape(m, sigma, heading, A)
            H = np.hstack([np.eye(2, OWN), -A])
            Q = np.concatenate([m.own[1], np.full(3, 1.0 - decay**2)])
            R = WHITE + growth.at(m.stamp_ns, sigma) * np.eye(2)
            yield Rows(joined(m.own[0], decay * np.eye(3)), Q, H, R, constants)

    return Filter(np.ones(3), rows())


def independent(fixes: Sequence[Moment]) -> Filter:
    """Filter that takes the error of each fix for its own."""

    def rows() -> Iterator[Rows]:
        for m in fixes:
            turn = m.heading * across(m.line)
            R = WHITE + m.sigma**2 * np.eye(2) + np.outer(turn, turn)
            yield Rows(*m.own, np.eye(2, OWN), R)

    return Filter(np.zeros(0), rows())


def expected(
    leader: Leader, fixes: Sequence[Moment], own_sigmas: Array, f: Filter
) -> tuple[Line, Line]:
    """What is expected of a filter: of its own covariance, and with its constant errors.

    The covariance of what is off (OWN + SIZE) and of the filter's estimate of it, jointly.
    """
    start = sigmas_of(leader)
    true = both(leader, fixes)
    P = np.diag(np.concatenate([own_sigmas, f.sigmas]) ** 2)
    n, size = OWN + lead.SIZE, len(P)
    joint = joined(np.diag(np.concatenate([own_sigmas, start]) ** 2), np.zeros((size, size)))
    moved = np.zeros((size, COLUMNS))
    lines: list[tuple[Line, Line]] = []
    for k, (truth, r) in enumerate(zip(true.rows, f.rows, strict=True), 1):
        P = r.Phi @ P @ r.Phi.T + np.diag(r.Q)
        K = np.linalg.solve(r.H @ P @ r.H.T + r.R, r.H @ P).T
        left = np.eye(size) - K @ r.H
        P = left @ P @ left.T + K @ r.R @ K.T
        moved = left @ (r.Phi @ moved)
        if r.constants is not None:
            moved = moved + K @ r.constants
        seen = np.vstack([np.eye(n), K @ truth.H])  # by truth and estimate, of the truth's errors
        carry = np.hstack([seen @ truth.Phi, np.vstack([np.zeros((n, size)), left @ r.Phi])])
        joint = carry @ joint @ carry.T + (seen * truth.Q) @ seen.T
        joint[n:, n:] += K @ truth.R @ K.T
        if 2 * k > len(fixes):
            error = np.hstack([np.eye(3, n), -np.eye(3, size)])
            E = error @ joint @ error.T
            lines.append((_line_of(E, P), _line_of(E, P + moved @ moved.T)))
    own, published = np.mean(np.array(lines), axis=0)
    return _root(own), _root(published)


def run(scenario: Scenario, own_sigmas: Array = SIGMAS) -> dict[str, Line]:
    """Results of the filters, by name; ``own_sigmas`` (7,) are those of the follower's errors."""
    fixes = moments(scenario, own_sigmas)
    filters = {
        'centralised': both(scenario.leader, fixes),
        'structured': both(stated_leader(fixes), fixes),
        'packets': three_states(fixes),
        'independent': independent(fixes),
    }
    lines = {n: expected(scenario.leader, fixes, own_sigmas, f) for n, f in filters.items()}
    return {name: own for name, (own, _) in lines.items()} | {'published': lines['packets'][1]}


def across(r: Array) -> Array:
    """Return up x r: how a turn by one radian moves the end of r, (2,)."""
    return np.array([-r[1], r[0]])


def joined(a: Array, b: Array) -> Array:
    """Block diagonal of two square matrices."""
    out = np.zeros((len(a) + len(b), len(a) + len(b)))
    out[: len(a), : len(a)], out[len(a) :, len(a) :] = a, b
    return out


def _turning(leader: Leader) -> int:
    return lead.HEADING if leader.array_deg is None else lead.TURN


def _velocity(scenario: Scenario, now: float) -> Array:
    back = scenario.mission and int(now // _LEG_S) % 2
    return np.array([0.0, -_SPEED if back else _SPEED])


def _line(leader: Leader, now: float) -> Array:
    angle = {
        'abeam': math.pi,
        'ahead': 1.5 * math.pi,
        'circling': 2.0 * math.pi * now / 1800.0,
        'east': math.pi,
    }[leader.place]
    return leader.range_m * np.array([math.cos(angle), math.sin(angle)])


def _own_step(v: Array, sigmas: Array) -> tuple[Array, Array]:
    Phi = np.eye(OWN)
    Phi[0, 2], Phi[1, 2] = -v[1] * _DT, v[0] * _DT
    Phi[:2, 4] = v * _DT
    Phi[0, 5] = Phi[1, 6] = _DT
    Phi[2, 3] = _DT
    decay = math.exp(-_DT / _SLOW_S)
    Phi[5, 5] = Phi[6, 6] = decay
    Q = np.zeros(OWN)
    Q[5:] = sigmas[5:] ** 2 * (1.0 - decay**2)
    return Phi, Q


def _level(r: Array) -> Array:
    return np.array([*r, 0.0])


def _line_of(E: Array, P: Array) -> Line:
    """Squares in place of `rms` and `said`; E (3, 3) is the true covariance."""
    nees = float(np.trace(np.linalg.solve(P[:2, :2], E[:2, :2]))) / 2.0
    return Line(float(np.trace(E[:2, :2])), float(np.trace(P[:2, :2])), nees, E[2, 2] / P[2, 2])


def _root(mean: Array) -> Line:
    square, variance, position, heading = mean.tolist()
    return Line(math.sqrt(square), math.sqrt(variance), position, heading)


def main() -> None:
    """Print both tables."""
    rows = []
    for sigmas in (SIGMAS, CALM):
        rows.append(
            'leader                   filter        RMS m  x centralised  x structured  said m'
            '  NEES position  heading'
        )
        for scenario in SCENARIOS:
            found = run(scenario, sigmas)
            best, given = found['centralised'].rms, found['structured'].rms
            for name, x in found.items():
                rows.append(
                    f'{scenario.name:24s} {name:12s} {x.rms:6.2f} {x.rms / best:14.3f} '
                    f'{x.rms / given:13.3f} {x.said:7.2f} {x.position:14.2f} {x.heading:8.2f}'
                )
    print('\n'.join(rows))  # noqa: T201 - the output of a command


if __name__ == '__main__':
    main()
