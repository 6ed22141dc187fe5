"""Delayed positions of the vehicle as fixes of the engine: any type of position, 2-D or 3-D."""

from __future__ import annotations

import numpy as np

from polar_nav_core.engine.events import Array, Fix
from polar_nav_core.grid import ecef_to_grid

from .arrays import congruent, finite_rows
from .mapping import FixMapping
from .position import LEVEL_SIGMA, PositionRows
from .rows import Stamps


def level_height(mapping: FixMapping, sea_surface_height: float) -> float | None:
    """Return the height [m] for fixes without one; None where their heights are measured."""
    return None if mapping.dimensions == 3 else sea_surface_height


def fixes_of(mapping: FixMapping, rows: PositionRows, first_arrival: int = 0) -> tuple[Fix, ...]:
    """Fixes of the rows that hold a position, in their order.

    Parameters
    ----------
    mapping : FixMapping
    rows : PositionRows
    first_arrival : int
        Number of the first row among those of all sources: places equal stamps in order.
    """
    received = _received(mapping, rows.stamps_ns, rows.log_ns)
    covariance = _stated(mapping, rows)
    usable = rows.given & rows.plausible
    return tuple(
        Fix(
            validity_ns=int(rows.stamps_ns[k]),
            transmit_ns=0,
            receive_ns=int(received[k]),
            source=mapping.source,
            sequence=int(k),
            order=int(k),
            arrival=first_arrival + int(k),
            r_e=rows.r_e[k],
            covariance_e=covariance[k],
            topic=rows.topic,
        )
        for k in np.flatnonzero(usable)
    )


def sigma_covariance(sigma: tuple[float, float], r_e: Array) -> Array:
    """Covariance of horizontal and vertical sigma [m], ECEF. (n, 3) -> (n, 3, 3)."""
    out = np.full((len(r_e), 3, 3), np.nan)
    good = finite_rows(r_e)
    if good.any():
        C_G_e = np.swapaxes(ecef_to_grid(r_e[good]), 1, 2)
        P_G = np.diag([sigma[0] ** 2, sigma[0] ** 2, sigma[1] ** 2])
        out[good] = congruent(C_G_e, P_G[None])
    return out


def _stated(mapping: FixMapping, rows: PositionRows) -> Array:
    if mapping.sigma is None:
        return rows.covariance_e
    horizontal, vertical = mapping.sigma
    return sigma_covariance(
        (horizontal, vertical if mapping.dimensions == 3 else LEVEL_SIGMA), rows.r_e
    )


def _received(mapping: FixMapping, stamps_ns: Stamps, log_ns: Stamps) -> Stamps:
    return log_ns if mapping.delay_ns is None else stamps_ns + mapping.delay_ns
