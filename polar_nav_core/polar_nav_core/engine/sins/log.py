"""Arrays for the log of linear steps (`clone`) and for snapshots (`rewind`)."""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from ...kernels.sins import state as fs
from ...kernels.sins.consider import COLUMNS
from ...kernels.sins.model import E
from ...kernels.sins.rings import Log, Past, make_hindsight
from ...kernels.sins.update import N

STEPS_PER_BLOCK = 20
"""Covariance steps in a block of `clone`; long blocks are dear to enter, short ones to pass."""


def _place(part: Array, state: fs.State) -> int:
    """Place of a part of a state in its flat array."""
    return (part.ctypes.data - state.flat.ctypes.data) // state.flat.itemsize


_STATE = fs.make_state()
P_PLACE, SENSITIVITY_PLACE = _place(_STATE.P, _STATE), _place(_STATE.sensitivity, _STATE)
_FOR_TAPE = SENSITIVITY_PLACE + _STATE.sensitivity.size
"""Values of a state that a tape copies: what stands behind them is for going on from it."""


def make_log(
    past: Past,
    *,
    steps: bool = False,
    snapshots: int = 0,
    model: bool = False,
    late: bool = True,
) -> Log:
    """Empty log as long as the history, with room for a snapshot every ``snapshots`` steps.

    Covariances after steps, and whole snapshots, are for fixes that come late, and for a vehicle's
    model.
    """
    flat = fs.FLAT + (fs.MODEL if model else 0)
    updates = len(past.corrections) if steps else 0
    stored = len(past.transitions) if steps else 0
    order = updates + stored
    kept = len(past.transitions) // snapshots + 2 if snapshots else 0
    return Log(
        counts=np.zeros(2, dtype=np.int64),
        kinds=np.zeros(order, dtype=np.int64),
        numbers=np.zeros(order, dtype=np.int64),
        stamps=np.zeros(order, dtype=np.int64),
        ranks=np.zeros(order, dtype=np.int64),
        epochs=np.zeros(order, dtype=np.int64),
        samples=np.zeros(order, dtype=np.int64),
        step_P=np.zeros((stored if late or model else min(stored, 1), N, N)),
        rows=np.zeros(order, dtype=np.int64),
        dof=np.zeros(order, dtype=np.int64),
        H=np.zeros((updates, 3, N)),
        z=np.zeros((updates, 3)),
        x=np.zeros((updates, N)),
        K=np.zeros((updates, 3, N)),
        S=np.zeros((updates, 3, 3)),
        L=np.zeros((updates, 3, 3)),
        moved=np.zeros((updates, 3, COLUMNS)),
        model_steps=np.zeros((stored if model else 0, 3, N + E)),
        model_rows=np.zeros((updates if model else 0, 2, 3, E)),
        snapshot_flat=np.zeros((kept, flat if late or model else _FOR_TAPE)),
        snapshot_counters=np.zeros((kept, fs.COUNTERS), dtype=np.int64),
        good_flat=np.zeros((1, flat)),
        good_ns=np.zeros(1, dtype=np.int64),
        hindsight=make_hindsight(),
    )
