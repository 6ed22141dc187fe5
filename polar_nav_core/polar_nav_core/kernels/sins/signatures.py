"""Evidence about slow faults, gathered while the filter runs: a watchdog that changes nothing.

`State.bank` holds the hypotheses (`hypotheses`), `State.windows` the residuals of each stream
since its window began. Beginnings are recycled so that their ages stay about a factor of two
apart.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import kernel
from ..evidence import slot_to_begin
from . import state as fs
from .hypotheses import (
    FIRST_H,
    FIRST_J,
    FIX_EAST,
    FIX_NORTH,
    KINDS,
    MOST_AT_ONCE,
    SLOTS,
    STATISTIC,
    STEP_EAST,
    STEP_NORTH,
    add_evidence,
    advance_signatures,
    answer,
    begin_slot,
    change_of_innovation,
    change_of_residual,
    grow,
    mean_change,
    repeated,
)
from .rings import Past
from .state import State
from .update import DR, DV, MARKOV
from .work import Work

WINDOW_NS = 1_000_000_000
"""Pings and depths are added up for so long; fixes are not."""
TURN = 0.01
"""Or until the vehicle has turned by this since the first ping [rad]."""
LEAST_S = 0.1
"""A shorter time between two windows is made up for by the next."""
BIRTH_NS = 20_000_000_000
"""A new beginning every so often."""
OLDEST_NS = 2_400_000_000_000
"""An older beginning is the first to make room."""
KEPT = 10.0
"""Statistic, a third of a WARN, from which on the likeliest beginning does not make room."""
JUDGED_NS = 30_000_000_000
"""Younger ones have no statistic: an outlier would be as large."""
STEP_NS = 300_000_000_000
"""Older steps of fixes have none: the filter has followed, and they may have gone back since."""


@kernel
def note(s: State, past: Past, w: Work, stream: int, m: int, delay: float) -> None:
    """Add a residual that was used to the evidence; the update's rows and gain are in the scratch.

    ``delay`` [s] is how old the rows are, where the signatures of now stand in for those of then.
    """
    e, L, weight = w.z, w.L, 1.0
    if s.counters[fs.CONSIDERS] == 1:
        e, L, weight = w.residual, w.narrow_L, 1.0 / w.nis[1]
    for a in range(m):
        x = e[a]
        for b in range(a):
            x -= L[a, b] * w.evidence[b]
        w.evidence[a] = x / L[a, a]
    window = s.windows[stream]
    first_H = window[FIRST_H:FIRST_J].reshape(3, w.H.shape[1])
    first_J = window[FIRST_J:].reshape(3, w.per_sigma.shape[1])
    if window[3] == 0.0:
        for a in range(m):
            for k in range(first_H.shape[1]):
                first_H[a, k] = w.H[a, k]
            for k in range(first_J.shape[1]):
                first_J[a, k] = w.per_sigma[a, k]
    for a in range(m - 1, -1, -1):
        x = w.evidence[a]
        for b in range(a + 1, m):
            x -= L[b, a] * w.evidence[b]
        w.evidence[a] = x / L[a, a]
        window[a] += weight * w.evidence[a]
    window[3] += weight
    now_ns = s.counters[fs.STAMP]
    young = now_ns - s.counters[fs.CLOSED_NS + stream] < WINDOW_NS
    if stream != fs.FIX_ROW and young and not _has_turned(first_H, w.H, m):
        return
    _advance(s, past, w, now_ns)
    _begin(s, now_ns)
    g, h = w.signatures[0:3], w.signatures[3:6]
    change_of_innovation(g, s.bank, first_H, delay, m)
    if stream == fs.FIX_ROW:
        for slot in range(SLOTS):
            since = (now_ns - s.counters[fs.BORN_NS + slot]) * 1e-9 - w.age[0]
            if s.counters[fs.BORN_NS + slot] > 0 and since > 0.0:
                g[0, slot * KINDS + FIX_EAST] -= since
                g[1, slot * KINDS + FIX_NORTH] -= since
                g[0, slot * KINDS + STEP_EAST] -= 1.0
                g[1, slot * KINDS + STEP_NORTH] -= 1.0
    number = min(max(int(window[3] + 0.5), 1), MOST_AT_ONCE)
    repeated(w.powers, w.H, w.K, number, m)
    mean = w.signatures[6:9]
    mean_change(mean, w.powers, g, number, m)
    change_of_residual(h, mean, s.bank, first_J, L, m)
    for a in range(m):
        x = 0.0
        for b in range(a, m):
            x += L[b, a] * window[b]
        w.evidence[a] = x
    add_evidence(s.bank, h, w.evidence, window[3], m)
    for slot in range(SLOTS):
        age_ns = now_ns - s.counters[fs.BORN_NS + slot]
        for kind in range(KINDS):
            old = age_ns > STEP_NS and kind in (STEP_EAST, STEP_NORTH)
            if old or age_ns < JUDGED_NS:
                s.bank[STATISTIC, slot * KINDS + kind] = 0.0
    answer(s.bank, 0, w.K, w.powers, g, -1.0, m)
    if s.counters[fs.CONSIDERS] == 1:
        _gain_of_first(w, s.shared, first_J, L, m)
        repeated(w.powers, w.per_sigma, w.learned, number, m)
        answer(s.bank, fs.LEARNED, w.learned, w.powers, h, weight, m)
    for k in range(FIRST_H):
        window[k] = 0.0
    s.counters[fs.CLOSED_NS + stream] = now_ns


@kernel
def _has_turned(first_H: Array, H: Array, m: int) -> bool:
    """Whether rows of the DVL's slow error have turned since the first of a window."""
    square = 0.0
    for a in range(m):
        for k in range(MARKOV, MARKOV + 3):
            square += (H[a, k] - first_H[a, k]) * (H[a, k] - first_H[a, k])
    return square > 2.0 * TURN * TURN  # of a turn theta it is 2 theta^2


