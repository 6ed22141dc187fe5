"""Strapdown through IMU samples ahead of the filter: what the filter does with them, without P.

The arithmetic is that of `events.imu_event`, of whose state this holds what the strapdown needs,
so that without a correction, and without samples that are missing, the filter arrives at the same
bits. Missing ones the filter interpolates (`fill`); here the next one is held over their time.
"""

from __future__ import annotations

from ...arrays import Array, Ints
from ..cache import kernel, routine
from ..frames.earth import up_and_height
from ..frames.grid import fill_C_e_G
from .imu import hold_surroundings, imu_step

STAMP, NEXT, HELD, HAS_PREVIOUS = 0, 1, 2, 3
"""Indexes of ``marks``, as `state` has them for the filter's counters."""
MARKS = 4
USUAL = 3
"""A gap is longer than so many of the intervals before it, as in `bridge`."""


@kernel
def _move_straight(v_G: Array, r_e: Array, C_e_G: Array, dt: float) -> None:
    """Move the position by dt [s] at constant velocity; C_e_G (3, 3) is scratch."""
    u_x, u_y, u_z, _ = up_and_height(r_e[0], r_e[1], r_e[2])
    fill_C_e_G(u_x, u_y, u_z, C_e_G)
    for k in range(3):
        r_e[k] += (C_e_G[0, k] * v_G[0] + C_e_G[1, k] * v_G[1] + C_e_G[2, k] * v_G[2]) * dt


@routine
def advance_strapdown(
    C_b_G: Array,
    v_G: Array,
    r_e: Array,
    biases_b: Array,
    increments: Array,
    previous: Array,
    previous_dt: Array,
    held: Array,
    marks: Ints,
    scratch: Array,
    step_ns: int,
    gap_ns: int,
    instant: bool,
    stamps_ns: Ints,
    samples_b: Array,
) -> None:
    """Advance a navigation state through n IMU samples, those up to its stamp left out.

    Parameters
    ----------
    C_b_G, v_G, r_e : (3, 3), (3,) [m/s], (3,) [m] arrays, in place
    biases_b : (2, 3) array
        Of gyro and accelerometer, body axes [rad/s], [m/s^2].
    increments, previous, previous_dt, held : arrays, in place
        As in `state.State`.
    marks : (MARKS,) array of int, in place
        Stamp of the state, end of the covariance step [ns], whether ``held`` is good, whether
        ``previous`` is.
    scratch : (9, 3) array
    step_ns, gap_ns : int
        Length of a covariance step; shortest gap that is bridged, 0 for never [ns].
    instant : bool
        Whether samples are values at their stamps, not means.
    stamps_ns : (n,) array of int
        In order.
    samples_b : (n, 2, 3) array
        Rate [rad/s] and specific force [m/s^2], body axes.
    """
    sums, used = scratch[:6], scratch[6:8]
    for i in range(stamps_ns.shape[0]):
        stamp_ns = stamps_ns[i]
        length_ns = stamp_ns - marks[STAMP]
        if length_ns <= 0:
            continue
        usual_ns = int(previous_dt[0] * 1e9)
        if gap_ns > 0 and usual_ns > 0 and length_ns > max(gap_ns, USUAL * usual_ns):
            _move_straight(v_G, r_e, sums[:3], (length_ns - usual_ns) * 1e-9)
            marks[STAMP] = stamp_ns - usual_ns
            marks[NEXT] = (marks[STAMP] // step_ns + 1) * step_ns
            marks[HELD] = marks[HAS_PREVIOUS] = 0
        dt = (stamp_ns - marks[STAMP]) * 1e-9
        averaged = instant and marks[HAS_PREVIOUS] == 1
        for j in range(2):
            for k in range(3):
                used[j, k] = samples_b[i, j, k]
                if averaged:
                    used[j, k] = 0.5 * (samples_b[i, j, k] + previous[j, k])
                if instant:
                    previous[j, k] = samples_b[i, j, k]
        if instant:
            marks[HAS_PREVIOUS] = 1
        if marks[HELD] == 0:
            until_ns = max(stamp_ns, marks[NEXT])
            hold_surroundings(held, v_G, r_e, (until_ns - marks[STAMP]) * 1e-9)
            marks[HELD] = 1
        imu_step(
            C_b_G,
            v_G,
            r_e,
            biases_b[0],
            biases_b[1],
            used[0],
            used[1],
            increments,
            dt,
            previous_dt[0],
            sums,
            held,
        )
        previous_dt[0] = dt
        marks[STAMP] = stamp_ns
        if stamp_ns >= marks[NEXT]:
            marks[NEXT] = (stamp_ns // step_ns + 1) * step_ns
            marks[HELD] = 0
