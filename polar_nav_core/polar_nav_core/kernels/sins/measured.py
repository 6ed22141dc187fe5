"""Rows, innovation and noise of the measurement at hand, in the scratch.

Depth, DVL ping and fix, and what the common errors do to each. Rows of measurements:
docs/derivations/measurements.md.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import entry, kernel, routine
from ..frames.earth import up_and_height
from ..frames.grid import fill_C_e_G
from . import state as fs
from .carried import carried_heading_rows
from .consider import COLUMNS, LEADER, depth_common, dvl_common, fix_common
from .rings import Past
from .rows import depth_rows, dvl_rows, fix_rows
from .scale import NUMBER, OUTAGE_NS, steady_scale_rows
from .settings import Settings
from .state import Frames, State
from .turn import known_turn_rows, own_share
from .update import innovation_covariance
from .work import Work


@kernel
def place_of_epoch(past: Past, i: int, point_e: Array, velocity_e: Array, C_e_G: Array) -> None:
    """Transponder and velocity, ECEF, of the epoch at place i of the ring; C_e_G is scratch."""
    r_e = past.positions[i]
    u_x, u_y, u_z, _ = up_and_height(r_e[0], r_e[1], r_e[2])
    fill_C_e_G(u_x, u_y, u_z, C_e_G)
    for k in range(3):
        point_e[k] = r_e[k]
        velocity_e[k] = 0.0
        for n in range(3):
            point_e[k] += C_e_G[n, k] * past.levers[i, n]
            velocity_e[k] += C_e_G[n, k] * past.velocities[i, n]


@entry
@routine
def epoch_place(past: Past, i: int, point_e: Array, velocity_e: Array, C_e_G: Array) -> None:
    """`place_of_epoch`, for Python."""
    place_of_epoch(past, i, point_e, velocity_e, C_e_G)


@kernel
def fill_depth(s: State, fr: Frames, c: Settings, w: Work, depth: float, variance: float) -> None:
    """Rows of a depth at the present estimate into the scratch."""
    depth_rows(
        w.H,
        w.R,
        w.z,
        fr.C_e_G,
        s.C_b_G,
        fr.height[0],
        c.sea_surface_height - depth,
        variance,
        c.lever_depth_b,
    )
    if s.counters[fs.CONSIDERS] == 1:
        depth_common(w.J)


@entry
@kernel
def fill_dvl(
    s: State, fr: Frames, c: Settings, w: Work, v_m: Array, R_m: Array, held: bool
) -> None:
    """Rows of a DVL ping at the present estimate into the scratch.

    A state that is ``held`` to a track is linearized at the velocity of that track.
    """
    dvl_rows(
        w.H,
        w.R,
        w.z,
        w.C_m_G,
        s.C_b_G,
        s.v_G,
        s.omega_ib_b,
        fr.omega_ie_G,
        s.b_gyro_b,
        s.dvl_scale_m,
        s.dvl_markov_m,
        v_m,
        R_m,
        c.C_m_b,
        c.lever_dvl_b,
    )
    if c.carries_heading:
        carried_heading_rows(w.H, s.v_G, s.carried)
    share = 0.0
    if not held and (c.knows_turn or c.steadies_scale):
        innovation_covariance(w.S, w.PHt, s.P, w.H, w.R, 3)
        share = own_share(w.S, w.R)
        if c.steadies_scale:
            if s.counters[fs.STAMP] - s.counters[fs.USED_NS + fs.DVL_ROW] > OUTAGE_NS:
                s.steady[NUMBER] = 0.0
            steady_scale_rows(w.H, w.R, w.z, w.C_m_G, s.P, s.steady, w.PHt, w.S)
    if c.knows_turn:
        known_turn_rows(w.H, w.z, s.v_G, share)
    if c.carries_heading:
        carried_heading_rows(w.H, s.v_G, s.carried)
    if s.counters[fs.CONSIDERS] == 1:
        for k in range(3):
            w.omega[k] = s.omega_ib_b[k] - s.b_gyro_b[k]
        dvl_common(w.J, s.C_b_G, w.H, w.omega, s.swing, c.lever_dvl_b)


@kernel
def fill_fix(
    s: State,
    fr: Frames,
    c: Settings,
    w: Work,
    stamp_ns: int,
    r_e: Array,
    covariance_e: Array,
    array_heading: float,
    relative_e: Array,
    common_e: Array,
) -> None:
    """Rows of a fix that is valid now into the scratch: the present position plus v dt."""
    dt = (stamp_ns - s.counters[fs.STAMP]) * 1e-9
    for k in range(3):
        w.point_e[k] = fr.point_e[k] + fr.velocity_e[k] * dt
    fill_shared(w.C_a_G, c, fr.C_e_G, array_heading, common_e)
    fix_rows(
        w.H,
        w.R,
        w.z,
        fr.C_e_G,
        fr.lever_G,
        w.point_e,
        r_e,
        covariance_e,
        w.C_a_G,
        s.usbl_bias_a,
    )
    consider_leader(s, c, common_e)
    if s.counters[fs.CONSIDERS] == 1:
        fix_common(w.J, fr.C_e_G, relative_e, s.v_G, common_e)


@kernel
def consider_leader(s: State, c: Settings, common_e: Array) -> None:
    """Consider common errors from the first fix on whose leader drifts.

    Without them an update has fewer operations, and other last bits.
    """
    if c.common[LEADER] > 0.0:
        for i in range(common_e.shape[0]):
            for k in range(common_e.shape[1] - COLUMNS + LEADER, common_e.shape[1]):
                if common_e[i, k] != 0.0:
                    s.counters[fs.CONSIDERS] = 1


@entry
@kernel
def fill_shared(
    A: Array, c: Settings, C_e_G: Array, array_heading: float, common_e: Array
) -> None:
    """Change of a fix per unit of the last three states, grid axes: A (3, 3).

    Those states are the leader's errors per sigma, whose columns (ECEF) come with the fix, or the
    USBL error in the axes of the array.
    """
    if c.shares_leader:
        for a in range(3):
            for b in range(3):
                A[a, b] = 0.0
                for k in range(3):
                    A[a, b] += C_e_G[a, k] * common_e[k, b]
    else:
        _fill_array_axes(A, array_heading, c.estimates_usbl_bias)


@kernel
def _fill_array_axes(C_a_G: Array, array_heading: float, estimated: bool) -> None:
    """C_a_G of the leader's array as far as a packet states it: turned by the leader's heading.

    Zero while the USBL bias is not estimated.
    """
    for a in range(3):
        for b in range(3):
            C_a_G[a, b] = 0.0
    if estimated:
        psi = 0.5 * math.pi - array_heading
        C_a_G[0, 0] = math.cos(psi)
        C_a_G[0, 1] = -math.sin(psi)
        C_a_G[1, 0] = math.sin(psi)
        C_a_G[1, 1] = math.cos(psi)
        C_a_G[2, 2] = 1.0
