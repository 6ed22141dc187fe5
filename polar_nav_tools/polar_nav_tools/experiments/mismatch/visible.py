"""Time of visibility of a fault: generalized likelihood of its known shape, of unknown size.

A fault of size ``a`` (1: as stated) adds ``a g_k`` to the innovations of an exact filter, whose
covariances S_k do not depend on it. The best test for the shape g has the statistic

    a_hat^2 J,   a_hat = sum g_k' S_k^-1 nu_k / J,   J(t) = sum over k until t of g_k' S_k^-1 g_k,

summed over the innovations of fixes, DVL and depth; a_hat has the standard deviation J^(-1/2). The
fault is *visible* from the time on at which J >= 25: 5 sigma.

The engine gives no innovation vectors of DVL and depth, but their normalized squares: NIS of each
fix in its receipt, and the sums per second of the others in the track. With innovations
``nu + a g`` the sum of squares is quadratic in ``a``, so with three runs of the exact filter (no
gate) at a small size e, inside the linear regime,

    J(t) = (NIS(t; e) + NIS(t; -e) - 2 NIS(t; 0)) / (2 e^2).

For the inertial vehicle these runs are in a world without noise, where NIS(t; 0) is 1e-4 and
rounding does not count; the world of a station keeps its noise, which cancels. Drawn faults
(outliers, noise) have the shape that the seed draws. Where a fault sets a wrong number
in every filter, the filter here has the wrong number, too.

The filter has the reserve that a user's parameters state (`plan.reserve`: how far biases walk, by
default): a drift that this reserve explains as well as the fault does is no evidence of a fault.
With the constant biases that the simulated IMU really has, a filter would see faults that no user
could tell from his instruments. Common errors are left out: they change no gain.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.outputs import NIS_SUM

from .faults import Fault
from .scenes import Ran, Scene

SMALL = 0.01
"""e: share of the fault for measuring its linear effect."""
VISIBLE_J = 25.0

_EXACT: dict[str, dict[str, Any]] = {
    'sins': {},
    'station': {
        'configuration': 'custom',
        'delay_handling': 'clone',
        'gate_probability': 1.0,
        'robust_fixes': 'none',
        'current_method': 'single',
        'current_walk': 1e-6,
        'identify_method': 'none',
    },
}
"""Parameters that make the best filter of a mode exact and linear."""


def information(
    scene: Scene, fault: Fault, seed: int, stated: Mapping[str, Any] | None = None
) -> tuple[Array, Array]:
    """Information J about a fault's size over time; ``stated`` are engine parameters.

    Returns
    -------
    time_s, J : (n,) arrays
        Since the start of the run, every second; of the fault as stated.
    """
    quiet: Any = scene.quiet(seed)
    changes: Mapping[str, Any] = {
        **scene.best,
        **_EXACT[scene.mode],
        **(stated or {}),
        **fault.for_all,
    }
    start_ns = scene.start_ns(quiet)
    time_s = np.arange(0.0, scene.duration_s + 1.0)
    total = np.zeros(len(time_s))
    for size, weight in ((SMALL, 1.0), (-SMALL, 1.0), (0.0, -2.0)):
        faulty: Any = fault.applied(quiet, size)
        ran = scene.run(faulty, changes, watched=False)
        total += weight * _nis_until(ran, start_ns, time_s)
    return time_s, total / (2.0 * SMALL**2)


class Visibility(NamedTuple):
    """Time from which a fault is visible [s], NaN for never; sigmas at the end."""

    from_s: float
    sigmas: float


def visibility(
    scene: Scene, fault: Fault, seed: int, stated: Mapping[str, Any] | None = None
) -> Visibility:
    """Visibility of a fault, in time since the start of the run; ``stated`` as in `information`.

    Missing messages are visible at once.
    """
    if fault.obvious:
        return Visibility(fault.start_s, float('nan'))
    time_s, J = information(scene, fault, seed, stated)
    enough = np.flatnonzero(J >= VISIBLE_J)
    from_s = float(time_s[enough[0]]) if len(enough) else float('nan')
    return Visibility(from_s, float(np.sqrt(max(0.0, J[-1]))))


def _nis_until(ran: Ran, start_ns: int, time_s: Array) -> Array:
    """Sum of all NIS until each time."""
    fixes = [(r.stamp_ns, r.nis) for r in ran.receipts if np.isfinite(r.nis)]
    local = ran.local[:, :, NIS_SUM].sum(axis=1)
    stamps = np.concatenate([np.array([s for s, _ in fixes], dtype=np.int64), ran.stamps_ns])
    values = np.concatenate([np.array([n for _, n in fixes]), local])
    at = np.searchsorted(time_s, (stamps - start_ns) * 1e-9 - 1e-9)
    sums = np.bincount(np.minimum(at, len(time_s) - 1), values, minlength=len(time_s))
    return np.asarray(np.cumsum(sums))
