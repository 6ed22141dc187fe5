"""A covariance that is enlarged between two steps, as the log of linear steps is told of it.

A late fix finds P at its place as that stored with the last step less what the updates since then
took away (`late_place`). What a gate that opens, or the remainder of a large correction, adds in
between is in no step: without it that difference is no covariance where the opened gate's own
update is taken away from a P that never was so large. So it is added to the stored step as well,
as if it had been known from there on: at most one covariance step too early.
"""

from __future__ import annotations

from ..cache import entry, kernel
from . import state as fs
from .bend import add_bend_of_correction
from .rings import Log
from .state import State
from .update import N
from .work import Work


@entry
@kernel
def hold_covariance(s: State, w: Work) -> None:
    """Copy P to the scratch M, before it is enlarged."""
    for i in range(N):
        for j in range(N):
            w.M[i, j] = s.P[i, j]


@entry
@kernel
def tell_enlarged(s: State, w: Work, log: Log) -> None:
    """Add to the P stored with the newest step what P has grown by since `hold_covariance`."""
    length = log.step_P.shape[0]
    if length == 0:
        return
    P = log.step_P[s.counters[fs.STEPS] % length]
    for i in range(N):
        for j in range(N):
            P[i, j] += s.P[i, j] - w.M[i, j]


@kernel
def tell_bend(s: State, w: Work, log: Log) -> None:
    """Add to the P stored with the newest step what `correct_and_remember` will add to P."""
    length = log.step_P.shape[0]
    if length > 0:
        add_bend_of_correction(log.step_P[s.counters[fs.STEPS] % length], s.v_G, w.x)
