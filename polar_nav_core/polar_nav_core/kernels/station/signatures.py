"""Evidence of slow faults: their signatures in state and fixes.

As `kernels.sins.hypotheses`: a hypothesis is a fault of unit size that began at a given time, of
one of these kinds:

- the current grows (1 m/s^2), or has begun (1 m/s), along x or y;
- the AHRS deviates by the sine or cosine of its heading (1 rad);
- ln of the drag has changed by 1: so has thrust against what is stated;
- the heading of the AHRS drifts (1 rad/s).

Its signature u, estimated less true state per unit of it, obeys the equation of a common error:
u <- F u and what the fault does meanwhile, u <- u + K g, and the innovation of a fix changes by
g = -H u. With the fix's innovation z and its covariance S,

    Lambda = sum g^T S^-1 g,    zeta = sum g^T S^-1 z,    T = zeta^2 / Lambda,

of a pair both together, is chi-square (1 or 2) while innovations are white, whatever the
signature: it goes by the heaviest member's slopes, once a second. Nothing of it is read by the
filter. Derivation: docs/derivations/signatures.md.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import kernel
from ..evidence import pair_statistic, slot_to_begin
from . import state as ss
from .common import transform
from .state import Bank, Settings, Work
from .step import slopes

STEP_NS = 1_000_000_000
"""Signatures are brought forward so often."""
LONGEST_NS = 5_000_000_000
"""A longer time without an AHRS sample begins everything anew."""
BIRTH_NS = 60_000_000_000
"""A new beginning every so often."""
OLDEST_NS = 1_200_000_000_000
"""An older beginning is the first to make room."""
JUDGED_NS = 30_000_000_000
"""Younger ones have no statistic."""


@kernel
def clear_signatures(b: Bank) -> None:
    """Begin anew: no hypothesis, no evidence."""
    for i in range(b.signatures.shape[0]):
        for j in range(b.signatures.shape[1]):
            b.signatures[i, j] = 0.0
    for slot in range(ss.SLOTS):
        b.counters[ss.BORN_NS + slot] = 0
    b.counters[ss.BIRTH_NS] = 0


@kernel
def advance_signatures(b: Bank, c: Settings, w: Work, at: Array, stamp: int) -> None:
    """Bring the signatures to an AHRS sample, with the slopes at the points ``at`` (B, 12).

    ``w`` is as `step.prepare_step` left it.
    """
    since_ns = stamp - b.counters[ss.SIGNATURES_NS]
    if c.doubt <= 0.0 or since_ns < STEP_NS:
        return
    b.counters[ss.SIGNATURES_NS] = stamp
    if since_ns > LONGEST_NS:
        clear_signatures(b)
        return
    best = 0
    for m in range(1, b.x.shape[0]):
        if b.weight[m] > b.weight[best]:
            best = m
    h = since_ns * 1e-9
    f_drag, f_share, g_x, g_y = slopes(at[best], c, w)
    transform(b.signatures, h, f_drag, f_share, g_x, g_y, w)
    level = math.hypot(w.C_A[0, 0], w.C_A[1, 0])
    s_psi = w.C_A[1, 0] / level if level > 0.0 else 0.0
    c_psi = w.C_A[0, 0] / level if level > 0.0 else 0.0
    u = b.signatures
    for slot in range(ss.SLOTS):
        if b.counters[ss.BORN_NS + slot] > 0:
            first = ss.KINDS * slot
            for k in range(2):
                u[ss.CURRENT + k, first + ss.GROWS + k] -= h
                turn = h * (s_psi if k == 0 else c_psi)
                u[ss.POSITION, first + ss.DEVIATES + k] -= turn * g_x
                u[ss.POSITION + 1, first + ss.DEVIATES + k] -= turn * g_y
            u[ss.HEADING, first + ss.TURNS] -= h


@kernel
def note_signatures(b: Bank, c: Settings, w: Work, outcome: Array, stamp: int) -> None:
    """Add a decided fix to the evidence, and what its gain makes of the signatures.

    ``w`` holds its rows and gains before the update. While the model is loose there is none.
    """
    if c.doubt <= 0.0 or outcome[ss.DECIDED] != ss.FUSED:
        return
    if b.loose[ss.EXTRA] > 0.0:
        clear_signatures(b)
        return
    if stamp >= b.counters[ss.BIRTH_NS]:
        born_ns = b.counters[ss.BORN_NS : ss.BORN_NS + ss.SLOTS]
        slot = slot_to_begin(born_ns, stamp, OLDEST_NS, b.signatures[ss.STATISTIC])
        first = ss.KINDS * slot
        for i in range(b.signatures.shape[0]):
            for k in range(ss.KINDS):
                b.signatures[i, first + k] = 0.0
        for k in range(2):
            b.signatures[ss.CURRENT + k, first + ss.BEGINS + k] = -1.0
        b.signatures[ss.DRAG, first + ss.DRAGS] = -1.0
        born_ns[slot] = stamp
        b.counters[ss.BIRTH_NS] = stamp + BIRTH_NS
    s00, s01, s11 = outcome[ss.S00], outcome[ss.S01], outcome[ss.S11]
    det = s00 * s11 - s01 * s01
    if not det > 0.0:
        return
    x0 = (s11 * outcome[ss.Z0] - s01 * outcome[ss.Z1]) / det
    x1 = (s00 * outcome[ss.Z1] - s01 * outcome[ss.Z0]) / det
    counts = 1.0 / max(outcome[ss.INFLATION], 1.0)
    u, g = b.signatures, w.change
    for j in range(u.shape[1]):
        for a in range(2):
            g[a, j] = 0.0
            for k in range(ss.N):
                g[a, j] -= w.H[a, k] * u[k, j]
    for k in range(u.shape[1]):
        square = s11 * g[0, k] * g[0, k] - 2.0 * s01 * g[0, k] * g[1, k]
        u[ss.LAMBDA, k] += counts * (square + s00 * g[1, k] * g[1, k]) / det
        u[ss.ZETA, k] += counts * (g[0, k] * x0 + g[1, k] * x1)
    for slot in range(ss.SLOTS):
        first = ss.KINDS * slot
        judged = stamp - b.counters[ss.BORN_NS + slot] >= JUDGED_NS
        for i in range(first, first + ss.DRAGS, 2):
            j = i + 1
            both = s11 * g[0, i] * g[0, j] - s01 * (g[0, i] * g[1, j] + g[1, i] * g[0, j])
            u[ss.CROSS, i] += counts * (both + s00 * g[1, i] * g[1, j]) / det
            statistic = 0.0
            if judged:
                statistic = pair_statistic(
                    u[ss.LAMBDA, i], u[ss.LAMBDA, j], u[ss.CROSS, i], u[ss.ZETA, i], u[ss.ZETA, j]
                )
            u[ss.STATISTIC, i] = statistic
            u[ss.STATISTIC, j] = statistic
        for k in range(first + ss.DRAGS, first + ss.KINDS):
            known = judged and u[ss.LAMBDA, k] > 0.0
            u[ss.STATISTIC, k] = u[ss.ZETA, k] ** 2 / u[ss.LAMBDA, k] if known else 0.0
    _answer(b, w)


@kernel
def _answer(b: Bank, w: Work) -> None:
    """Add K g to the signatures, with the mean gain of the members by their weights."""
    for i in range(ss.N):
        k0 = 0.0
        k1 = 0.0
        for m in range(b.x.shape[0]):
            S, h0, h1 = w.S[m], w.PHt[m, 0, i], w.PHt[m, 1, i]
            x = b.weight[m] / (w.inflation[m] * (S[0] * S[2] - S[1] * S[1]))
            k0 += x * (S[2] * h0 - S[1] * h1)
            k1 += x * (S[0] * h1 - S[1] * h0)
        for j in range(b.signatures.shape[1]):
            b.signatures[i, j] += k0 * w.change[0, j] + k1 * w.change[1, j]
