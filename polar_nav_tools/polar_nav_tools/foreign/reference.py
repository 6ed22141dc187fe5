"""A topic of positions as the truth that estimates are scored against."""

from __future__ import annotations

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.grid import ecef_to_grid
from polar_nav_ros.adapters.arrays import finite_rows
from polar_nav_ros.adapters.position import PositionRows

from ..series.vehicle import TruthSeries
from .sources import Stamps


def truth_of(rows: PositionRows | None, vehicle: str) -> TruthSeries | None:
    """Return positions by stamp as truth; None when there are fewer than two.

    Velocity that the messages do not have is that of the positions; attitude stays NaN.
    """
    if rows is None or len(rows.stamps_ns) < 2:
        return None
    once = np.r_[True, np.diff(rows.stamps_ns) > 0]
    stamps_ns, r_e = rows.stamps_ns[once], rows.r_e[once]
    if len(stamps_ns) < 2:
        return None
    v_G, C_b_G = rows.v_G[once], rows.C_b_G[once]
    unknown = ~finite_rows(v_G)
    if unknown.any():
        v_G = np.where(unknown[:, None], _velocity_G(stamps_ns, r_e), v_G)
    lat, lon, height = geodetic_from_ecef(r_e)
    n = len(stamps_ns)
    nothing = np.full(n, np.nan)
    nothing3 = np.full((n, 3), np.nan)
    return TruthSeries(
        vehicle=vehicle,
        stamp_ns=stamps_ns,
        sequence=np.arange(n, dtype=np.int64),
        r_e=r_e,
        latitude=np.asarray(lat),
        longitude=np.asarray(lon),
        height=np.asarray(height),
        depth=nothing,
        altitude=nothing,
        v_G=v_G,
        C_b_G=C_b_G,
        omega_ib_b=nothing3,
        f_b=nothing3,
        current_G=nothing3,
    )


def _velocity_G(stamps_ns: Stamps, r_e: Array) -> Array:
    t = (stamps_ns - stamps_ns[0]) * 1e-9
    return np.asarray(np.einsum('nij,nj->ni', ecef_to_grid(r_e), np.gradient(r_e, t, axis=0)))
