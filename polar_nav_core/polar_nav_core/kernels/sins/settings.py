"""Constants of a run that the compiled filter reads: sensors, noise, gates, lever arms."""

from __future__ import annotations

from typing import NamedTuple

from ...arrays import Array
from .compass import Heading


class Aiding(NamedTuple):
    """Constants of the vehicle's model and of its use in the filter."""

    on: bool
    numbers: Array  # (7, 3), rows below
    thrust_ns: int  # how long a thrust holds that no newer one follows
    lost_ns: int  # without a good ping for longer: bottom lock is lost
    pings: int  # good ones in a row until the DVL is used again


# Rows of Aiding.numbers. WALKS: variances per second of v_r, V_c and both of the drag's.
# DIFFERENCE: variance of v_G - C_b_G v_r - V_c, horizontal and vertical, and its time. OTHER: net
# buoyancy, speed at which ln Dt and f are stated, variance per second of v_r without a thrust.
# WATER: variance and time of the slow error of a velocity through the water.
INERTIA = 0


LINEAR = 1


QUADRATIC = 2


WALKS = 3


DIFFERENCE = 4


OTHER = 5


WATER = 6


class Settings(NamedTuple):
    """Constants of a run: sensors, noise, gates, lever arms."""

    step_ns: int
    steps_per_snapshot: int
    output_ns: int
    instant: bool  # IMU samples are values at the stamp, not means
    active: int  # leading states that the covariance must be positive definite in
    estimates_usbl_bias: bool
    shares_leader: bool  # the last three states are the leader's errors, per sigma
    adaptive: bool
    knows_turn: bool  # rows of a ping: the velocity that a turn moves is that known with it (turn)
    carries_heading: bool  # and no correction of that velocity shows a heading (carried)
    steadies_scale: bool  # rows of a ping: the velocity of the scale is without jitter (scale)
    back_propagates: bool  # fixes of the streams are late: they stand where they were received
    forgetting: float
    floor: float
    ceiling: float
    robust: int  # how fixes far off are weighted down: index in order.ROBUST_FIXES
    robust_thresholds: Array  # (4,): NIS of a fix from which on, per number of rows
    gates: Array  # (4,): threshold of NIS per number of rows
    far_nis: float  # without a gate: NIS from which on a fix may be implausible; inf: never
    max_speed: float  # of the vehicle [m/s]
    densities: Array  # (4,): of gyro, accelerometer and their bias walks, squared
    markov: Array  # (2,): steady variance and correlation time of the DVL's Markov velocity
    usbl: Array  # (2,): the same of the USBL error
    sea_surface_height: float
    C_m_b: Array
    lever_point_b: Array
    lever_dvl_b: Array
    lever_depth_b: Array
    gap_ns: int  # a longer way from an IMU sample is bridged; 0: never
    fills: bool  # IMU samples missing on a shorter way are interpolated (fill)
    shock: float  # usual changes between IMU samples beyond which one leaps; 0: never (shock)
    gap_variances: Array  # (2,): see gap
    reopen_ns: int  # how long a gate stays shut at least before it opens again; 0: for good
    most_excess: float  # largest State.excess; 0: the IMU's noise is as stated
    considers: bool  # some common error has a sigma, even of a leader that does not drift
    common: Array  # (COLUMNS,): sigmas of the common errors (consider)
    aiding: Aiding
    heading: Heading
