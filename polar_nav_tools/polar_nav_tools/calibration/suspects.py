"""Constants that are off by more than what is stated of them: tests of one run's innovations.

A score test of each constant that moves innovations, all states of the filter and all common
errors with their stated sigmas being nuisance; then of the others beside those that were found.
Derivation: docs/derivations/calibration.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from polar_nav_core.arrays import Array, Ints
from polar_nav_core.engine.innovations import Innovations, innovations
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.kernels.sins import consider
from polar_nav_core.params import default_of

from .constants import CONSTANTS, Constant, data_of
from .problem import SIGMAS, in_common, prepared, stated_sigmas

SURE = 5.0
"""Sigmas from which on a constant is said to be off: of a dozen tests of a right model one in
140,000 recordings goes so far."""
ALIKE = 0.9
"""Correlation of two estimates, each alone, from which on one constant can be the other."""
LONGEST_S = 4 * 3600.0
"""Of a longer recording the first hours are enough: their innovations are in memory."""
BLOCKS = 20
"""Blocks of time whose scores show how much a score scatters."""
TESTED = (
    'delay', 'dvl_yaw', 'dvl_pitch', 'dvl_lever_x', 'dvl_lever_y', 'dvl_latency', 'range_scale',
    'array_yaw', 'sea_surface', 'transponder_lever_x', 'transponder_lever_y',
)  # fmt: skip
"""Constants with a column of their own, and the lever arms of fixes, by a difference each."""
_AS_OF_FIXES = 'dvl_lever_sigma'
"""Whose sigma stands for that of a transponder's lever arm, of which none is stated."""
_STEP = 0.02
"""Of a difference, as a share of the prior."""


@dataclass(frozen=True)
class Suspect:
    """A constant that is off by more than what is stated of it.

    Attributes
    ----------
    constant : Constant
    value, sigma : float
        What has to be added to what is stated, SI, by one step of least squares; its 1-sigma.
    sigmas : float
        By how many sigmas it is off, of the estimate and of what is stated together.
    least : float
        What is stated of it, 1-sigma, SI.
    twins : tuple of Constant
        Others that would explain nearly the same.
    """

    constant: Constant
    value: float
    sigma: float
    sigmas: float
    least: float
    twins: tuple[Constant, ...]


def constants_of(params: EngineParams, inputs: Inputs) -> tuple[Constant, ...]:
    """Constants that a run has data about and whose rows it gives."""
    there = data_of(params, inputs)
    return tuple(c for c in CONSTANTS if c.name in TESTED and c.needs in there)


def suspects(params: EngineParams, inputs: Inputs) -> tuple[Suspect, ...]:
    """Constants of a run that are off, the one that explains most first.

    Raises
    ------
    ConfigError
        As `innovations`.
    """
    constants = constants_of(params, inputs)
    if not constants:
        return ()
    run, M = rows(params, inputs, constants)
    evidence = Evidence.of(M, run.white, run.stamps_ns)
    known = Known.of(params, constants, M.shape[2])
    places = places_of(constants)
    by_place = dict(zip(places, constants, strict=True))

    def suspect(one: Off) -> Suspect:
        c = by_place[one.column]
        twins = tuple(by_place[k] for k in one.alike)
        return Suspect(
            c, c.sign * one.value, one.sigma, one.sigmas, known.least[one.column], twins
        )

    return tuple(map(suspect, off(evidence, known, places)))


def rows(
    params: EngineParams, inputs: Inputs, constants: Sequence[Constant]
) -> tuple[Innovations, Array]:
    """Innovations of a run, and their change per unit of each common error and constant.

    Returns
    -------
    run : Innovations
        Of a filter whose gates let through what the constants may be off by.
    M : (n, 3, COLUMNS + k) array
        Behind the common errors the k constants that have no column among them.
    """
    stated = prepared(params, constants)
    run = innovations(stated, inputs)
    columns = [run.moved]
    for c in constants:
        if c.column < 0 and c.move is not None:
            step = _STEP * c.prior
            more = innovations(*c.move(stated, inputs, step))
            same, up = in_common(run, more)
            by = np.zeros_like(run.white)
            by[same] = (run.white[same] - more.white[up]) / step
            columns.append(by[:, :, None])
    return run, np.concatenate(columns, axis=2)


def places_of(constants: Sequence[Constant]) -> list[int]:
    """Columns of constants in what `rows` returns."""
    out, behind = [], consider.COLUMNS
    for c in constants:
        out.append(c.column if c.column >= 0 else behind)
        behind += c.column < 0
    return out


