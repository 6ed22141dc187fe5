"""Stretch of a filter's linear steps and updates, copied from its rings."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from math import prod
from typing import Any, NamedTuple

import numpy as np

from ...arrays import Array, Ints
from ...error_model import X
from ...errors import PolarNavError
from ...kernels.sins import state as fs
from ...kernels.sins import stretch as kernels
from ...kernels.sins.adjoint import PHI
from ...kernels.sins.consider import COLUMNS
from ...kernels.sins.model import MOVING, E
from ...kernels.sins.update import N
from ...spilled import Spool
from .filter import NavigationFilter
from .log import P_PLACE, SENSITIVITY_PLACE


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
    H, K : (rows, n) arrays
        Rows of all updates, and their transposed gains.
    L, z, moved, sizes, dof : (updates, ...) arrays
        Factor of S, innovation, its change per unit of each common error (without rows until one
        is considered), number of rows, degrees of freedom.
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
    dof: Ints
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

    def copy(self) -> Stretch:
        """The same in arrays of its own."""
        return Stretch(**{name: getattr(self, name).copy() for name in _COLUMNS})


_COLUMNS = tuple(x.name for x in fields(Stretch))
_WHOLE = ('kinds', 'indices', 'sizes', 'dof', 'ranks', 'samples', 'stamps_ns', 'places', 'steps')
"""Columns of integers; all others are floats, of the same eight bytes."""


class Form(NamedTuple):
    """Numbers that the shapes of a stretch follow from."""

    steps: int
    updates: int
    rows: int
    states: int
    considers: bool
    model: bool

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the columns, in their order."""
        steps, updates, rows, states, considers, model = self
        n = N + E if model else N
        return {
            'kinds': (steps + updates,),
            'indices': (steps + updates,),
            'phi': (steps, PHI),
            'model': (steps * model, MOVING, N + E),
            'H': (rows, n),
            'K': (rows, n),
            'L': (updates, 3, 3),
            'z': (updates, 3),
            'moved': (updates * considers, 3, COLUMNS),
            'sizes': (updates,),
            'dof': (updates,),
            'ranks': (updates,),
            'samples': (updates,),
            'stamps_ns': (states,),
            'places': (states,),
            'steps': (states,),
            'navigation': (states, fs.NAVIGATION),
            'block': (states, 2 * E * model),
            'P': (states, n, n),
            'sensitivity': (states * considers, n, COLUMNS),
            'deviations': (states, n),
        }

    @property
    def size(self) -> int:
        """Number of values."""
        return _layout(self)[-1].end


class _Column(NamedTuple):
    """Place of a column among the values of a stretch."""

    name: str
    begin: int
    end: int
    shape: tuple[int, ...]


@lru_cache(maxsize=256)
def _layout(form: Form) -> tuple[_Column, ...]:
    """Columns of a form, one behind the other: asked for some times in each pass."""
    found: list[_Column] = []
    begin = 0
    for name, shape in form.shapes.items():
        found.append(_Column(name, begin, begin + prod(shape), shape))
        begin = found[-1].end
    return tuple(found)


def stretch_in(room: Array, form: Form) -> Stretch:
    """Stretch of a form whose columns stand one behind the other in ``room``, with its values."""
    columns: dict[str, Any] = {}
    for name, begin, end, shape in _layout(form):
        values = room[begin:end]
        columns[name] = (values.view(np.int64) if name in _WHOLE else values).reshape(shape)
    return Stretch(**columns)


def position_variance(P: Array) -> float:
    """Trace of the position's covariance [m^2] in the last of some covariances; 0 of none."""
    return float(np.trace(P[-1, X.dr_e, X.dr_e])) if len(P) else 0.0


def write_stretch(
    f: NavigationFilter, taken: int, states: int, spool: Spool
) -> tuple[Form, Array, Stretch]:
    """Form, values in the room of a spool, and stretch of what a filter has logged.

    Since so many entries, and so many states.

    Raises
    ------
    PolarNavError
        When its rings went round in between.
    """
    log, past = f.log, f.past
    count, snapshots = int(log.counts[0]), int(log.counts[1])
    counts = np.zeros(3, dtype=np.int64)
    if count - taken <= len(log.kinds):
        kernels.count_entries(log, taken, count, counts)
    if count - taken > len(log.kinds) or counts[1] > len(log.H):
        raise PolarNavError('the log of the filter went round before it was copied')
    if snapshots - states > len(log.snapshot_flat):
        raise PolarNavError('the states of the filter went round before they were copied')
    rows = np.arange(states, snapshots) % len(log.snapshot_flat)
    n_steps, n_updates, n_rows = counts.tolist()
    model = len(log.model_steps) > 0
    form = Form(n_steps, n_updates, n_rows, len(rows), f.considers, model)
    values = spool.room(form.size)
    out = stretch_in(values, form)
    steps, updates = (np.empty(n, dtype=np.int64) for n in (form.steps, form.updates))
    of_updates = out.sizes, out.dof, out.ranks, out.samples
    kernels.pack_order(log, taken, out.kinds, out.indices, *of_updates, steps, updates)
    of_states = out.stamps_ns, out.steps, out.navigation, out.P, out.sensitivity, out.deviations
    kernels.pack_states(log, rows, (P_PLACE, SENSITIVITY_PLACE), *of_states)
    kernels.place_states(out.kinds, out.ranks, steps, out.steps, out.places)
    steps %= len(past.transitions)
    updates %= len(log.H)
    kernels.pack_steps(past.transitions, steps, out.phi)
    kernels.pack_updates(log, updates, out.sizes, out.H, out.K, out.L, out.z, out.moved)
    if form.model:
        out.model[:] = log.model_steps[steps]
        of_model = log.model_rows[updates].transpose(1, 0, 2, 3)
        out.H[:, N:], out.K[:, N:] = of_model[:, np.arange(3) < out.sizes[:, None]]
        _write_blocks(log.snapshot_flat[rows], out)
    return form, values, out


def _write_blocks(flat: Array, out: Stretch) -> None:
    """Write what snapshots have of a vehicle's model."""
    blocks = flat[:, fs.FLAT :].reshape(len(flat), fs.MODEL_ROWS, E)
    out.P[:, :N, N:] = blocks[:, fs.P_XE : fs.P_EE]
    out.P[:, N:, :N] = out.P[:, :N, N:].transpose(0, 2, 1)
    out.P[:, N:, N:] = blocks[:, fs.P_EE : fs.MEAN]
    out.block[:] = blocks[:, fs.MEAN :].reshape(len(flat), 2 * E)
    out.sensitivity[:, N:] = 0.0
