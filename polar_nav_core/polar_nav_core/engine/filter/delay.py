"""Strategies for late fixes, by their names."""

from __future__ import annotations

from ..params import DELAY_HANDLING, Configuration
from .adaptation import COMPILED, PRINTED
from .clone import Clone
from .fusion import BackPropagate, Ignore, Make, Tagged
from .published import Published
from .rewind import Rewind

STRATEGIES: dict[str, Make] = {
    'ignore': Ignore,
    'tagged': Tagged,
    'back_propagate': BackPropagate,
    'clone': Clone,
    'rewind': Rewind,
}


def compiled(configuration: Configuration) -> bool:
    """Whether everything but fixes can go through the compiled loop."""
    return configuration.noise_adaptation in COMPILED


def make_fusion(configuration: Configuration) -> Make:
    """Strategy of a configuration; the printed noise adaptations are filters of their own."""
    if configuration.noise_adaptation in PRINTED:
        return Published
    return STRATEGIES[configuration.delay_handling]


if tuple(STRATEGIES) != DELAY_HANDLING:
    raise ImportError(f'params.DELAY_HANDLING names {DELAY_HANDLING}, not {tuple(STRATEGIES)}')
