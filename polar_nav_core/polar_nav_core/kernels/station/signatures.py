"""Evidence of slow faults: their signatures in state and fixes.

As `kernels.sins.hypotheses`: a hypothesis is a fault of unit size that began at a given time, of
one of these kinds:

- the current grows (1 m/s^2), or has begun (1 m/s), along x or y;
- the AHRS deviates by the sine or cosine of its heading (1 rad);
- ln of the drag has changed by 1: so has thrust against what is stated;
- the heading of the AHRS drifts (1 rad/s);
- ranges drift (1 m/s), or bearings (1 rad/s).

Its signature u, estimated less true state per unit of it, obeys the equation of a common error:
u <- F u and what the fault does meanwhile, u <- u + K g, and the innovation of a fix changes by
g = -H u, and by what the fault does to the fix itself. With the fix's innovation z and its
covariance S,

    Lambda = sum g^T S^-1 g,    zeta = sum g^T S^-1 z,    T = zeta^2 / Lambda,

of a pair both together, is chi-square (1 or 2) while innovations are white, whatever the
signature. Members of the bank differ in how fast the current walks, so each has signatures of its
own, once a second, and a likelihood L of its innovations since the hypothesis began, when its
weight was w. A fault leaves the current as it was; without one, it may walk otherwise from then
on. So the statistic of the bank is

    T = 2 ln (sum w L exp(T / 2) / sum L)    over its members,

or that of its mixture, which has signatures as well, if that is more: it goes by the heaviest
member's slopes and the mean gain, and follows a current that changes as the mixture does.

Nothing of it is read by the filter. Derivation: docs/derivations/signatures.md.
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
KEPT = 14.0
"""Statistic, half a WARN, from which on the likeliest beginning does not make room."""
JUDGED_NS = 30_000_000_000
"""Younger ones have no statistic."""
LEAST_WEIGHT = 1e-300
"""Of a member, for its logarithm."""


@kernel
def clear_signatures(b: Bank) -> None:
    """Begin anew: no hypothesis, no evidence."""
    for m in range(b.signatures.shape[0]):
        for i in range(b.signatures.shape[1]):
            for j in range(b.signatures.shape[2]):
                b.signatures[m, i, j] = 0.0
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
    h = since_ns * 1e-9
    level = math.hypot(w.C_A[0, 0], w.C_A[1, 0])
    s_psi = w.C_A[1, 0] / level if level > 0.0 else 0.0
    c_psi = w.C_A[0, 0] / level if level > 0.0 else 0.0
    members, best = b.x.shape[0], 0
    for m in range(1, members):
        if b.weight[m] > b.weight[best]:
            best = m
    for m in range(members + 1):
        f_drag, f_share, g_x, g_y = slopes(at[m if m < members else best], c, w)
        u = b.signatures[m]
        transform(u, h, f_drag, f_share, g_x, g_y, w)
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
    """Add a decided fix to the evidence, and what gains make of the signatures.

    ``w`` holds its rows and gains before the update. While the model is loose there is none.
    """
    if c.doubt <= 0.0 or outcome[ss.DECIDED] != ss.FUSED:
        return
    if b.loose[ss.EXTRA] > 0.0:
        clear_signatures(b)
        return
    if stamp >= b.counters[ss.BIRTH_NS]:
        _begin(b, stamp)
    members = b.x.shape[0]
    for m in range(members):
        _change(b, w, m, stamp)
        _gather(b.signatures[m], w.change, w.z[m], w.wide[m], max(w.inflation[m], 1.0))
        _judge(b, b.signatures[m], stamp)
        _answer(b.signatures[m], w, m, 1.0)
    mixture = b.signatures[members]
    z, S = outcome[ss.Z0 : ss.Z0 + 2], outcome[ss.S00 : ss.S00 + 3]
    _change(b, w, members, stamp)
    _gather(mixture, w.change, z, S, max(outcome[ss.INFLATION], 1.0))
    _judge(b, mixture, stamp)
    for m in range(members):
        _answer(mixture, w, m, b.weight[m])
    _weigh(b)


@kernel
def _begin(b: Bank, stamp: int) -> None:
    """Begin hypotheses of all kinds in one slot."""
    born_ns = b.counters[ss.BORN_NS : ss.BORN_NS + ss.SLOTS]
    statistic = b.signatures[b.weight.shape[0], ss.STATISTIC]
    slot = slot_to_begin(born_ns, stamp, OLDEST_NS, statistic, KEPT)
    first = ss.KINDS * slot
    for m in range(b.signatures.shape[0]):
        u = b.signatures[m]
        for k in range(ss.KINDS):
            for i in range(u.shape[0]):
                u[i, first + k] = 0.0
            if m < b.weight.shape[0]:
                u[ss.PRIOR, first + k] = math.log(max(b.weight[m], LEAST_WEIGHT))
        for k in range(2):
            u[ss.CURRENT + k, first + ss.BEGINS + k] = -1.0
        u[ss.DRAG, first + ss.DRAGS] = -1.0
    born_ns[slot] = stamp
    b.counters[ss.BIRTH_NS] = stamp + BIRTH_NS


@kernel
def _change(b: Bank, w: Work, m: int, stamp: int) -> None:
    """Fill w.change (2, KINDS SLOTS): g of a fix, by the hypotheses of table m."""
    u, g = b.signatures[m], w.change
    for j in range(u.shape[1]):
        for a in range(2):
            g[a, j] = 0.0
            for k in range(ss.N):
                g[a, j] -= w.H[a, k] * u[k, j]
    for slot in range(ss.SLOTS):
        born_ns = b.counters[ss.BORN_NS + slot]
        if born_ns > 0:
            age_s = max(stamp - born_ns, 0) * 1e-9
            g[0, ss.KINDS * slot + ss.RANGES] += age_s
            g[1, ss.KINDS * slot + ss.BEARINGS] += age_s


@kernel
def _gather(u: Array, g: Array, z: Array, S: Array, inflation: float) -> None:
    """Add an innovation z (2,) with covariance (S00, S01, S11) to the evidence of a table u."""
    s00, s01, s11 = S[0], S[1], S[2]
    det = s00 * s11 - s01 * s01
    if not det > 0.0:
        return
    det *= inflation
    x0 = (s11 * z[0] - s01 * z[1]) / det
    x1 = (s00 * z[1] - s01 * z[0]) / det
    likelihood = -0.5 * (z[0] * x0 + z[1] * x1 + math.log(inflation * det))
    for k in range(u.shape[1]):
        square = s11 * g[0, k] * g[0, k] - 2.0 * s01 * g[0, k] * g[1, k]
        u[ss.LAMBDA, k] += (square + s00 * g[1, k] * g[1, k]) / det
        u[ss.ZETA, k] += g[0, k] * x0 + g[1, k] * x1
        u[ss.LIKELIHOOD, k] += likelihood
    for slot in range(ss.SLOTS):
        for i in range(ss.KINDS * slot, ss.KINDS * slot + ss.DRAGS, 2):
            j = i + 1
            both = s11 * g[0, i] * g[0, j] - s01 * (g[0, i] * g[1, j] + g[1, i] * g[0, j])
            u[ss.CROSS, i] += (both + s00 * g[1, i] * g[1, j]) / det


@kernel
def _judge(b: Bank, u: Array, stamp: int) -> None:
    """Fill the own statistics of a table u; 0 for a hypothesis that is too young."""
    for slot in range(ss.SLOTS):
        first = ss.KINDS * slot
        judged = stamp - b.counters[ss.BORN_NS + slot] >= JUDGED_NS
        for i in range(first, first + ss.DRAGS, 2):
            j = i + 1
            statistic = 0.0
            if judged:
                statistic = pair_statistic(
                    u[ss.LAMBDA, i], u[ss.LAMBDA, j], u[ss.CROSS, i], u[ss.ZETA, i], u[ss.ZETA, j]
                )
            u[ss.OWN, i] = statistic
            u[ss.OWN, j] = statistic
        for k in range(first + ss.DRAGS, first + ss.KINDS):
            known = judged and u[ss.LAMBDA, k] > 0.0
            u[ss.OWN, k] = u[ss.ZETA, k] ** 2 / u[ss.LAMBDA, k] if known else 0.0


@kernel
def _answer(u: Array, w: Work, m: int, weight: float) -> None:
    """Add K g to the signatures u with the gain of member m, times a weight."""
    S = w.S[m]
    x = weight / (w.inflation[m] * (S[0] * S[2] - S[1] * S[1]))
    for i in range(ss.N):
        h0, h1 = w.PHt[m, 0, i], w.PHt[m, 1, i]
        k0 = x * (S[2] * h0 - S[1] * h1)
        k1 = x * (S[0] * h1 - S[1] * h0)
        for j in range(u.shape[1]):
            u[i, j] += k0 * w.change[0, j] + k1 * w.change[1, j]


@kernel
def _weigh(b: Bank) -> None:
    """Fill the statistic of the bank from those of its members and its mixture."""
    u, members = b.signatures, b.weight.shape[0]
    for k in range(u.shape[2]):
        most, most_fault = -math.inf, -math.inf
        for m in range(members):
            most = max(most, u[m, ss.LIKELIHOOD, k])
            most_fault = max(most_fault, _with_fault(u, m, k))
        none, fault = 0.0, 0.0
        for m in range(members):
            none += math.exp(u[m, ss.LIKELIHOOD, k] - most)
            fault += math.exp(_with_fault(u, m, k) - most_fault)
        statistic = 2.0 * (most_fault - most + math.log(fault / none))
        u[members, ss.STATISTIC, k] = max(statistic, u[members, ss.OWN, k])


@kernel
def _with_fault(u: Array, m: int, k: int) -> float:
    """Logarithm of the likelihood of a fault of the size that fits member m best, of column k."""
    value: float = u[m, ss.PRIOR, k] + u[m, ss.LIKELIHOOD, k] + 0.5 * u[m, ss.OWN, k]
    return value
