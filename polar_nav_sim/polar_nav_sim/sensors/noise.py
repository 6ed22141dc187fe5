"""Noise by sample number: drawn in fixed chunks, so that that of sample k is the same at any pace.

Whether samples come one by one or in blocks, and whether some are skipped, sample k always sees
the same numbers. Every kind of noise is drawn even where its sigma is zero: switching one on never
changes another.
"""

from __future__ import annotations

import math
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CHUNK = 256


class Draws:
    """Standard normal numbers, or uniform ones, by row, drawn chunk by chunk.

    Parameters
    ----------
    rng : numpy.random.Generator
        The stream; nothing else may draw from it afterwards.
    columns : int
        Numbers per sample.
    uniform : bool
        Uniform in [-1, 1) instead of standard normal.
    """

    def __init__(self, rng: np.random.Generator, columns: int, *, uniform: bool = False) -> None:
        self._uniform = uniform
        self._rng = rng
        self._columns = columns
        self.chunk = -1
        self.rows = np.empty((0, columns))

    def advance(self) -> Floats:
        """Draw the next chunk; shape (CHUNK, columns)."""
        self.chunk += 1
        shape = (CHUNK, self._columns)
        self.rows = (
            self._rng.uniform(-1.0, 1.0, shape)
            if self._uniform
            else self._rng.standard_normal(shape)
        )
        return self.rows


class GaussMarkov:
    """First-order Gauss-Markov process, stationary from the start; sigma 0 gives zeros.

    x_{k+1} = a x_k + sigma sqrt(1 - a^2) w_k, a = exp(-dt/tau): exact at the samples.
    """

    def __init__(self, sigma: Floats, tau_s: float, dt_s: float, first: Floats) -> None:
        self._a = math.exp(-dt_s / tau_s)
        self._b = sigma * math.sqrt(-math.expm1(-2.0 * dt_s / tau_s))
        self._x = sigma * first

    def advance(self, w: Floats) -> Floats:
        """Values for one chunk of standard normal rows (n, c); the first is the present one."""
        # Column by column, with the rounding of scipy.signal's lfilter. To load that takes as much
        # time and memory as all else that a sensor is made of.
        a = self._a
        columns = zip(self._x.tolist(), (self._b * w).T.tolist(), strict=True)
        x = np.array(
            [list(accumulate(c, lambda x, u: u + a * x, initial=first)) for first, c in columns]
        ).T
        self._x = x[-1]
        return np.asarray(x[:-1])


class RandomWalk:
    """x_{k+1} = x_k + density sqrt(dt) w_k, from zero."""

    def __init__(self, density: Floats, dt_s: float) -> None:
        self._b = density * math.sqrt(dt_s)
        self._x = np.zeros_like(density)

    def advance(self, w: Floats) -> Floats:
        """Values for one chunk of standard normal rows (n, c); the first is the present one."""
        x = self._x + np.concatenate([np.zeros((1, w.shape[1])), np.cumsum(self._b * w, axis=0)])
        self._x = x[-1]
        return np.asarray(x[:-1])


class Index:
    """Check that sample numbers increase."""

    def __init__(self) -> None:
        self._next = 0

    def take(self, k0: int, count: int) -> None:
        """Accept the numbers k0 to k0 + count - 1.

        Raises
        ------
        ValueError
            If one of them was accepted before.
        """
        if k0 < self._next:
            raise ValueError(f'sample {k0} comes after sample {self._next - 1}')
        self._next = k0 + count


def fixed_product(C: Floats, x: Floats) -> Floats:
    """C x for each row of x, shape (n, 3), with the same rounding whatever n is (BLAS has not)."""
    return np.asarray(x[:, :1] * C[:, 0] + x[:, 1:2] * C[:, 1] + x[:, 2:] * C[:, 2])
