"""Topic of `initial: {from: topic}` live: its newest message states the start, until there is one.

It is no source: what is found becomes a command (nav/command), from which a replay starts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping as Names
from dataclasses import replace
from typing import Any

import numpy as np

from polar_nav_core.attitude import euler_from_matrix, grid_heading
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.engine.start.model import Stated
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid

from .live import Source, Taken
from .mapping import Mapping, PositionMapping
from .pose import sigma_height
from .position import PositionRows, positions_of


class StartTopic:
    """Positions of base_link, with attitude and velocity where the type has them.

    Parameters
    ----------
    mapping : PositionMapping
        Of section ``initial``.
    """

    def __init__(self, mapping: PositionMapping) -> None:
        self.stream = mapping.stream
        self._mapping = mapping
        self._source = Source(0, mapping.stream.topic, mapping.stream, 'position', None)

    def bind(self, sample: object, constants: Names[str, Any], place: str = 'sources') -> None:
        """Find the fields in a message of the topic; errors as `Source.bind`."""
        self._source.bind(sample, constants, place)

    def stated(self, message: Any, arrival_ns: int, known: Stated) -> Stated | None:  # noqa: ANN401
        """Return what is stated of the start with a message; None where it holds no position.

        Parameters
        ----------
        message : object
        arrival_ns : int
        known : Stated
            By the user: it wins.

        Raises
        ------
        ConfigError
            When neither message nor mapping state the frame of the positions.
        """
        try:
            rows = self._source.rows(Taken(message, arrival_ns, arrival_ns))
            found, level = positions_of(rows, self._mapping), False
            if not found.given[0]:  # without a height
                found, level = positions_of(rows, self._mapping, 0.0), True
        except (ValueError, IndexError, TypeError) as error:
            if isinstance(error, ConfigError):
                raise
            return None
        if not (found.given[0] and found.plausible[0]):
            return None
        return _with_attitude(_with_place(known, found, level=level), known, found)


def _with_place(known: Stated, rows: PositionRows, *, level: bool) -> Stated:
    r_e = rows.r_e[0]
    lat, lon, height = (float(v) for v in geodetic_from_ecef(r_e))
    C_e_G = ecef_to_grid(r_e)
    P_G = C_e_G @ rows.covariance_e[0] @ C_e_G.T
    across = max(float(P_G[0, 0]), float(P_G[1, 1]))
    out = known
    if known.latitude is None:
        out = replace(out, latitude=lat, longitude=lon)
        if across > 0.0:  # not of NaN
            out = replace(out, sigma_position=math.sqrt(across))
    vertical = float(P_G[2, 2])
    sigma = sigma_height(vertical, across)
    left_open = sigma is None and not math.isnan(vertical)
    if known.height is None and not (level or left_open):
        out = replace(out, height=height)
        if sigma is not None:
            out = replace(out, sigma_height=sigma)
    return out


def _with_attitude(out: Stated, known: Stated, rows: PositionRows) -> Stated:
    C_b_G, v_G = rows.C_b_G[0], rows.v_G[0]
    if np.isfinite(C_b_G).all():
        _, pitch, roll = (float(v) for v in euler_from_matrix(C_b_G))
        if known.heading is None:
            out = replace(out, heading=float(grid_heading(C_b_G)), heading_reference='grid')
        if known.roll is None:
            out = replace(out, roll=roll, pitch=pitch)
    if known.v_G is None and np.isfinite(v_G).all():
        out = replace(out, v_G=(float(v_G[0]), float(v_G[1]), float(v_G[2])))
    return out


def start_topic_of(mapping: Mapping) -> StartTopic | None:
    """Return the topic of a mapping's start; None without one, or where fixes come from it."""
    initial = mapping.initial.position
    fixes = [fix.position.stream.topic for fix in mapping.fixes]
    if initial is None or initial.stream.topic in fixes:
        return None
    return StartTopic(initial)
