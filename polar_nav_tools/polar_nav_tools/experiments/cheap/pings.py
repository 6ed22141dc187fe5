"""Plane model of a slow vehicle with a MEMS IMU: what the pings of its DVL show of the heading.

``python -m polar_nav_tools.experiments.cheap.pings`` prints a table. Legs at 0.3 to 0.8 m/s with
turns on the spot, pings of 5 mm/s at 8 Hz, fixes as those of the experiment. Everything is as the
filter is told; what differs is the velocity in the rows of the heading. It shares no code with the
engine. Rows by the *measured* velocity have the noise of their ping in them, which no motion goes
with: the filter takes it for heading information, n^2/sigma^2 per ping and square radian. So did
the engine up to version 5; its rows were the *blended* ones up to version 16, and now a turn is
*carried* with the corrections of the velocity as well (docs/derivations/measurements.md).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from polar_nav_core.arrays import Array

MEASURED, PREDICTED, BLENDED, CARRIED = 'measured', 'predicted', 'blended', 'carried'
"""Velocity in the rows of the heading; the third lies between both by the share of the innovation
that is the estimate's own error; the last is the predicted one, and each correction of the
velocity takes the covariance along."""
_DT, _RUNS = 0.125, 96
_WHITE, _FIX, _SLOW, _SLOW_S = 0.005, 1.2, 2.0, 60.0
_GYRO_NOISE, _GYRO_WALK, _ACCEL_NOISE = math.radians(0.005), math.radians(2e-4), 1.4e-3
_HEADING = math.radians(4.0)
_START = np.array([2.5, 2.5, 0.05, 0.05, _HEADING, math.radians(0.02), 1e-3, 1e-3, _SLOW, _SLOW])
"""1-sigma at the start: position (2), velocity (2), heading, gyro bias, accelerometer bias (2),
slow error of the fixes (2)."""
_N = len(_START)


class Line(NamedTuple):
    """Result of a filter: RMS, sigma and NEES per degree of freedom, in the second half."""

    heading_deg: float
    said_deg: float
    heading: float
    rms_m: float
    position: float


def _turned(angle: Array, v: Array) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1]], axis=-1)


def _motion(duration_s: float) -> tuple[Array, Array]:
    """Headings (n,) [rad] and body velocities (n, 2) [m/s]: legs of 70 s, turns of 15 s."""
    t = np.arange(int(duration_s / _DT)) * _DT
    number, since = np.divmod(t, 85.0)
    ramp = np.clip(np.minimum(since / 8.0, (70.0 - since) / 8.0), 0.0, 1.0)
    ahead = np.array([0.3, 0.5, 0.8])[number.astype(int) % 3] * (0.5 - 0.5 * np.cos(np.pi * ramp))
    way = np.where(number // 2 % 2 == 0, 1.0, -1.0)
    rate = np.where(since > 70.0, way * 0.5 * np.pi / 15.0, 0.0)
    rate += math.radians(1.0) * np.sin(2.0 * np.pi * t / 7.0)
    v_b = np.column_stack([ahead, 0.03 * np.sin(2.0 * np.pi * t / 11.0)])
    return np.cumsum(rate) * _DT, v_b


class _Filter:
    """Closed-loop filters of all runs; errors are estimate minus truth, as in the engine."""

    def __init__(self, x: Array, *, carries: bool) -> None:
        self.x, self._carries = x, carries
        self.P = np.broadcast_to(np.diag(_START**2), (len(x), _N, _N)).copy()

    def update(self, H: Array, z: Array, sigma: float) -> None:
        HP = H @ self.P
        S = HP @ np.swapaxes(H, 1, 2) + sigma**2 * np.eye(2)
        K = np.swapaxes(np.linalg.solve(S, HP), 1, 2)
        self.P = self.P - K @ HP
        moved = -(K @ z[:, :, None])[:, :, 0]
        self.x = self.x + moved
        if self._carries:  # a turn takes the velocity of now along, and not that of before
            T = np.broadcast_to(np.eye(_N), self.P.shape).copy()
            T[:, 2, 4], T[:, 3, 4] = -moved[:, 3], moved[:, 2]
            self.P = T @ self.P @ np.swapaxes(T, 1, 2)


def _rows(v: Array) -> Array:
    H = np.zeros((len(v), 2, _N))
    H[:, 0, 2] = H[:, 1, 3] = 1.0
    H[:, 0, 4], H[:, 1, 4] = v[:, 1], -v[:, 0]
    return H


def _ping_rows(f: _Filter, z: Array, kind: str, sigma: float) -> Array:
    """Rows of pings with innovations z."""
    v = f.x[:, 2:4]
    H = _rows(v - z)
    if kind in (PREDICTED, CARRIED):
        return _rows(v)
    if kind == BLENDED:
        own = np.einsum('rai,rij,raj->r', H, f.P, H)
        return _rows(v - (own / (own + 2.0 * sigma**2))[:, None] * z)
    return H


def run(kind: str, sigma: float = _WHITE, duration_s: float = 1200.0, seed: int = 1) -> Line:
    """Result with rows of a kind where pings are stated with a sigma [m/s]."""
    rng = np.random.default_rng(seed)
    psi, v_b = _motion(duration_s)
    v = _turned(psi, v_b)
    r = np.cumsum(v, axis=0) * _DT
    off = rng.standard_normal((_RUNS, _N)) * _START
    gyro, accel, slow = off[:, 5], off[:, 6:8], off[:, 8:]
    start = np.concatenate([r[0], v[0], [psi[0]], np.zeros(5)]) + off
    f = _Filter(start, carries=kind == CARRIED)
    f.x[:, 5:] = 0.0
    noise = np.zeros(_N)
    noise[2:4], noise[4], noise[5] = _ACCEL_NOISE**2, _GYRO_NOISE**2, _GYRO_WALK**2
    decay = math.exp(-1.0 / _SLOW_S)
    found = []
    for i in range(1, len(psi)):
        gyro = gyro + _GYRO_WALK * math.sqrt(_DT) * rng.standard_normal(_RUNS)
        rate = (psi[i] - psi[i - 1]) / _DT + gyro
        rate += _GYRO_NOISE / math.sqrt(_DT) * rng.standard_normal(_RUNS)
        middle = np.full(_RUNS, 0.5 * (psi[i] + psi[i - 1]))
        force = _turned(-middle, np.tile((v[i] - v[i - 1]) / _DT, (_RUNS, 1))) + accel
        force += _ACCEL_NOISE / math.sqrt(_DT) * rng.standard_normal((_RUNS, 2))
        rate, force = rate - f.x[:, 5], force - f.x[:, 6:8]
        heading = f.x[:, 4] + 0.5 * rate * _DT
        push = _turned(heading, force) * _DT
        f.x[:, :2] += (f.x[:, 2:4] + 0.5 * push) * _DT
        f.x[:, 2:4] += push
        f.x[:, 4] += rate * _DT
        Phi = np.broadcast_to(np.eye(_N), (_RUNS, _N, _N)).copy()
        Phi[:, 0, 2] = Phi[:, 1, 3] = _DT
        Phi[:, 2, 4], Phi[:, 3, 4] = -push[:, 1], push[:, 0]
        Phi[:, 4, 5] = -_DT
        c, s = np.cos(heading) * _DT, np.sin(heading) * _DT
        Phi[:, 2, 6], Phi[:, 2, 7], Phi[:, 3, 6], Phi[:, 3, 7] = -c, s, -s, -c
        f.P = Phi @ f.P @ np.swapaxes(Phi, 1, 2) + np.diag(noise * _DT)
        measured = v_b[i] + _WHITE * rng.standard_normal((_RUNS, 2))
        z = f.x[:, 2:4] - _turned(f.x[:, 4], measured)
        f.update(_ping_rows(f, z, kind, sigma), z, sigma)
        if i % 8:
            continue
        f.P[:, 8:, :] *= decay
        f.P[:, :, 8:] *= decay
        f.P[:, [8, 9], [8, 9]] += _SLOW**2 * (1.0 - decay**2)
        f.x[:, 8:] *= decay
        slow = decay * slow + _SLOW * math.sqrt(1.0 - decay**2) * rng.standard_normal(slow.shape)
        fix = r[i] - slow + _FIX * rng.standard_normal((_RUNS, 2))
        H = np.zeros((_RUNS, 2, _N))
        H[:, 0, 0] = H[:, 1, 1] = H[:, 0, 8] = H[:, 1, 9] = 1.0
        f.update(H, f.x[:, :2] - fix + f.x[:, 8:], _FIX)
        if 2 * i > len(psi):
            found.append(_measured(f, r[i], float(psi[i])))
    square, variance, heading_nees, flat, position = np.mean(found, axis=0).tolist()
    heading_deg, said_deg = (math.degrees(math.sqrt(x)) for x in (square, variance))
    return Line(heading_deg, said_deg, heading_nees, math.sqrt(flat), position)


def _measured(f: _Filter, r: Array, psi: float) -> list[float]:
    turn, e = f.x[:, 4] - psi, f.x[:, :2] - r
    nees = np.einsum('ri,ri->r', e, np.linalg.solve(f.P[:, :2, :2], e[:, :, None])[:, :, 0])
    variance = f.P[:, 4, 4]
    values = (turn**2, variance, turn**2 / variance, np.sum(e**2, axis=1), 0.5 * nees)
    return [float(x.mean()) for x in values]


def main() -> None:
    """Print the table."""
    rows = ['rows by     sigma m/s  heading deg   said   NEES  position m   NEES']
    for kind, sigma in (
        *((k, _WHITE) for k in (MEASURED, PREDICTED, BLENDED, CARRIED)),
        *((k, 0.03) for k in (MEASURED, BLENDED, CARRIED)),
    ):
        x = run(kind, sigma)
        rows.append(
            f'{kind:10s} {sigma:10.3f} {x.heading_deg:12.2f} {x.said_deg:6.2f} {x.heading:6.2f} '
            f'{x.rms_m:11.2f} {x.position:6.2f}'
        )
    print('\n'.join(rows))  # noqa: T201 - the output of a command


if __name__ == '__main__':
    main()
