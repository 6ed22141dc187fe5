"""Parameters of a vehicle's node that its mapping file states."""

from __future__ import annotations

import math
from collections.abc import Mapping as Names
from pathlib import Path
from typing import Any, NamedTuple

from polar_nav_core.grid import convergence

from . import mapping_file
from .mapping import Mapping
from .packets import carries_packets

START_SIGMAS = {
    'initial_sigma_position': 10.0,
    'initial_sigma_height': 10.0,
    'initial_sigma_velocity': 0.1,
    'initial_sigma_tilt_deg': 1.0,
    'initial_sigma_heading_deg': 5.0,
}
"""1-sigma where nothing is stated: those of someone else's vehicle, not of a simulated start."""
_NOT_LEVELLED_DEG = 5.0
"""1-sigma of tilt where neither roll nor pitch is stated, and nobody levelled."""
_PLACE = ('initial_latitude_deg', 'initial_longitude_deg')


class SourceFile(NamedTuple):
    """The mapping file that a node was started with.

    Attributes
    ----------
    text : str
        As it stands; empty without one.
    mapping : Mapping or None
    parameters : dict
        That it states, see `parameters_of`.
    """

    text: str = ''
    mapping: Mapping | None = None
    parameters: dict[str, Any] = {}  # noqa: RUF012 - nobody writes into it

    @classmethod
    def given(cls, given: Names[str, Any]) -> SourceFile:
        """Read the file that a node's parameter ``sources`` names; errors as `mapping_file.load`.

        Parameters
        ----------
        given : mapping
            Parameters that the node was started with.
        """
        if not given.get('sources'):
            return cls()
        text, mapping = mapping_file.read(Path(str(given['sources'])).expanduser())
        return cls(text, mapping, parameters_of(mapping, given))

    def about(self) -> dict[str, Any]:
        """Return what the node's description says of it: the text, which a replay needs."""
        return {'sources': self.text} if self.text else {}


def parameters_of(mapping: Mapping, given: Names[str, Any]) -> dict[str, Any]:
    """Values that a mapping states for the parameters of a running node.

    Without a place to start from, or without a heading, the node waits for
    ``~/set_initial_state``.

    Parameters
    ----------
    mapping : Mapping
    given : mapping
        Parameters that the node was started with, which win.
    """
    values: dict[str, Any] = dict(mapping.params)
    packets = [fix for fix in mapping.fixes if carries_packets(fix.position.stream)]
    if packets:
        values |= {'leader_id': packets[0].leader_id, 'own_id': packets[0].own_id}
    heading = _grid_heading_deg(mapping, {**values, **given})
    if heading is not None:
        values.setdefault('initial_grid_heading_deg', heading)
    known = {*values, *given}
    sigmas = dict(START_SIGMAS)
    if not {'initial_roll_deg', 'initial_pitch_deg'} <= known:
        sigmas['initial_sigma_tilt_deg'] = _NOT_LEVELLED_DEG
    values = sigmas | values
    if not {*_PLACE, 'initial_grid_heading_deg'} <= known:
        values.setdefault('initialize', 'service')
    return values


def _grid_heading_deg(mapping: Mapping, values: Names[str, Any]) -> float | None:
    """Grid heading at the start [deg] by the file; None where it states none, or no place."""
    initial = mapping.initial
    if initial.grid_heading_deg is not None:
        return initial.grid_heading_deg
    if initial.heading_deg is None or not set(_PLACE) <= set(values):
        return None
    lat, lon = (math.radians(float(values[name])) for name in _PLACE)
    return math.remainder(initial.heading_deg - math.degrees(float(convergence(lat, lon))), 360.0)
