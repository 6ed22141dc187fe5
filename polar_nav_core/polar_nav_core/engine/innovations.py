"""Whitened innovations of a whole run, and how they move with each common error.

Of a strapdown run with every fix at its validity, as `smoothing` processes it. They hold all that
a recording says of constants that the filter does not estimate (docs/derivations/calibration.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Array, Ints
from ..errors import ConfigError
from ..kernels.sins import marginal
from . import run as engine_run
from .inputs import Inputs
from .outputs import Receipt
from .params import EngineParams
from .sins.innovation_tape import InnovationTape
from .smoothed import at_validity
from .smoothing import LOOK_S, in_order


@dataclass(frozen=True)
class Innovations:
    """Innovations of the measurements of a run in the order in which they were fused.

    Attributes
    ----------
    stamps_ns, ranks : (n,) arrays
        Of the measurement; its sensor as `events.Rank`.
    sizes, dof : (n,) arrays
        Number of its rows; degrees of freedom, of a fix without a height fewer.
    white : (n, 3) array
        L^-1 z with S = L L^T: unit variance, rows beyond the size zero.
    moved : (n, 3, COLUMNS) array
        L^-1 M: change of ``white`` per unit of each common error (`kernels.sins.consider`).
    log_sigma : (n, 3) array
        Logarithms of the diagonal of L: of the sigma of each row given those before, without
        common errors; rows beyond the size zero.
    state : (30,) array
        At the end: C_b_G, v_G [m/s], r_e [m], sensor errors.
    P, sensitivity : (24, 24), (24, COLUMNS) arrays
        At the end: covariance without common errors, change of the error per unit of each.
    filters : int
        Number of filters: more than one where one was lost and began anew.
    receipts : sequence of Receipt
    divergence : str
    """

    stamps_ns: Ints
    ranks: Ints
    sizes: Ints
    dof: Ints
    white: Array
    moved: Array
    log_sigma: Array
    state: Array
    P: Array
    sensitivity: Array
    filters: int
    receipts: Sequence[Receipt]
    divergence: str


def innovations(
    params: EngineParams, inputs: Inputs, *, progress: Callable[[float], None] | None = None
) -> Innovations:
    """Whitened innovations of a run of the strapdown mode.

    Raises
    ------
    ConfigError
        For parameters that have no linear steps, and for a run in which nothing was measured.
    """
    stated = in_order(params)
    stamps = inputs.imu_stamps_ns
    first_ns, last_ns = (int(stamps[0]), int(stamps[-1])) if len(stamps) else (0, 0)
    fixes = tuple(
        at_validity(f)
        for f in inputs.fixes
        # After the last sample there is no state to compare with.
        if f.refusal is None and first_ns <= f.validity_ns <= last_ns
    )
    with InnovationTape() as tape:
        result = engine_run.run(
            stated,
            replace(inputs, fixes=fixes),
            sink=lambda _: None,
            progress=progress,
            look_every_s=LOOK_S,
            tape=tape,
        )
        if not tape.pieces:
            raise ConfigError('nothing was measured: the filter did not start, or fused nothing')
        stamps_ns, ranks, sizes, dof, white, moved, log_sigma = (
            np.concatenate(column) for column in zip(*tape.pieces, strict=True)
        )
        state, P, sensitivity = tape.end()
        return Innovations(
            stamps_ns=stamps_ns,
            ranks=ranks,
            sizes=sizes,
            dof=dof,
            white=white,
            moved=moved,
            log_sigma=log_sigma,
            state=state,
            P=P,
            sensitivity=sensitivity,
            filters=len(tape.parts),
            receipts=result.receipts,
            divergence=result.divergence,
        )


def independent(run: Innovations, sigmas: Array) -> tuple[Array, Array]:
    """Innovations of a run as independent numbers, with common errors of so many sigmas unknown.

    The density of all that was measured is the product of normal densities over the rows:
    ``ln p = -sum(log_sigma) - sum(white**2) / 2 - rows ln(2 pi) / 2``.

    Parameters
    ----------
    run : Innovations
    sigmas : (COLUMNS,) array
        Of the common errors, in the units of `kernels.sins.consider`; zero for none.

    Returns
    -------
    white, log_sigma : (n, 3) arrays
        Numbers of unit variance, and the logarithm of the sigma that each was divided by; rows
        beyond a measurement's size are zero.
    """
    white, log_sigma = np.empty_like(run.white), np.empty_like(run.white)
    c = len(sigmas)
    scratch = (np.empty(c), np.empty((c, c)), np.empty(c))
    marginal.independent_rows(run.white, run.moved, run.sizes, sigmas, *scratch, white, log_sigma)
    return white, run.log_sigma + log_sigma
