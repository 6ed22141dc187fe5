"""Refused fixes that show a dead reckoning that is wrong, and not fixes that are displaced.

A filter can lock on to a wrong heading, gyro bias or DVL scale, with a covariance that denies it;
the gate then refuses true fixes for good. What such an error does to dead reckoning has a shape:
the track is turned and stretched, and the turn grows with time. Fixes that are displaced, drift or
scatter lack that shape, or ask for a turn that the instruments as stated at the start cannot have
(any turn is allowed for a while after a DVL's gate had to be opened: `sins.turned`). So the last
refused fixes in a row are weighed twice: against an offset alone, and against dead reckoning as
uncertain as if nothing had been learnt yet.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Ints
from .events import Fix
from .results import chi2_gate

Complex: TypeAlias = NDArray[np.complex128]
"""East + i north."""

FEWEST = 10
"""Refused fixes in a row that are weighed."""
_FEWEST_SINCE = 6
"""Of those since a moment from which on the heading is unknown: there is less to be told apart."""
_CERTAIN = 0.9999
"""Chi-square probability beyond which an explanation is none."""
_MUCH_WORSE = 2.0
"""An offset alone must miss that quantile by this factor: the turn is to be seen, not guessed."""
_ENLARGED = 4.0
"""Factor on the variances that the fit finds: it has its own linearization."""
_STARTS = np.deg2rad([0.0, 60.0, -60.0, 120.0, -120.0, 180.0])
"""Turns that the search begins with, as far as heading is stated to be off."""
_STEPS = 15
MOST_HEADING = math.pi / math.sqrt(3.0)
"""Sigma of a heading of which nothing is known [rad]."""


@dataclass(frozen=True)
class Unlearnt:
    """Sigmas of dead reckoning as stated at the start: the filter may have learnt wrongly.

    Attributes
    ----------
    heading : float
        [rad].
    scale : float
        Of the DVL.
    gyro_bias : float
        [rad/s].
    """

    heading: float
    scale: float
    gyro_bias: float


@dataclass(frozen=True)
class Turn:
    """Turn and shift of the estimate into the track of the fixes, at present.

    Attributes
    ----------
    angle, rate : float
        Counterclockwise from above [rad], and its growth [rad/s].
    moved : (2,) array
        Way from the estimated position to that of the turned track, horizontal grid axes [m].
    covariance : (4, 4) array
        Of angle, rate and way.
    """

    angle: float
    rate: float
    moved: Array
    covariance: Array


@dataclass(frozen=True)
class Present:
    """The estimate that refused fixes contradict.

    Attributes
    ----------
    stamp_ns : int
    r_e : (3,) array
        Position, ECEF [m].
    track : callable
        Gives the way to it from stamps [ns] (n,) by the velocities of then, turned by what the
        heading was corrected by since: east + i north [m]; None if the past is too short.
    """

    stamp_ns: int
    r_e: Array
    track: Callable[[Ints], Complex | None]


@dataclass(frozen=True)
class Refused:
    """A refused fix: validity, position and covariance (ECEF), and fix minus estimate (grid)."""

    validity_ns: int
    r_e: Array
    covariance_e: Array
    offset_G: Array

    def variance(self, C_e_G: Array) -> float:
        """Return the variance of the fix, mean of the horizontal axes [m^2]."""
        return float(np.trace((C_e_G @ self.covariance_e @ C_e_G.T)[:2, :2]) / 2.0)


class RefusedRow:
    """The newest fixes that were refused in a row."""

    def __init__(self) -> None:
        self._row: deque[Refused] = deque(maxlen=FEWEST)

    def add(self, fix: Fix, offset_G: Array) -> None:
        """Append a refused fix; ``offset_G`` (3,) is fix minus estimate at its validity [m]."""
        self._row.append(Refused(fix.validity_ns, fix.r_e, fix.covariance_e, offset_G))

    def __len__(self) -> int:
        return len(self._row)

    def clear(self) -> None:
        """Begin a new row: a fix was used, or the covariance enlarged."""
        self._row.clear()

    def in_order(self) -> list[Refused]:
        """Return the fixes in the order of their validity."""
        return sorted(self._row, key=lambda r: r.validity_ns)

    def turn(
        self, C_e_G: Array, present: Present, sigmas: Unlearnt, since_ns: int | None = None
    ) -> Turn | None:
        """Turn of dead reckoning that explains the row; None if an offset does, or nothing.

        Parameters
        ----------
        C_e_G, present, sigmas
            As of `turn_of`.
        since_ns : int, optional
            Fixes that are valid later count, and fewer of them are enough: all, or the newest, as
            what was wrong with the attitude may have gone on after the gate had opened.
        """
        row = self.in_order()
        if since_ns is None:
            return turn_of(row, C_e_G, present, sigmas) if len(row) >= FEWEST else None
        row, found = [r for r in row if r.validity_ns > since_ns], None
        if len(row) >= _FEWEST_SINCE:
            found = turn_of(row, C_e_G, present, sigmas)
        if found is None and len(row) > _FEWEST_SINCE:
            found = turn_of(row[-_FEWEST_SINCE:], C_e_G, present, sigmas)
        return found


def turn_of(row: list[Refused], C_e_G: Array, present: Present, sigmas: Unlearnt) -> Turn | None:
    """Turn of dead reckoning that explains fixes; None where an offset does, or nothing.

    Dead reckoning is that of one attitude, the present one, as far as the past is stored: what
    corrections have bent or moved in the meantime would be no turn of a rigid track.

    Parameters
    ----------
    row : list of Refused
        In the order of validity.
    C_e_G : (3, 3) array
        ECEF to grid axes.
    present : Present
    sigmas : Unlearnt
    """
    offset = _complex(np.array([r.offset_G for r in row]))
    fixes = _complex(np.array([C_e_G @ (r.r_e - row[0].r_e) for r in row]))
    here = _complex((C_e_G @ (present.r_e - row[0].r_e))[None])
    stamps_ns = np.array([r.validity_ns for r in row] + [present.stamp_ns])
    time_s = (stamps_ns - row[-1].validity_ns) * 1e-9
    way = present.track(stamps_ns)
    track = np.append(fixes - offset, here) if way is None else here - way
    sigma = np.sqrt(np.array([r.variance(C_e_G) for r in row]))
    limit = chi2_gate(_CERTAIN, 2 * len(row) - 2)
    displaced = _centred(fixes - track[:-1], sigma) / sigma
    if not np.sum(np.abs(displaced) ** 2) > _MUCH_WORSE * limit:
        return None
    fit = _Fit(fixes, np.diff(track), time_s, sigma, sigmas)
    found = [fit.search(start) for start in _STARTS if abs(start) <= 3.0 * sigmas.heading]
    chi2, x, covariance = min(found, key=lambda f: f[0])
    if not chi2 < limit:
        return None
    place, slopes = fit.place(x)
    age_s = float(time_s[-1])
    J = np.vstack([[0.0, 1.0, age_s], [0.0, 0.0, 1.0], slopes])
    at_present = J @ covariance @ J.T
    at_present[2:, 2:] += np.eye(2) / np.sum(sigma**-2)
    moved = place - here[0]
    return Turn(
        float(x[1] + x[2] * age_s),
        float(x[2]),
        np.array([moved.real, moved.imag]),
        _ENLARGED * at_present,
    )


class _Fit:
    """Least squares of a turned and stretched track on fixes, with stated sigmas as priors.

    fixes = offset + sum of g exp(i (angle + rate t)) times the pieces of the track. The last piece
    goes on to where the estimate is at present, which has no fix yet.
    """

    def __init__(
        self, fixes: Complex, pieces: Complex, time_s: Array, sigma: Array, sigmas: Unlearnt
    ) -> None:
        self._fixes, self._sigma = fixes, sigma
        self._pieces = pieces
        self._middle_s = 0.5 * (time_s[1:] + time_s[:-1])
        tiny = 1e-12
        self._prior = np.maximum([sigmas.scale, sigmas.heading, sigmas.gyro_bias], tiny)

    def _track(self, x: Array) -> tuple[Complex, list[Complex]]:
        """The turned track from its first fix on, and its derivatives by log g, angle, rate."""
        pieces = self._pieces * np.exp(x[0] + 1j * (x[1] + x[2] * self._middle_s))
        track, growing = _sums(pieces), _sums(pieces * self._middle_s)
        return track, [track, 1j * track, 1j * growing]

    def _turned(self, x: Array) -> tuple[Array, Array]:
        """Residuals [sigma] and their derivatives by logarithm of g, angle, rate; offset out."""
        track, slopes = self._track(x)
        r = _centred(self._fixes - track[:-1], self._sigma) / self._sigma
        rows = [_pair(_centred(d[:-1], self._sigma) / self._sigma) for d in slopes]
        return _pair(r), np.column_stack(rows)

    def place(self, x: Array) -> tuple[complex, Array]:
        """End of the track through the fixes, east + i north, and its derivatives (2, 3)."""
        track, slopes = self._track(x)
        end = _mean(self._fixes - track[:-1], self._sigma) + track[-1]
        moved = [d[-1] - _mean(d[:-1], self._sigma) for d in slopes]
        return end, np.array([[d.real for d in moved], [d.imag for d in moved]])

    def search(self, start: float) -> tuple[float, Array, Array]:
        """Chi-square, parameters (3,) and covariance (3, 3) from a turn [rad] to begin with."""
        x: Array = np.array([0.0, start, 0.0])
        weights = np.diag(self._prior**-2)
        for _ in range(_STEPS):
            r, J = self._turned(x)
            x = x + np.linalg.solve(J.T @ J + weights, J.T @ r - weights @ x)
            x[0] = min(max(x[0], -1.0), 1.0)
        r, J = self._turned(x)
        chi2 = float(r @ r + np.sum((x / self._prior) ** 2))
        return chi2, x, np.asarray(np.linalg.inv(J.T @ J + weights))


def _sums(pieces: Complex) -> Complex:
    """Sums of the first 0, 1, 2 ... pieces."""
    return np.concatenate([np.zeros(1, dtype=np.complex128), np.cumsum(pieces)])


def _complex(rows: Array) -> Complex:
    """East + i north of rows (n, 3) in grid axes."""
    return np.asarray(rows[:, 0] + 1j * rows[:, 1])


def _mean(z: Complex, sigma: Array) -> complex:
    """Weighted mean of complex numbers."""
    weights = sigma**-2
    return complex(np.sum(weights * z) / np.sum(weights))


def _centred(z: Complex, sigma: Array) -> Complex:
    """Complex numbers less their weighted mean."""
    return np.asarray(z - _mean(z, sigma))


def _pair(z: Complex) -> Array:
    """Real parts, then imaginary ones."""
    return np.concatenate([np.real(z), np.imag(z)])
