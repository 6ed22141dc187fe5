"""Delayed positions of the vehicle as fixes of the engine: any type of position, 2-D or 3-D."""

from __future__ import annotations

import math

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.events import Fix
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.level import LEVEL_SIGMA

from .arrays import congruent, finite_rows
from .mapping import FixMapping
from .position import PositionRows
from .rows import Stamps

CLOCKS_AGREE_NS = 100_000_000
"""That clocks of two computers may differ by."""
_LEAST_STEP_S = 1e-3
"""Between two positions of a source: closer ones are one and the same."""


def level_height(mapping: FixMapping, sea_surface_height: float) -> float | None:
    """Return the height [m] for fixes without one; None where their heights are measured."""
    return None if mapping.dimensions == 3 else sea_surface_height


def fixes_of(
    mapping: FixMapping,
    rows: PositionRows,
    first_arrival: int = 0,
    before_ns: int | None = None,
) -> tuple[Fix, ...]:
    """Fixes of the rows that hold a position, in their order.

    Parameters
    ----------
    mapping : FixMapping
    rows : PositionRows
    first_arrival : int
        Number of the first row among those of all sources: places equal stamps in order.
    before_ns : int, optional
        Validity of the source's last position before these rows [ns].
    """
    received = _received(mapping, rows.stamps_ns, rows.log_ns)
    covariance = _stated(mapping, rows)
    usable = rows.given & rows.plausible
    r_e, covariance = _from_antenna(mapping, rows.r_e, covariance)
    if mapping.correlation_s > 0.0:
        factors = shares(rows.stamps_ns[usable], mapping.correlation_s, before_ns)
        covariance = covariance.copy()
        covariance[usable] *= factors[:, None, None]
    return tuple(
        Fix(
            validity_ns=int(rows.stamps_ns[k]),
            transmit_ns=0,
            receive_ns=int(received[k]),
            source=mapping.source,
            sequence=int(k),
            order=int(k),
            arrival=first_arrival + int(k),
            r_e=r_e[k],
            covariance_e=covariance[k],
            topic=rows.topic,
            delay_sigma=mapping.delay_sigma_s,
            leader_sigma=mapping.slow_sigma,
            surface_depth=mapping.surface_depth,
        )
        for k in np.flatnonzero(usable)
    )


def reception_ns(validity_ns: Stamps, arrival_ns: Stamps) -> Stamps:
    """Times of reception of positions that came at these times of the host's clock [ns].

    None can come before it was valid. Where its sender's clock is a little ahead, as with NTP, or
    the host's goes in steps, as ``/clock`` does, it came when it was valid.
    """
    ahead_ns = validity_ns - arrival_ns
    agree = (ahead_ns > 0) & (ahead_ns <= CLOCKS_AGREE_NS)
    return np.asarray(np.where(agree, validity_ns, arrival_ns))


def shares(stamps_ns: Stamps, correlation_s: float, before_ns: int | None = None) -> Array:
    """Factors of the covariances of positions whose errors resemble one another. (n,) -> (n,).

    An error e with the correlation ``rho = exp(-dt/T)`` to the one before tells of a position that
    stays what is not known yet through ``e - rho e_before`` alone: variance ``(1 - rho^2)
    sigma^2``, share ``1 - rho`` of the position. A white error that tells as much has the variance
    ``sigma^2 (1 + rho)/(1 - rho) = sigma^2 coth(dt/2T)``; for steps much shorter than T the
    spectral density is that of the process, ``2 T sigma^2``.

    Parameters
    ----------
    stamps_ns : (n,) array
        Validities in the order of arrival [ns].
    correlation_s : float
        T [s].
    before_ns : int, optional
        Validity before the first one; without it that one is the first of all, with factor 1.
    """
    out, last_ns = np.ones(len(stamps_ns)), before_ns
    for k, stamp_ns in enumerate(stamps_ns.tolist()):
        if last_ns is not None:
            dt = max(abs(stamp_ns - last_ns) * 1e-9, _LEAST_STEP_S)
            out[k] = 1.0 / math.tanh(0.5 * dt / correlation_s)
        last_ns = stamp_ns
    return out


def sigma_covariance(sigma: tuple[float, float], r_e: Array) -> Array:
    """Covariance of horizontal and vertical sigma [m], ECEF. (n, 3) -> (n, 3, 3)."""
    out = np.full((len(r_e), 3, 3), np.nan)
    good = finite_rows(r_e)
    if good.any():
        C_G_e = np.swapaxes(ecef_to_grid(r_e[good]), 1, 2)
        P_G = np.diag([sigma[0] ** 2, sigma[0] ** 2, sigma[1] ** 2])
        out[good] = congruent(C_G_e, P_G[None])
    return out


def _from_antenna(mapping: FixMapping, r_e: Array, covariance_e: Array) -> tuple[Array, Array]:
    """Fixes of an antenna, of the point that the filter knows. (n, 3), (n, 3, 3).

    Its height over that point is known for a level vehicle; its horizontal part has any
    direction, and `_LEANING` of it is vertical.
    """
    x, y, z = mapping.offset_b
    if not any(mapping.offset_b):
        return r_e, covariance_e
    apart = x * x + y * y
    good = finite_rows(r_e)
    C_G_e = np.swapaxes(ecef_to_grid(r_e[good]), 1, 2)
    variances = [0.5 * apart, 0.5 * apart, _LEANING**2 * (apart + z * z)]
    moved, wider = r_e.copy(), covariance_e.copy()
    moved[good] -= z * C_G_e[:, :, 2]
    wider[good] += congruent(C_G_e, np.diag(variances)[None])
    return moved, wider


_LEANING = 0.1
"""Sine of the roll or pitch that a vehicle has at the surface: ours."""


def _stated(mapping: FixMapping, rows: PositionRows) -> Array:
    if mapping.sigma is None:
        own: Array = rows.covariance_e
    else:
        horizontal, vertical = mapping.sigma
        level = mapping.dimensions == 2
        own = sigma_covariance((horizontal, LEVEL_SIGMA if level else vertical), rows.r_e)
    if mapping.slow_sigma == 0.0:
        return own
    # The engine takes what is shared out of the whole again.
    return own + sigma_covariance((mapping.slow_sigma, 0.0), rows.r_e)


def _received(mapping: FixMapping, stamps_ns: Stamps, log_ns: Stamps) -> Stamps:
    return log_ns if mapping.delay_ns is None else stamps_ns + mapping.delay_ns
