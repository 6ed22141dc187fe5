"""Lever arm and latency of a DVL out of the turns of a recording, without a filter.

In windows of twenty seconds the IMU alone carries a velocity along, in axes n of the body at the
start of the window, in which gravity is as constant as its unknown bias of tilt:

    v_b(t) = C_b_n(t)^T (v_0 + integral of C_b_n f_b dt + g_n t)

A ping that is late by tau, at a point that is off by e, measures

    v_b + omega x e - tau dv_b/dt

Per window v_0 and g_n are unknown, in all together e_x, e_y, tau and the biases of accelerometers
and gyros: least squares, linear but for the gyros' bias, which is taken off before it is solved
again; sigmas are from the scatter between windows. A filter's own innovations would show less: it
follows the pings, and with them the error of a long turn.

A bias b of the gyros turns C_b_n by phi = beta b, beta the integral of C_b_n. To first order

    dv_b = C_b_n^T (integral of [C_b_n f_b x] beta dt - [x x] beta) b,    x = v_0 + a + g_n t

is missing in a window that was carried along with it, a the integral of C_b_n f_b.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.attitude import exp, skew
from polar_nav_core.engine.inputs import Inputs
from polar_nav_ros.adapters.arrays import finite_rows

_WINDOW_S = 20.0
_MOST_WINDOWS, _FEWEST_WINDOWS = 24, 6
"""Those with the most turning; each costs the integration of its samples."""
_FEWEST_PINGS = 12
_LONGEST_STEP_S = 1.0
"""A window in which the IMU was silent for longer is left out."""
_OUTLIER = 5.0
"""Pings further off, in robust sigmas, are left out of a second solution."""
_LEVER, _LAG, _GYRO = slice(0, 2), 2, slice(6, 9)
_PRIOR = np.array([10.0, 10.0, 5.0, *[0.5] * 3, *[0.02] * 3])
"""1-sigma of lever arm [m], lag [s], biases [m/s^2], [rad/s]: what no turn shows stays small."""
_ROUNDS, _ENOUGH = 5, 1e-5
"""Of solving again with the gyros' bias taken off; until it changes by less [rad/s]."""


@dataclass(frozen=True)
class Turns:
    """What the turns show of a DVL, beyond what was stated.

    Attributes
    ----------
    lever_b : (2,) array
        Forward and to the left [m].
    lag_s : float
        How old a ping is at its stamp [s].
    lever_sigma, lag_sigma : (2,) array, float
        1-sigma, from the scatter between windows.
    speed : float
        Mean speed in those windows [m/s].
    windows : int
    """

    lever_b: Array
    lag_s: float
    lever_sigma: Array
    lag_sigma: float
    speed: float
    windows: int


@dataclass(frozen=True)
class _Window:
    """Rows of one window, three per ping, with its own unknowns taken out."""

    A: Array
    y: Array


@dataclass(frozen=True)
class _Part:
    """Samples and pings of one window: times since its start [s], rates, forces, velocities."""

    t: Array
    omega: Array
    f: Array
    at: Array
    v: Array


def turns(inputs: Inputs, lever_b: Array) -> Turns | None:
    """Look at the turns of a recording; None where there are too few.

    Parameters
    ----------
    inputs : Inputs
        With a DVL, body axes.
    lever_b : (3,) array
        The DVL from the IMU, as stated [m].
    """
    parts = _parts(inputs)
    if len(parts) < _FEWEST_WINDOWS:
        return None
    bias = np.zeros(3)
    for _ in range(_ROUNDS):
        found = _solved([_window(p, bias, lever_b) for p in parts])
        if found is None:
            return None
        x, sigma = found
        bias += x[_GYRO]
        if np.abs(x[_GYRO]).max() < _ENOUGH:
            break
    return Turns(
        lever_b=x[_LEVER],
        lag_s=float(x[_LAG]),
        lever_sigma=sigma[_LEVER],
        lag_sigma=float(sigma[_LAG]),
        speed=float(np.mean([np.linalg.norm(p.v, axis=1).mean() for p in parts])),
        windows=len(parts),
    )


