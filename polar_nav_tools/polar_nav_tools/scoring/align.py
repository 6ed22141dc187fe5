"""Truth at the stamps of the estimates, by time of validity and never by index.

Equal stamps need no assumption and come first. Where a bag's truth is not at the estimates' stamps
(another recorder, another clock grid), truth is interpolated between its neighbours: position by
the cubic Hermite curve through both positions and velocities, velocity linearly, attitude along
the shortest rotation. An estimate outside the truth's span, or inside a gap of it, is not scored,
and is counted.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import spilled
from polar_nav_core.attitude import exp, log
from polar_nav_core.errors import PolarNavError
from polar_nav_core.grid import ecef_to_grid

from ..series.vehicle import EstimateSeries, Series, TruthSeries
from .json_values import record

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

Mode = Literal['auto', 'exact', 'interpolate']


class ScoringError(PolarNavError):
    """A truth and an estimate that cannot be compared, with the reason."""


@dataclass(frozen=True, eq=False)
class TruthAt:
    """Truth at `stamp_ns`, axes as in TruthSeries."""

    stamp_ns: Ints  # shape (n,)
    r_e: Floats  # shape (n, 3) [m]
    v_G: Floats  # shape (n, 3) [m/s]
    C_b_G: Floats  # shape (n, 3, 3)


@dataclass(frozen=True, eq=False)
class EstimateAt(Series):
    """Compared columns of the estimates at `stamp_ns`, axes as in EstimateSeries."""

    stamp_ns: Ints  # shape (n,)
    r_e: Floats  # shape (n, 3) [m]
    v_G: Floats  # shape (n, 3) [m/s]
    C_b_G: Floats  # shape (n, 3, 3)
    true_heading: Floats  # shape (n,) [rad]
    true_heading_sigma: Floats  # shape (n,) [rad]
    P_position_G: Floats  # shape (n, 3, 3) [m^2]
    P_velocity_G: Floats  # shape (n, 3, 3) [(m/s)^2]
    P_attitude_G: Floats  # shape (n, 3, 3) [rad^2]

    @classmethod
    def of(cls, estimate: EstimateSeries, rows: NDArray[np.intp]) -> Self:
        """The given rows of `estimate`."""
        return cls(
            **{f.name: spilled.chosen(getattr(estimate, f.name), rows) for f in fields(cls)}
        )


@dataclass(frozen=True)
class AlignmentCounts:
    """Numbers of paired and dropped estimates; the last six add up to `estimates`."""

    truth: int
    estimates: int
    exact: int  # scored against a truth sample of the same stamp
    interpolated: int  # scored against interpolated truth
    skipped: int  # left out because enough others have a truth sample of the same stamp
    outside: int  # before the first or after the last truth sample
    in_gap: int  # between truth samples further apart than `max_gap_s`
    repeated: int  # another estimate of the same stamp came later

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return record(asdict(self))


@dataclass(frozen=True, eq=False)
class Alignment:
    """Pairs of truth and estimate, in order of stamps."""

    truth: TruthAt
    estimate: EstimateAt
    counts: AlignmentCounts


def align(
    truth: TruthSeries,
    estimate: EstimateSeries,
    *,
    mode: Mode = 'auto',
    max_gap_s: float = 1.5,
) -> Alignment:
    """Pairs of each estimate with the truth at its stamp.

    Parameters
    ----------
    truth, estimate : TruthSeries, EstimateSeries
        In any order; both are sorted by stamp here.
    mode : {'auto', 'exact', 'interpolate'}
        `exact` scores equal stamps only; `interpolate` fills in the others; `auto` is `exact` when
        equal stamps cover at least half of the sparser series (truth at 1 Hz and estimates at 10
        Hz on one clock grid are then compared at 1 Hz, where nothing is assumed), else
        `interpolate`.
    max_gap_s : float
        Truth samples further apart are not interpolated between [s].

    Raises
    ------
    ScoringError
        When a series is empty, truth contradicts itself, or no estimate can be scored.
    """
    if mode not in ('auto', 'exact', 'interpolate'):
        raise ValueError(f'mode={mode!r} must be auto, exact or interpolate')
    if not max_gap_s > 0.0:
        raise ValueError(f'max_gap_s={max_gap_s} must be > 0')
    what = f'vehicle {truth.vehicle!r}'
    if len(truth) == 0 or len(estimate) == 0:
        empty = 'truth' if len(truth) == 0 else 'estimates'
        raise ScoringError(f'{what}: no {empty} to score')
    truth = _sorted_truth(truth, what)
    estimate, repeated = _last_of_each_stamp(estimate)

    last = len(truth) - 1

    def is_exact(stamp_ns: Ints, place: NDArray[np.intp]) -> NDArray[np.bool_]:
        return np.asarray(truth.stamp_ns[np.minimum(place, last)] == stamp_ns)

    def gaps_ns(place: NDArray[np.intp]) -> Ints:
        left, right = _neighbours(place, last)
        return np.asarray(truth.stamp_ns[right] - truth.stamp_ns[left])

    by_rows = spilled.by_rows
    place = by_rows(lambda ns: np.asarray(np.searchsorted(truth.stamp_ns, ns)), estimate.stamp_ns)
    exact = by_rows(is_exact, estimate.stamp_ns, place)
    outside = ~exact & ((place == 0) | (place > last))
    between = ~exact & ~outside
    in_gap = between & (by_rows(gaps_ns, place) > max_gap_s * 1e9)
    between &= ~in_gap
    if mode == 'auto':
        inside = (truth.stamp_ns >= estimate.stamp_ns[0]) & (
            truth.stamp_ns <= estimate.stamp_ns[-1]
        )
        sparser = min(int(inside.sum()), int((exact | between).sum()))
        mode = 'exact' if 2 * int(exact.sum()) >= max(sparser, 1) else 'interpolate'
    skipped = between & (mode == 'exact')
    between &= ~skipped

    keep = exact | between
    if not keep.any():
        raise ScoringError(
            f'{what}: none of {len(estimate)} estimates can be scored: {int(outside.sum())} '
            f'outside the {len(truth)} truth samples in time, {int(in_gap.sum())} in gaps over '
            f'{max_gap_s:g} s, {int(skipped.sum())} without a truth sample of the same stamp'
        )
    rows = np.flatnonzero(keep)
    # Copies of the exact ones, so that nothing is rounded where nothing is interpolated.
    at = np.minimum(place[rows], last)
    r_e, v_G, C_b_G = (spilled.chosen(c, at) for c in (truth.r_e, truth.v_G, truth.C_b_G))
    for part in spilled.parts(len(rows)):
        some = rows[part]
        blend = part.start + np.flatnonzero(between[some])
        if blend.size:
            i, j = _neighbours(place[rows[blend]], last)
            stamps_ns = estimate.stamp_ns[rows[blend]]
            r_e[blend], v_G[blend], C_b_G[blend] = _interpolated(truth, i, j, stamps_ns)
    counts = AlignmentCounts(
        truth=len(truth),
        estimates=len(estimate) + repeated,
        exact=int(exact.sum()),
        interpolated=int(between.sum()),
        skipped=int(skipped.sum()),
        outside=int(outside.sum()),
        in_gap=int(in_gap.sum()),
        repeated=repeated,
    )
    return Alignment(
        TruthAt(estimate.stamp_ns[rows], r_e, v_G, C_b_G), EstimateAt.of(estimate, rows), counts
    )


def _neighbours(place: NDArray[np.intp], last: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows of the truth before and after the places of stamps in it."""
    return np.maximum(place - 1, 0), np.minimum(place, last)