@kernel
def _gain_of_first(w: Work, shared: Array, first_J: Array, L: Array, m: int) -> None:
    """Fill per_sigma with L^-1 J, and learned with L^-1 J Pi, of the rows that h has.

    A lever arm and a latency show by rates and accelerations that swing: with a gain of other
    rows than those of h an answer would not take the change away, but add to it.
    """
    for a in range(m):
        for k in range(w.per_sigma.shape[1]):
            x = first_J[a, k]
            for b in range(a):
                x -= L[a, b] * w.per_sigma[b, k]
            w.per_sigma[a, k] = x / L[a, a]
        for k in range(w.per_sigma.shape[1]):
            x = w.per_sigma[a, k]
            for d in range(w.per_sigma.shape[1]):
                x -= w.per_sigma[a, d] * shared[1 + d, k]
            w.learned[a, k] = x


@kernel
def _advance(s: State, past: Past, w: Work, now_ns: int) -> None:
    """Bring the signatures to now, with the transition of the newest covariance step."""
    dt = (now_ns - s.counters[fs.BANK_NS]) * 1e-9
    if s.counters[fs.BANK_NS] > 0 and dt < LEAST_S:
        return
    Phi = past.transitions[s.counters[fs.STEPS] % past.transitions.shape[0]]
    square = 0.0
    for k in range(3):
        square += Phi[DR, DV + k] * Phi[DR, DV + k]
    step = math.sqrt(square)  # the position moves by the velocity times the length of the step
    if s.counters[fs.BANK_NS] > 0 and step > 0.0:
        advance_signatures(s.bank, Phi, step, dt, w.signatures)
        for slot in range(SLOTS):
            if s.counters[fs.BORN_NS + slot] > 0:
                grow(s.bank, slot, dt)
    s.counters[fs.BANK_NS] = now_ns


@kernel
def _begin(s: State, now_ns: int) -> None:
    """Begin new hypotheses where it is time to, in an empty slot or one that is hardly missed."""
    if now_ns < s.counters[fs.BIRTH_NS]:
        return
    born_ns = s.counters[fs.BORN_NS : fs.BORN_NS + SLOTS]
    chosen = slot_to_begin(born_ns, now_ns, OLDEST_NS, s.bank[STATISTIC], KEPT)
    begin_slot(s.bank, chosen)
    born_ns[chosen] = now_ns
    s.counters[fs.BIRTH_NS] = now_ns + BIRTH_NS


@kernel
def clear_evidence(s: State) -> None:
    """Begin anew: no hypothesis, no residual."""
    for i in range(s.bank.shape[0]):
        for k in range(s.bank.shape[1]):
            s.bank[i, k] = 0.0
    for i in range(s.windows.shape[0]):
        for k in range(s.windows.shape[1]):
            s.windows[i, k] = 0.0
    for slot in range(SLOTS):
        s.counters[fs.BORN_NS + slot] = 0
    s.counters[fs.BIRTH_NS] = 0
