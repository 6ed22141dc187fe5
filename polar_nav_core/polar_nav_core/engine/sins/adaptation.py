"""Noise adaptation by its name."""

from __future__ import annotations

from ..params import COMPILED_NOISE, NOISE_ADAPTATION
from .noise import MeasurementNoise, ProcessNoise
from .sage_husa import GuardedNoise, GuardedProcess

COMPILED = COMPILED_NOISE
"""Known to the compiled filter: nothing of them is left to Python."""
PRINTED = ('sage_husa_unguarded', 'sage_husa_published')
"""These are whole filters of their own (published.py)."""


def make_noise(name: str, forgetting: float, floor: float) -> MeasurementNoise | None:
    """R of one kind of measurement; None when Python has nothing to adapt."""
    if name not in NOISE_ADAPTATION:
        raise ValueError(f'noise_adaptation {name!r} is none of {", ".join(NOISE_ADAPTATION)}')
    return GuardedNoise(forgetting, floor) if name == 'sage_husa' else None


def make_process(name: str, forgetting: float) -> ProcessNoise | None:
    """Q of the filter; None when it is as stated."""
    return GuardedProcess(forgetting) if name == 'sage_husa' else None
