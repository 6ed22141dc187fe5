"""Headings of any adapter as angles clockwise from their reference, with an AHRS' vertical."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.arrays import Array
from polar_nav_core.errors import ConfigError
from polar_nav_core.nav_columns import rotations

from .arrays import turned
from .mapping import HeadingMapping
from .rows import Rows, Stamps

_UNKNOWN = -1.0
"""First element of a covariance of a sender without orientation (REP-145)."""
_UNIT = 1e-2
"""Departure of a quaternion's length from 1 beyond which it is no rotation."""


@dataclass(frozen=True)
class HeadingRows:
    """Headings of a topic, in the order of the bag; NaN where a message holds none.

    Attributes
    ----------
    topic : str
    stamps_ns, log_ns : (n,) arrays
    heading : (n,) array
        Of the body's x axis, clockwise from the reference [rad].
    up_b : (n, 3) array
        Vertical by roll and pitch, body axes; NaN of a plain heading.
    """

    topic: str
    stamps_ns: Stamps
    log_ns: Stamps
    heading: Array
    up_b: Array


def headings_of(rows: Rows, mapping: HeadingMapping) -> HeadingRows:
    """Headings of a topic: of orientations, or plain ones.

    Raises
    ------
    ConfigError
        When an orientation is not four numbers per message, or a heading not one.
    """
    attitude = rows.floats('attitude')
    if attitude is None:
        plain = rows.floats('heading')
        if plain is None or plain.ndim != 1:
            raise ConfigError(f'{rows.topic}: heading is not one number per message')
        heading, up_b = plain * mapping.scale, np.full((len(rows), 3), np.nan)
    else:
        if attitude.ndim != 2 or attitude.shape[1] != 4:
            raise ConfigError(f'{rows.topic}: attitude is not 4 numbers per message')
        heading, up_b = _of_orientations(attitude, with_orientation(rows, attitude), mapping)
    return HeadingRows(rows.topic, rows.stamps_ns, rows.log_ns, heading, up_b)


def with_orientation(rows: Rows, xyzw: Array) -> NDArray[np.bool_]:
    """Return a mask (n,) of messages that hold an orientation, of their quaternions (n, 4)."""
    with np.errstate(over='ignore', invalid='ignore'):
        length = np.sqrt((xyzw * xyzw).sum(axis=1))
        known = np.asarray(np.abs(length - 1.0) <= _UNIT)
    covariance = rows.floats('covariance')
    if covariance is not None:
        known &= covariance[:, 0] != _UNKNOWN
    return known


def _of_orientations(
    xyzw: Array, known: NDArray[np.bool_], mapping: HeadingMapping
) -> tuple[Array, Array]:
    """Headings (n,) and verticals (n, 3) of orientations (n, 4), sensor axes to the world's."""
    heading, up_b = np.full(len(xyzw), np.nan), np.full((len(xyzw), 3), np.nan)
    C_s_w = rotations(xyzw[known])
    ahead, up = mapping.C_s_b.T[:, 0], C_s_w[:, 2]
    x, y = (
        C_s_w[:, k, 0] * ahead[0] + C_s_w[:, k, 1] * ahead[1] + C_s_w[:, k, 2] * ahead[2]
        for k in (0, 1)
    )
    east, north = (x, y) if mapping.world == 'enu' else (y, x)
    heading[known] = np.arctan2(east, north)
    sign = 1.0 if mapping.world == 'enu' else -1.0
    up_b[known] = sign * turned(mapping.C_s_b, up)
    return heading, up_b
