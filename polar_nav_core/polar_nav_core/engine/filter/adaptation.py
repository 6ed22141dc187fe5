"""Noise adaptation by its name."""

from __future__ import annotations

from .noise import AdaptiveNoise, ProcessNoise, StatedNoise
from .sage_husa import GuardedNoise, GuardedProcess

PRINTED = ('sage_husa_unguarded', 'sage_husa_published')
"""These are whole filters of their own (published.py)."""


def make_noise(name: str, forgetting: float, floor: float) -> StatedNoise:
    """R of one kind of measurement."""
    if name == 'adaptive_r':
        return AdaptiveNoise(forgetting, floor)
    if name == 'sage_husa':
        return GuardedNoise(forgetting, floor)
    if name == 'none' or name in PRINTED:
        return StatedNoise()
    known = ', '.join(('none', 'adaptive_r', 'sage_husa', *PRINTED))
    raise ValueError(f'noise_adaptation {name!r} is none of {known}')


def make_process(name: str, forgetting: float) -> ProcessNoise | None:
    """Q of the filter; None when it is as stated."""
    return GuardedProcess(forgetting) if name == 'sage_husa' else None
