"""Start of a recording that states no place or no heading: the alignment of a live node."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from polar_nav_core.engine.events import InitialState
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.start.machine import Start as Alignment
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import from_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_ros.adapters.mapping import Mapping
from polar_nav_ros.adapters.stated import parameters_of, stated_of

from .initial import Start


def must_align(mapping: Mapping) -> bool:
    """Whether a mapping states too little to start, and an alignment may find the rest.

    A vehicle that the mapping states to rest has its own way (`initial.find_start`).
    """
    initial, params = mapping.initial, mapping.params
    if initial.position is not None:
        return False
    place = {'initial_latitude_deg', 'initial_longitude_deg'} <= set(params)
    headings = (
        initial.heading_deg,
        initial.grid_heading_deg,
        params.get('initial_grid_heading_deg'),
    )
    stated = any(h is not None for h in headings) or initial.heading_from == 'gyrocompass'
    return not (place and stated)


def align(mapping: Mapping, inputs: Inputs) -> Start:
    """Initial parameters that an alignment finds, and the stamp they hold at.

    Parameters
    ----------
    mapping : Mapping
    inputs : Inputs
        All of the recording.

    Raises
    ------
    ConfigError
        When the recording ends before it has found them, with what it waits for.
    """
    params = from_mapping(FollowerParams, parameters_of(mapping, {}))
    sources = {
        'fix': mapping.fixes,
        'dvl': mapping.dvl,
        'depth': mapping.depth,
        'heading': mapping.heading,
    }
    there = frozenset(name for name, source in sources.items() if source)
    alignment = Alignment(params, stated_of(params, mapping.params, mapping), there)
    for event in inputs.events():
        found = alignment.take(event)
        if found is not None:
            return Start(found.stamp_ns, values_of(found.state), (), f'aligned: {found.sentence}')
    raise ConfigError(f'{mapping.place}: initial: {alignment.progress.sentence}')


def values_of(state: InitialState) -> dict[str, Any]:
    """Return the parameters `initial_*` of a state."""
    degrees = ('latitude', 'longitude', 'roll', 'pitch', 'grid_heading')
    values: dict[str, Any] = {
        f'initial_{name}_deg': math.degrees(getattr(state, name)) for name in degrees
    }
    return values | {
        'initial_height': state.height,
        'initial_v_G': np.asarray(state.v_G).tolist(),
        'initial_sigma_position': state.sigma_position_horizontal,
        'initial_sigma_height': state.sigma_position_vertical,
        'initial_sigma_velocity': state.sigma_velocity,
        'initial_sigma_tilt_deg': math.degrees(state.sigma_tilt),
        'initial_sigma_heading_deg': math.degrees(state.sigma_heading),
    }
