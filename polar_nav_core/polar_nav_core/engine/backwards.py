"""Backward pass over the tape of a filter: smoothed states, and the residual of each measurement.

Compiled in `kernels.sins.smooth`. Equations: docs/derivations/smoother.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .. import nav_columns, spilled
from ..arrays import Array, Ints
from ..errors import ConfigError
from ..kernels.sins import smooth as kernels
from ..kernels.sins import state as fs
from ..kernels.sins.consider import COLUMNS
from ..kernels.sins.model import E
from ..kernels.sins.update import NAV, N
from .hindsight import OF_FIXES, Judged
from .params import EngineParams
from .sins import aiding
from .sins.stretch import Stretch, position_variance
from .sins.tape import Tape
from .track import Track

_WIDE = 1e4
"""Variance of position [m^2], above which the last second is smoothed with more digits."""
_NOTHING = 'there is nothing to smooth: the filter did not start'


@dataclass(frozen=True)
class Back:
    """Result of a backward pass.

    Attributes
    ----------
    track : Track
        Of the estimates that are published.
    stamps_ns, states : (n,), (n, 30) arrays
        All that were smoothed: leading values of the filter's state.
    judged : Judged
        Of all measurements, in order.
    common : (COLUMNS, COLUMNS + 1) array
        Information of the common errors, and its vector behind it.
    largest_turn : float
        Largest correction of an attitude [rad].
    moved : float
        Largest correction of attitude, velocity or position, of its sigma.
    """

    track: Track
    stamps_ns: Ints
    states: Array
    judged: Judged
    common: Array
    largest_turn: float
    moved: float

    def without_track(self) -> Back:
        """The same without the track and the states."""
        nothing = {n: getattr(self.track, n)[:0].copy() for n in Track.__dataclass_fields__}
        none = self.stamps_ns[:0].copy(), self.states[:0].copy()
        return replace(self, track=Track(**nothing), stamps_ns=none[0], states=none[1])


Move = Callable[[Track], Track]
"""Moves estimates with covariances to another point of the vehicle."""


def backwards(
    params: EngineParams,
    tape: Tape,
    published: int,
    covariances: bool,
    move: Move | None = None,
) -> Back:
    """Smoothed states of a tape; in the track those of every so many covariance steps.

    ``move`` gets the track piece by piece.
    """
    n = N + E if params.model_aiding else N
    adjoint = np.zeros((n, 1 + COLUMNS if tape.considers else 1))
    information = np.zeros((n, n))
    common = np.zeros((COLUMNS, COLUMNS + 1))
    low, wide = np.zeros((n, n)), np.zeros(1, dtype=np.int64)
    scratch, columns = np.zeros((6, n, n)), np.zeros((COLUMNS, N))
    model = aiding.make_aiding(params)
    total = tape.total
    pieces = spilled.LastFirst({}, total.steps // published + len(tape.parts))
    states = spilled.LastFirst({}, total.states)
    judged = spilled.LastFirst(dict.fromkeys(OF_FIXES, tape.fixes), total.updates)
    turn = moved = 0.0
    for stretch, ends, before in tape.backwards():
        if ends:
            adjoint[:], information[:], low[:] = 0.0, 0.0, 0.0
            wide[0] = 1 if position_variance(stretch.P) > _WIDE else 0
        x = np.empty((len(stretch.stamps_ns), n))
        residuals = np.empty((len(stretch.sizes), 3))
        V = np.empty((len(stretch.sizes), 3, 3))
        kernels.smooth_back(
            stretch.kinds,
            stretch.indices,
            stretch.phi,
            stretch.model,
            stretch.H,
            stretch.K,
            stretch.L,
            stretch.z,
            stretch.moved,
            stretch.sizes,
            stretch.places,
            stretch.navigation,
            stretch.deviations,
            x,
            stretch.P,
            stretch.sensitivity,
            adjoint,
            information,
            common,
            tape.common if tape.considers else np.zeros(COLUMNS),
            residuals,
            V,
            before,
            low,
            wide,
            scratch,
        )
        judged.add(vars(Judged.of(stretch, residuals, V)))
        states.add({'stamps_ns': stretch.stamps_ns, 'states': stretch.navigation})
        P, sensitivity = stretch.P, stretch.sensitivity
        if params.model_aiding:
            P, sensitivity = P[:, :N, :N].copy(), sensitivity[:, :N].copy()
        kernels.publish_rows(P, sensitivity, stretch.navigation, tape.common, columns, tape.hidden)
        turn = max(turn, float(np.abs(x[:, :3]).max(initial=0.0)))
        sigma = np.sqrt(np.einsum('nii->ni', P)[:, :NAV])
        moved = max(moved, float((np.abs(x[:, :NAV]) / sigma).max(initial=0.0)))
        shown = (stretch.steps > 0) & (stretch.steps % published == 0)
        piece = _track_of(stretch, P, shown)
        if params.model_aiding:
            of_model = aiding.values_of(_blocks(stretch, x), model)
            piece = replace(piece, model=of_model[shown])
        pieces.add(vars(_published(piece, covariances, move)))
        tape.give_back()
    track = pieces.in_order()
    if not track or not len(track['stamps_ns']):
        raise ConfigError(_NOTHING)
    return Back(
        Track(**track),
        **states.in_order(),
        judged=Judged(**judged.in_order()),
        common=common,
        largest_turn=turn if math.isfinite(turn) else math.inf,
        moved=moved if math.isfinite(moved) else math.inf,
    )


def _blocks(stretch: Stretch, x: Array) -> Array:
    """Smoothed estimates of the vehicle's model, as the filter has them (k, MODEL_ROWS, 7)."""
    out = np.zeros((len(x), fs.MODEL_ROWS, E))
    out[:, fs.P_EE : fs.MEAN] = stretch.P[:, N:, N:]
    out[:, fs.MEAN] = stretch.block[:, :E] - x[:, N:]
    out[:, fs.THRUST] = stretch.block[:, E:]
    return out


def _track_of(stretch: Stretch, P: Array, shown: NDArray[np.bool_]) -> Track:
    rows = stretch.navigation[shown]
    n = len(rows)
    return Track(
        stretch.stamps_ns[shown],
        rows[:, 12:15].copy(),
        rows[:, 9:12].copy(),
        rows[:, :9].reshape(n, 3, 3).copy(),
        P[shown],
        rows[:, 15:30].copy(),
        np.zeros((n, 2, 3)),
        np.zeros((n, 3), dtype=np.int64),
    )


def _published(piece: Track, covariances: bool, move: Move | None) -> Track:
    """Piece of a track with what is derived from its covariances, which are dropped or not."""
    if move is not None:
        piece = move(piece)
    derived = nav_columns.describe(piece.r_e, piece.C_b_G, piece.P)
    P = piece.P if covariances else np.zeros((0, N, N))
    return replace(piece, P=P, derived=derived)
