"""Named filter configurations of a replay, and the pair that the demo compares.

A follower of a leader has the named configurations of the engine. In station mode a name stands
for the paper's filter, for the usual one, or for the usual one with another treatment of late
fixes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from polar_nav_core.engine.methods import CONFIGURATIONS, DELAY_HANDLING

STATION = 'station'
WITH_LEADER = ('conventional_akf', 'modified_akf', 'default')
"""Compared by default: late fixes treated as current, delay-aware as published, the default."""
WITH_STATION = ('published', 'default')
"""The paper's filter, with current and drag known, and the one that estimates them."""

_USUAL = {'configuration': 'default', 'station_filter': 'augmented'}
STATION_VARIANTS: dict[str, dict[str, Any]] = {
    'default': _USUAL,
    'published': {
        'configuration': 'default',
        'station_filter': 'published',
        'identify_method': 'published',
    },
    **{
        name: {
            **_USUAL,
            'configuration': 'custom',
            'delay_handling': name,
            'robust_fixes': 'mahalanobis',
        }
        for name in DELAY_HANDLING
    },
}
NAMES = tuple(dict.fromkeys([*CONFIGURATIONS, *STATION_VARIANTS]))
"""Every name of a configuration that a command takes."""


def parameters_of(name: str, recorded: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters of a named configuration, in the mode of a run."""
    if recorded.get('mode') == STATION and name in STATION_VARIANTS:
        return dict(STATION_VARIANTS[name])
    return {'configuration': name}


def compared_of(recorded: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of the configurations that are compared by default."""
    return WITH_STATION if recorded.get('mode') == STATION else WITH_LEADER
