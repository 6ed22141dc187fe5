"""Test statistics of running innovation memories (kernels.watch), for one stamp or for many.

Innovations of a filter that knows its sensors are white with the stated covariance. A mean of n
such, divided by their sigma, has variance 1/n; n times its square is chi-square with one degree of
freedom. A stream whose innovations scatter more than stated is tested against its own scatter, so
that outliers and understated noise do not pass for a bias.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ...kernels import watch


class Statistics(NamedTuple):
    """Statistics of streams and memories; leading shape (..., STREAMS, MEMORIES).

    Attributes
    ----------
    number : (...) array
        Effective number of attempts in the memory.
    nis : (...) array
        Mean NIS per degree of freedom; 1 is honest.
    nis_sigmas : (...) array
        How many sigmas that is from 1, by the effective number and one degree of freedom.
    refused : (...) array
        Share that the gate refused.
    grid_mean, track_mean : (..., 3) arrays
        Mean innovation per sigma: grid east, north, up; along track, across, up.
    grid, track : (..., 3) arrays
        Chi-square (1) of those means.
    across : (...) array
        Mean share of the horizontal innovation that lies across track, signed: -1 to 1.
    grid_rise, track_rise : (..., 3) arrays
        Largest cumulative log likelihood ratio of a shift to either side, by axis.
    noise_rise, calm_rise : (...) arrays
        That of a larger, of a smaller scatter.
    alike_rise : (...) array
        That of neighbours that are alike.
    """

    number: Array
    nis: Array
    nis_sigmas: Array
    refused: Array
    grid_mean: Array
    track_mean: Array
    grid: Array
    track: Array
    across: Array
    grid_rise: Array
    track_rise: Array
    noise_rise: Array
    calm_rise: Array
    alike_rise: Array


def statistics(memories: Array) -> Statistics:
    """Test statistics of innovation memories.

    Parameters
    ----------
    memories : (..., STREAMS, MEMORIES, WIDTH) array
        As `kernels.watch.observe` keeps them; empty ones give zeros.
    """
    weight = memories[..., watch.WEIGHT]
    safe = np.where(weight > 0.0, weight, 1.0)
    number = weight**2 / np.where(weight > 0.0, memories[..., watch.WEIGHT_2], 1.0)
    nis = memories[..., watch.NIS] / safe
    grid_mean = memories[..., watch.GRID : watch.GRID + 3] / safe[..., None]
    track_mean = memories[..., watch.TRACK : watch.TRACK + 3] / safe[..., None]
    square = memories[..., watch.SQUARE : watch.SQUARE + 3] / safe[..., None]
    scatter = np.maximum(1.0, square)
    level = np.maximum(1.0, 0.5 * (square[..., 0] + square[..., 1]))
    grid_scatter = np.stack([level, level, scatter[..., 2]], axis=-1)
    return Statistics(
        number=number,
        nis=nis,
        nis_sigmas=np.where(weight > 0.0, (nis - 1.0) * np.sqrt(0.5 * number), 0.0),
        refused=memories[..., watch.REFUSED] / safe,
        grid_mean=grid_mean,
        track_mean=track_mean,
        grid=number[..., None] * grid_mean**2 / grid_scatter,
        track=number[..., None] * track_mean**2 / scatter,
        across=memories[..., watch.ACROSS] / safe,
        grid_rise=_either(memories[..., watch.GRID_RISE : watch.TRACK_RISE]),
        track_rise=_either(memories[..., watch.TRACK_RISE : watch.NOISE_RISE]),
        noise_rise=memories[..., watch.NOISE_RISE],
        calm_rise=memories[..., watch.CALM_RISE],
        alike_rise=memories[..., watch.ALIKE_RISE],
    )


def _either(rises: Array) -> Array:
    """Larger one of the sums for both sides, (..., 6) to (..., 3)."""
    return np.asarray(rises.reshape(*rises.shape[:-1], 3, 2).max(axis=-1))
