"""What the watchdog sees of a navigation in station mode."""

from __future__ import annotations

import math

import numpy as np

from ...kernels.station import state as ss
from ...order import DEPTH_ROW, DVL_ROW, FIX_ROW
from ..health.station import StationView
from ..health.view import Gaps
from .fusion import StationFusion


def view_of(fusion: StationFusion, stamp_ns: int, resets: int) -> StationView:
    """View of a navigation at a stamp; ``resets`` counts what the engine itself enlarged."""
    f, p = fusion.filter, fusion.params
    counters = f.bank.counters
    x, P = f.published_mixture()
    opened_ns = np.zeros(max(DVL_ROW, DEPTH_ROW, FIX_ROW) + 1, dtype=np.int64)
    opened_ns[FIX_ROW] = counters[ss.OPENED_NS]
    stated, _ = p.vehicle_model().logarithmic_drag(p.model_speed)
    thrust_ns = int(counters[ss.THRUST_NS])
    sample = (int(counters[ss.IMU]) - 1) % len(f.streams.imu_stamps)
    C_b_G = f.streams.C_b_G[sample]
    smoothed = f.settings.attitude_tau > 0.0
    return StationView(
        stamp_ns=stamp_ns,
        memories=f.bank.memories,
        opened_ns=opened_ns,
        used_ns=np.zeros_like(opened_ns),
        speed=float(np.linalg.norm(x[ss.V_R : ss.POSITION])),
        depth=f.settings.surface - f.bank.flat[ss.HEIGHT],
        P_horizontal=P[ss.HORIZONTAL, ss.HORIZONTAL],
        resets=resets + int(counters[ss.OPENINGS] + counters[ss.LOOSENED]),
        gaps=Gaps(
            int(counters[ss.GAPS]), int(counters[ss.GAP_NS]) * 1e-9, int(counters[ss.GAP_END_NS])
        ),
        share=float(x[ss.SHARE]),
        share_sigma=math.sqrt(max(0.0, P[ss.SHARE, ss.SHARE])),
        drag_ratio=float(x[ss.DRAG]) - stated,
        drag_sigma=math.sqrt(max(0.0, P[ss.DRAG, ss.DRAG])),
        thrust_age_s=(stamp_ns - thrust_ns) * 1e-9 if thrust_ns else math.inf,
        thrust_timeout_s=p.thrust_timeout_s,
        loose=bool(f.bank.loose[ss.EXTRA] > 0.0),
        loosened_ns=int(counters[ss.LOOSENED_NS]),
        turned_ns=int(counters[ss.TURN_NS]),
        signatures=f.bank.signatures,
        weight=f.bank.weight,
        born_ns=counters[ss.BORN_NS : ss.BIRTH_NS],
        psi=math.atan2(C_b_G[1, 0], C_b_G[0, 0]) if smoothed else None,
        turn=float(f.streams.unexplained[sample]),
        heading_sigma=math.sqrt(max(0.0, P[ss.HEADING, ss.HEADING])),
        followed=1e-3 * counters[ss.FOLLOWED_MM : ss.FOLLOWED_MM + 2].astype(np.float64),
        jumped=bool(counters[ss.JUMPED]),
        current=x[ss.CURRENT : ss.DRAG].copy(),
        P_current=P[ss.CURRENT : ss.DRAG, ss.CURRENT : ss.DRAG].copy(),
    )
