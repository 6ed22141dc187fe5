"""One run of a follower as series: its estimates, and what became of its fixes."""

from __future__ import annotations

from dataclasses import dataclass

from .model import ModelRun
from .vehicle import EstimateSeries, ReceiptRecord


@dataclass(frozen=True, eq=False, kw_only=True)
class RunSeries:
    """Series of one run, live or replayed.

    Attributes
    ----------
    estimates : EstimateSeries
    receipts : list of ReceiptRecord
    model : ModelRun or None
        Estimated model of the vehicle and the water; None where no model took part.
    divergence : str
        Why the filter stopped; empty when it did not.
    """

    estimates: EstimateSeries
    receipts: list[ReceiptRecord]
    model: ModelRun | None = None
    divergence: str = ''
