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
from ...kernels import statistics as columns
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
    alike_rise, block_rise : (...) arrays
        That of neighbours that are alike, of blocks whose sums scatter more.
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
    block_rise: Array


def statistics(memories: Array) -> Statistics:
    """Test statistics of innovation memories.

    Parameters
    ----------
    memories : (..., STREAMS, MEMORIES, WIDTH) array
        As `kernels.watch.observe` keeps them; empty ones give zeros.
    """
    flat = np.ascontiguousarray(memories).reshape(-1, watch.WIDTH)
    out = np.empty((len(flat), columns.WIDTH))
    columns.fill_statistics(flat, out)
    out = out.reshape(*memories.shape[:-1], columns.WIDTH)
    return Statistics(
        number=out[..., columns.NUMBER],
        nis=out[..., columns.NIS],
        nis_sigmas=out[..., columns.NIS_SIGMAS],
        refused=out[..., columns.REFUSED],
        grid_mean=out[..., columns.GRID_MEAN : columns.GRID_MEAN + 3],
        track_mean=out[..., columns.TRACK_MEAN : columns.TRACK_MEAN + 3],
        grid=out[..., columns.GRID : columns.GRID + 3],
        track=out[..., columns.TRACK : columns.TRACK + 3],
        across=out[..., columns.ACROSS],
        grid_rise=out[..., columns.GRID_RISE : columns.GRID_RISE + 3],
        track_rise=out[..., columns.TRACK_RISE : columns.TRACK_RISE + 3],
        noise_rise=memories[..., watch.NOISE_RISE],
        calm_rise=memories[..., watch.CALM_RISE],
        alike_rise=memories[..., watch.ALIKE_RISE],
        block_rise=memories[..., watch.BLOCK_RISE],
    )