@dataclass(frozen=True)
class Known:
    """What is known of each column, 1-sigma, (c,) each.

    Attributes
    ----------
    stated : array
        As stated: while a column is nuisance.
    least : array
        More than which a column has to be off to be said. At least the engine's default of what
        is stated: scale errors of an IMU, which no filter estimates, look like lever arms and
        latencies of that size.
    prior : array
        Of one that is not believed.
    """

    stated: Array
    least: Array
    prior: Array

    @classmethod
    def of(cls, params: EngineParams, constants: Sequence[Constant], columns: int) -> Known:
        """What parameters state of the columns of `rows`."""
        stated = np.zeros(columns)
        stated[: consider.COLUMNS] = stated_sigmas(params)
        least, prior = stated.copy(), stated.copy()
        for c, place in zip(constants, places_of(constants), strict=True):
            name, unit = SIGMAS.get(c.column, (_AS_OF_FIXES, 1.0))
            least[place] = max(stated[place], default_of(EngineParams, name) / unit)
            prior[place] = c.prior
        return cls(stated, least, prior)


@dataclass(frozen=True)
class Evidence:
    """What innovations say of columns, by blocks of time.

    Attributes
    ----------
    information : (blocks, c, c) array
        M^T M of the rows of each.
    vector : (blocks, c) array
        M^T w.
    """

    information: Array
    vector: Array

    @classmethod
    def of(cls, M: Array, white: Array, stamps_ns: Ints) -> Evidence:
        """Evidence of rows, change (n, 3, c) and whitened innovations (n, 3), at their stamps."""
        first, length = stamps_ns.min(), np.ptp(stamps_ns) + 1
        block = (stamps_ns - first) * BLOCKS // length
        parts = [(M[of].reshape(-1, M.shape[2]), white[of].ravel())
                 for of in (block == k for k in range(BLOCKS))]  # fmt: skip
        return cls(np.array([m.T @ m for m, _ in parts]), np.array([m.T @ w for m, w in parts]))


@dataclass(frozen=True)
class Off:
    """A column that is off.

    Attributes
    ----------
    column : int
    value, sigma : float
        Estimate beside the others that are off, and its 1-sigma.
    sigmas : float
        By how many sigmas, of the estimate and of what is stated together.
    alike : tuple of int
        Columns that would explain nearly the same.
    """

    column: int
    value: float
    sigma: float
    sigmas: float
    alike: tuple[int, ...] = ()


def off(evidence: Evidence, known: Known, places: Sequence[int]) -> tuple[Off, ...]:
    """Columns that are off by more than what is known of them, in the order of their evidence.

    Parameters
    ----------
    evidence : Evidence
    known : Known
    places : sequence of int
        Columns that are tested, of those that are alike the first one first; others are nuisance.
    """
    J, h = evidence.information.sum(axis=0), evidence.vector.sum(axis=0)
    if not (np.isfinite(J).all() and np.isfinite(h).all()):
        return ()
    sigma, found = known.stated.copy(), dict[int, tuple[int, ...]]()
    while left := [k for k in places if k not in found and J[k, k] > 0.0]:
        tests = {k: _tested(evidence, J, h, sigma, known, k) for k in left}
        best = max(left, key=lambda k: tests[k].sigmas)
        if tests[best].sigmas < SURE:
            break
        rho = _correlations(J, sigma, best)
        alike = [
            k for k in left if k == best or (abs(rho[k]) >= ALIKE and tests[k].sigmas >= SURE)
        ]
        found[alike[0]] = tuple(alike[1:])
        # Of columns that are alike one is enough.
        sigma[alike[0]] = known.prior[alike[0]]
    last = [
        replace(_tested(evidence, J, h, sigma, known, k), alike=alike)
        for k, alike in found.items()
    ]
    return tuple(one for one in last if one.sigmas >= SURE)


def _correlations(J: Array, sigma: Array, k: int) -> Array:
    """Cosines (c,) between what moves innovations as column k does and as each does.

    With nuisance of so many sigmas taken out of both.
    """
    at = np.flatnonzero(sigma)
    scale = sigma[at]
    inner = J[np.ix_(at, at)] * np.outer(scale, scale) + np.eye(len(at))
    cross = J[:, at] * scale
    left = J - cross @ np.linalg.solve(inner, cross.T)
    size = np.sqrt(np.clip(np.diag(left), 0.0, None))
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.asarray(np.nan_to_num(left[k] / (size[k] * size)))


def _tested(evidence: Evidence, J: Array, h: Array, sigma: Array, known: Known, k: int) -> Off:
    """Estimate of one column beside others of so many sigmas, and how far off it is.

    Its sigma is the larger one of two: that of the model, and that by the scatter of the score
    from block to block, which coloured innovations make larger.
    """
    free = sigma.copy()
    free[k] = known.prior[k]
    at = np.flatnonzero(free)
    scale = free[at]
    P = np.linalg.inv(J[np.ix_(at, at)] * np.outer(scale, scale) + np.eye(len(at)))
    P *= np.outer(scale, scale)
    b = P @ h[at]
    j = int(np.searchsorted(at, k))
    rest = evidence.vector[:, at] - evidence.information[:, at][:, :, at] @ b
    variance = max(float(P[j, j]), float(np.sum((rest @ P[:, j]) ** 2)))
    sigmas = abs(float(b[j])) / float(np.sqrt(variance + known.least[k] ** 2))
    return Off(k, float(b[j]), float(np.sqrt(variance)), sigmas)
