"""What the watchdog sees of a strapdown navigation."""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array
from ...error_model import X
from ...kernels import watch
from ...kernels.sins import compass, fill, heading, hypotheses
from ...kernels.sins import state as fs
from ...kernels.sins.look import look
from ..heading_params import REFERENCES
from ..health.compass import Compass
from ..health.slow import Evidence
from ..health.view import Gaps, View
from .filter import NavigationFilter
from .fusion import Fusion


def place_of(f: NavigationFilter) -> tuple[float, Array, Array]:
    """Height above the ellipsoid [m], grid axes (3, 3), horizontal covariance in them (2, 2)."""
    s, C_e_G, P_horizontal = f.state, np.empty((3, 3)), np.empty((2, 2))
    height: float = look(
        s.r_e,
        s.P,
        s.sensitivity,
        int(s.counters[fs.CONSIDERS]),
        f.settings.common,
        s.conflict,
        f.work.M,
        f.work.LP,
        C_e_G,
        P_horizontal,
    )
    return height, C_e_G, P_horizontal


def view_of(fusion: Fusion, stamp_ns: int, resets: int) -> View:
    """View of a navigation at a stamp; ``resets`` counts what the engine itself enlarged."""
    f = fusion.filter
    s, counters = f.state, f.state.counters
    height, C_e_G, P_horizontal = place_of(f)
    opened_ns = counters[fs.OPENED_NS : fs.OPENED_NS + 3].copy()
    opened_ns[opened_ns == f.start_ns] = 0
    return View(
        stamp_ns=stamp_ns,
        memories=s.memories,
        shared=s.shared,
        evidence=Evidence(
            s.bank,
            counters[fs.BORN_NS : fs.BORN_NS + hypotheses.SLOTS],
            C_e_G[:2] @ s.bank[X.dr_e],
        ),
        opened_ns=opened_ns,
        leapt_ns=int(counters[fs.LEAPT_NS]),
        shock_ns=int(counters[fs.SHOCK_NS]),
        used_ns=counters[fs.USED_NS : fs.USED_NS + 3],
        refused_row=counters[fs.REFUSED_ROW : fs.REFUSED_ROW + 3],
        speed=math.hypot(*s.v_G.tolist()),
        depth=f.settings.sea_surface_height - height,
        P_horizontal=P_horizontal,
        leader_stated=f.leader.stated,
        imu_noise=math.sqrt(1.0 + float(s.excess[0])),
        resets=resets + int(counters[fs.OPENINGS : fs.OPENINGS + 3].sum()),
        gaps=Gaps(
            int(counters[fs.GAPS]),
            int(counters[fs.GAP_NS]) * 1e-9,
            int(counters[fs.GAP_END_NS]),
            int(counters[fs.MISSING_NS]) / fill.FADE_NS,
        ),
        compass=_compass_of(f),
    )


def heading_measured_ns(f: NavigationFilter) -> int:
    """When a DVL, an AHRS or a compass was used last [ns]; 0 for never."""
    used_ns = int(f.state.counters[fs.USED_NS + fs.DVL_ROW])
    if f.settings.heading.on:
        used_ns = max(used_ns, int(f.state.counters[fs.HEADING_USED_NS]))
    return used_ns


def _compass_of(f: NavigationFilter) -> Compass | None:
    """Measured headings as the watchdog judges them; None where they are not used."""
    s, c = f.state, f.settings.heading
    if not c.on:
        return None
    opened = s.counters[fs.HEADING_OPENINGS] > 0
    return Compass(
        memories=s.heading_memories,
        reference=REFERENCES[c.reference],
        used=float(s.heading[heading.USED]),
        gated=float(s.heading[heading.GATED]),
        weak=float(s.heading[heading.WEAK]),
        horizontal=float(s.heading[heading.HORIZONTAL]),
        bias=float(s.usbl_bias_a[0]),
        bias_sigma=math.sqrt(float(s.P[heading.BIAS, heading.BIAS])),
        stated_sigma=float(c.noise[compass.START]),
        used_ns=int(s.counters[fs.HEADING_USED_NS]),
        opened_ns=int(s.counters[fs.HEADING_OPENED_NS]) if opened else 0,
        vouched=_agree(s.memories[fs.FIX_ROW, watch.SHORT]),
    )


def _agree(row: Array) -> bool:
    """Whether most measurements of a short memory were used; as `kernels.sins.reopen.agrees`."""
    return bool(row[watch.WEIGHT] > 0.0 and row[watch.REFUSED] < 0.5 * row[watch.WEIGHT])
