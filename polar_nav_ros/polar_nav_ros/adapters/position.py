"""Positions of any adapter as ECEF; covariance, velocity and attitude where they are given."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.arrays import Array
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.level import LEVEL_SIGMA
from polar_nav_core.nav_columns import rotations

from .arrays import congruent, finite_rows, unfilled
from .frames import Placed, to_earth
from .mapping import Frame, PositionMapping
from .rows import Rows, Stamps

_UNKNOWN = 0
"""NavSatFix.COVARIANCE_TYPE_UNKNOWN."""
_NO_TURN = (0.0, 0.0, 0.0, 1.0)
"""Quaternion of a message whose sender fills in no orientation."""
_EARTH = (6.3e6, 6.4e6)
"""Distances from the centre of the earth at which a vehicle can be [m]."""


@dataclass(frozen=True)
class PositionRows:
    """Positions of a topic, in the order of the bag.

    Attributes
    ----------
    topic, type : str
    stamps_ns, log_ns : (n,) arrays
    r_e : (n, 3) array
        ECEF [m]; NaN where the message gave none.
    covariance_e : (n, 3, 3) array
        ECEF [m^2]; NaN where it is not known.
    v_G : (n, 3) array
        Velocity over ground, grid axes [m/s]; NaN where it is not known.
    C_b_G : (n, 3, 3) array
        Attitude; NaN where it is not known.
    given : (n,) array of bool
        Whether the message says that it has a position.
    plausible : (n,) array of bool
        Whether the coordinates can be a vehicle's at all; the others are NaN in r_e.
    stated : bool
        Whether the type carries covariances.
    """

    topic: str
    type: str
    stamps_ns: Stamps
    log_ns: Stamps
    r_e: Array
    covariance_e: Array
    v_G: Array
    C_b_G: Array
    given: NDArray[np.bool_]
    plausible: NDArray[np.bool_]
    stated: bool

    def sorted(self) -> PositionRows:
        """Return the rows that can be used, by stamp."""
        order = np.argsort(self.stamps_ns, kind='stable')
        zero = unfilled(self.stamps_ns)
        usable = self.given & self.plausible & (~zero | zero.all())
        order = order[usable[order]]
        names = ('stamps_ns', 'log_ns', 'r_e', 'covariance_e', 'v_G', 'C_b_G', 'given')
        chosen = {n: getattr(self, n)[order] for n in (*names, 'plausible')}
        return replace(self, **chosen)


def positions_of(rows: Rows, mapping: PositionMapping, level: float | None = None) -> PositionRows:
    """Positions of a topic.

    Parameters
    ----------
    rows : Rows
    mapping : PositionMapping
    level : float, optional
        Positions are two-dimensional: their vertical sigma is `LEVEL_SIGMA`, and this stands in
        place of a height that is not finite [m, above the ellipsoid]. In ECEF it has no meaning.

    Raises
    ------
    ConfigError
        When the frame of the positions is stated neither by mapping nor by message.
    """
    frame = _frame_of(rows, mapping)
    name = 'geodetic' if 'geodetic' in rows.values else 'position'
    values = rows.floats(name)
    if values is None or values.ndim != 2 or values.shape[1] != 3:
        raise ConfigError(f'{rows.topic}: {name} is not 3 numbers per message')
    if frame.kind == 'earth':
        level = None
    if level is not None:
        values = values.copy()
        height = level if frame.kind in ('geodetic', 'epsg') else 0.0
        values[:, 2] = np.where(np.isfinite(values[:, 2]), values[:, 2], height)
    given = finite_rows(values)
    if 'status' in rows.values:
        given &= rows.values['status'] >= 0  # STATUS_NO_FIX is -1
    if name == 'geodetic':
        given &= values[:, :2].any(axis=1)  # 0 N 0 E, to the last digit: nobody filled it in
    placed, plausible = _placed(frame, values, given)
    axes = placed.axes_e
    C_b_G = _attitude(rows, mapping, placed)
    return PositionRows(
        topic=rows.topic,
        type=rows.type,
        stamps_ns=rows.stamps_ns,
        log_ns=rows.log_ns,
        r_e=placed.r_e,
        covariance_e=_covariance(rows, axes, placed.r_e, level is not None),
        v_G=_velocity(rows, mapping, C_b_G),
        C_b_G=C_b_G,
        given=given,
        plausible=plausible | ~given,
        stated=bool({'covariance', 'covariance_grid', 'sigma'} & rows.values.keys()),
    )


def _frame_of(rows: Rows, mapping: PositionMapping) -> Frame:
    if mapping.frame.kind is not None:
        return mapping.frame
    if 'geodetic' in rows.values:
        return Frame('geodetic')
    names = set(rows.values['frame_id'].tolist()) if 'frame_id' in rows.values else set()
    if names == {'earth'}:
        return Frame('earth')
    said = f'its messages name frame {", ".join(sorted(map(repr, names)))}' if names else ''
    raise ConfigError(
        f'{rows.topic}: frame is missing: geodetic, earth, enu or ned with origin, or epsg; {said}'
    )


def _placed(
    frame: Frame, values: Array, given: NDArray[np.bool_]
) -> tuple[Placed, NDArray[np.bool_]]:
    """Take the usable rows to ECEF; what cannot be a place stays NaN."""
    good = given.copy()
    if frame.kind == 'geodetic':
        good &= (np.abs(values[:, 0]) <= 90.0) & (np.abs(values[:, 1]) <= 360.0)
    r_e = np.full((len(values), 3), np.nan)
    axes = np.full((len(values), 3, 3), np.nan)
    if good.any():
        placed = to_earth(frame, values[good])
        r_e[good], axes[good] = placed.r_e, placed.axes_e
    distance = np.sqrt(np.einsum('ni,ni->n', r_e, r_e))
    with np.errstate(invalid='ignore'):
        plausible = good & (distance > _EARTH[0]) & (distance < _EARTH[1])
    r_e[~plausible] = np.nan
    return Placed(r_e, axes), plausible


def _covariance(rows: Rows, axes: Array, r_e: Array, level: bool) -> Array:
    n = len(rows)
    out = np.full((n, 3, 3), np.nan)
    name = 'covariance' if 'covariance' in rows.values else 'covariance_grid'
    flat = rows.floats(name)
    sigma = rows.floats('sigma')
    known = np.ones(n, dtype=bool)
    if flat is not None:
        size = 6 if flat.shape[1] == 36 else 3
        P = flat.reshape(n, size, size)[:, :3, :3]
    elif sigma is not None:
        P = np.square(sigma)[:, None, None] * np.eye(3)
    else:
        return out
    if 'covariance_type' in rows.values:
        known = rows.values['covariance_type'] != _UNKNOWN
    known &= P[:, 0, 0] != -1.0
    if level:  # what is stated of the height may be of any size, or no number
        P = P.copy()
        P[:, 2, :] = P[:, :, 2] = 0.0
    if name == 'covariance_grid' and sigma is None:
        known &= finite_rows(r_e)
        axes = np.full((n, 3, 3), np.nan)
        axes[known] = np.swapaxes(ecef_to_grid(r_e[known]), 1, 2)
    out[known] = congruent(axes, P)[known]
    return _levelled(out, r_e) if level else out


def _levelled(P_e: Array, r_e: Array) -> Array:
    """Covariances with `LEVEL_SIGMA` along the vertical there, which no map's axis is far away."""
    out = np.full_like(P_e, np.nan)
    good = finite_rows(r_e)
    if good.any():
        C_e_G = ecef_to_grid(r_e[good])
        P_G = congruent(C_e_G, P_e[good])
        P_G[:, 2, :] = P_G[:, :, 2] = 0.0
        P_G[:, 2, 2] = LEVEL_SIGMA**2
        out[good] = congruent(np.swapaxes(C_e_G, 1, 2), P_G)
    return out


