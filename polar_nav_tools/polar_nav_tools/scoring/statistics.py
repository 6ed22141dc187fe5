"""Summary statistics of a series of errors.

RMS, median, 95 % and maximum are of the magnitude; the mean keeps its sign, so that a constant
offset (a lag, a bias) is distinguishable from scatter. Values that are not finite are left out and
counted.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike

from .json_values import record


@dataclass(frozen=True)
class Statistics:
    """Summary of one error component over one window, in the unit of the values."""

    count: int
    missing: int  # values that were not finite
    rms: float
    median: float  # of the magnitude
    p95: float  # of the magnitude, linear interpolation between order statistics
    max: float  # of the magnitude
    mean: float  # signed

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON; None where there is no number."""
        return record(asdict(self))

    def scaled(self, factor: float) -> Statistics:
        """Summary in another unit (`factor` > 0 target units per present unit)."""
        if not factor > 0.0:
            raise ValueError(f'factor={factor} must be > 0')
        return Statistics(
            self.count,
            self.missing,
            self.rms * factor,
            self.median * factor,
            self.p95 * factor,
            self.max * factor,
            self.mean * factor,
        )


def statistics(values: ArrayLike) -> Statistics:
    """Summary of `values`, any shape, flattened.

    Parameters
    ----------
    values : array_like
        Errors, any unit.

    Returns
    -------
    Statistics
        All NaN when no value is finite.
    """
    flat = np.asarray(values, dtype=np.float64).ravel()
    good = flat[np.isfinite(flat)]
    missing = flat.size - good.size
    if good.size == 0:
        nan = float('nan')
        return Statistics(0, missing, nan, nan, nan, nan, nan)
    magnitude = np.abs(good)
    median, p95 = np.quantile(magnitude, [0.5, 0.95])
    return Statistics(
        count=good.size,
        missing=missing,
        rms=float(np.sqrt(np.mean(good * good))),
        median=float(median),
        p95=float(p95),
        max=float(magnitude.max()),
        mean=float(good.mean()),
    )
