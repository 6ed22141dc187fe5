"""Strategies for late fixes, by their names."""

from __future__ import annotations

from ..params import DELAY_HANDLING
from .clone import Clone
from .fusion import BackPropagate, Ignore, Make, Tagged
from .rewind import Rewind

STRATEGIES: dict[str, Make] = {
    'ignore': Ignore,
    'tagged': Tagged,
    'back_propagate': BackPropagate,
    'clone': Clone,
    'rewind': Rewind,
}

if tuple(STRATEGIES) != DELAY_HANDLING:
    raise ImportError(f'params.DELAY_HANDLING names {DELAY_HANDLING}, not {tuple(STRATEGIES)}')
