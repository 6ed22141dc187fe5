"""Stretch of a filter's linear steps and updates, copied from its rings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import Array, Ints
from ...errors import PolarNavError
from ...kernels.sins import rings
from ...kernels.sins import state as fs
from ...kernels.sins import stretch as kernels
from ...kernels.sins.adjoint import PHI
from ...kernels.sins.consider import COLUMNS
from ...kernels.sins.model import MOVING, E
from ...kernels.sins.update import N
from .filter import NavigationFilter


@dataclass(frozen=True)
class Stretch:
    """Entries of a stretch of a run, and states between them.

    Attributes
    ----------
    kinds, indices : (n,) arrays
        STEP, UPDATE or KEPT, and the row of its numbers below.
    phi : (steps, PHI) array
        Transitions.
    model : (steps, 3, 31) array
        Of the states of a vehicle's model; without one, no rows, and n below is 24, not 31.
    H, K, L, z, moved, sizes : (updates, ...) arrays
        Rows, transposed gain, factor of S, innovation, its change per unit of each common error
        (without rows until one is considered), number of rows.
    ranks, samples : (updates,) arrays
        Sensor as `events.Rank`, number in its stream.
    stamps_ns, places, steps : (k,) arrays
        Of the states; number of entries and of covariance steps before each.
    navigation : (k, 30) array
        Leading values of the state: C_b_G, v_G, r_e, sensor errors.
    block : (k, 14) array
        Estimates of the vehicle's model, its thrust; without one, no columns.
    P, sensitivity : (k, n, n), (k, n, COLUMNS) arrays
        Covariance without common errors, and what one unit of each does to the error; without
        rows as ``moved``.
    deviations : (k, n) array
        Estimated error of each state: zero where the filter corrects it at once.
    """

    kinds: Ints
    indices: Ints
    phi: Array
    model: Array
    H: Array
    K: Array
    L: Array
    z: Array
    moved: Array
    sizes: Ints
    ranks: Ints
    samples: Ints
    stamps_ns: Ints
    places: Ints
    steps: Ints
    navigation: Array
    block: Array
    P: Array
    sensitivity: Array
    deviations: Array


def _place(part: Array, state: fs.State) -> int:
    """Place of a part of a state in its flat array."""
    return (part.ctypes.data - state.flat.ctypes.data) // state.flat.itemsize


_STATE = fs.make_state()
_P, _SENSITIVITY = _place(_STATE.P, _STATE), _place(_STATE.sensitivity, _STATE)


def stretch_of(f: NavigationFilter, taken: int, states: int) -> Stretch:
    """What a filter has logged since so many entries and states.

    Raises
    ------
    PolarNavError
        When its rings went round in between.
    """
    log, past = f.log, f.past
    count, snapshots = int(log.counts[0]), int(log.counts[1])
    order = np.arange(taken, count) % len(log.kinds)
    kinds, numbers = log.kinds[order], log.numbers[order]
    step = kinds == rings.STEP
    update = ~step
    if count - taken > len(log.kinds) or int(update.sum()) > len(log.H):
        raise PolarNavError('the log of the filter went round before it was copied')
    if snapshots - states > len(log.snapshot_flat):
        raise PolarNavError('the states of the filter went round before they were copied')
    steps, updates = numbers[step] % len(past.transitions), numbers[update] % len(log.H)
    phi = np.empty((len(steps), PHI))
    kernels.pack_steps(past.transitions, steps, phi)
    indices = np.empty(len(kinds), dtype=np.int64)
    indices[step] = np.arange(len(steps))
    indices[update] = np.arange(len(updates))
    H, K, L = (np.empty((len(updates), 3, n)) for n in (N, N, 3))
    z, moved = np.empty((len(updates), 3)), np.empty((len(updates), 3, COLUMNS))
    moved = moved if f.considers else moved[:0]
    kernels.pack_updates(log, updates, H, K, L, z, moved)
    model = np.zeros((0, MOVING, N + E))
    if len(log.model_steps):
        of_model = log.model_rows[updates]
        H, K = (np.concatenate([x, of_model[:, k]], axis=2) for k, x in enumerate((H, K)))
        model = log.model_steps[steps]
    rows = np.arange(states, snapshots) % len(log.snapshot_flat)
    flat, counters = log.snapshot_flat[rows], log.snapshot_counters[rows]
    P, sensitivity, block = _covariances(flat)
    held = log.hindsight.deviations
    return Stretch(
        kinds=kinds,
        indices=indices,
        phi=phi,
        model=model,
        H=H,
        K=K,
        L=L,
        z=z,
        moved=moved,
        sizes=log.rows[order][update],
        ranks=log.ranks[order][update],
        samples=log.samples[order][update],
        stamps_ns=counters[:, fs.STAMP],
        places=_places(kinds, numbers, log.ranks[order], counters[:, fs.STEPS]),
        steps=counters[:, fs.STEPS],
        navigation=flat[:, : fs.NAVIGATION],
        block=block,
        P=P,
        sensitivity=sensitivity if f.considers else sensitivity[:0],
        deviations=held[rows] if len(held) else np.zeros((len(rows), P.shape[1])),
    )


def _places(kinds: Ints, numbers: Ints, ranks: Ints, steps: Ints) -> Ints:
    """Number of entries before each state: it stands behind those of its step."""
    ends = np.flatnonzero(kinds == rings.STEP) + 1
    # A vehicle's model is compared at once, as part of the step.
    after = np.minimum(ends, len(kinds) - 1)
    compared = (kinds[after] != rings.STEP) & (ranks[after] == fs.IMU_RANK) & (ends < len(kinds))
    behind = (ends + compared)[
        np.searchsorted(numbers[kinds == rings.STEP], steps).clip(max=len(ends) - 1)
    ]
    return np.where(steps > 0, behind, 0)


def _covariances(flat: Array) -> tuple[Array, Array, Array]:
    """P (k, n, n), sensitivities (k, n, COLUMNS) and the model's (k, 0 or 9) of snapshots."""
    aided = flat.shape[1] > fs.FLAT
    n = N + E if aided else N
    P, sensitivity = np.zeros((len(flat), n, n)), np.zeros((len(flat), n, COLUMNS))
    P[:, :N, :N] = flat[:, _P : _P + N * N].reshape(-1, N, N)
    sensitivity[:, :N] = flat[:, _SENSITIVITY : _SENSITIVITY + N * COLUMNS].reshape(-1, N, COLUMNS)
    if not aided:
        return P, sensitivity, np.zeros((len(flat), 0))
    blocks = flat[:, fs.FLAT :].reshape(len(flat), fs.MODEL_ROWS, E)
    P[:, :N, N:] = blocks[:, fs.P_XE : fs.P_EE]
    P[:, N:, :N] = P[:, :N, N:].transpose(0, 2, 1)
    P[:, N:, N:] = blocks[:, fs.P_EE : fs.MEAN]
    return P, sensitivity, blocks[:, fs.MEAN :].reshape(len(flat), 2 * E)
