"""Input of an identification: fixes of a window of time and the log between them.

Fixes are dated by their validity, integer nanoseconds, in any order; losses only make the steps
between them longer. The log holds attitude and thrust; thrust holds from its stamp to the next.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from .polar_fix import PolarFix

Stamps = NDArray[np.int64]
LONGEST_STEP_S = 0.25
"""Longer intervals of the log are divided, attitude along the straight line."""


@dataclass(frozen=True)
class PositionFix:
    """One fix in horizontal coordinates of the station frame.

    Attributes
    ----------
    validity_ns : int
    x, y : float
        Position [m].
    covariance : (2, 2) array
        Of the error that is independent from fix to fix [m^2].
    x_s, y_s, heading_sigma : float
        Position of the station [m], and the 1-sigma of its heading, the same error in all [rad].
    """

    validity_ns: int
    x: float
    y: float
    covariance: Array
    x_s: float = 0.0
    y_s: float = 0.0
    heading_sigma: float = 0.0


def position_fix(validity_ns: int, polar: PolarFix, z: float) -> PositionFix:
    """Position of range and bearing, Eq. (10), with its covariance.

    ``D_h = sqrt(D^2 - dz^2)`` is the horizontal range; its error is that of D times D / D_h.

    Parameters
    ----------
    z : float
        Height of the vehicle in the station frame [m]; NaN: the range is assumed horizontal.
    """
    dz = z - float(polar.station[2])
    if not math.isfinite(dz):
        dz = 0.0
    across = math.sqrt(max(polar.range**2 - dz * dz, 0.0))
    angle = polar.station_heading + polar.bearing
    c, s = math.cos(angle), math.sin(angle)
    sigma_r = polar.range_sigma * polar.range / max(across, polar.range_sigma)
    slopes = np.array([[c, -across * s], [s, across * c]])
    variances = np.array([sigma_r**2, polar.bearing_sigma**2])
    covariance = (slopes * variances) @ slopes.T
    covariance[[0, 1], [0, 1]] += 1e-6  # right below the station the bearing has no information
    x_s, y_s = float(polar.station[0]), float(polar.station[1])
    return PositionFix(
        validity_ns,
        x_s + across * c,
        y_s + across * s,
        covariance,
        x_s,
        y_s,
        polar.station_heading_sigma,
    )


@dataclass(frozen=True)
class Log:
    """Attitude and thrust, each at its own stamps, in order.

    Attributes
    ----------
    attitude_ns, force_ns : (m,), (k,) arrays of int
    psi : (m,) array
        Measured heading, counter-clockwise from x [rad], any multiple of a turn.
    pitch, yaw_rate : (m,) arrays
        Positive nose down [rad]; body z axis [rad/s].
    force : (k,) array
        Surge force from the stamp on [N].
    """

    attitude_ns: Stamps
    psi: Array
    pitch: Array
    yaw_rate: Array
    force_ns: Stamps
    force: Array


@dataclass(frozen=True)
class Window:
    """Fixes in order of validity, and the log on a grid that has every fix as a node.

    Attributes
    ----------
    validity_ns : (n,) array of int
    position : (n, 2) array
        Fixes [m], station frame.
    covariance : (n, 2, 2) array
        [m^2].
    station : (n, 2) array
        Positions of the station [m].
    heading_sigma : float
        Of the station [rad].
    seconds, psi, pitch, yaw_rate, force : (m,) arrays
        The grid, seconds from the first fix; psi without jumps.
    node : (n,) array of int
        Index of each fix on the grid.
    """

    validity_ns: Stamps
    position: Array
    covariance: Array
    station: Array
    heading_sigma: float
    seconds: Array
    psi: Array
    pitch: Array
    yaw_rate: Array
    force: Array
    node: NDArray[np.intp]

    @property
    def fixes(self) -> int:
        """Number of fixes."""
        return len(self.validity_ns)

    @property
    def duration(self) -> float:
        """From the first fix to the last [s]."""
        return float(self.validity_ns[-1] - self.validity_ns[0]) * 1e-9


def make_window(
    fixes: list[PositionFix], log: Log, *, most: int, longest_gap_s: float, lead_s: float = 10.0
) -> Window | None:
    """Window of the newest fixes that the log covers; None without any.

    Parameters
    ----------
    fixes : list of PositionFix
        In any order.
    log : Log
    most : int
        Largest number of fixes, the newest ones.
    longest_gap_s : float
        Only the time after the last longer gap of the log is used.
    lead_s : float
        Length of the log before the first fix that is integrated, so that start errors decay.
    """
    if not fixes or len(log.attitude_ns) < 2 or not len(log.force_ns):
        return None
    begin, end = _covered(log, int(longest_gap_s * 1e9))
    inside = sorted(
        (f for f in fixes if begin <= f.validity_ns <= end), key=lambda f: f.validity_ns
    )[-most:]
    if not inside:
        return None
    validity = np.array([f.validity_ns for f in inside], dtype=np.int64)
    first = max(begin, int(validity[0]) - int(lead_s * 1e9))
    grid = _grid(log, validity, first)
    psi = np.unwrap(log.psi)

    def along(values: Array) -> Array:
        return np.interp(grid - first, log.attitude_ns - first, values)

    held = np.searchsorted(log.force_ns, grid, side='right') - 1
    return Window(
        validity_ns=validity,
        position=np.array([[f.x, f.y] for f in inside]),
        covariance=np.array([f.covariance for f in inside]),
        station=np.array([[f.x_s, f.y_s] for f in inside]),
        heading_sigma=max(f.heading_sigma for f in inside),
        seconds=(grid - validity[0]) * 1e-9,
        psi=along(psi),
        pitch=along(log.pitch),
        yaw_rate=along(log.yaw_rate),
        force=log.force[np.maximum(held, 0)],
        node=np.searchsorted(grid, validity),
    )


def _covered(log: Log, gap_ns: int) -> tuple[int, int]:
    """Begin and end [ns] of the last stretch of attitude and thrust without a long gap."""
    begin, end = 0, np.iinfo(np.int64).max
    for stamps in (log.attitude_ns, log.force_ns):
        after = np.flatnonzero(np.diff(stamps) > gap_ns)
        begin = max(begin, int(stamps[after[-1] + 1] if len(after) else stamps[0]))
        end = min(end, int(stamps[-1]) + gap_ns)
    return begin, end


def _grid(log: Log, validity: Stamps, first: int) -> Stamps:
    """Stamps of log and fixes from first to the last fix, long intervals divided."""
    last = int(validity[-1])
    logged = np.concatenate([log.attitude_ns, log.force_ns])
    logged = logged[(logged > first) & (logged < last)]
    nodes = np.unique(np.concatenate([[first], logged, validity])).astype(np.int64)
    step = int(LONGEST_STEP_S * 1e9)
    parts = np.maximum(-(-np.diff(nodes) // step), 1)
    whole = np.repeat(nodes[:-1], parts)
    part = np.arange(len(whole)) - np.repeat(np.cumsum(parts) - parts, parts)
    divided = whole + np.repeat(np.diff(nodes), parts) * part // np.repeat(parts, parts)
    return np.append(divided, last).astype(np.int64)
