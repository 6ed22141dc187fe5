"""Rows ``H``, ``R``, ``z`` of pings and fixes in a filter, as of now or referred to it."""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from ...error_model import X
from ...kernels.sins import consider, measured
from ...kernels.sins import late as filter_late
from ...kernels.sins import state as fs
from ...kernels.sins import walk as filter_walk
from ..events import DvlPing, Fix
from ..level import degrees_of_freedom
from .filter import NavigationFilter
from .leader import NO_LEADER


def fill_dvl(f: NavigationFilter, ping: DvlPing) -> None:
    """Fill ``H``, ``R``, ``z`` with the rows of a DVL ping."""
    measured.fill_dvl(
        f.state,
        f.frames,
        f.settings,
        f.work,
        ping.v_m,
        ping.covariance_m,
        False,
    )


def fill_common(f: NavigationFilter, fix: Fix, common_e: Array) -> None:
    """Change of a fix's innovation per unit of each common error into the scratch.

    ``common_e`` (3, 7) is that of the fix per sigma of its leader's errors.
    """
    constants = common_e[:, 3:].any() and f.settings.common[consider.LEADER] > 0.0
    if constants:
        f.state.counters[fs.CONSIDERS] = 1
    if f.considers:
        v_G, C_e_G = f.state.v_G, f.frames.C_e_G
        consider.fix_common(f.work.J, C_e_G, fix.relative_e, v_G, common_e)


def innovation_covariance(f: NavigationFilter, fix: Fix) -> Array:
    """Covariance of a fix's innovation now, grid axes (3, 3): with the common errors."""
    C, state = f.frames.C_e_G, f.state
    S: Array = C @ (state.P[X.dr_e, X.dr_e] + fix.covariance_e) @ C.T
    if f.considers:
        fill_common(f, fix, NO_LEADER)  # the fix's covariance has its leader's error
        moved = (f.work.J[:3] + C @ state.sensitivity[X.dr_e]) * f.settings.common
        S += moved @ moved.T
    return S


def refer_to_now(f: NavigationFilter, first_correction: int) -> None:
    """Subtract the corrections since ``first_correction`` from ``z`` by the rows ``H``."""
    h = f.history
    since = np.arange(first_correction, h.correction) % len(h.corrections)
    f.work.z[:] -= f.work.H @ h.corrections[since].sum(axis=0)


def fill_late_fix(f: NavigationFilter, fix: Fix) -> int:
    """Fill ``H``, ``R``, ``z`` with the rows of a late fix, referred to now.

    Returns
    -------
    int
        Covariance steps since its validity; below zero when the history does not reach there.
    """
    split = f.leader.split(fix)
    fill_common(f, fix, split.common_e)
    f.work.dof[0] = degrees_of_freedom(fix)
    return int(
        filter_late.fill_late_fix(
            f.state,
            f.frames,
            f.settings,
            f.past,
            f.work,
            fix.validity_ns,
            fix.r_e,
            split.covariance_e,
            fix.array_heading,
            split.common_e,
        )
    )


def walk_to_now(f: NavigationFilter, first_step: int, first_correction: int) -> int:
    """Refer the rows ``H``, ``z`` from a stored step to now; returns the number of steps."""
    h = f.history
    filter_walk.walk_forward(
        f.work.H,
        f.work.z,
        3,
        f.past.inverses,
        first_step,
        h.step,
        h.corrections,
        h.correction_steps,
        first_correction,
        h.correction,
    )
    return h.step - first_step
