"""What to do with a fix that is older than the estimate: one function per strategy.

All work on the same filter: each fills its rows for the fix; the filter then gates, updates and
feeds back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from polar_nav_core.kernels import filter_rows

from ..events import Array, Fix
from .history import Epoch
from .navigation import NavigationFilter


@dataclass(frozen=True)
class Prepared:
    """How a fix was brought to the filter's present."""

    steps: int


_NO_BIAS = np.zeros((3, 3))


def _rows(f: NavigationFilter, fix: Fix, epoch: Epoch, stamp_ns: int) -> None:
    point_e: Array = epoch.point_e + epoch.velocity_e * ((stamp_ns - epoch.stamp_ns) * 1e-9)
    filter_rows.fix_rows(
        f.H,
        f.R,
        f.z,
        f.C_e_G,
        epoch.lever_G,
        point_e,
        fix.r_e,
        fix.covariance_e,
        array_axes(f, fix),
        f.usbl_bias_a,
    )


def array_axes(f: NavigationFilter, fix: Fix) -> Array:
    """C_a_G of the leader's array as far as a packet tells it: turned by the leader's heading.

    Zero while the USBL bias is not estimated.
    """
    if not f.estimates_usbl_bias:
        return _NO_BIAS
    psi = 0.5 * np.pi - fix.array_heading
    c, s = np.cos(psi), np.sin(psi)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def ignore(f: NavigationFilter, fix: Fix, _epoch: Epoch) -> Prepared:
    """Take the fix as the position now: the conventional filter, off by speed times delay."""
    now = f.history.newest()
    current = Epoch(
        now.stamp_ns, f.point_e, f.velocity_e, f.lever_G, now.step, f.history.correction
    )
    _rows(f, fix, current, fix.receive_ns)
    return Prepared(0)


def back_propagate(f: NavigationFilter, fix: Fix, epoch: Epoch) -> Prepared:
    """Innovation at validity with H* = H Phi^-1: the published modified AKF, in closed loop."""
    _rows(f, fix, epoch, fix.validity_ns)
    return Prepared(f.walk_to_now(epoch.step, epoch.correction))


STRATEGIES: dict[str, Callable[[NavigationFilter, Fix, Epoch], Prepared]] = {
    'ignore': ignore,
    'back_propagate': back_propagate,
}
