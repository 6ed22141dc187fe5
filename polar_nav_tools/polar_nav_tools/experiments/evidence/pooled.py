"""Numbers of several seeds as cells of a table: pooled RMS, ratios, NEES against its band."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...scoring.consistency import chi_square_band
from ...scoring.tables import Column, show
from ..jobs import RunResult

DIMENSIONS = {'position': 3, 'velocity': 3, 'heading': 1}
PROBABILITY = 0.999
NEES_COLUMNS = tuple(Column(f'nees_{kind}', f'NEES {kind}') for kind in DIMENSIONS)
NEES_NOTE = (
    'NEES: mean of the second half per degree of freedom, 1 is honest; * is outside the 99.9 %'
    ' band of seeds x dimension,'
)


def values(runs: Sequence[RunResult], key: str) -> np.ndarray:
    """Metric of each run that has it, shape (runs,)."""
    return np.array([r.metrics[key] for r in runs if key in r.metrics])


def rms(runs: Sequence[RunResult], key: str = 'rms') -> float:
    """Root of the mean square over the runs; infinite if one stopped."""
    if not runs or any(r.stopped or key not in r.metrics for r in runs):
        return float('inf')
    return float(np.sqrt(np.mean(values(runs, key) ** 2)))


def ratio_cells(
    over: Sequence[RunResult], under: Sequence[RunResult], goal: float
) -> dict[str, object]:
    """Ratio of both RMS, and whether it is at most the goal; empty without one to compare with."""
    if not np.isfinite(rms(under)):
        return {}
    ratio = rms(over) / rms(under)
    return {'ratio': ratio, 'met': bool(ratio <= goal)}


def spread_of_ratio(
    over: Sequence[RunResult], under: Sequence[RunResult], key: str = 'rms'
) -> str:
    """Lowest to highest ratio of single seeds."""
    below = {r.seed: r.metrics.get(key, np.nan) for r in under}
    ratios = [r.metrics.get(key, np.inf) / below[r.seed] for r in over if r.seed in below]
    return f'{show(min(ratios))} to {show(max(ratios))}' if ratios else ''


def band(seeds: int, dimension: int) -> tuple[float, float]:
    """Band of a mean NEES per degree of freedom over independent seeds."""
    low, high = chi_square_band(seeds * dimension, PROBABILITY)
    return float(low) / (seeds * dimension), float(high) / (seeds * dimension)


def nees_cells(runs: Sequence[RunResult]) -> dict[str, object]:
    """Mean NEES of each quantity, with a star outside its band."""
    out: dict[str, object] = {}
    for kind, dimension in DIMENSIONS.items():
        found = values(runs, f'nees_{kind}')
        if len(found):
            low, high = band(len(found), dimension)
            mean = float(found.mean())
            out[f'nees_{kind}'] = show(mean) + ('' if low <= mean <= high else ' *')
    return out


def nees_note(seeds: int) -> str:
    """Sentence on the band."""
    three, one = band(seeds, 3), band(seeds, 1)
    return (
        f'{NEES_NOTE} {three[0]:.2f} to {three[1]:.2f} for three components,'
        f' {one[0]:.2f} to {one[1]:.2f} for heading.'
    )