def _interpolated(
    truth: TruthSeries, i: NDArray[np.intp], j: NDArray[np.intp], stamp_ns: Ints
) -> tuple[Floats, Floats, Floats]:
    """Position, velocity and attitude at `stamp_ns`, between truth rows `i` and `j`."""
    h = (truth.stamp_ns[j] - truth.stamp_ns[i])[:, None] * 1e-9
    s = (stamp_ns - truth.stamp_ns[i])[:, None] * 1e-9 / h
    # dr_e/dt = C_G_e v_G.
    dot_i = np.einsum('nji,nj->ni', ecef_to_grid(truth.r_e[i]), truth.v_G[i])
    dot_j = np.einsum('nji,nj->ni', ecef_to_grid(truth.r_e[j]), truth.v_G[j])
    step = truth.r_e[j] - truth.r_e[i]
    r_e = truth.r_e[i] + (
        s * s * (3 - 2 * s) * step + s * (1 - s) * h * ((1 - s) * dot_i - s * dot_j)
    )
    v_G = (1 - s) * truth.v_G[i] + s * truth.v_G[j]
    C_i = truth.C_b_G[i]
    C_b_G = C_i @ exp(s * log(np.swapaxes(C_i, 1, 2) @ truth.C_b_G[j]))
    return r_e, v_G, C_b_G


def _sorted_truth(truth: TruthSeries, what: str) -> TruthSeries:
    """Truth by stamp, once per stamp; two different truths of one stamp are an error."""
    ordered = truth.in_order()
    stamp_ns = ordered.stamp_ns
    same = np.flatnonzero(stamp_ns[1:] == stamp_ns[:-1])
    if same.size == 0:
        return ordered
    differ = same[(ordered.r_e[same] != ordered.r_e[same + 1]).any(1)]
    if differ.size:
        stamp = int(ordered.stamp_ns[differ[0]])
        raise ScoringError(
            f'{what}: truth has two different positions at stamp {stamp} ns '
            f'({differ.size} such stamps); is this one run?'
        )
    first = np.r_[True, stamp_ns[1:] > stamp_ns[:-1]]
    return ordered.rows(first)


def _last_of_each_stamp(estimate: EstimateSeries) -> tuple[EstimateSeries, int]:
    """Estimates by stamp, the last published of each stamp; and the number of dropped ones."""
    ordered = estimate.in_order()
    last = np.r_[np.diff(ordered.stamp_ns) > 0, True]
    repeated = int((~last).sum())
    return (ordered.rows(last) if repeated else ordered), repeated
