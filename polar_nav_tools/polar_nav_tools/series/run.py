"""One run of a follower as series: estimates and receipts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from polar_nav_core.engine.health.conditions import Health

from .model import ModelRun
from .vehicle import EstimateSeries, ReceiptRecord

FILTER, SMOOTHER = 'filter', 'smoother'
"""Names of a run and of the same run smoothed, where both are compared."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RunSeries:
    """Series of one run, live or replayed.

    Attributes
    ----------
    estimates : EstimateSeries
    receipts : sequence of ReceiptRecord
    model : ModelRun or None
        Estimated model of the vehicle and the water; None without a model.
    divergence : str
        Reason why the filter stopped; empty if it did not.
    health : tuple of Health
        Judgements of the watchdog in the order of time, of a replayed run.
    """

    estimates: EstimateSeries
    receipts: Sequence[ReceiptRecord]
    model: ModelRun | None = None
    divergence: str = ''
    health: tuple[Health, ...] = ()
