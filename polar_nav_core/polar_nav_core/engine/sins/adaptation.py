"""Noise adaptations that run in Python, by name."""

from __future__ import annotations

from ..methods import COMPILED_NOISE, NOISE_ADAPTATION
from .noise import MeasurementNoise, ProcessNoise
from .sage_husa import GuardedNoise, GuardedProcess

COMPILED = COMPILED_NOISE
"""Adaptations that the compiled filter does by itself."""
PRINTED = ('sage_husa_unguarded', 'sage_husa_published')
"""Adaptations that are whole filters of their own (published.py)."""


def make_noise(
    name: str, forgetting: float, floor: float, ceiling: float
) -> MeasurementNoise | None:
    """Adapted noise R of one kind of measurement; None if it is as stated or compiled."""
    if name not in NOISE_ADAPTATION:
        raise ValueError(f'noise_adaptation {name!r} is none of {", ".join(NOISE_ADAPTATION)}')
    return GuardedNoise(forgetting, floor, ceiling) if name == 'sage_husa' else None


def make_process(name: str, forgetting: float) -> ProcessNoise | None:
    """Adapted process noise Q of the filter; None if it is as stated."""
    return GuardedProcess(forgetting) if name == 'sage_husa' else None
