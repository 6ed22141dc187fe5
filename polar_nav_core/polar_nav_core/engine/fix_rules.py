"""Rules by which a single fix is refused before any gate judges it, each with a reason."""

from __future__ import annotations

import math

import numpy as np

from .driver import Driver
from .events import Fix
from .integrity import IntegrityMonitor
from .params import EngineParams
from .results import out_of_reach_reason

_CERTAIN_REJECTION = 4.0
"""A fix whose NIS exceeds the gate by this factor is left to the gate, which surely refuses it."""


def out_of_reach(
    params: EngineParams, fix: Fix, fusion: Driver, gate: float, since_ns: int
) -> str:
    """Reason to refuse a fix of a station where there is no gate; empty for a plausible one.

    It is beyond ``max_fix_sigma``, and farther off than the vehicle can have moved since the last
    fix was used (``since_ns``). In the strapdown mode `kernels.sins.judge` decides the same.
    """
    if params.mode != 'station' or math.isfinite(gate) or not params.max_fix_sigma:
        return ''
    off = fusion.offset(fix)
    if off is None or off[1] <= params.max_fix_sigma**2:
        return ''
    distance = float(np.linalg.norm(off[0]))
    if distance <= params.max_speed * (fix.receive_ns - since_ns) * 1e-9:
        return ''
    return out_of_reach_reason(distance, off[1])


def submerged(params: EngineParams, fix: Fix, fusion: Driver) -> str:
    """Reason to refuse the fix of an antenna that is under water; empty at the surface."""
    if math.isinf(fix.surface_depth):
        return ''
    depth = params.sea_surface_height - fusion.height()
    if depth <= fix.surface_depth:
        return ''
    return (
        f'the vehicle is at a depth of {depth:.1f} m: the antenna works above '
        f'{fix.surface_depth:g} m only'
    )


def held(monitor: IntegrityMonitor, fix: Fix, fusion: Driver, gate: float) -> str:
    """Reason to refuse a fix that the gate might pass; empty to leave the fix to the gate.

    While fixes are refused, the covariance grows by dead reckoning until, after long enough, the
    displaced ones would fit. Then the gate alone would take the displacement over without a word.
    So once fixes have been refused for longer than allowed, those that lie with the refused ones
    stay refused until they come back to the estimate or the crew resets the filter. Fixes that the
    gate will refuse by a wide margin are left to it, whose receipt has the exact numbers.
    """
    if not monitor.lasting(fix.receive_ns):
        return ''
    off = fusion.offset(fix)
    if (
        off is None
        or not monitor.agrees_with_refused(off[0])
        or off[1] > _CERTAIN_REJECTION * gate
    ):
        return ''
    state = monitor.state(fix.receive_ns)
    return (
        f'{float(np.linalg.norm(off[0])):.1f} m off, like the {state.gated_run} fixes before it '
        f'that were gated over {state.gated_s:.0f} s: not taken over without ~/reset or '
        f'~/set_initial_state, though the covariance has grown (NIS about {off[1]:.1f})'
    )
