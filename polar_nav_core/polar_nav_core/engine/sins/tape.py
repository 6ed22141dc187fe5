"""Record of a filter's linear steps and updates, in the order in which they were made.

A smoother reads it backwards. Rings of the filter hold two minutes; `Tape.take` copies what is new
in them to a temporary file, so that a day needs no more memory than a minute.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from ...arrays import Array, Ints
from ...errors import PolarNavError
from ...kernels.sins import state as fs
from ...kernels.sins.consider import COLUMNS
from ...kernels.sins.smooth import PHI
from ...kernels.sins.update import COUPLED, NAV, N
from ..events import InitialState
from ..params import EngineParams
from .filter import NavigationFilter
from .fusion import Ignore


@dataclass(frozen=True)
class Stretch:
    """Entries of a stretch of a run, and states between them.

    Attributes
    ----------
    kinds, indices : (n,) arrays
        STEP or UPDATE, and the row of its numbers below.
    phi : (steps, PHI) array
        Transitions.
    H, K, L, z, moved, sizes : (updates, ...) arrays
        Rows, transposed gain, factor of S, innovation, its change per unit of each common error,
        number of rows.
    stamps_ns, places : (k,) arrays
        Of the states; number of entries before each.
    navigation : (k, 30) array
        Leading values of the state: C_b_G, v_G, r_e, sensor errors.
    P, sensitivity : (k, 24, 24), (k, 24, COLUMNS) arrays
        Covariance without common errors, and what one unit of each does to the error.
    """

    kinds: Ints
    indices: Ints
    phi: Array
    H: Array
    K: Array
    L: Array
    z: Array
    moved: Array
    sizes: Ints
    stamps_ns: Ints
    places: Ints
    navigation: Array
    P: Array
    sensitivity: Array


class Recorded(Ignore):
    """Filter that logs its steps and updates; its fixes come when they are valid.

    Parameters
    ----------
    params, initial, stamp_ns : as of `Fusion`
    every : int
        Covariance steps from one stored state to the next.
    """

    def __init__(
        self, params: EngineParams, initial: InitialState, stamp_ns: int, every: int
    ) -> None:
        self._every = every
        super().__init__(params, initial, stamp_ns)

    def make_filter(
        self, params: EngineParams, initial: InitialState, stamp_ns: int
    ) -> NavigationFilter:
        """Filter with a log and states at every so many steps."""
        return NavigationFilter(params, initial, stamp_ns, steps=True, states_every=self._every)


class Tape:
    """Tape of one run.

    Parameters
    ----------
    every : int
        Covariance steps from one stored state to the next.

    Attributes
    ----------
    parts : list of int
        Stretches before each filter that was recorded: one, and one more for each that was lost.
    common : (COLUMNS,) array
        1-sigma of the common errors of the newest filter.
    hidden : bool
        Whether its last three states are not published: errors of a leader or of headings.
    """

    def __init__(self, every: int) -> None:
        self._every = every
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the tape
        self._offsets: list[int] = []
        self._filter: NavigationFilter | None = None
        self._taken = 0
        self._states = 0
        self.parts: list[int] = []
        self.common = np.zeros(COLUMNS)
        self.hidden = False

    def make(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> Recorded:
        """Fusion of an engine whose filter is recorded; the first, or after one that was lost."""
        self.take()
        fusion = Recorded(params, initial, stamp_ns, self._every)
        self._filter = fusion.filter
        self._taken = 1  # the first entry is the start
        self._states = int(fusion.filter.log.counts[1])
        self.parts.append(len(self._offsets))
        settings = fusion.filter.settings
        self.common = np.asarray(settings.common, dtype=np.float64).copy()
        self.hidden = settings.shares_leader or settings.heading.on
        return fusion

    def take(self) -> None:
        """Copy what was logged since the last call.

        Raises
        ------
        PolarNavError
            When the rings went round in between.
        """
        f = self._filter
        if f is None or int(f.log.counts[0]) == self._taken:
            return
        stretch = self._stretch(f)
        self._offsets.append(self._file.seek(0, 2))
        for field in fields(stretch):
            np.save(self._file, getattr(stretch, field.name))

    def _stretch(self, f: NavigationFilter) -> Stretch:
        log, past = f.log, f.past
        count, snapshots = int(log.counts[0]), int(log.counts[1])
        order = np.arange(self._taken, count) % len(log.kinds)
        if count - self._taken > len(log.kinds):
            raise PolarNavError('the log of the filter went round before it was copied')
        kinds, numbers = log.kinds[order], log.numbers[order]
        step, update = kinds == fs.STEP, kinds == fs.UPDATE
        steps = numbers[step] % len(past.transitions)
        updates = numbers[update] % len(log.H)
        Phi = past.transitions[steps]
        phi = np.empty((len(steps), PHI))
        phi[:, : NAV * COUPLED] = Phi[:, :NAV, :COUPLED].reshape(len(steps), -1)
        phi[:, NAV * COUPLED :] = np.einsum('nii->ni', Phi)[:, NAV:]
        indices = np.empty(len(kinds), dtype=np.int64)
        indices[step] = np.arange(len(steps))
        indices[update] = np.arange(len(updates))
        rows = np.arange(self._states, snapshots) % len(log.snapshot_flat)
        if snapshots - self._states > len(log.snapshot_flat):
            raise PolarNavError('the states of the filter went round before they were copied')
        flat, counters = log.snapshot_flat[rows], log.snapshot_counters[rows]
        after = np.flatnonzero(step)  # a state stands behind the entry of its step
        places = after[np.searchsorted(numbers[step], counters[:, fs.STEPS])] + 1
        P, sensitivity = np.empty((len(rows), N, N)), np.empty((len(rows), N, COLUMNS))
        state = fs.make_state()
        for k, row in enumerate(flat):
            state.flat[:] = row[: fs.FLAT]
            P[k], sensitivity[k] = state.P, state.sensitivity
        stretch = Stretch(
            kinds=kinds,
            indices=indices,
            phi=phi,
            H=log.H[updates],
            K=log.K[updates],
            L=log.L[updates],
            z=log.z[updates],
            moved=log.moved[updates],
            sizes=log.rows[order][update],
            stamps_ns=counters[:, fs.STAMP],
            places=places,
            navigation=flat[:, : fs.NAVIGATION],
            P=P,
            sensitivity=sensitivity,
        )
        self._taken, self._states = count, snapshots
        return stretch

    def backwards(self) -> Iterator[tuple[Stretch, bool]]:
        """The stretches from the last to the first, and whether another filter ended with it."""
        ends = {first - 1 for first in self.parts} | {len(self._offsets) - 1}
        for number in range(len(self._offsets) - 1, -1, -1):
            self._file.seek(self._offsets[number])
            arrays = {field.name: np.load(self._file) for field in fields(Stretch)}
            yield Stretch(**arrays), number in ends

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
