"""Sage-Husa adaptation of the noise: guarded, for use, and as printed in the paper.

Guarded (`sage_husa`): R-hat per kind of measurement (:class:`GuardedNoise`) and one Q-hat of the
filter (:class:`GuardedProcess`), both as ratios to what is stated. There are no q-hat and r-hat: a
mean of the position noise is not separable from dr, nor one of the velocity noise from dv, and the
pair drifts (docs/derivations/adaptation.md).

As printed (`sage_husa_unguarded`, eqs. 35-38, and `sage_husa_published`, eqs. 62-65, both in the
corrected reading of docs/derivations/adaptation.md): :class:`Printed`. It is expected to diverge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...kernels.sins import update as kf
from .noise import MeasurementNoise, ProcessNoise

R_CEILING = 100.0
"""Largest R-hat, as a multiple of the stated R in any direction, whatever ceiling is chosen."""
Q_BOUNDS = (0.25, 4.0)
"""Smallest and largest Q-hat, as multiples of the stated Q in any direction."""


def clipped(A: Array, lo: float, hi: float) -> Array:
    """Nearest symmetric matrix whose eigenvalues lie in [lo, hi]."""
    values, vectors = np.linalg.eigh(0.5 * (A + A.T))
    if values[0] >= lo and values[-1] <= hi:
        return A
    limited = np.clip(values, lo, hi)
    return sandwich(vectors, np.diag(limited))


def lower_inverse(L: Array) -> Array:
    """Inverse of a lower triangular matrix."""
    X = np.eye(len(L))
    for i in range(len(L)):
        X[i] = (X[i] - np.einsum('k,kj->j', L[i, :i], X[:i])) / L[i, i]
    return X


def sandwich(A: Array, B: Array) -> Array:
    """A B A^T."""
    product: Array = np.einsum('ik,jk->ij', np.einsum('ik,kl->il', A, B), A)
    return product


class GuardedNoise(MeasurementNoise):
    """R-hat' = (1 - d) R-hat + d (v v^T - H P- H^T), in units of the stated R; floor and ceiling.

    With L L^T the stated R, the average runs over L^-1 (v v^T - H P- H^T) L^-T, so that a stated R
    that changes from one measurement to the next keeps its meaning. It starts as if the stated R
    had been seen 1/(1 - b) times. A sample weighs less when it is mostly uncertainty of the state.
    The average is left as it is; what the filter takes of it has eigenvalues in [floor, ceiling].

    Parameters
    ----------
    forgetting : float
        b, in (0, 1).
    floor, ceiling : float
        Smallest and largest ratio in any direction.
    """

    def __init__(self, forgetting: float, floor: float, ceiling: float = R_CEILING) -> None:
        self._b = forgetting
        self._floor = floor
        self._ceiling = min(ceiling, R_CEILING)
        self.reset()

    def reset(self) -> None:
        """Reset to the stated noise."""
        self._power = self._b ** (1.0 / (1.0 - self._b))
        self.average = np.eye(3)
        self.ratio = np.eye(3)

    def apply(self, R: Array) -> None:
        """R <- L ratio L^T with L L^T = R; an R that is not positive definite is left alone."""
        L = np.zeros((3, 3))
        if kf.cholesky(L, R, 3):
            R[...] = sandwich(L, self.ratio)

    def learn(self, z: Array, R_stated: Array, S: Array) -> None:
        """Adapt R-hat to an innovation (3,), given the stated R and S, (3, 3) each."""
        L = np.zeros((3, 3))
        if not kf.cholesky(L, R_stated, 3):
            return
        inverse = lower_inverse(L)
        v = np.einsum('ik,k->i', inverse, z)
        of_state = sandwich(inverse, S) - self.ratio
        self._power *= self._b
        d = (1.0 - self._b) / (1.0 - self._power)
        d /= max(1.0, float(np.diagonal(of_state).max()))
        self.average = (1.0 - d) * self.average + d * (np.outer(v, v) - of_state)
        self.ratio = clipped(self.average, self._floor, self._ceiling)


class GuardedProcess(ProcessNoise):
    """Q-hat' = (1 - d) Q-hat + d (K v v^T K^T + P - Phi P Phi^T), bounded, in units of Q.

    P - Phi P Phi^T is Q-hat - K S K^T, so a sample is Q-hat + K (v v^T - S) K^T: what the
    innovations were larger than expected. Updates between two covariance steps count together, as
    one measurement of several rows. Ratios are D^-1/2 Q-hat D^-1/2 over the states with stated
    noise, D what was stated for the time since the sample before; other states keep none. An
    update that takes more out of P than the steps put in says as much less of Q, and weighs so.
    Eigenvalues of the ratio stay in `Q_BOUNDS`.

    Parameters
    ----------
    forgetting : float
        b, in (0, 1).
    """

    def __init__(self, forgetting: float) -> None:
        k0 = 1.0 / (1.0 - forgetting)
        self._b = forgetting
        self._power = forgetting**k0
        self._active: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
        self._stated = np.zeros(0)
        self.average = np.zeros((0, 0))
        self.ratio = np.zeros((0, 0))
        self._excess: Array | None = None
        self._taken = np.zeros(0)

    def add(self, P: Array, Phi: Array, q: Array, dt: float) -> None:  # noqa: ARG002 - Printed
        """P <- P + Q-hat - diag(q), after learning from the updates since the step before."""
        if not len(self._active):
            self._active = np.flatnonzero(q > 0.0)
            n = len(self._active)
            if not n:
                return
            self._stated, self.average, self.ratio = np.zeros(n), np.eye(n), np.eye(n)
        if self._excess is not None:
            self._sample(self._excess)
        self._stated = self._stated + q[self._active]
        root = np.sqrt(q[self._active])
        change = (self.ratio - np.eye(len(root))) * root[:, None] * root[None, :]
        P[np.ix_(self._active, self._active)] += 0.5 * (change + change.T)

    def learn(self, K: Array, z: Array, S: Array) -> None:
        """Store K (v v^T - S) K^T for the next step; ignored before the first step."""
        if not len(self._active):
            return
        g = K[:, self._active]
        excess = sandwich(g.T, np.outer(z, z) - S)
        taken = np.diagonal(sandwich(g.T, S))
        self._taken = taken if self._excess is None else self._taken + taken
        self._excess = excess if self._excess is None else self._excess + excess

    def _sample(self, excess: Array) -> None:
        root = np.sqrt(self._stated)
        self._power *= self._b
        d = (1.0 - self._b) / (1.0 - self._power)
        d /= max(1.0, float((self._taken / self._stated).max()))
        sample = self.ratio + excess / (root[:, None] * root[None, :])
        self.average = (1.0 - d) * self.average + d * sample
        self.ratio = clipped(self.average, *Q_BOUNDS)
        self._stated = np.zeros_like(self._stated)
        self._excess = None


class Printed(ProcessNoise):
    """q-hat, Q-hat, r-hat and R-hat of eqs. (35)-(38), or of (62)-(65), nothing guarded.

    The paper steps and measures at the same rate. Here a covariance step can be shorter than the
    time between two measurements, so q-hat and Q-hat are held per second: a sample is divided by
    that time, and a step adds its share. With one measurement a step this is the paper's form.

    Parameters
    ----------
    simplified : bool
        (62)-(65), without the terms that are subtracted in (36) and (38).
    forgetting : float
        b, in (0, 1).
    start : float
        Measurements that count as seen before the first; 0 is d_k as printed, with d_1 = 1.
    size : int
        Number of states.
    """

    def __init__(self, *, simplified: bool, forgetting: float, start: float, size: int) -> None:
        self.simplified = simplified
        self._b = forgetting
        self._power = forgetting**start
        self.q = np.zeros(size)
        self.Q: Array | None = None
        self.r = np.zeros(6)
        self.R = np.zeros((6, 6))
        self._known = np.zeros(6, dtype=bool)
        self.added = np.zeros((size, size))
        self.elapsed = 0.0
        self.last_dt = 0.0

    def add(self, P: Array, Phi: Array, q: Array, dt: float) -> None:
        """P <- P + Q-hat dt - diag(q); sums the added noise since the last measurement."""
        if self.Q is None:
            self.Q = np.diag(q / dt)
        step = self.Q * dt
        P += step - np.diag(q)
        self.added = sandwich(Phi, self.added) + step
        self.elapsed += dt
        self.last_dt = dt

    def noise(self, rows: NDArray[np.intp], stated: Array) -> Array:
        """R-hat of the given rows; rows never measured start with the stated R."""
        new = np.flatnonzero(~self._known[rows])
        if len(new):
            self.R, self._known = self.R.copy(), self._known.copy()
            self.R[np.ix_(rows[new], rows[new])] = stated[np.ix_(new, new)]
            self._known[rows] = True
        R: Array = self.R[np.ix_(rows, rows)]
        return R

    def learn_printed(
        self,
        correction: Array,
        z: Array,
        v: Array,
        P_before: Array,
        P_after: Array,
        HPHt: Array,
        rows: NDArray[np.intp],
    ) -> None:
        """Adapt q-hat, Q-hat, r-hat and R-hat to one measurement.

        Parameters
        ----------
        correction : (n,) array
            K v.
        z, v : (m,) arrays
            Innovation before and after r-hat was taken off.
        P_before, P_after : (n, n) arrays
        HPHt : (m, m) array
            H P- H^T.
        rows : (m,) array
            Which of the six rows (velocity, position) these are.
        """
        if self.Q is None or self.elapsed <= 0.0:
            return
        self._power *= self._b
        d = (1.0 - self._b) / (1.0 - self._power)
        square, place = np.outer(v, v), np.ix_(rows, rows)
        Q_sample, R_sample = np.outer(correction, correction) + P_after, square
        if self.simplified:
            self.q = (1.0 - d) * self.q + d * correction / self.elapsed  # (62), as printed
        else:
            self.q = self.q + d * correction / self.elapsed  # (35), X_{k+1} - Phi X_k
            Q_sample = Q_sample - (P_before - self.added)  # P- less what was added is Phi P Phi^T
            R_sample = square - HPHt
        self.Q = (1.0 - d) * self.Q + d * Q_sample / self.elapsed
        R, r = self.R.copy(), self.r.copy()
        R[place] = (1.0 - d) * R[place] + d * R_sample
        r[rows] = (1.0 - d) * r[rows] + d * z
        self.R, self.r = R, r
        self.added = np.zeros_like(self.added)
        self.elapsed = 0.0
