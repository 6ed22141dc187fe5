"""The linear model of leader and follower in the plane, and filters of the follower.

``python -m polar_nav_tools.experiments.leader_error.two_vehicles`` prints two tables: of a
follower whose DVL has a slow error, and of one that knows its own (`CALM`). They share no code
with the engine but the columns of the leader's error. `centralised` is the Kalman filter of
both vehicles, which knows the errors of both; no filter of the same fixes can be better. `packets`
knows of the leader what its packets state, and `published` has the constant errors of the leader
in the covariance besides; `independent` takes each fix's error for its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from polar_nav_core.engine.events import Array
from polar_nav_core.engine.sins.leader import Growth, Smooth, columns
from polar_nav_core.engine.sins.leader_drift import COLUMNS, Drift

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
CALM = np.array([*_SIGMAS[:3], 1e-8, 5e-4, 3e-4, 3e-4])
"""Of a follower whose attitude oscillates: its IMU shows the errors of its DVL."""
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
    """Means (runs, n) and the covariance of a filter; what constant errors make of its means."""

    def __init__(self, P: Array) -> None:
        self.P = P
        self.x = np.zeros((_RUNS, len(P)))
        self.moved = np.zeros((len(P), COLUMNS))

    def predict(self, Phi: Array, Q: Array) -> None:
        self.x = self.x @ Phi.T
        self.P = Phi @ self.P @ Phi.T + np.diag(Q)
        self.moved = Phi @ self.moved

    def update(self, H: Array, R: Array, z: Array, constants: Array | None = None) -> None:
        S = H @ self.P @ H.T + R
        K = np.linalg.solve(S, H @ self.P).T
        self.x = self.x + (z - self.x @ H.T) @ K.T
        A = np.eye(len(self.P)) - K @ H
        self.P = A @ self.P @ A.T + K @ R @ K.T
        if constants is not None:
            self.moved = A @ self.moved + K @ constants


def _velocity(scenario: Scenario, now: float) -> Array:
    back = scenario.mission and int(now // _LEG_S) % 2
    return np.array([0.0, -_SPEED if back else _SPEED])


def _line(leader: Leader, now: float) -> Array:
    angle = {'abeam': math.pi, 'ahead': 1.5 * math.pi, 'circling': 2.0 * math.pi * now / 1800.0}
    return leader.range_m * np.array(
        [math.cos(angle[leader.place]), math.sin(angle[leader.place])]
    )


def _own_step(v: Array, sigmas: Array) -> tuple[Array, Array]:
    Phi = np.eye(_OWN)
    Phi[0, 2], Phi[1, 2] = -v[1] * _DT, v[0] * _DT
    Phi[:2, 4] = v * _DT
    Phi[0, 5] = Phi[1, 6] = _DT
    Phi[2, 3] = _DT
    decay = math.exp(-_DT / _SLOW_S)
    Phi[5, 5] = Phi[6, 6] = decay
    Q = np.zeros(_OWN)
    Q[5:] = sigmas[5:] ** 2 * (1.0 - decay**2)
    return Phi, Q


def _joined(a: Array, b: Array) -> Array:
    out = np.zeros((len(a) + len(b), len(a) + len(b)))
    out[: len(a), : len(a)], out[len(a) :, len(a) :] = a, b
    return out


def _across(r: Array) -> Array:
    return np.array([-r[1], r[0], 0.0])


def run(scenario: Scenario, seed: int = 1, own_sigmas: Array = _SIGMAS) -> dict[str, Line]:
    """Results of the filters, by name; ``own_sigmas`` (7,) are those of the follower's errors."""
    rng = np.random.default_rng(seed)
    leader, sigmas = scenario.leader, sigmas_of(scenario.leader)
    n = _OWN + lead.SIZE
    truth = rng.standard_normal((_RUNS, n)) * np.concatenate([own_sigmas, sigmas])
    stated = np.diag(sigmas**2)
    own = np.diag(own_sigmas**2)
    filters = {
        'centralised': _Filter(_joined(own, stated)),
        'packets': _Filter(_joined(own, np.eye(3))),
        'independent': _Filter(own),
    }
    found: dict[str, list[Line]] = {name: [] for name in (*filters, 'published')}
    turning = lead.HEADING if leader.array_deg is None else lead.TURN
    way = np.zeros(2)
    smooth = Smooth(_TAU_S), Smooth(_TAU_S)
    growth, drift = Growth(_TAU_S), Drift()
    steps = int(scenario.duration_s / _DT)
    decay = math.exp(-_DT / _TAU_S)
    for k in range(1, steps + 1):
        v = _velocity(scenario, (k - 1) * _DT)
        # The leader's own way: the follower's less how it moves round it.
        moved = _line(leader, k * _DT) - _line(leader, (k - 1) * _DT)
        v_leader = v - moved / _DT
        way = way + v_leader * _DT
        Phi_own, Q_own = _own_step(v, own_sigmas)
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
        stated_heading = smooth[1].at(stamp_ns, float(heading))
        A = columns(sigma, stated_heading, turn, _across(way))[:2]
        place = np.array([*way, 0.0])
        constants = drift.columns(stamp_ns, place, np.eye(3), sigma, stated_heading)[:2]
        H_packets = np.hstack([H[:, :_OWN], -A])
        whole = R + position**2 * np.eye(2) + heading**2 * np.outer(turn[:2], turn[:2])
        markov = _joined(Phi_own, decay * np.eye(3))
        noise = np.concatenate([Q_own, np.full(3, 1.0 - decay**2)])
        filters['centralised'].predict(Phi, Q)
        filters['centralised'].update(H, R, z)
        filters['packets'].predict(markov, noise)
        white = R + growth.at(stamp_ns, sigma) * np.eye(2)
        filters['packets'].update(H_packets, white, z, constants)
        filters['independent'].predict(Phi_own, Q_own)
        filters['independent'].update(H[:, :_OWN], whole, z)
        if 2 * k > steps:
            for name, f in filters.items():
                found[name].append(_measured(f, truth, f.P))
            packets = filters['packets']
            total = packets.P + packets.moved @ packets.moved.T
            found['published'].append(_measured(packets, truth, total))
    return {name: _mean(lines) for name, lines in found.items()}


def _measured(f: _Filter, truth: Array, P: Array) -> Line:
    e = f.x[:, :2] - truth[:, :2]
    psi = f.x[:, 2] - truth[:, 2]
    nees = np.einsum('ni,ni->n', e, np.linalg.solve(P[:2, :2], e.T).T)
    return Line(
        float(np.mean(np.sum(e**2, axis=1))),
        float(np.trace(P[:2, :2])),
        float(nees.mean()) / 2.0,
        float(np.mean(psi**2)) / float(P[2, 2]),
    )


def _mean(lines: list[Line]) -> Line:
    square, variance, position, heading = np.mean(np.array(lines), axis=0).tolist()
    return Line(math.sqrt(square), math.sqrt(variance), position, heading)


def main() -> None:
    """Print both tables."""
    head = 'leader                   filter        RMS m  x best  said m  NEES position  heading'
    rows = []
    for sigmas in (_SIGMAS, CALM):
        rows.append(head)
        for scenario in SCENARIOS:
            found = run(scenario, own_sigmas=sigmas)
            for name, x in found.items():
                ratio = x.rms / found['centralised'].rms
                rows.append(
                    f'{scenario.name:24s} {name:12s} {x.rms:6.2f} {ratio:7.3f} {x.said:7.2f} '
                    f'{x.position:14.2f} {x.heading:8.2f}'
                )
    print('\n'.join(rows))  # noqa: T201 - the output of a command


if __name__ == '__main__':
    main()
