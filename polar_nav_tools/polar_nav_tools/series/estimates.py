"""Series of a run for scoring and report, from its rows and without messages.

The numbers are those of `polar_nav_ros.navigation_outputs` followed by `bags.arrays`, bit for bit
(a test compares): both use `polar_nav_core.nav_columns`, here for some hundred rows at
a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import nav_columns
from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.receipt_rows import Receipts
from polar_nav_core.engine.track import Track
from polar_nav_core.error_model import X
from polar_nav_core.spilled_table import Table
from polar_nav_msgs.msg import NavState

from .vehicle import SENSOR_ERRORS, SENSOR_SIGMAS, EstimateSeries, ReceiptRecord

_COVARIANCES = {
    'P_position_G': nav_columns.POSITION_COVARIANCE_G,
    'P_velocity_G': nav_columns.VELOCITY_COVARIANCE_G,
    'P_attitude_G': nav_columns.ATTITUDE_COVARIANCE_G,
}

Columns = dict[str, NDArray[Any]]


class EstimateRows:
    """Collector of a run's rows (the ``sink`` of `engine.run.run`) for an EstimateSeries.

    A day of rows does not stay in memory (`spilled`). Of each covariance it stores the published
    blocks and sigmas only, so that rows of derived columns are enough (``derived=True``).

    Parameters
    ----------
    params : EngineParams
        Of the run.
    expected : int
        Approximate number of rows, for which room is allocated.
    """

    def __init__(self, params: EngineParams, expected: int = 0) -> None:
        self._params = params
        self._expected = expected
        self._table: Table | None = None

    def append(self, chunk: Track) -> None:
        """Append copies of some rows."""
        columns = self._columns_of(chunk)
        if self._table is None:
            self._table = Table(columns, max(self._expected, len(chunk.stamps_ns)))
        self._table.append(columns)

    def series(self, vehicle: str) -> EstimateSeries:
        """Return the series of the whole run."""
        if self._table is None:
            self.append(_no_rows())
            return self.series(vehicle)
        configuration = self._params.configuration if len(self._table) else ''
        columns: dict[str, Any] = self._table.columns()
        return EstimateSeries(
            vehicle=vehicle,
            configuration=configuration,
            configurations=(configuration,) if configuration else (),
            **columns,
        )

    def _columns_of(self, rows: Track) -> Columns:
        """Columns of an EstimateSeries; see `navigation_outputs.nav_to_msg` for each."""
        count, derived = len(rows.stamps_ns), rows.derived
        if len(derived) == count:
            nav_columns.require_axes(derived)
        else:
            derived = nav_columns.describe(rows.r_e, rows.C_b_G, rows.P)
        sigma, errors, fixes = derived[:, nav_columns.SIGMA], rows.sensor_errors, rows.fixes
        height = derived[:, nav_columns.COLUMNS['height']]
        age = np.where(fixes[:, 1] > 0, (rows.stamps_ns - fixes[:, 2]) * 1e-9, np.nan)
        return {
            'stamp_ns': rows.stamps_ns,
            'status': np.full(count, NavState.STATUS_NAVIGATING, dtype=np.uint8),
            'r_e': rows.r_e,
            **{name: derived[:, k] for name, k in nav_columns.COLUMNS.items()},
            'depth': self._params.sea_surface_height - height,
            'v_G': rows.v_G,
            'C_b_G': nav_columns.rotations(derived[:, nav_columns.QUATERNION]),
            **{
                name: derived[:, place].reshape(count, 3, 3)
                for name, place in _COVARIANCES.items()
            },
            **{name: errors[:, 3 * i : 3 * i + 3] for i, name in enumerate(SENSOR_ERRORS)},
            **{name: sigma[:, 9 + 3 * i : 12 + 3 * i] for i, name in enumerate(SENSOR_SIGMAS)},
            'fixes_received': fixes[:, 0],
            'fixes_fused': fixes[:, 1],
            'age_of_last_fix': age,
            'local_statistics': rows.local_statistics,
        }


_RECEIPT = [f.name for f in fields(Receipt)]


def receipts_of(receipts: Sequence[Receipt]) -> Sequence[ReceiptRecord]:
    """Receipts of a run in the form of recorded ones, made when they are read."""
    return Records(receipts if isinstance(receipts, Receipts) else Receipts(receipts))


class Records(Sequence[ReceiptRecord]):
    """Records of receipts, of which a day has too many to keep them."""

    def __init__(self, receipts: Receipts) -> None:
        self._receipts = receipts

    def columns(self, *names: str) -> Columns:
        """Return fields of the receipts as columns; see `Receipts.columns`."""
        return self._receipts.columns(*names)

    def __len__(self) -> int:
        return len(self._receipts)

    def __iter__(self) -> Iterator[ReceiptRecord]:
        return map(_record_of, self._receipts)

    @overload
    def __getitem__(self, index: int) -> ReceiptRecord: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[ReceiptRecord, ...]: ...

    def __getitem__(self, index: int | slice) -> ReceiptRecord | tuple[ReceiptRecord, ...]:
        if isinstance(index, slice):
            return tuple(map(_record_of, self._receipts[index]))
        return _record_of(self._receipts[index])


def _record_of(receipt: Receipt) -> ReceiptRecord:
    values = {name: getattr(receipt, name) for name in _RECEIPT}
    values['verdict'], values['verdict_text'] = int(receipt.verdict), receipt.verdict.name
    return ReceiptRecord.of({**values, 'age_s': receipt.age_s})


def _no_rows() -> Track:
    return Track(
        stamps_ns=np.zeros(0, dtype=np.int64),
        r_e=np.zeros((0, 3)),
        v_G=np.zeros((0, 3)),
        C_b_G=np.zeros((0, 3, 3)),
        P=np.zeros((0, X.size, X.size)),
        sensor_errors=np.zeros((0, 15)),
        local_statistics=np.zeros((0, 2, 3)),
        fixes=np.zeros((0, 3), dtype=np.int64),
    )