def _attitude(rows: Rows, mapping: PositionMapping, placed: Placed) -> Array:
    """C_b_G, NaN where the message has no attitude or no position to refer it to.

    Orientations that are all level and ahead to the last digit were filled in by nobody.
    """
    n = len(rows)
    out = np.full((n, 3, 3), np.nan)
    usable = finite_rows(placed.r_e)
    C_b_s = mapping.C_s_b.T
    grid = rows.floats('attitude_grid')
    xyzw = rows.floats('attitude_grid_xyzw')
    if grid is not None:
        out = grid.reshape(n, 3, 3) @ C_b_s
    elif xyzw is not None:
        out = rotations(xyzw) @ C_b_s
    elif (stated := _stated_attitude(rows)) is not None and usable.any():
        # A map's axes carry its scale; what turns is the rotation in them.
        axes = placed.axes_e[usable]
        axes = axes / np.sqrt(np.einsum('nij,nij->nj', axes, axes))[:, None, :]
        C_s_p = rotations(stated[usable])
        out[usable] = ecef_to_grid(placed.r_e[usable]) @ axes @ C_s_p @ C_b_s
    out[~usable] = np.nan
    return np.asarray(out)


def _stated_attitude(rows: Rows) -> Array | None:
    stated = rows.floats('attitude')
    return None if stated is None or (stated == _NO_TURN).all() else stated


def _velocity(rows: Rows, mapping: PositionMapping, C_b_G: Array) -> Array:
    grid = rows.floats('velocity_grid')
    if grid is not None:
        return grid
    own = rows.floats('velocity_body')
    if own is None:
        return np.full((len(rows), 3), np.nan)
    return np.asarray(np.einsum('nij,nj->ni', C_b_G @ mapping.C_s_b, own))
