"""Descriptions of followers on /run_info: engine version, and parameters for a replay.

Bags are read for good: a parameter that was retired since is left out and named, and one that a
bag does not state has the value that reproduces the engine of that bag, never today's default.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from polar_nav_core.engine.version import ENGINE_VERSION, engine_version_of
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import unknown_parameter
from polar_nav_core.retired import RETIRED
from polar_nav_follower.defaults import as_recorded, defaults_of
from polar_nav_follower.params import FollowerParams

from ..bags.reader import Bag

FOLLOWER_PACKAGE = 'polar_nav_follower'


@dataclass(frozen=True)
class Description:
    """Description that a follower_node published in a bag.

    Attributes
    ----------
    engine_version : int
        Engine that recorded the run.
    params : dict
        A value for every parameter of FollowerParams; and unknown ones, which
        :meth:`require_known` refuses.
    stated : set of str
        Those of `params` that the bag states.
    retired : dict
        Recorded parameters that were retired since, by name, with their recorded values.
    sources : str
        The mapping file of its sources; empty without one.
    """

    engine_version: int
    params: dict[str, Any]
    stated: frozenset[str]
    retired: dict[str, Any]
    sources: str = ''

    def require_known(self) -> None:
        """Raise an error for parameters that are neither declared nor retired.

        Raises
        ------
        ConfigError
            Naming the first one and both engines.
        """
        known = {f.name for f in fields(FollowerParams)}
        unknown = sorted(set(self.params) - known)
        if unknown:
            why = unknown_parameter(unknown[0], 'follower_node', known)
            raise ConfigError(
                f'the bag was recorded with a parameter that is not known here: {why} '
                f'(recorded with engine {self.engine_version}, this is engine {ENGINE_VERSION})'
            )

    def retired_texts(self) -> list[str]:
        """One sentence for each retired parameter."""
        return [
            f'parameter {name} = {value!r} was {RETIRED[name]}'
            for name, value in sorted(self.retired.items())
        ]


def descriptions_of(bag: Bag) -> dict[str, Description]:
    """Descriptions of the followers in a bag, by vehicle."""
    return {
        name.strip('/').split('/')[0]: describe(info)
        for name, info in bag.node_infos.items()
        if info.get('package') == FOLLOWER_PACKAGE
    }


def describe(info: Mapping[str, Any]) -> Description:
    """Description in one message of /run_info."""
    params = info.get('params')
    found = read_parameters(params if isinstance(params, dict) else {}, engine_version_of(info))
    sources = info.get('sources')
    return replace(found, sources=sources) if isinstance(sources, str) else found


def read_parameters(stated: Mapping[str, Any], engine_version: int) -> Description:
    """Description by stated parameters, completed by the defaults of the engine version."""
    recorded = dict(stated)
    retired = {name: recorded.pop(name) for name in sorted(RETIRED.keys() & recorded)}
    params = as_recorded(defaults_of(engine_version) | recorded, engine_version)
    return Description(engine_version, params, frozenset(recorded), retired)


NOTHING_DESCRIBED = describe({})
"""For a vehicle whose follower_node is not on /run_info."""
