"""Update of a filter by rows with a noise that is adapted in Python, beside the compiled ones."""

from __future__ import annotations

import math

from ...kernels.sins import consider
from ...kernels.sins import state as fs
from ...kernels.sins import update as kf
from ...kernels.sins.judge import dof_of, judge, remember
from ..results import Outcome
from .filter import NavigationFilter
from .noise import MeasurementNoise
from .robust import inflation


def fuse_adapted(f: NavigationFilter, m: int, noise: MeasurementNoise, stream: int) -> Outcome:
    """Gate ``H``, ``R``, ``z`` with a noise adapted in Python, update and feed back.

    ``stream`` is the row of the tally that counts it.

    Raises
    ------
    FilterDivergence
        When the innovation covariance is not positive definite.
    """
    w = f.work
    stated = w.R.copy()
    noise.apply(w.R)
    w.nis[1] = 1.0
    if not judge(f.state, f.settings, w, w.R, m):
        f.check(fs.S_NOT_DEFINITE)
    S = w.S.copy()
    tally = f.state.tally[stream]
    dof = dof_of(w, stream, m)
    fused = bool(w.nis[0] <= f.settings.gates[dof])
    if fused:
        w.nis[1] = inflation(noise.robust, float(w.nis[0]), dof)
    remember(f.state, f.settings, w, w.z, stream, m, fused)
    if not fused:
        tally[fs.GATED] += 1.0
        return f.outcome(m, fused=False, dof=dof)
    tally[fs.UPDATES] += 1.0
    tally[fs.NIS_SUM] += w.nis[0]
    factor = float(w.nis[1])
    if factor > 1.0:
        w.R[:m, :m] += (factor - 1.0) * w.S[:m, :m]
        w.S[:m, :m] *= factor
        w.L[:m, :m] *= math.sqrt(factor)
    noise.learn(w.z / math.sqrt(factor), stated, S)
    kf.update(f.state.P, w.x, w.S, w.z, m, w.K, w.PHt, w.L, w.D)
    if f.considers:
        consider.update_sensitivity(f.state.sensitivity, w.K, w.moved, m)
    if f.process is not None:
        f.process.learn(w.K[:m], w.z[:m], w.S[:m, :m])
    f.feed_back(w.x)
    return f.outcome(m, fused=True, dof=dof)
