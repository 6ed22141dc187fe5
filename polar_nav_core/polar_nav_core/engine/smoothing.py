"""Fixed-interval smoothing of a whole run: each estimate by all that was measured.

A filter processes the run with every fix at its validity, and its steps and updates are recorded
(`sins.tape`); the backward pass over them is compiled (`kernels.sins.smooth`). How late a fix came
does not matter here. Equations: docs/derivations/smoother.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .. import nav_columns
from ..arrays import Array
from ..errors import ConfigError
from ..kernels.sins import smooth as kernels
from ..kernels.sins.consider import COLUMNS
from ..kernels.sins.update import N
from . import run as engine_run
from .events import Fix, Receipt
from .inputs import Inputs
from .params import EngineParams
from .sins.tape import Stretch, Tape
from .track import Track

LOOK_S = 60.0
"""How often the log is copied; the filter's rings hold more than twice that."""
_HISTORY_S = 130.0


@dataclass(frozen=True)
class Smoothed:
    """Smoothed track of a run.

    Attributes
    ----------
    track : Track
        With covariances that contain the common errors, as published ones do.
    receipts : tuple of Receipt
        Of fixes, as the filter decided that had each at its validity.
    divergence : str
        Why the filter stopped; empty where it did not.
    information : (COLUMNS, COLUMNS) array
        Fisher information of the common errors, with navigation and sensor states as nuisance.
    vector : (COLUMNS,) array
        ``information`` times their least-squares estimate.
    largest_turn : float
        Largest smoothed correction of the attitude [rad]: what the linear model has to bear.
    """

    track: Track
    receipts: tuple[Receipt, ...]
    divergence: str
    information: Array
    vector: Array
    largest_turn: float


def smooth(
    params: EngineParams,
    inputs: Inputs,
    *,
    every_s: float = 1.0,
    covariances: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Smoothed:
    """Smoothed track of a run of the strapdown mode, an estimate every so many seconds.

    Parameters
    ----------
    params : EngineParams
        Gate and weights are those of its configuration; how it treats late fixes does not count.
    inputs : Inputs
    every_s : float
        [s]; rounded to whole covariance steps.
    covariances : bool
        Whether the track keeps them, besides the columns derived from them.
    progress : callable, optional

    Raises
    ------
    ConfigError
        For parameters that have no linear steps to go back over.
    """
    stated = in_order(params)
    every = max(1, round(every_s / stated.filter_period_s))
    fixes = tuple(at_validity(f) for f in inputs.fixes if f.refusal is None and f.validity_ns > 0)
    with Tape(every) as tape:
        result = engine_run.run(
            stated,
            replace(inputs, fixes=fixes),
            sink=lambda _: None,
            derived=True,
            progress=progress,
            look_every_s=LOOK_S,
            tape=tape,
        )
        return _backwards(tape, result.receipts, result.divergence, covariances)


def in_order(params: EngineParams) -> EngineParams:
    """The same filter for fixes that come when they are valid."""
    configuration = params.resolved()
    if params.mode != 'sins':
        raise ConfigError('smoothing knows mode sins only; station mode has no smoother yet')
    if params.model_aiding:
        raise ConfigError('smoothing does not know model_aiding yet')
    if configuration.noise_adaptation != 'none':
        raise ConfigError(
            f'noise_adaptation {configuration.noise_adaptation}: smoothing needs stated noise; '
            'use configuration default'
        )
    return replace(
        params,
        configuration='custom',
        delay_handling='ignore',
        noise_adaptation='none',
        gate_probability=configuration.gate_probability,
        robust_fixes=configuration.robust_fixes,
        history_s=_HISTORY_S,
    )


def at_validity(fix: Fix) -> Fix:
    """Fix that is received when it is valid."""
    return replace(fix, transmit_ns=fix.validity_ns, receive_ns=fix.validity_ns)


def _backwards(
    tape: Tape,
    receipts: tuple[Receipt, ...],
    divergence: str,
    covariances: bool,
) -> Smoothed:
    adjoint, information = np.zeros((1 + COLUMNS, N)), np.zeros((N, N))
    common = np.zeros((COLUMNS, COLUMNS + 1))
    scratch = np.zeros((2, N, N))
    pieces: list[Track] = []
    turn = 0.0
    for stretch, ends in tape.backwards():
        if ends:
            adjoint[:], information[:] = 0.0, 0.0
        x = np.empty((len(stretch.stamps_ns), N))
        kernels.smooth_back(
            stretch.kinds,
            stretch.indices,
            stretch.phi,
            stretch.H,
            stretch.K,
            stretch.L,
            stretch.z,
            stretch.moved,
            stretch.sizes,
            stretch.places,
            stretch.navigation,
            x,
            stretch.P,
            stretch.sensitivity,
            adjoint,
            information,
            common,
            scratch,
        )
        kernels.publish_rows(
            stretch.P, stretch.sensitivity, stretch.navigation, tape.common, tape.hidden
        )
        turn = max(turn, float(np.abs(x[:, :3]).max(initial=0.0)))
        pieces.append(_track_of(stretch, len(stretch.P) if covariances else 0))
    return Smoothed(
        _joined(pieces[::-1]),
        receipts,
        divergence,
        common[:, :COLUMNS].copy(),
        common[:, COLUMNS].copy(),
        turn if math.isfinite(turn) else math.inf,
    )


def _track_of(stretch: Stretch, kept: int) -> Track:
    n, rows = len(stretch.stamps_ns), stretch.navigation
    r_e, C_b_G = rows[:, 12:15].copy(), rows[:, :9].reshape(n, 3, 3)
    return Track(
        stretch.stamps_ns,
        r_e,
        rows[:, 9:12],
        C_b_G,
        stretch.P[:kept],
        rows[:, 15:30],
        np.zeros((n, 2, 3)),
        np.zeros((n, 3), dtype=np.int64),
        derived=nav_columns.describe(r_e, C_b_G, stretch.P),
    )


def _joined(pieces: list[Track]) -> Track:
    names = (
        'stamps_ns', 'r_e', 'v_G', 'C_b_G', 'P', 'sensor_errors', 'local_statistics', 'fixes',
        'derived',
    )  # fmt: skip
    if not pieces:
        raise ConfigError('there is nothing to smooth: the filter did not start')
    return Track(**{n: np.concatenate([getattr(p, n) for p in pieces]) for n in names})
