"""The linear model of leader and follower in the plane, and three filters of the follower.

``python -m polar_nav_tools.experiments.leader_error.two_vehicles`` prints a table. It shares no
code with the engine but the columns of the leader's error. `centralised` is the Kalman filter of
both vehicles, which knows the errors of both; no filter of the same fixes can be better. `packets`
knows of the leader what its packets state, `independent` takes each fix's error for its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from polar_nav_core.engine.events import Array
from polar_nav_core.engine.sins.leader import Growth, Smooth, columns

from . import leader as lead
from .experiment import SCENARIOS, Scenario
from .leader import Leader, rounded, sigmas_of, step

_DT = 4.0
_SPEED = 3.0
_LEG_S = 900.0
"""Of the way there and back that stands for a racetrack."""
_RUNS = 400
_TAU_S = 3600.0
_OWN = 7
"""The follower's errors: position (2), heading, gyro bias, DVL scale, slow velocity (2)."""
_SIGMAS = np.array([5.0, 5.0, math.radians(5.0 / 60.0), 1.45e-7, 0.004, 0.005, 0.005])
_SLOW_S = 300.0
_FIX_SIGMA = 1.0


class Line(NamedTuple):
    """Result of a filter: in the second half, over all runs.

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


class _Filter:
    """Means (runs, n) and the covariance of a filter."""

    def __init__(self, P: Array) -> None:
        self.P = P
        self.x = np.zeros((_RUNS, len(P)))

    def predict(self, Phi: Array, Q: Array) -> None:
        self.x = self.x @ Phi.T
        self.P = Phi @ self.P @ Phi.T + np.diag(Q)

    def update(self, H: Array, R: Array, z: Array) -> None:
        S = H @ self.P @ H.T + R
        K = np.linalg.solve(S, H @ self.P).T
        self.x = self.x + (z - self.x @ H.T) @ K.T
        A = np.eye(len(self.P)) - K @ H
        self.P = A @ self.P @ A.T + K @ R @ K.T


def _velocity(scenario: Scenario, now: float) -> Array:
    back = scenario.mission and int(now // _LEG_S) % 2
    return np.array([0.0, -_SPEED if back else _SPEED])


def _line(leader: Leader, now: float) -> Array:
    angle = {'abeam': math.pi, 'ahead': 1.5 * math.pi, 'circling': 2.0 * math.pi * now / 1800.0}
    return leader.range_m * np.array(
        [math.cos(angle[leader.place]), math.sin(angle[leader.place])]
    )


def _own_step(v: Array) -> tuple[Array, Array]:
    Phi = np.eye(_OWN)
    Phi[0, 2], Phi[1, 2] = -v[1] * _DT, v[0] * _DT
    Phi[:2, 4] = v * _DT
    Phi[0, 5] = Phi[1, 6] = _DT
    Phi[2, 3] = _DT
    decay = math.exp(-_DT / _SLOW_S)
    Phi[5, 5] = Phi[6, 6] = decay
    Q = np.zeros(_OWN)
    Q[5:] = _SIGMAS[5:] ** 2 * (1.0 - decay**2)
    return Phi, Q


def _joined(a: Array, b: Array) -> Array:
    out = np.zeros((len(a) + len(b), len(a) + len(b)))
    out[: len(a), : len(a)], out[len(a) :, len(a) :] = a, b
    return out


def _across(r: Array) -> Array:
    return np.array([-r[1], r[0], 0.0])


def run(scenario: Scenario, seed: int = 1) -> dict[str, Line]:
    """Results of the filters, by name."""
    rng = np.random.default_rng(seed)
    leader, sigmas = scenario.leader, sigmas_of(scenario.leader)
    n = _OWN + lead.SIZE
    truth = rng.standard_normal((_RUNS, n)) * np.concatenate([_SIGMAS, sigmas])
    stated = np.diag(sigmas**2)
    own = np.diag(_SIGMAS**2)
    filters = {
        'centralised': _Filter(_joined(own, stated)),
        'packets': _Filter(_joined(own, np.eye(3))),
        'independent': _Filter(own),
    }
    found: dict[str, list[Line]] = {name: [] for name in filters}
    turning = lead.HEADING if leader.array_deg is None else lead.TURN
    way = np.zeros(2)
    smooth = Smooth(_TAU_S), Smooth(_TAU_S)
    growth = Growth(_TAU_S)
    steps = int(scenario.duration_s / _DT)
    decay = math.exp(-_DT / _TAU_S)
    for k in range(1, steps + 1):
        v = _velocity(scenario, (k - 1) * _DT)
        # The leader's own way: the follower's less how it moves round it.
        moved = _line(leader, k * _DT) - _line(leader, (k - 1) * _DT)
        v_leader = v - moved / _DT
        way = way + v_leader * _DT
        Phi_own, Q_own = _own_step(v)
        Phi_leader, Q_leader = step(leader, sigmas, v_leader, _DT)
        Phi, Q = _joined(Phi_own, Phi_leader), np.concatenate([Q_own, Q_leader])
        truth = truth @ Phi.T + rng.standard_normal(truth.shape) * np.sqrt(Q)
        stated = Phi_leader @ stated @ Phi_leader.T + np.diag(Q_leader)
        largest = float(np.linalg.eigvalsh(stated[lead.POSITION, lead.POSITION])[-1])
        position, heading = rounded(np.sqrt([largest, stated[turning, turning]]))
        turn = _across(_line(leader, k * _DT))
        H = np.zeros((2, n))
        H[:, :2] = np.eye(2)
        H[:, _OWN : _OWN + 2] = -np.eye(2)
        H[:, _OWN + turning] -= turn[:2]
        R = _FIX_SIGMA**2 * np.eye(2)
        z = truth @ H.T + _FIX_SIGMA * rng.standard_normal((_RUNS, 2))
        stamp_ns = round(k * _DT * 1e9)
        sigma = smooth[0].at(stamp_ns, float(position))
        A = columns(
            sigma,
            smooth[1].at(stamp_ns, float(heading)),
            turn,
            _across(way),
        )[:2]
        H_packets = np.hstack([H[:, :_OWN], -A])
        whole = R + position**2 * np.eye(2) + heading**2 * np.outer(turn[:2], turn[:2])
        markov = _joined(Phi_own, decay * np.eye(3))
        noise = np.concatenate([Q_own, np.full(3, 1.0 - decay**2)])
        filters['centralised'].predict(Phi, Q)
        filters['centralised'].update(H, R, z)
        filters['packets'].predict(markov, noise)
        filters['packets'].update(H_packets, R + growth.at(stamp_ns, sigma) * np.eye(2), z)
        filters['independent'].predict(Phi_own, Q_own)
        filters['independent'].update(H[:, :_OWN], whole, z)
        if 2 * k > steps:
            for name, f in filters.items():
                found[name].append(_measured(f, truth))
    return {name: _mean(lines) for name, lines in found.items()}


def _measured(f: _Filter, truth: Array) -> Line:
    e = f.x[:, :2] - truth[:, :2]
    psi = f.x[:, 2] - truth[:, 2]
    nees = np.einsum('ni,ni->n', e, np.linalg.solve(f.P[:2, :2], e.T).T)
    return Line(
        float(np.mean(np.sum(e**2, axis=1))),
        float(np.trace(f.P[:2, :2])),
        float(nees.mean()) / 2.0,
        float(np.mean(psi**2)) / float(f.P[2, 2]),
    )


def _mean(lines: list[Line]) -> Line:
    square, variance, position, heading = np.mean(np.array(lines), axis=0).tolist()
    return Line(math.sqrt(square), math.sqrt(variance), position, heading)


def main() -> None:
    """Print the table."""
    rows = ['leader                   filter        RMS m  x best  said m  NEES position  heading']
    for scenario in SCENARIOS:
        found = run(scenario)
        for name, x in found.items():
            ratio = x.rms / found['centralised'].rms
            rows.append(
                f'{scenario.name:24s} {name:12s} {x.rms:6.2f} {ratio:7.3f} {x.said:7.2f} '
                f'{x.position:14.2f} {x.heading:8.2f}'
            )
    print('\n'.join(rows))  # noqa: T201 - the output of a command


if __name__ == '__main__':
    main()
