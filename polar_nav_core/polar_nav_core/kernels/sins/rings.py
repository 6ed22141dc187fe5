"""What the compiled filter keeps of the past, and what waits for it: rings of arrays.

IMU epochs, transitions and corrections; the order of linear steps with the rows of updates, and
snapshots (for late fixes and a smoother); streams of measurements.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Array
from .state import NAVIGATION
from .update import Ints, N


class Past(NamedTuple):
    """Rings of IMU epochs, transitions and corrections; number i stands at i % length."""

    stamps: Ints
    positions: Array  # r_e, ECEF
    velocities: Array  # v_G, grid axes
    levers: Array  # transponder from base_link, grid axes
    usbl_biases: Array  # as estimated, array axes
    steps: Ints
    firsts: Ints
    transitions: Array
    inverses: Array  # of the transitions: transition.fill_transition
    corrections: Array
    correction_steps: Ints


class Streams(NamedTuple):
    """Rings of measurements; ``counts`` is the number of each received (order of counters)."""

    counts: Ints  # (6,): IMU, depth, DVL, fix, control, heading
    imu_stamps: Ints
    omega_ib_b: Array
    f_b: Array
    depth_stamps: Ints
    depth: Array
    depth_variance: Array
    dvl_stamps: Ints
    dvl_v_m: Array
    dvl_covariance_m: Array
    dvl_water: Ints  # 1 where the velocity is relative to the water
    fix_stamps: Ints  # of their place in the order: validity for `rewind`, else reception
    fix_validities: Ints
    fix_r_e: Array
    fix_covariance_e: Array
    fix_array_heading: Array
    fix_relative_e: Array  # (n, 3): from the leader's array to the transponder, ECEF [m]
    fix_common_e: Array  # (n, 3, 7): change per unit of the leader's errors, ECEF [m]
    fix_dof: Ints  # degrees of freedom: of a fix without a height two, else three
    fix_outcomes: Array  # (n, OUTCOME): fused, NIS, innovation, its variances, enlargement, dof
    fix_notes: Ints  # (n, 3): steps gone back over, stamp of the state, rows of output so far
    control_stamps: Ints  # nothing comes here without a vehicle's model
    control_force_b: Array
    heading_stamps: Ints  # nothing comes here without a reference of headings
    headings: Array  # clockwise from it [rad]
    heading_up_b: Array  # (n, 3): the vertical of the AHRS, or NaN


ENLARGEMENT, DOF, OUTCOME = 8, 9, 10
"""The last columns of ``fix_outcomes``, and their number."""


class Hindsight(NamedTuple):
    """What a filter that is run for a smoother knows besides (`hindsight`); empty for others."""

    keeps: Ints  # (1,): 1 where refused measurements are logged, too
    stamps: Ints  # of the states that the filter is linearized at; none: it corrects its own
    states: Array  # (n, 30): their leading values
    place: Ints  # (1,): the next of them
    deviation: Array  # (24,): estimated error of a state that is held to them
    deviations: Array  # (snapshots, 24): the same at each snapshot
    dvl: Ints  # BY_GATE, TO_FUSE or TO_REFUSE, of each ping; none: all by the gate
    depth: Ints
    fix: Ints  # (2,): the same of the fix at hand, and its number


BY_GATE = 0


TO_FUSE = 1


TO_REFUSE = 2
"""Who decides on a measurement: the gate, or what was found with hindsight."""


def make_hindsight() -> Hindsight:
    """Return what a filter by itself knows: nothing."""

    def none() -> Ints:
        return np.zeros(0, dtype=np.int64)

    def one() -> Ints:
        return np.zeros(1, dtype=np.int64)

    return Hindsight(
        keeps=one(),
        stamps=none(),
        states=np.zeros((0, NAVIGATION)),
        place=one(),
        deviation=np.zeros(N),
        deviations=np.zeros((0, N)),
        dvl=none(),
        depth=none(),
        fix=np.zeros(2, dtype=np.int64),
    )


class Log(NamedTuple):
    """Linear steps and updates in order, for `clone`; snapshots, for `rewind`.

    Entry i of the order stands at i % length. A step's Phi and P stand at its number in the rings
    of steps, an update's rows at the number of its correction.
    """

    counts: Ints  # (2,): entries of the order, snapshots
    kinds: Ints
    numbers: Ints
    stamps: Ints
    ranks: Ints
    epochs: Ints
    samples: Ints  # number of a measurement in its stream
    step_P: Array
    rows: Ints
    dof: Ints  # degrees of freedom of an update: its rows, of a fix without a height two
    H: Array
    z: Array
    x: Array
    K: Array
    S: Array
    L: Array
    moved: Array  # innovation per unit of each common error, of updates at the present
    model_steps: Array  # (steps, 3, 31): Phi_ex, Phi_ee of a vehicle's model; without: no rows
    model_rows: Array  # (updates, 2, 3, 7): H_e and gain of it
    snapshot_flat: Array  # State.flat, and State.model after it
    snapshot_counters: Ints
    good_flat: Array  # (1, ...): as above, when the covariance was last tested in full
    good_ns: Ints  # (1,): its stamp
    hindsight: Hindsight


STEP = 0


UPDATE = 1


KEPT = 2
"""Kinds of entries: step, update, and, for a smoother only, a measurement that was refused."""
