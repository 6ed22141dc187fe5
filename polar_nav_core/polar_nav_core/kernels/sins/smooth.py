"""Late fixes on the stored linear steps: one alone as a clone, several by filtering again.

Both work on the log that `events` writes: the order of steps and updates, and their
matrices. Nothing is linearized or gated anew but the new fix.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel, routine
from . import state as fs
from .clone import clone_begin, clone_fuse, clone_measurement, clone_step, drop_information
from .fuse import adapt_noise, feed_back_and_remember, judge, passes, store_update
from .state import Frames, Log, Past, Settings, State, Work
from .update import COUPLED, NAV, Ints, N, cholesky, nis_of, predict, update

PLACED = 3
"""Kind of an entry while filtering again: a late fix at the place where it belongs."""
NEW = 4
"""The same, for the fix that is being taken: it is gated, the others were."""


@kernel
def covariance_at(P: Array, log: Log, base: int, place: int) -> None:
    """Covariance after the entries before ``place``; ``base`` is the last step among them."""
    length = log.kinds.shape[0]
    step = log.numbers[base % length] % log.step_P.shape[0]
    for i in range(N):
        for j in range(N):
            P[i, j] = log.step_P[step, i, j]
    for entry in range(base + 1, place):
        e = entry % length
        if log.kinds[e] == fs.UPDATE:
            u = log.numbers[e] % log.H.shape[0]
            drop_information(P, log.K[u], log.S[u], log.rows[e])


@routine
def refer_to_place(z: Array, H: Array, log: Log, epoch: int, place: int, oldest: int) -> None:
    """Take out of z what was fed back after the epoch was stored and before ``place``."""
    length = log.kinds.shape[0]
    entry = place - 1
    while entry >= oldest and log.epochs[entry % length] > epoch:
        e = entry % length
        if log.kinds[e] == fs.UPDATE:
            u = log.numbers[e] % log.H.shape[0]
            for a in range(3):
                s = 0.0
                for k in range(N):
                    s += H[a, k] * log.x[u, k]
                z[a] -= s
        entry -= 1


@routine
def smooth(
    past: Past,
    log: Log,
    base: int,
    place: int,
    H: Array,
    z: Array,
    C: Array,
    P_cc: Array,
    P: Array,
    work9: Array,
    work6: Array,
) -> None:
    """Carry a clone of H x from its place among the stored entries to now.

    Parameters
    ----------
    past, log : stored transitions; order and matrices of steps and updates
    base, place : int
        Entry of the last step before the clone's place; first entry after it.
    H : (3, 24) array
        Rows of the clone, position in grid axes [m].
    z : (3,) array, in place
        Innovation of the clone's measurement: against the estimate then, later that of now [m].
    C, P_cc : (24, 3), (3, 3) arrays, out
        Covariance of the present error with the clone, and the clone's own [m^2].
    P, work9, work6 : (24, 24), (9, 3), (6, 3) arrays, scratch
    """
    length = log.kinds.shape[0]
    covariance_at(P, log, base, place)
    clone_begin(C, P_cc, P, H)
    for entry in range(place, log.counts[0]):
        e = entry % length
        number = log.numbers[e]
        if log.kinds[e] == fs.STEP:
            clone_step(C, past.transitions[number % past.transitions.shape[0]], work9)
        else:
            u = number % log.H.shape[0]
            clone_measurement(
                C, P_cc, z, log.H[u], log.L[u], log.K[u], log.z[u], log.rows[e], work6
            )


@routine
def fuse_clone(
    s: State,
    fr: Frames,
    c: Settings,
    past: Past,
    w: Work,
    log: Log,
    C: Array,
    P_cc: Array,
    z: Array,
    late_z: Array,
) -> int:
    """FUSED, REFUSED or S_NOT_DEFINITE, of a clone's measurement with noise w.R and rows w.H.

    ``z`` is its innovation against the present, ``late_z`` the one at its own place, which is what
    the log keeps.
    """
    adapt_noise(s, c, w, fs.FIX_ROW, fs.VECTOR)
    if not _judge_clone(w, P_cc, z):
        return fs.S_NOT_DEFINITE
    if not passes(s, c, w, z, fs.FIX_ROW, fs.VECTOR):
        return fs.REFUSED
    clone_fuse(s.P, w.x, C, P_cc, w.R, w.L, z, w.K, w.D)
    for a in range(3):
        w.z[a] = late_z[a]
    store_update(log, s.counters[fs.CORRECTIONS], w, 3)
    feed_back_and_remember(s, fr, c, past, w.x)
    return fs.FUSED


@kernel
def _judge_clone(w: Work, P_cc: Array, z: Array) -> bool:
    """Whether S = P_cc + R is positive definite; S, its factor and NIS are in the scratch."""
    for a in range(3):
        for b in range(3):
            w.S[a, b] = P_cc[a, b] + w.R[a, b]
    if not cholesky(w.L, w.S, 3):
        return False
    w.nis[0] = nis_of(w.L, z, w.w, 3)
    return True


@routine
def filter_again(
    s: State,
    fr: Frames,
    c: Settings,
    past: Past,
    w: Work,
    log: Log,
    kinds: Ints,
    numbers: Ints,
    epochs: Ints,
    rows: Ints,
    removed_x: Array,
    first_epoch: int,
    P: Array,
    change: Array,
    work24: Array,
    outcome: Array,
) -> int:
    """What becomes of a new late fix when stored steps are filtered again with it in its place.

    The present follows.

    Parameters
    ----------
    s, fr, c, past, w, log : the filter; state, frames, past and log are changed
    kinds, numbers, epochs, rows : (n,) arrays
        The entries to repeat, PLACED and NEW fixes and what they leave (REMOVED) among them.
    removed_x : (r, 24) array
        What the removed updates had done to the estimate; a REMOVED entry's number is the row.
    first_epoch : int
        Epochs stored before the first entry's predecessor.
    P : (24, 24) array, in place
        Covariance before the first entry.
    change, work24 : (24,) arrays, scratch
        New estimate minus old, as an error state.
    outcome : (9,) array, out
        Of the new fix: fused, NIS, innovation, its variances, enlargement.

    Returns
    -------
    int
        FUSED or REFUSED for the new fix, or a code below zero.
    """
    for k in range(N):
        change[k] = 0.0
    last = first_epoch
    verdict = fs.REFUSED
    for e in range(kinds.shape[0]):
        shift_epochs(past, s, last, epochs[e], change)
        last = max(last, epochs[e])
        kind = kinds[e]
        number = numbers[e]
        if kind == fs.STEP:
            Phi = past.transitions[number % past.transitions.shape[0]]
            slot = number % log.step_P.shape[0]
            predict(P, Phi, log.step_q[slot], w.M)
            for i in range(NAV):
                total = 0.0
                for k in range(COUPLED):
                    total += Phi[i, k] * change[k]
                work24[i] = total
            for i in range(N):
                change[i] = work24[i] if i < NAV else Phi[i, i] * change[i]
                for j in range(N):
                    log.step_P[slot, i, j] = P[i, j]
        elif kind == fs.REMOVED:
            for k in range(N):
                change[k] += removed_x[number, k]
        else:
            code = _update_again(s, c, w, log, kind, number, rows[e], P, change, outcome)
            if code < 0:
                return code
            if kind == NEW:
                verdict = code
    shift_epochs(past, s, last, s.counters[fs.EPOCHS], change)
    for i in range(N):
        w.x[i] = -change[i]
        for j in range(N):
            s.P[i, j] = P[i, j]
    feed_back_and_remember(s, fr, c, past, w.x)
    return verdict


@kernel
def _update_again(
    s: State,
    c: Settings,
    w: Work,
    log: Log,
    kind: int,
    number: int,
    m: int,
    P: Array,
    change: Array,
    outcome: Array,
) -> int:
    """Repeat a stored update against the changed estimate, or take a late fix at its place."""
    u = number % log.H.shape[0]
    for a in range(3):
        total = log.z[u, a]
        for k in range(N):
            h = log.H[u, a, k]
            w.H[a, k] = h
            if h != 0.0:
                total += h * change[k]
        w.z[a] = total
        for b in range(3):
            w.R[a, b] = log.R[u, a, b]
    if kind == NEW:
        adapt_noise(s, c, w, fs.FIX_ROW, m)
    if not judge(w, P, w.H, w.R, w.z, m):
        return fs.S_NOT_DEFINITE
    if kind == NEW:
        outcome[1] = w.nis[0]
        for a in range(3):
            outcome[2 + a] = w.z[a]
            outcome[5 + a] = w.S[a, a]
        passed = passes(s, c, w, w.z, fs.FIX_ROW, m)
        outcome[0] = 1.0 if passed else 0.0
        outcome[8] = w.nis[1]
        if not passed:
            return fs.REFUSED
    update(P, w.x, w.S, w.z, m, w.K, w.PHt, w.L, w.D)
    for k in range(N):
        before = log.x[u, k] if kind == fs.UPDATE else 0.0
        change[k] += before - w.x[k]
    store_update(log, number, w, m)
    return fs.FUSED


@kernel
def shift_epochs(past: Past, s: State, first: int, until: int, change: Array) -> None:
    """Move what is stored of epochs first..until-1 by a change of the estimate.

    Grid axes are those of now: over the length of the history they hardly turn.
    """
    length = past.stamps.shape[0]
    begin = max(first, s.counters[fs.EPOCHS] - length)
    for number in range(begin, until):
        i = number % length
        l0 = past.levers[i, 0]
        l1 = past.levers[i, 1]
        l2 = past.levers[i, 2]
        # Chat lever = C lever - phi x (C lever)
        past.levers[i, 0] += l1 * change[2] - l2 * change[1]
        past.levers[i, 1] += l2 * change[0] - l0 * change[2]
        past.levers[i, 2] += l0 * change[1] - l1 * change[0]
        for k in range(3):
            past.positions[i, k] += change[6 + k]
            past.velocities[i, k] += change[3 + k]
