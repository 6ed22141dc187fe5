"""Test statistics of innovation memories: against their definitions in NumPy, memory by memory."""

import numpy as np

from polar_nav_core.engine.health.statistics import statistics
from polar_nav_core.kernels import watch


def memories_of(rng, *shape):
    """Memories as of some innovations each, one of them empty."""
    memories = rng.normal(0.0, 3.0, (*shape, watch.WIDTH))
    memories[..., watch.WEIGHT] = rng.uniform(0.5, 40.0, shape)
    memories[..., watch.WEIGHT_2] = rng.uniform(0.5, 40.0, shape)
    memories[..., watch.SQUARE : watch.SQUARE + 3] = rng.uniform(0.0, 200.0, (*shape, 3))
    memories.reshape(-1, watch.WIDTH)[-1] = 0.0
    return memories


def test_they_are_what_they_are_said_to_be():
    memories = memories_of(np.random.default_rng(1), 5, watch.STREAMS, watch.MEMORIES)
    s = statistics(memories)
    assert not any(np.any(values[-1, -1, -1]) for values in s)  # of the empty one
    for index in list(np.ndindex(memories.shape[:-1]))[:-1]:
        m = memories[index]
        weight, square = m[watch.WEIGHT], m[watch.SQUARE : watch.SQUARE + 3] / m[watch.WEIGHT]
        number, nis = weight**2 / m[watch.WEIGHT_2], m[watch.NIS] / weight
        level = max(1.0, square[:2].mean())
        grid = m[watch.GRID : watch.GRID + 3] / weight
        track = m[watch.TRACK : watch.TRACK + 3] / weight
        for values, expected in (
            (s.number, number),
            (s.nis, nis),
            (s.nis_sigmas, (nis - 1.0) * np.sqrt(number / 2.0)),
            (s.refused, m[watch.REFUSED] / weight),
            (s.across, m[watch.ACROSS] / weight),
            (s.grid_mean, grid),
            (s.track_mean, track),
            (s.grid, number * grid**2 / [level, level, max(1.0, square[2])]),
            (s.track, number * track**2 / np.maximum(1.0, square)),
            (s.grid_rise, m[watch.GRID_RISE : watch.TRACK_RISE].reshape(3, 2).max(axis=1)),
            (s.track_rise, m[watch.TRACK_RISE : watch.NOISE_RISE].reshape(3, 2).max(axis=1)),
            (s.noise_rise, m[watch.NOISE_RISE]),
            (s.calm_rise, m[watch.CALM_RISE]),
            (s.alike_rise, m[watch.ALIKE_RISE]),
        ):
            np.testing.assert_allclose(values[index], expected, rtol=1e-14)
