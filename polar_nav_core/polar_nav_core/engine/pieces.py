"""Rows that the compiled loops write, as pieces of a track, in both modes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol, TypeVar

import numpy as np

from .. import nav_columns
from ..arrays import Array
from ..error_model import X
from ..kernels.sins import state as fs
from ..kernels.sins.model import E
from ..kernels.sins.output import make_rows
from ..kernels.station import state as ss
from .inputs import Stamps
from .lever import Rates
from .outputs import Estimate
from .params import EngineParams
from .sins import aiding
from .station import arrays
from .station.filter import StationFilter
from .track import StationTrack, Track, copied

_ROWS = 256
_ROWS_SLIM = 1024
"""Rows at a time, with covariances, and with part of them or what is derived: so that they stay in
the second cache. Where a run keeps whole covariances there is room for all, without a copy."""
_ROWS_STATION = 512
_NAVIGATION = X.dr_e.stop
"""States of attitude, velocity and position: the least of which rows have the covariance."""

T_co = TypeVar('T_co', bound=Track | StationTrack, covariant=True)


class Pieces(Protocol[T_co]):
    """Output rows of one mode, and their conversion to pieces of its track."""

    @property
    def rows(self) -> Any:  # noqa: ANN401 - fs.Rows or ss.Rows
        """Rows that the compiled loop writes."""

    def of_rows(self, part: slice, fixes: Stamps) -> T_co:
        """Some of the rows as views, with the counts of fixes of as many rows (n, 3)."""

    def of_estimate(self, estimate: Estimate) -> T_co:
        """The engine's newest estimate as a single row."""


class SinsPieces:
    """Pieces of a `Track`.

    Parameters
    ----------
    params : EngineParams
    derived : bool
        Whether rows hold the derived columns (`nav_columns`) in place of covariances.
    room : int
        Rows at a time; 0 for the usual number.
    states : int
        Leading states of which a track has the covariance.
    """

    def __init__(
        self,
        params: EngineParams,
        *,
        derived: bool = False,
        room: int = 0,
        states: int = X.size,
    ) -> None:
        self._model = aiding.make_aiding(params)
        self._derived, self._room, self._states = derived, room, states
        self._noise = params.gyro_noise_density
        self._moved: tuple[Array, Rates] | None = None
        kept = max(states, _NAVIGATION)
        room = room or (_ROWS_SLIM if derived or kept == _NAVIGATION else _ROWS)
        self.rows = make_rows(room, model=self._model.on, derived=derived, states=kept)

    def moved_by(self, lever_b: Array, rates: Rates) -> None:
        """Have rows of the IMU's point moved to base_link; ``lever_b`` is from there to it."""
        self._moved = lever_b, rates
        room = 0 if self._derived else self._room  # covariances are converted some at a time
        self.rows = make_rows(room or _ROWS, model=self._model.on, derived=False)

    def of_rows(self, part: slice, fixes: Stamps) -> Track:
        """Some of the rows as views, with the counts of fixes of as many rows (n, 3)."""
        rows, flat = self.rows, self.rows.flat[part]
        track = Track(
            rows.stamps[part],
            flat[:, 12:15],
            flat[:, 9:12],
            flat[:, 0:9].reshape(len(flat), 3, 3),
            rows.P[part],
            flat[:, 15:30],
            rows.tally[part, : fs.FIX_ROW],
            fixes,
            self._values(flat),
            rows.derived[part],
        )
        if self._moved is not None:
            track = self._at_base_link(track, *self._moved)
        return self._leading(track)

    def _leading(self, track: Track) -> Track:
        if self._states == X.size:
            return track
        return replace(track, P=track.P[:, : self._states, : self._states])

    def _at_base_link(self, track: Track, lever_b: Array, rates: Rates) -> Track:
        track = track.at_base_link(lever_b, rates, self._noise)
        if not self._derived:
            return track
        derived = nav_columns.describe(track.r_e, track.C_b_G, track.P)
        return replace(track, P=np.zeros((0, X.size, X.size)), derived=derived)

    def _values(self, flat: Array) -> Array:
        if not self._model.on:
            return np.zeros((len(flat), 0))
        blocks = flat[:, fs.NAVIGATION :].reshape(-1, fs.MODEL_ROWS, E)
        return aiding.values_of(blocks, self._model)

    def of_estimate(self, estimate: Estimate) -> Track:
        """An estimate as a single row."""
        e, derived = estimate, self._derived
        errors = [e.gyro_bias_b, e.accel_bias_b, e.dvl_scale_m, e.dvl_markov_m, e.usbl_bias_a]
        track = Track(
            np.array([e.stamp_ns], dtype=np.int64),
            e.r_e[None],
            e.v_G[None],
            e.C_b_G[None],
            e.P[None][: 0 if derived else 1],
            np.concatenate(errors)[None],
            e.local_statistics[None],
            _counts_of(e),
            aiding.row_of(e.model)[None],
            nav_columns.describe(e.r_e[None], e.C_b_G[None], e.P[None])[: 1 if derived else 0],
        )
        return self._leading(track)


class StationPieces:
    """Pieces of a `StationTrack`.

    Parameters
    ----------
    params : EngineParams
    filter_now : callable
        Returns the filter, whose last row of output has what an `Estimate` leaves out.
    room : int
        Rows at a time; 0 for the usual number.
    """

    def __init__(
        self, params: EngineParams, filter_now: Callable[[], StationFilter], room: int = 0
    ) -> None:
        self.rows = arrays.make_rows(room or _ROWS_STATION, len(arrays.densities(params)))
        self._filter_now = filter_now

    def of_rows(self, part: slice, fixes: Stamps) -> StationTrack:
        """Some of the rows as views, with the counts of fixes of as many rows (n, 3)."""
        return _of_station_rows(self.rows, part, fixes)

    def of_estimate(self, estimate: Estimate) -> StationTrack:
        """The engine's newest estimate as a single row."""
        return copied(_of_station_rows(self._filter_now().row, slice(1), _counts_of(estimate)))


def _of_station_rows(rows: ss.Rows, part: slice, fixes: Stamps) -> StationTrack:
    return StationTrack(
        rows.stamps[part],
        rows.r_e[part],
        rows.v_G[part],
        rows.C_b_G[part],
        rows.P[part],
        rows.x[part],
        rows.P_x[part],
        rows.walk[part],
        rows.weight[part],
        rows.tally[part],
        fixes,
    )


def _counts_of(e: Estimate) -> Stamps:
    counts = [e.fixes_received, e.fixes_fused, e.last_validity_ns]
    return np.array([counts], dtype=np.int64)
