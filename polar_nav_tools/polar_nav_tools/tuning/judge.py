"""Judges noise by a part of a recording that it was not found from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine import run as engine_run

from ..calibration.problem import SENSORS
from ..foreign.recording import Recording
from ..scoring.align import ScoringError
from ..scoring.consistency import Consistency, chi_square_band
from ..scoring.score import score
from ..scoring.windows import Window
from ..series.estimates import EstimateRows, receipts_of
from .likelihood import Mask, Rows, noisier
from .parameters import Parameter

BAND = 0.999
"""Share of recordings with the right noise whose NIS is in the band."""
_SURE = 2.0
"""Standard errors from which on a difference of likelihoods is one."""
STATED, SUGGESTED = 'stated', 'suggested'


@dataclass(frozen=True)
class Nis:
    """Mean squared independent innovation of one sensor, as stated and as suggested.

    Attributes
    ----------
    sensor : str
    rows : int
    stated, suggested : float
        1 in a right model; NaN where the filter is lost.
    band : (low, high)
        Of a right model, `BAND` of it.
    """

    sensor: str
    rows: int
    stated: float
    suggested: float
    band: tuple[float, float]

    @property
    def inside(self) -> bool:
        """Whether the suggested noise is in the band."""
        return self.band[0] <= self.suggested <= self.band[1]


@dataclass(frozen=True)
class HeldOut:
    """What the part held out says of stated and suggested noise.

    Attributes
    ----------
    seconds : float
        Its length.
    rows : int
        Numbers that were predicted.
    gain, gain_sigma : float
        Logarithm of the predictive likelihood as suggested less that as stated, per number, and
        its standard error; infinite where the filter is lost with what is stated.
    nis : tuple of Nis
    """

    seconds: float
    rows: int
    gain: float
    gain_sigma: float
    nis: tuple[Nis, ...]

    @property
    def verdict(self) -> str:
        """``better``, ``worse`` or ``alike``."""
        if abs(self.gain) <= _SURE * self.gain_sigma:
            return 'alike'
        return 'better' if self.gain > 0.0 else 'worse'


def held_out(stated: Rows | None, suggested: Rows | None, seconds: float) -> HeldOut:
    """Judgement of the rows of a part held out, each predicted from all before it.

    None stands for a filter that is lost.
    """
    some = suggested if suggested is not None else stated
    if some is None or not len(some.ranks):
        return HeldOut(seconds, 0, math.nan, math.nan, ())
    nis = []
    for rank, name in SENSORS.items():
        of = some.ranks == rank
        count = int(some.dof[of].sum())
        if count:
            low, high = chi_square_band(float(count), BAND)
            mean, other = (_mean_square(rows, of, count) for rows in (stated, suggested))
            band = (float(low) / count, float(high) / count)
            nis.append(Nis(name, count, mean, other, band))
    count = int(some.dof.sum())
    if stated is None or suggested is None or not stated.same_measurements(suggested):
        gain = math.inf if suggested is not None else -math.inf
        return HeldOut(seconds, count, gain, 0.0, tuple(nis))
    gains = suggested.ln_density() - stated.ln_density()
    sigma = _sigma_of_sum(gains)
    return HeldOut(seconds, count, float(gains.sum()) / count, sigma / count, tuple(nis))


def _mean_square(rows: Rows | None, of: Mask, count: int) -> float:
    if rows is None or len(rows.ranks) != len(of):
        return math.nan
    return float(np.sum(rows.white[of] ** 2) / count)


_BLOCKS = 20


def _sigma_of_sum(values: Array) -> float:
    """Standard error of a sum, from sums over blocks of time."""
    sums = np.array([block.sum() for block in np.array_split(values, _BLOCKS)])
    return float(np.std(sums, ddof=1) * math.sqrt(_BLOCKS))


def nees(
    run: Recording, parameters: Sequence[Parameter], at: Array, start_ns: int
) -> dict[str, Consistency]:
    """NEES of position, velocity and heading from a stamp on, as the filter is used.

    With its gates and weights, and fixes as late as they came; empty without a truth.

    Parameters
    ----------
    run : Recording
    parameters, at : sequence of Parameter, (k,) array
        Noise, as logarithms of factors on what is stated.
    start_ns : int
    """
    if run.truth is None:
        return {}
    params, inputs = noisier(run.stated, run.inputs, parameters, at)
    rows = EstimateRows(run.stated)
    result = engine_run.run(params, inputs, sink=rows.append, imu_lever_b=run.imu_lever_b)
    estimates = rows.series(run.vehicle)
    end_ns = int(run.inputs.imu_stamps_ns[-1])
    part = Window('held out', start_ns, max(start_ns, end_ns))
    receipts = receipts_of(result.receipts)
    try:
        found = score(run.vehicle, run.truth, estimates, receipts, phases=(part,))
    except ScoringError:
        return {}
    window = found.windows[part.name]
    return {
        'position': window.nees_position,
        'velocity': window.nees_velocity,
        'heading': window.nees_heading,
    }
