"""Tracks of whole runs in both modes, and their collection piece by piece."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from .. import nav_columns
from ..arrays import Array
from ..error_model import X
from ..identification.result import Identification
from ..kernels.sins import state as fs
from ..kernels.sins.model import E
from ..kernels.sins.output import make_rows
from ..kernels.station import state as ss
from .engine import Engine
from .inputs import Stamps
from .lever import Rates, Rows
from .outputs import Estimate, ModelEstimate, Output, Receipt
from .params import EngineParams
from .receipt_rows import Receipts
from .sins import aiding
from .station import arrays
from .station.filter import StationFilter, model_of

_ROWS = 256
_ROWS_DERIVED = 1024
"""Rows at a time, with covariances and with what is derived from them: so that they stay in the
second cache. Where a run keeps whole covariances there is room for all: they are not copied."""
_ROWS_STATION = 512


@dataclass(frozen=True)
class Track:
    """Estimates of a run, one row each.

    Attributes
    ----------
    stamps_ns : (k,) array
    r_e, v_G : (k, 3) arrays
        Position, ECEF [m]; velocity, grid axes [m/s].
    C_b_G : (k, 3, 3) array
    P : (k, 24, 24) array
        Covariance of the error state, or of its leading states where no more is asked for; without
        rows where only `derived` is.
    sensor_errors : (k, 15) array
        Gyro bias, accelerometer bias, DVL scale, DVL Markov velocity, USBL bias as estimated.
    local_statistics : (k, 2, 3) array
        Of DVL and depth since the row before: used, gated, sum of NIS (outputs.LOCAL_DOF).
    fixes : (k, 3) array
        Fixes received, fixes fused, newest validity [ns].
    model : (k, 31) array
        Of vehicle and water; `filter.aiding.estimate_of` names what stands in a row. Without the
        vehicle's model, (k, 0).
    derived : (k, nav_columns.WIDTH) array
        Columns derived from state and covariance (`nav_columns`), in place of P; without rows
        unless asked for.
    """

    stamps_ns: Stamps
    r_e: Array
    v_G: Array
    C_b_G: Array
    P: Array
    sensor_errors: Array
    local_statistics: Array
    fixes: Stamps
    model: Array = field(default_factory=lambda: np.zeros((0, 0)))
    derived: Array = field(default_factory=lambda: np.zeros((0, nav_columns.WIDTH)))

    def at_base_link(self, lever_b: Array, rates: Rates, gyro_noise_density: float) -> Track:
        """Estimates of base_link from those of the IMU's point, with their covariance.

        Parameters
        ----------
        lever_b : (3,) array
            IMU from base_link [m].
        rates : Rates
            With the estimates' stamps among its own.
        gyro_noise_density : float
            [rad/s/sqrt(Hz)]
        """
        rows = Rows.of(self.r_e, self.v_G, self.P)
        rate, bias_b = rates.at(self.stamps_ns), self.sensor_errors[:, 0:3]
        rows.move(lever_b, gyro_noise_density, rate, bias_b, self.C_b_G)
        return replace(self, r_e=rows.r_e, v_G=rows.v_G, P=rows.P)


@dataclass(frozen=True)
class StationTrack:
    """Estimates of a run in station mode, one row each.

    Attributes
    ----------
    stamps_ns : (k,) array
    r_e, v_G : (k, 3) arrays
        Position, ECEF [m]; velocity, grid axes [m/s].
    C_b_G : (k, 3, 3) array
    P : (k, 9, 9) array
        Covariance of attitude, velocity and position errors.
    x, P_x : (k, 12), (k, 12, 12) arrays
        State of kernels.station.state and its covariance.
    walk : (k,) array
        Density q_c in use [m^2/s^3].
    weight : (k, B) array
        Of the bank's members.
    local_statistics : (k, 2, 3) array
        Of DVL and depth since the row before, as in `Track`.
    fixes : (k, 3) array
        Fixes received, fixes fused, newest validity [ns].
    """

    stamps_ns: Stamps
    r_e: Array
    v_G: Array
    C_b_G: Array
    P: Array
    x: Array
    P_x: Array
    walk: Array
    weight: Array
    local_statistics: Array
    fixes: Stamps

    def model(self, k: int, params: EngineParams) -> ModelEstimate:
        """Estimated drag and current of row k."""
        return model_of(self.x[k], self.P_x[k], float(self.walk[k]), params.model_speed)


T = TypeVar('T', bound=Track | StationTrack)
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
        room = room or (_ROWS_DERIVED if derived else _ROWS)
        self.rows = make_rows(room, model=self._model.on, derived=derived)

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
        return _copied(_of_station_rows(self._filter_now().row, slice(1), _counts_of(estimate)))


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


class Collector(Generic[T]):
    """Collects the pieces of a track, receipts and identifications of a run.

    Parameters
    ----------
    pieces : Pieces
        Of the mode.
    sink : callable, optional
        Gets the pieces, which are overwritten after the call; by default they are kept.
    """

    def __init__(self, pieces: Pieces[T], sink: Callable[[T], None] | None = None) -> None:
        self._pieces = pieces
        self._kept: list[T | slice] = []
        """Pieces, and rows that still stand where they were written."""
        self._sink = sink
        self._single: list[T] = []
        self.rows = pieces.rows
        self._fixes = np.zeros((len(self.rows.stamps), 3), dtype=np.int64)
        self._noted = self._drained = self._copied = 0
        self.receipts = Receipts()
        self.identifications: list[Identification] = []

    def collect(self, outputs: Iterator[Output]) -> None:
        """Store outputs of the engine: receipts, identifications, single estimates."""
        for output in outputs:
            if isinstance(output, Receipt):
                self.receipts.append(output)
            elif isinstance(output, Identification):
                self.identifications.append(output)
            else:
                self._drain_rows()
                self._single.append(self._pieces.of_estimate(output))
                if len(self._single) >= _ROWS:
                    self._drain_single()

    def note(self, engine: Engine, until: int | None = None) -> None:
        """Write the engine's counts of fixes into the rows added since the last call.

        Up to row ``until``, where that is given.
        """
        n = int(self.rows.io[1]) if until is None else until
        if n > self._noted:
            self._fixes[self._noted : n] = engine.fix_counts()
            self._noted = n

    def note_fused(self, engine: Engine, validities_ns: Sequence[int], until: Stamps) -> None:
        """Write counts of fixes into rows between fixes that were fused but are not yet counted.

        Up to row ``until[k]`` it is fix k that is still to come.
        """
        last = int(until[-1])
        if last > self._noted:
            received, fused, newest_ns = engine.fix_counts()
            number = np.arange(len(until))
            newest = np.maximum.accumulate([newest_ns, *validities_ns[:-1]])
            counts = np.column_stack([received + number, fused + number, newest])
            rows = np.arange(self._noted, last)
            self._fixes[self._noted : last] = counts[np.searchsorted(until, rows, side='right')]
            self._noted = last

    def drain(self) -> None:
        """Pass all waiting rows to the sink."""
        self._drain_single()
        self._drain_rows()

    def _drain_single(self) -> None:
        if self._single:
            piece, self._single = _joined(self._single), []
            if self._sink is None:
                self._kept.append(piece)
            else:
                self._sink(piece)

    def _drain_rows(self) -> None:
        part = slice(self._drained, self._noted)
        if part.start == part.stop:
            return
        self._drain_single()
        if self._sink is not None:
            self._sink(self._of_rows(part))
        else:
            before = self._kept[-1] if self._kept else None
            if isinstance(before, slice) and before.stop == part.start:
                self._kept[-1] = slice(before.start, part.stop)
            else:
                self._kept.append(part)
            if part.stop < len(self.rows.stamps):
                self._drained = part.stop
                return
            waiting = self._kept[self._copied :]
            self._kept[self._copied :] = [
                _copied(self._of_rows(k)) if isinstance(k, slice) else k for k in waiting
            ]
            self._copied = len(self._kept)
        self.rows.io[1] = self._noted = self._drained = 0

    def _of_rows(self, part: slice) -> T:
        return self._pieces.of_rows(part, self._fixes[part])

    def _piece(self, kept: T | slice) -> T:
        return self._of_rows(kept) if isinstance(kept, slice) else kept

    def track(self) -> T:
        """Track of all rows that were kept; what is not whole in memory is copied."""
        pieces = [self._piece(kept) for kept in self._kept or [slice(0)]]
        return _joined(pieces) if len(pieces) > 1 else _in_one(pieces[0])


def _copied(piece: T) -> T:
    return type(piece)(**{f.name: getattr(piece, f.name).copy() for f in fields(piece)})


def _in_one(piece: T) -> T:
    """The same, with each column in one piece."""
    return type(piece)(
        **{f.name: np.ascontiguousarray(getattr(piece, f.name)) for f in fields(piece)}
    )


def _joined(pieces: list[T]) -> T:
    names = [f.name for f in fields(pieces[0])]
    return type(pieces[0])(**{n: np.concatenate([getattr(p, n) for p in pieces]) for n in names})
