"""Rows of a run's track: collected in chunks, kept or passed on."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from .. import nav_columns
from ..kernels.sins import state as fs
from ..kernels.sins.model import E
from .engine import Engine
from .events import Array, Estimate, Output, Receipt, no_local_statistics
from .inputs import Stamps
from .sins import aiding

ROWS = 256
ROWS_TOLD = 1024
"""Rows at a time, with covariances and with what is told of them: so that they stay in the second
cache."""


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
        Covariance of the error state; without rows where only `told` is wanted.
    sensor_errors : (k, 15) array
        Gyro bias, accelerometer bias, DVL scale, DVL Markov velocity, USBL bias as estimated.
    local_statistics : (k, 2, 3) array
        Of DVL and depth since the row before: used, gated, sum of NIS (events.LOCAL_DOF).
    fixes : (k, 3) array
        Fixes received, fixes fused, newest validity [ns].
    model : (k, 31) array
        Of vehicle and water; `filter.aiding.estimate_of` names what stands in a row. Without the
        vehicle's model, (k, 0).
    told : (k, nav_columns.WIDTH) array
        What follows from state and covariance (`nav_columns`), where it was wanted in place of P;
        else without rows.
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
    told: Array = field(default_factory=lambda: np.zeros((0, nav_columns.WIDTH)))


RowSink = Callable[[Track], None]
"""Given the rows of a run some hundred at a time; they are overwritten after the call."""


class Collector:
    """Rows of the track in chunks, and receipts."""

    def __init__(self, sink: RowSink | None, model: fs.Aiding, *, told: bool = False) -> None:
        self._chunks: list[Track] = []
        self._sink = sink or self._keep
        self._single: list[Track] = []
        self._model = model
        self._told = told
        room = ROWS_TOLD if told else ROWS
        self.rows = fs.make_rows(room, model=model.on, told=told)
        self._fixes = np.zeros((room, 3), dtype=np.int64)
        self._noted = 0
        self.receipts: list[Receipt] = []
        self.local_statistics = no_local_statistics()

    def take(self, outputs: Iterator[Output]) -> None:
        """Take what the engine gives by itself."""
        for output in outputs:
            if isinstance(output, Receipt):
                self.receipts.append(output)
            elif isinstance(output, Estimate):
                self._drain_rows()
                self._single.append(_row(output, told=self._told))
                if len(self._single) >= ROWS:
                    self._drain_single()

    def note(self, engine: Engine, until: int | None = None) -> None:
        """Write the engine's counts of fixes to the rows that came since the last time.

        Up to row ``until``, where that is given.
        """
        n = int(self.rows.io[1]) if until is None else until
        if n > self._noted:
            self._fixes[self._noted : n] = engine.fix_counts()
            self._noted = n

    def note_fused(self, engine: Engine, validities_ns: Sequence[int], until: Stamps) -> None:
        """As `note`, with the counts before each of some fixes that were fused, not yet counted.

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
        """Pass on what waits."""
        self._drain_single()
        self._drain_rows()

    def _drain_single(self) -> None:
        if self._single:
            self._pass_on(_joined(self._single))
            self._single = []

    def _drain_rows(self) -> None:
        n, rows = self._noted, self.rows
        if n == 0:
            return
        self._drain_single()
        flat = rows.flat[:n]
        self._pass_on(
            Track(
                rows.stamps[:n],
                flat[:, 12:15],
                flat[:, 9:12],
                flat[:, 0:9].reshape(n, 3, 3),
                rows.P[:n],
                flat[:, 15:30],
                rows.tally[:n, :2],
                self._fixes[:n],
                self._values(flat),
                rows.told[:n],
            )
        )
        rows.io[1] = self._noted = 0

    def _values(self, flat: Array) -> Array:
        if not self._model.on:
            return np.zeros((len(flat), 0))
        return aiding.values_of(
            flat[:, fs.NAVIGATION :].reshape(-1, fs.MODEL_ROWS, E), self._model
        )

    def _pass_on(self, chunk: Track) -> None:
        self.local_statistics += np.sum(chunk.local_statistics, axis=0)
        self._sink(chunk)

    def _keep(self, chunk: Track) -> None:
        self._chunks.append(Track(**{n: getattr(chunk, n).copy() for n in _NAMES}))

    def track(self) -> Track:
        """All rows that were kept."""
        if not self._chunks:
            return Track(
                np.zeros(0, dtype=np.int64),
                r_e=np.zeros((0, 3)),
                v_G=np.zeros((0, 3)),
                C_b_G=np.zeros((0, 3, 3)),
                P=np.zeros((0, 24, 24)),
                sensor_errors=np.zeros((0, 15)),
                local_statistics=np.zeros((0, 2, 3)),
                fixes=np.zeros((0, 3), dtype=np.int64),
                model=np.zeros((0, aiding.WIDTH if self._model.on else 0)),
            )
        return _joined(self._chunks)


_NAMES = tuple(Track.__dataclass_fields__)


def _joined(chunks: list[Track]) -> Track:
    return Track(**{n: np.concatenate([getattr(c, n) for c in chunks]) for n in _NAMES})


def _row(e: Estimate, *, told: bool) -> Track:
    errors = [e.gyro_bias_b, e.accel_bias_b, e.dvl_scale_m, e.dvl_markov_m, e.usbl_bias_a]
    counts = [e.fixes_received, e.fixes_fused, e.last_validity_ns]
    return Track(
        np.array([e.stamp_ns], dtype=np.int64),
        e.r_e[None],
        e.v_G[None],
        e.C_b_G[None],
        e.P[None][: 0 if told else 1],
        np.concatenate(errors)[None],
        e.local_statistics[None],
        np.array([counts], dtype=np.int64),
        aiding.row_of(e.model)[None],
        nav_columns.describe(e.r_e[None], e.C_b_G[None], e.P[None])[: 1 if told else 0],
    )
