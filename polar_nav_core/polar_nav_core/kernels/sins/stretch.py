"""Steps, updates and states out of a filter's rings, packed for a smoother's tape."""

from __future__ import annotations

from ...arrays import Array, Ints
from ..cache import entry, routine
from .adjoint import PHI
from .consider import COLUMNS
from .rings import Log
from .state import NAVIGATION
from .update import COUPLED, NAV, N


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
    navigation, P, sensitivity, deviations : (n, ...) arrays, out
        ``sensitivity`` may be without rows.
    """
    held = log.hindsight.deviations.shape[0] > 0
    for k in range(rows.shape[0]):
        flat = log.snapshot_flat[rows[k]]
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
