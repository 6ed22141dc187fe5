"""Effect of a fix: the estimate at its validity, the estimates around its use, other fixes.

Positions are compared in the grid axes of the follower's estimate. The change that a fix made is
taken from the two published estimates around its use, the motion between them taken out with
their own velocities: good to a dt^2 / 2, millimetres at 10 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.link.packet import Broadcast
from polar_nav_follower.measurements.fix import position_of

from ..scoring.align import align
from ..scoring.errors import errors
from ..series.vehicle import EstimateSeries, ReceiptRecord
from .content import Content
from .records import FixRecords, Measured

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Belief:
    """Estimate published for the time of validity, and its difference to the fix.

    Vectors of shape (3,), grid axes [m]: `sigma` of the follower's own position, `difference`
    fix minus belief, `fix_sigma` of the fix; the last two are NaN where the fix was not read.
    `error` and `fix_error` are horizontal distances from the truth, NaN without truth.
    """

    stamp_ns: int
    sigma: Floats
    difference: Floats
    fix_sigma: Floats
    error: float
    fix_error: float


@dataclass(frozen=True)
class Change:
    """Change of position, velocity, sigma and error between the estimates around a fix's use.

    `shift` in grid axes [m], shape (3,); `sigma_*` and `error_*` horizontal [m]; `also` are other
    fixes that were received between the two.
    """

    before_ns: int
    after_ns: int
    shift: Floats
    velocity_shift: Floats
    sigma_before: float
    sigma_after: float
    error_before: float
    error_after: float
    also: tuple[int, ...]


@dataclass(frozen=True)
class Other:
    """Another fix under way at the same time."""

    sequence: int
    validity_ns: int
    receive_ns: int | None
    verdict: str


@dataclass(frozen=True)
class Around:
    """Series for the plots of the time around a fix: stamps [ns], sigmas and errors [m]."""

    stamp_ns: NDArray[np.int64]
    sigma: Floats
    error: Floats  # empty without truth
    received_ns: NDArray[np.int64]  # of other fixes that were used


def belief_at_validity(
    records: FixRecords, measured: Measured | None, broadcast: Content | None
) -> Belief | None:
    """Estimate published for the time of validity, compared with the fix and the truth."""
    e = records.estimates
    validity_ns = broadcast.validity_ns if broadcast is not None else None
    if validity_ns is None and measured is not None:
        validity_ns = measured.validity_ns
    if validity_ns is None:
        return None
    row = _last_before(e, validity_ns + 1)
    if row is None or not np.isfinite(e.r_e[row]).all():
        return None
    C_e_G = ecef_to_grid(e.r_e[row])
    dt = (validity_ns - int(e.stamp_ns[row])) * 1e-9
    lever_G = e.C_b_G[row] @ np.array(records.transponder_lever_b)
    base_e = e.r_e[row] + C_e_G.T @ (e.v_G[row] * dt)
    point_e = base_e + C_e_G.T @ lever_G
    difference, fix_sigma = np.full(3, np.nan), np.full(3, np.nan)
    fix_e = None
    if isinstance(broadcast, Broadcast):
        fix_e, covariance_e = position_of(broadcast)
        difference = C_e_G @ (fix_e - point_e)
        fix_sigma = np.sqrt(np.diagonal(C_e_G @ covariance_e @ C_e_G.T))
    error = fix_error = float('nan')
    true = _truth_at(records, validity_ns)
    if true is not None:
        true_e, C_b_G = true
        error = float(np.hypot(*(C_e_G @ (base_e - true_e))[:2]))
        if fix_e is not None:
            true_point = true_e + C_e_G.T @ (C_b_G @ np.array(records.transponder_lever_b))
            fix_error = float(np.hypot(*(C_e_G @ (fix_e - true_point))[:2]))
    return Belief(
        stamp_ns=int(e.stamp_ns[row]),
        sigma=np.sqrt(np.diagonal(e.P_position_G[row])),
        difference=difference,
        fix_sigma=fix_sigma,
        error=error,
        fix_error=fix_error,
    )


def _truth_at(records: FixRecords, stamp_ns: int) -> tuple[Floats, Floats] | None:
    """True position and attitude, extrapolated from the last sample; None outside of the truth."""
    t = records.truth
    if t is None:
        return None
    row = int(np.searchsorted(t.stamp_ns, stamp_ns, side='right')) - 1
    if row < 0 or stamp_ns - int(t.stamp_ns[row]) > 1_500_000_000:
        return None
    dt = (stamp_ns - int(t.stamp_ns[row])) * 1e-9
    return t.r_e[row] + ecef_to_grid(t.r_e[row]).T @ (t.v_G[row] * dt), t.C_b_G[row]


def _last_before(e: EstimateSeries, stamp_ns: int) -> int | None:
    row = int(np.searchsorted(e.stamp_ns, stamp_ns, side='left')) - 1
    return row if row >= 0 else None


def change_by(records: FixRecords, receipt: ReceiptRecord | None, sequence: int) -> Change | None:
    """Change between the estimates around a fix's use: before it, and from its stamp on."""
    if receipt is None or receipt.verdict_text != 'FUSED' or receipt.receive_ns is None:
        return None
    e, at_ns = records.estimates, receipt.stamp_ns
    before = _last_before(e, at_ns)
    if before is None or before + 1 >= len(e):
        return None
    after = before + 1
    pair = slice(before, after + 1)
    if not np.isfinite(e.r_e[pair]).all():
        return None
    stamps = e.stamp_ns[pair].tolist()
    C_e_G = ecef_to_grid(e.r_e[before])
    motion = (at_ns - stamps[0]) * e.v_G[before] + (stamps[1] - at_ns) * e.v_G[after]
    shift = C_e_G @ (e.r_e[after] - e.r_e[before]) - motion * 1e-9
    sigma = _horizontal_sigma(e.rows(pair))
    error = _error_at(records, stamps)
    also = tuple(
        h.packet.sequence
        for h in records.heard
        if h.final is not None
        and h.final.verdict_text == 'FUSED'
        and stamps[0] < h.packet.receive_ns <= stamps[1]
        and h.packet.sequence != sequence
    )
    return Change(
        before_ns=stamps[0],
        after_ns=stamps[1],
        shift=shift,
        velocity_shift=e.v_G[after] - e.v_G[before],
        sigma_before=float(sigma[0]),
        sigma_after=float(sigma[1]),
        error_before=error[0],
        error_after=error[1],
        also=also,
    )


