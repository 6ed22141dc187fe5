"""Record of what a filter's measurements differ from its predictions by, in units of their sigma.

A measurement with innovation z, rows H and S = H P H^T + R = L L^T is kept as L^-1 z, which is
white with unit variance in a world as modelled, and as L^-1 M, its change per unit of each common
error (docs/derivations/common_errors.md).
"""

from __future__ import annotations

import numpy as np

from ...arrays import Array, Ints
from ...errors import PolarNavError
from ...kernels.sins import rings
from ...kernels.sins import state as fs
from .tape import Tape

ROWS = 3
_STATES_EVERY = 100_000
"""Covariance steps from one stored state to the next: nobody reads them here."""


class InnovationTape(Tape):
    """Tape that keeps whitened innovations, and the state at the end.

    Attributes
    ----------
    pieces : list of tuple of arrays
        Per look: stamps [ns], ranks, sizes, degrees of freedom, whitened innovations (n, 3),
        sensitivities (n, 3, COLUMNS) and logarithms of the diagonal of L (n, 3); rows beyond the
        size are zero.
    """

    def __init__(self) -> None:
        super().__init__(_STATES_EVERY)
        self.pieces: list[tuple[Ints, Ints, Ints, Ints, Array, Array, Array]] = []

    def take(self) -> None:
        """Copy what was logged since the last call.

        Raises
        ------
        PolarNavError
            When the ring went round in between.
        """
        f = self._filter
        if f is None or int(f.log.counts[0]) == self._taken:
            return
        log = f.log
        count = int(log.counts[0])
        if count - self._taken > len(log.kinds):
            raise PolarNavError('the log of the filter went round before it was copied')
        order = np.arange(self._taken, count) % len(log.kinds)
        order = order[log.kinds[order] == rings.UPDATE]
        rows = log.numbers[order] % len(log.H)
        sizes = log.rows[order]
        stacked = np.concatenate([log.z[rows][:, :, None], log.moved[rows]], axis=2)
        L = log.L[rows]
        white = whitened(L, stacked, sizes)
        beyond = np.arange(ROWS) >= sizes[:, None]
        log_sigma = np.log(np.where(beyond, 1.0, L[:, range(ROWS), range(ROWS)]))
        measured = (log.stamps[order], log.ranks[order], sizes, log.dof[order])
        self.pieces.append((*measured, white[:, :, 0], white[:, :, 1:], log_sigma))
        self._taken = count

    def end(self) -> tuple[Array, Array, Array]:
        """Leading values of the state (30,), P (24, 24), and sensitivity (24, COLUMNS) at the end.

        Raises
        ------
        PolarNavError
            When no filter was recorded.
        """
        if self._filter is None:
            raise PolarNavError('no filter was recorded')
        s = self._filter.state
        return s.flat[: fs.NAVIGATION].copy(), s.P.copy(), s.sensitivity.copy()


def whitened(L: Array, x: Array, sizes: Ints) -> Array:
    """L^-1 x of each measurement, shape (n, 3, k); rows beyond its size are zero.

    Parameters
    ----------
    L : (n, 3, 3) array
        Lower triangular factors.
    x : (n, 3, k) array
    sizes : (n,) array
        Number of rows of each.
    """
    out = np.zeros_like(x)
    for a in range(ROWS):
        has = sizes > a
        rest = x[has, a] - np.einsum('nb,nbk->nk', L[has, a, :a], out[has, :a])
        out[has, a] = rest / L[has, a, a, None]
    return out
