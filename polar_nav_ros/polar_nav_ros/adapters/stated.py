"""Parameters of a vehicle's node that its mapping file states."""

from __future__ import annotations

import math
from collections.abc import Collection
from collections.abc import Mapping as Names
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.start.model import Stated
from polar_nav_core.grid import convergence

from . import mapping_file
from .mapping import Mapping
from .packets import carries_packets

P = TypeVar('P', bound=EngineParams)

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
_AT_REST = 0.5
"""1-sigma of a velocity of zero that nobody stated [m/s]."""
_TILT = ('initial_roll_deg', 'initial_pitch_deg')
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
    if not set(_TILT) <= known:
        sigmas['initial_sigma_tilt_deg'] = _NOT_LEVELLED_DEG
    initial = mapping.initial
    if initial.kind == 'alignment':
        values.setdefault('initialize', 'alignment')
        values.setdefault('align_window_s', min(max(initial.rest_s, 1.0), 600.0))
        if initial.heading_from == 'gyrocompass':
            values.setdefault('align_heading', 'gyrocompass')
    return sigmas | values


def settled(params: P, names: Collection[str], mapping: Mapping | None = None) -> P:
    """Parameters with ``initialize: auto`` replaced by what it stands for.

    Place, height and heading stated: ``parameters``, else ``alignment``, which finds the rest.

    Parameters
    ----------
    params : EngineParams
    names : collection of str
        Parameters that the user stated.
    mapping : Mapping, optional
        Whose `initial` states a heading.
    """
    if params.initialize != 'auto':
        return params
    stated = stated_of(params, names, mapping)
    parts = (stated.latitude, stated.height, stated.heading)
    if any(part is None for part in parts):
        return replace(params, initialize='alignment')
    # What is not stated is not known to be zero.
    changes: dict[str, Any] = {'initialize': 'parameters'}
    if mapping is None and stated.roll is None and 'initial_sigma_tilt_deg' not in names:
        changes['initial_sigma_tilt_deg'] = _NOT_LEVELLED_DEG
    if mapping is None and stated.v_G is None and 'initial_sigma_velocity' not in names:
        changes['initial_sigma_velocity'] = _AT_REST
    return replace(params, **changes)


def stated_of(
    params: EngineParams, names: Collection[str], mapping: Mapping | None = None
) -> Stated:
    """What the user stated of the initial state: the parameters by name, and the mapping.

    Parameters as for `settled`.
    """
    there = set(names)
    place = set(_PLACE) <= there
    tilt = set(_TILT) <= there
    heading, reference = None, 'grid'
    if 'initial_grid_heading_deg' in there:
        heading = math.radians(params.initial_grid_heading_deg)
    elif mapping is not None and mapping.initial.grid_heading_deg is not None:
        heading = math.radians(mapping.initial.grid_heading_deg)
    elif mapping is not None and mapping.initial.heading_deg is not None:
        heading, reference = math.radians(mapping.initial.heading_deg), 'true'
    v_G = params.initial_v_G
    return Stated(
        latitude=math.radians(params.initial_latitude_deg) if place else None,
        longitude=math.radians(params.initial_longitude_deg) if place else None,
        height=params.initial_height if 'initial_height' in there else None,
        heading=heading,
        heading_reference=reference,
        roll=math.radians(params.initial_roll_deg) if tilt else None,
        pitch=math.radians(params.initial_pitch_deg) if tilt else None,
        v_G=(v_G[0], v_G[1], v_G[2]) if 'initial_v_G' in there else None,
        sigma_position=params.initial_sigma_position,
        sigma_height=params.initial_sigma_height,
        sigma_velocity=params.initial_sigma_velocity,
        sigma_tilt=math.radians(params.initial_sigma_tilt_deg),
        sigma_heading=math.radians(params.initial_sigma_heading_deg),
    )


def _grid_heading_deg(mapping: Mapping, values: Names[str, Any]) -> float | None:
    """Grid heading at the start [deg] by the file; None where it states none, or no place."""
    initial = mapping.initial
    if initial.grid_heading_deg is not None:
        return initial.grid_heading_deg
    if initial.heading_deg is None or not set(_PLACE) <= set(values):
        return None
    lat, lon = (math.radians(float(values[name])) for name in _PLACE)
    return math.remainder(initial.heading_deg - math.degrees(float(convergence(lat, lon))), 360.0)