def _horizontal_sigma(e: EstimateSeries) -> Floats:
    """2-D sigma [m]: root of the sum of both horizontal variances."""
    return np.asarray(np.sqrt(e.P_position_G[:, 0, 0] + e.P_position_G[:, 1, 1]))


def _error_at(records: FixRecords, stamps: list[int]) -> list[float]:
    out = []
    for stamp in stamps:
        true = _truth_at(records, stamp)
        row = _last_before(records.estimates, stamp + 1)
        if true is None or row is None:
            out.append(float('nan'))
            continue
        r_e = records.estimates.r_e[row]
        out.append(float(np.hypot(*(ecef_to_grid(r_e) @ (r_e - true[0]))[:2])))
    return out


def others_under_way(
    records: FixRecords, source: str, sequence: int, span: list[int]
) -> tuple[Other, ...]:
    """Other fixes that were valid, but not yet received, while this one was under way."""
    if not span:
        return ()
    low, high = min(span), max(span)
    arrived = {(h.packet.source, h.packet.sequence): h for h in reversed(records.heard)}
    known: dict[tuple[str, int], int] = {
        (p.source, p.sequence): p.broadcast.validity_ns
        for p in (*(h.packet for h in records.heard), *records.sent)
        if p.broadcast is not None
    }
    out = []
    for key, validity_ns in sorted(known.items(), key=lambda item: item[1]):
        heard = arrived.get(key)
        received = heard.packet.receive_ns if heard is not None else None
        if key == (source, sequence) or validity_ns >= high:
            continue
        if received is None or received <= low:
            continue
        verdict = heard.final.verdict_text if heard is not None and heard.final else 'no receipt'
        out.append(Other(key[1], validity_ns, received, verdict))
    return tuple(out)


def time_around(records: FixRecords, span: list[int], sequence: int) -> Around:
    """Series of sigmas and errors around the stamps `span` of a fix."""
    if span:
        width = max(span) - min(span)
        low, high = min(span) - max(width, 4 * 10**9), max(span) + max(width, 6 * 10**9)
        part = records.estimates.between(low, high)
    else:
        low, high = records.start_ns, records.end_ns
        part = records.estimates
    error = np.empty(0)
    if records.truth is not None and len(part):
        truth = records.truth.between(low - 2 * 10**9, high + 2 * 10**9)
        if len(truth):
            pairs = align(truth, part)
            found = errors(pairs)
            known = dict(zip(found.stamp_ns.tolist(), found.horizontal.tolist(), strict=True))
            error = np.array([known.get(s, np.nan) for s in part.stamp_ns.tolist()])
    used = [
        h.packet.receive_ns
        for h in records.heard
        if h.final is not None
        and h.final.verdict_text == 'FUSED'
        and low <= h.packet.receive_ns < high
        and h.packet.sequence != sequence
    ]
    sigma = _horizontal_sigma(part)
    return Around(part.stamp_ns, sigma, error, np.array(used, dtype=np.int64))
