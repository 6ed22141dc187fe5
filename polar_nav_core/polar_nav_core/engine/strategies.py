"""Strategies for late fixes by name, of both modes."""

from __future__ import annotations

from .driver import Make
from .methods import DELAY_HANDLING
from .params import EngineParams
from .sins.adaptation import COMPILED, PRINTED
from .sins.clone import Clone
from .sins.fusion import BackPropagate, Ignore, Tagged
from .sins.published import Published
from .sins.rewind import Rewind
from .station import fusion as station

STRATEGIES: dict[str, Make] = {
    'ignore': Ignore,
    'tagged': Tagged,
    'back_propagate': BackPropagate,
    'clone': Clone,
    'rewind': Rewind,
}

STATION: dict[str, Make] = {
    'ignore': station.Ignore,
    'tagged': station.Tagged,
    'back_propagate': station.BackPropagate,
    'clone': station.Clone,
    'rewind': station.Rewind,
}


def compiled(params: EngineParams) -> bool:
    """Whether local measurements can go through the compiled loop with these parameters."""
    return params.mode == 'station' or params.resolved().noise_adaptation in COMPILED


def make_fusion(params: EngineParams) -> Make:
    """Class of the strategy for late fixes in a mode and configuration.

    The printed noise adaptations are filters of their own, without a strategy.
    """
    configuration = params.resolved()
    if params.mode == 'station':
        return STATION[configuration.delay_handling]
    if configuration.noise_adaptation in PRINTED:
        return Published
    return STRATEGIES[configuration.delay_handling]


if tuple(STRATEGIES) != DELAY_HANDLING or tuple(STATION) != DELAY_HANDLING:
    raise ImportError(f'methods.DELAY_HANDLING names {DELAY_HANDLING}, not {tuple(STRATEGIES)}')