def _parts(inputs: Inputs) -> list[_Part]:
    """Cut a recording into windows; those with the most turning."""
    valid = inputs.dvl_valid & finite_rows(inputs.dvl_v_m)
    pings_ns, v = inputs.dvl_stamps_ns[valid], inputs.dvl_v_m[valid]
    good = finite_rows(inputs.omega_ib_b) & finite_rows(inputs.f_b)
    good[1:] &= np.diff(inputs.imu_stamps_ns) > 0
    stamps_ns = inputs.imu_stamps_ns[good]
    if len(stamps_ns) < 2 or len(pings_ns) < _FEWEST_PINGS:
        return []
    omega, f = inputs.omega_ib_b[good], inputs.f_b[good]
    starts = np.arange(int(stamps_ns[0]), int(stamps_ns[-1]), round(_WINDOW_S * 1e9))
    bounds: list[int] = [
        int(k) for k in np.searchsorted(stamps_ns, np.append(starts, stamps_ns[-1]))
    ]
    spread = [float(np.std(omega[a:b, 2])) if b > a else 0.0 for a, b in pairwise(bounds)]
    chosen = np.sort(np.argsort(spread)[::-1][:_MOST_WINDOWS])
    parts = []
    for k in chosen:
        a, b = bounds[k], bounds[k + 1]
        inside = slice(*np.searchsorted(pings_ns, stamps_ns[[a, max(b - 1, a)]], side='right'))
        t = (stamps_ns[a:b] - stamps_ns[a]) * 1e-9
        at = (pings_ns[inside] - stamps_ns[a]) * 1e-9
        if len(at) < _FEWEST_PINGS or np.diff(t).max() > _LONGEST_STEP_S:
            continue
        parts.append(_Part(t, omega[a:b], f[a:b], at, v[inside]))
    return parts


def _window(p: _Part, gyro_bias_b: Array, lever_b: Array) -> _Window:
    """Rows of a window, with a bias of the gyros [rad/s] taken off."""
    t, at, omega = p.t, p.at, p.omega - gyro_bias_b
    dt = np.diff(t, prepend=t[0])[:, None, None]
    C = _carried(omega * dt[:, 0])
    f_n = np.einsum('nij,nj->ni', C, p.f)
    a = np.cumsum(f_n * dt[:, 0], axis=0)
    beta = np.cumsum(C * dt, axis=0)
    gamma = np.cumsum(skew(f_n) @ beta * dt, axis=0)
    k = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    share = ((at - t[k - 1]) / (t[k] - t[k - 1]))[:, None]

    def between(x: Array) -> Array:
        return np.asarray((1.0 - share) * x[k - 1] + share * x[k])

    rate = between(omega)
    # Velocity and integrals in the body's axes of each sample: these change slowly.
    a_b = between(np.einsum('nji,nj->ni', C, a))
    C_n_b = between(np.swapaxes(C, 1, 2).reshape(-1, 9)).reshape(-1, 3, 3)
    own = np.concatenate([C_n_b, C_n_b * at[:, None, None]], axis=2).reshape(-1, 6)
    y = (p.v - np.cross(rate, lever_b) - a_b).reshape(-1)
    fit, *_ = np.linalg.lstsq(own, y, rcond=None)
    x = fit[:3] + a + fit[3:] * t[:, None]
    change = between(np.gradient(np.einsum('nji,nj->ni', C, x), t, axis=0))

    def seen(by_n: Array) -> Array:
        turned = np.einsum('nji,njk->nik', C, by_n)
        return between(turned.reshape(-1, 9)).reshape(-1, 3, 3)

    shared = np.concatenate(
        [
            np.cross(rate, np.array([1.0, 0.0, 0.0]))[:, :, None],
            np.cross(rate, np.array([0.0, 1.0, 0.0]))[:, :, None],
            -change[:, :, None],
            -seen(beta),
            seen(gamma - skew(x) @ beta),
        ],
        axis=2,
    ).reshape(-1, len(_PRIOR))
    Q, _ = np.linalg.qr(own)
    return _Window(shared - Q @ (Q.T @ shared), y - Q @ (Q.T @ y))


def _carried(delta_theta_b: Array) -> Array:
    """Attitude against the start of a window, (n, 3, 3), by increments of angle (n, 3) [rad]."""
    C = np.asarray(exp(delta_theta_b))
    reach = 1  # each C holds the product of the last so many steps
    while reach < len(C):
        C = np.concatenate([C[:reach], C[:-reach] @ C[reach:]])
        reach *= 2
    return C


def _solved(windows: list[_Window]) -> tuple[Array, Array] | None:
    """What all windows share, and its 1-sigma; None where pings say nothing."""
    kept = windows
    for again in (True, False):
        A, y = np.concatenate([w.A for w in kept]), np.concatenate([w.y for w in kept])
        free, *_ = np.linalg.lstsq(A, y, rcond=None)
        variance = float(np.mean((y - A @ free) ** 2))
        if not (np.isfinite(variance) and variance > 0.0):
            return None
        inverse = np.linalg.inv(A.T @ A + np.diag(variance / _PRIOR**2))
        x = inverse @ (A.T @ y)
        if again:
            limit = _OUTLIER * 1.4826 * float(np.median(np.abs(y - A @ x)))
            near = [np.abs(w.y - w.A @ x) <= limit for w in windows]
            kept = [_Window(w.A[r], w.y[r]) for w, r in zip(windows, near, strict=True)]
    scores = np.array([w.A.T @ (w.y - w.A @ x) for w in kept])
    few = len(kept) / (len(kept) - 1.0)
    return x, np.sqrt(np.diagonal(few * inverse @ (scores.T @ scores) @ inverse))
