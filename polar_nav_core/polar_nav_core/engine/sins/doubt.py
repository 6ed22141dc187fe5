"""Doubt in a filter's estimate, which refused fixes raise: covariances that reach to them."""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from ...error_model import X
from ...kernels.sins import enlarged, hypotheses, reopen
from ...kernels.sins import state as fs
from .filter import NavigationFilter

_MOST_ANGLE = 1.0
"""1-sigma from which on nothing is known of an angle [rad]."""


def inflate(f: NavigationFilter, factor: float) -> None:
    """Enlarge the covariance by a factor, within the limits of `kernels.sins.reopen`."""
    enlarged.hold_covariance(f.state, f.work)
    reopen.inflate(f.state, min(max(factor, reopen.LEAST), reopen.MOST))
    opened_for_fixes(f)


def is_too_much(f: NavigationFilter, factor: float) -> bool:
    """Whether angles of an enlarged covariance would be none that a linear filter can have."""
    largest = float(np.diagonal(f.state.P)[X.phi_G].max())
    return min(max(factor, reopen.LEAST), reopen.MOST) * largest > _MOST_ANGLE**2


def doubt_position(f: NavigationFilter, distance: float) -> None:
    """Replace the position's covariance by that of an error of ``distance`` [m] per axis."""
    enlarged.hold_covariance(f.state, f.work)
    P = f.state.P
    P[X.dr_e, :] = 0.0
    P[:, X.dr_e] = 0.0
    P[X.dr_e, X.dr_e] = distance**2 * np.eye(3)
    opened_for_fixes(f)


def contradict(f: NavigationFilter, offset_G: Array, speed_G: Array) -> None:
    """Let the published covariance reach to where refused fixes say that the vehicle is.

    ``offset_G`` [m] is how far off they lie, ``speed_G`` [m/s] how fast that changes; zero
    where nothing contradicts.
    """
    f.state.conflict[:3] = speed_G
    f.state.conflict[3:] = f.frames.C_e_G.T @ offset_G


def opened_for_fixes(f: NavigationFilter) -> None:
    """Count an enlargement for fixes; what was remembered of them begins anew."""
    enlarged.tell_enlarged(f.state, f.work, f.log)
    counters = f.state.counters
    counters[fs.OPENED_NS + fs.FIX_ROW] = counters[fs.STAMP]
    counters[fs.OPENINGS + fs.FIX_ROW] += 1
    forget_fixes(f)


def forget_fixes(f: NavigationFilter) -> None:
    """Begin anew with what fixes and common errors have shown: another estimate showed it."""
    f.state.memories[fs.FIX_ROW] = 0.0
    f.state.shared[:] = 0.0
    f.state.bank[:] = 0.0
    f.state.windows[:] = 0.0
    f.state.counters[fs.BIRTH_NS] = 0
    f.state.counters[fs.BORN_NS : fs.BORN_NS + hypotheses.SLOTS] = 0
