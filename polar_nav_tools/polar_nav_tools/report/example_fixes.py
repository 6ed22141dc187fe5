"""Fixes of the example of a report: positions, decisions and packets of a made-up mission."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..series.vehicle import ReceiptRecord, TruthSeries
from .input import FixPositions, SentPackets

Floats = NDArray[np.float64]

VERDICT_NUMBERS = {'FUSED': 0, 'GATED': 1, 'DUPLICATE': 2, 'BAD_CRC': 7, 'IN_FLIGHT': 10}
START_NS = 1_600_000_000_000_000_000
RATE = 10  # [Hz]
FIX_PERIOD = 2.0  # [s]


def late_fixes(
    truth: TruthSeries, rng: np.random.Generator
) -> tuple[FixPositions, list[ReceiptRecord], SentPackets, Floats]:
    """Fixes 3 to 9 s late, some lost, damaged, repeated or wrong, and the lag of ignoring that.

    Returns
    -------
    fixes, receipts, sent
        Positions, decisions and packets.
    lag_s : ndarray, shape (N,)
        Delay by which a filter lags at each sample of the truth that fuses fixes as current [s].
    """
    end = (len(truth) - 1) / RATE
    validity = np.arange(1.0, end, FIX_PERIOD)
    n = len(validity)
    transmit = validity + 0.6 + rng.uniform(0.0, 0.4, n)
    swell = 1.5 * np.sin(2.0 * np.pi * validity / 240.0)
    receive = transmit + 4.2 + swell + rng.gamma(2.0, 0.6, n)
    row = np.round(validity * RATE).astype(int)
    r_e = truth.r_e[row] + rng.standard_normal((n, 3))
    wrong = rng.random(n) < 0.02
    r_e[wrong] += 30.0 * rng.standard_normal((int(wrong.sum()), 3))
    lost = rng.random(n) < 0.08
    damaged = ~lost & (rng.random(n) < 0.03)
    # In SI nanoseconds from here on.
    v_ns, t_ns, a_ns = (
        START_NS + np.round(x * 1e9).astype(np.int64) for x in (validity, transmit, receive)
    )
    receipts = []
    for k in np.argsort(receive):
        if lost[k]:
            continue
        verdict = 'BAD_CRC' if damaged[k] else 'GATED' if wrong[k] else 'FUSED'
        verdict = 'IN_FLIGHT' if receive[k] > end else verdict
        receipts.append(_receipt(k, verdict, v_ns[k], t_ns[k], a_ns[k], rng))
        if rng.random() < 0.02:
            receipts.append(_receipt(k, 'DUPLICATE', v_ns[k], t_ns[k], a_ns[k] + 700_000_000, rng))
    receipts.sort(key=lambda r: r.stamp_ns)
    good = ~lost & ~damaged & (receive <= end)
    fixes = FixPositions('leader', np.arange(n)[good], v_ns[good], r_e[good])
    sent = SentPackets('leader', np.arange(n), t_ns)
    # Lag of a filter that fuses late fixes as current: its gain averages delays over some
    # seconds.
    t = np.arange(len(truth)) / RATE
    lag_s = np.zeros(len(t))
    used = [
        (r.receive_ns, r.age_s) for r in receipts if r.verdict_text == 'FUSED' and r.receive_ns
    ]
    arrivals = np.array([(ns - START_NS) * 1e-9 for ns, _ in used])
    level, last = 0.0, 0
    for k, now in enumerate(t):
        upto = int(np.searchsorted(arrivals, now, side='right'))
        for _, age in used[last:upto]:
            level += 0.25 * (age - level)
        last = upto
        lag_s[k] = level
    return fixes, receipts, sent, lag_s


def _receipt(
    sequence: int,
    verdict: str,
    validity: int,
    transmit: int,
    receive: int,
    rng: np.random.Generator,
) -> ReceiptRecord:
    used = verdict in ('FUSED', 'GATED')
    variance = np.array([1.25, 1.25, 0.1])
    innovation = np.sqrt(variance) * rng.standard_normal(3) * (12.0 if verdict == 'GATED' else 1.0)
    age = (receive - validity) * 1e-9
    nan = np.full(3, np.nan)
    return ReceiptRecord(
        stamp_ns=int(receive),
        verdict=VERDICT_NUMBERS[verdict],
        verdict_text=verdict,
        reason=f'{verdict.lower()} at an age of {age:.2f} s',
        topic='/follower/acomms/rx',
        source='leader',
        sequence=int(sequence),
        revision=0,
        validity_ns=int(validity) if verdict != 'BAD_CRC' else None,
        transmit_ns=int(transmit),
        receive_ns=int(receive),
        fused_ns=int(receive) if verdict == 'FUSED' else None,
        age_s=age if verdict != 'BAD_CRC' else float('nan'),
        delay_handling='back_propagate',
        steps_rolled_back=0,
        innovation_G=innovation if used else nan,
        innovation_variance_G=variance if used else nan,
        nis=float((innovation**2 / variance).sum()) if used else float('nan'),
        degrees_of_freedom=3 if used else 0,
        gate=16.3,
    )


def as_ignored(
    receipt: ReceiptRecord, truth: TruthSeries, lag_s: Floats, rng: np.random.Generator
) -> ReceiptRecord:
    """The same fix in the run that fuses it as current: innovation off by v (lag - delay)."""
    if receipt.verdict_text != 'FUSED' or receipt.receive_ns is None:
        return dataclasses.replace(receipt, delay_handling='ignore')
    row = min(int((receipt.receive_ns - START_NS) * 1e-9 * RATE), len(lag_s) - 1)
    variance = np.array([9.0, 9.0, 0.1])
    innovation = truth.v_G[row] * (lag_s[row] - receipt.age_s) + rng.standard_normal(3)
    return dataclasses.replace(
        receipt,
        delay_handling='ignore',
        innovation_G=innovation,
        innovation_variance_G=variance,
        nis=float((innovation**2 / variance).sum()),
    )
