"""Steps, updates and states out of a filter's rings, packed for a smoother's tape."""

from __future__ import annotations

from ...arrays import Array, Ints
from ..cache import entry, routine
from .adjoint import PHI
from .consider import COLUMNS
from .rings import STEP, Log
from .state import IMU_RANK, NAVIGATION
from .state import STAMP as AT
from .state import STEPS as NUMBER
from .update import COUPLED, NAV, N


@entry
@routine
def count_entries(log: Log, first: int, end: int, counts: Ints) -> None:
    """Write the numbers of steps, of updates and of their rows among entries, into (3,)."""
    counts[0] = counts[1] = counts[2] = 0
    for e in range(first, end):
        i = e % log.kinds.shape[0]
        if log.kinds[i] == STEP:
            counts[0] += 1
        else:
            counts[1] += 1
            counts[2] += log.rows[i]


@entry
@routine
def pack_order(
    log: Log,
    first: int,
    kinds: Ints,
    indices: Ints,
    sizes: Ints,
    dof: Ints,
    ranks: Ints,
    samples: Ints,
    steps: Ints,
    updates: Ints,
) -> None:
    """Write the order of entries from a first one on, and where their numbers stand in the rings.

    Parameters
    ----------
    log : Log
    first : int
    kinds, indices : (n,) arrays, out
        Of each entry: its kind, and its number among those of its kind.
    sizes, dof, ranks, samples : (updates,) arrays, out
        Number of rows, degrees of freedom, sensor, number in its stream.
    steps, updates : (steps,), (updates,) arrays, out
        Numbers of steps and corrections.
    """
    step = update = 0
    for k in range(kinds.shape[0]):
        i = (first + k) % log.kinds.shape[0]
        kinds[k] = log.kinds[i]
        if log.kinds[i] == STEP:
            indices[k], steps[step] = step, log.numbers[i]
            step += 1
        else:
            indices[k], updates[update] = update, log.numbers[i]
            sizes[update], dof[update] = log.rows[i], log.dof[i]
            ranks[update], samples[update] = log.ranks[i], log.samples[i]
            update += 1


@entry
@routine
def place_states(kinds: Ints, ranks: Ints, steps: Ints, of_states: Ints, places: Ints) -> None:
    """Write the number of entries before each state: it stands behind those of its step.

    Parameters
    ----------
    kinds, ranks, steps : (n,), (updates,), (steps,) arrays
        As `pack_order` leaves them.
    of_states : (k,) array
        Numbers of the newest step of each state, ascending; zero before the first.
    places : (k,) array, out
    """
    end = step = update = 0
    for k in range(of_states.shape[0]):
        while end < kinds.shape[0] and (step == 0 or steps[step - 1] < of_states[k]):
            if kinds[end] == STEP:
                step += 1
            else:
                update += 1
            end += 1
        # Up to the last of the steps; what follows it belongs to no state.
        while end > 0 and kinds[end - 1] != STEP:
            end -= 1
            update -= 1
        behind = end
        # A vehicle's model is compared at once, as part of the step.
        if end < kinds.shape[0] and kinds[end] != STEP and ranks[update] == IMU_RANK:
            behind += 1
        places[k] = behind if of_states[k] > 0 else 0


@entry
@routine
def pack_steps(transitions: Array, steps: Ints, phi: Array) -> None:
    """Write the transitions of steps, places in their ring, into ``phi`` (n, PHI)."""
    for k in range(steps.shape[0]):
        Phi, out = transitions[steps[k]], phi[k]
        for i in range(NAV):
            for j in range(COUPLED):
                out[i * COUPLED + j] = Phi[i, j]
        for i in range(NAV, N):
            out[PHI - N + i] = Phi[i, i]


@entry
@routine
def pack_updates(
    log: Log,
    updates: Ints,
    sizes: Ints,
    H: Array,
    K: Array,
    L: Array,
    z: Array,
    moved: Array,
) -> None:
    """Write updates, places in their ring, into arrays (n, ...); ``moved`` may be without rows.

    Of H and K only as many rows as ``sizes`` says of each: (all rows, 24) or wider.
    """
    row = 0
    for k in range(updates.shape[0]):
        u = updates[k]
        for a in range(sizes[k]):
            for i in range(N):
                H[row, i] = log.H[u, a, i]
                K[row, i] = log.K[u, a, i]
            row += 1
        for a in range(3):
            z[k, a] = log.z[u, a]
            for b in range(3):
                L[k, a, b] = log.L[u, a, b]
            if moved.shape[0] > 0:
                for c in range(moved.shape[2]):
                    moved[k, a, c] = log.moved[u, a, c]


@entry
@routine
def pack_states(
    log: Log,
    rows: Ints,
    places: tuple[int, int],
    stamps_ns: Ints,
    steps: Ints,
    navigation: Array,
    P: Array,
    sensitivity: Array,
    deviations: Array,
) -> None:
    """Write states, places in their ring, into arrays (n, ...); of P what a filter of 24 has.

    Parameters
    ----------
    log : Log
    rows : (n,) array
    places : two of int
        Where P and the sensitivities begin in a stored state.
    stamps_ns, steps : (n,) arrays, out
    navigation, P, sensitivity, deviations : (n, ...) arrays, out
        ``sensitivity`` may be without rows.
    """
    held = log.hindsight.deviations.shape[0] > 0
    for k in range(rows.shape[0]):
        flat = log.snapshot_flat[rows[k]]
        stamps_ns[k] = log.snapshot_counters[rows[k], AT]
        steps[k] = log.snapshot_counters[rows[k], NUMBER]
        for i in range(NAVIGATION):
            navigation[k, i] = flat[i]
        for i in range(N):
            for j in range(N):
                P[k, i, j] = flat[places[0] + i * N + j]
        if sensitivity.shape[0] > 0:
            for i in range(N):
                for c in range(COLUMNS):
                    sensitivity[k, i, c] = flat[places[1] + i * COLUMNS + c]
        for i in range(deviations.shape[1]):
            deviations[k, i] = log.hindsight.deviations[rows[k], i] if held else 0.0
