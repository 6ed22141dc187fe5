"""All of the compiled filter that changes with time, as named arrays.

`State` is two flat arrays and named views into the first, so that a snapshot is two copies. What
does not change stands in `settings`, scratch in `work`, the past and the streams of measurements
in `rings`, rows of output in `output`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Array

# Kernels read these as attributes of this module.
from ...order import CONTROL_RANK as CONTROL_RANK
from ...order import DEPTH_RANK as DEPTH_RANK
from ...order import DEPTH_ROW as DEPTH_ROW
from ...order import DVL_RANK as DVL_RANK
from ...order import DVL_ROW as DVL_ROW
from ...order import FIX_RANK as FIX_RANK
from ...order import FIX_ROW as FIX_ROW
from ...order import FUSED as FUSED
from ...order import GATED as GATED
from ...order import HEADING_RANK as HEADING_RANK
from ...order import IMU_RANK as IMU_RANK
from ...order import NEVER_NS as NEVER_NS
from ...order import NIS_SUM as NIS_SUM
from ...order import REFUSED as REFUSED
from ...order import ROBUST_HUBER as ROBUST_HUBER
from ...order import ROBUST_NONE as ROBUST_NONE
from ...order import UPDATES as UPDATES
from .. import watch
from . import consider, hypotheses, scale
from .hypotheses import LEARNED as LEARNED
from .model import E
from .update import Ints, N

# Indexes of State.counters.
STAMP = 0
BOUNDARY = 1
HAS_PREVIOUS = 2
EPOCHS = 3
STEPS = 4
CORRECTIONS = 5
IMU = 6
DEPTH = 7
DVL = 8
FIX = 9
NEXT = 10  # stamp from which on a sample ends the covariance step that runs
HELD = 11  # 1 while State.held is good
CONTROL = 12
THRUST_NS = 13
IMPULSE_NS = 14
LOCK_NS = 15
GOOD_PINGS = 16
GOOD_NS = 17
USED_NS = 18  # three: stamp of the newest measurement used, per stream
OPENED_NS = 21  # three: when the gate of a stream was last opened again; the start at first
OPENINGS = 24  # three: how often the gate of a stream was opened again
USES = 27  # three: measurements used, per stream
IMU_NS = 30  # stamp of the newest IMU sample; STAMP is later in a gap
GAPS = 31  # between IMU samples, that were bridged
GAP_NS = 32  # length of the last one
GAP_END_NS = 33  # stamp of the sample that ended it
REFUSED_NS = 34  # two: newest refused measurement of DVL, depth
RUN_NS = 36  # two: since when those in a row that agree are refused
SHARED_NS = 38  # stamp of State.shared
BANK_NS = 39  # stamp of the signatures in State.bank
BIRTH_NS = 40  # stamp from which on the next hypotheses begin
CLOSED_NS = 41  # three: when the newest window of a stream ended
BORN_NS = 44  # one for each slot: when its hypotheses began; 0 for an empty one
HEADING = BORN_NS + hypotheses.SLOTS
HEADING_TRY_NS = HEADING + 1  # stamp of the newest heading that was tried
HEADING_USED_NS = HEADING + 2
HEADING_OPENED_NS = HEADING + 3  # when its gate was last opened again; the start at first
HEADING_OPENINGS = HEADING + 4
CONSIDERS = HEADING + 5  # 1 where a common error has a sigma, or the leader drifts
WATER_NS = HEADING + 6  # stamp of the newest velocity through the water that was used
USUAL_NS = HEADING + 7  # shortest of the newest intervals between IMU samples (fill)
ODD = HEADING + 8  # how irregular they are (fill)
HELD_NS = HEADING + 9  # stamp up to which a ping had the last rates held (fill); 0: none
WAITS = HEADING + 10  # 1 while a snapshot waits for the next step that a sample ends
MISSING_NS = HEADING + 11  # time of samples that were missing, of the last FADE_NS (fill)
INTERVAL_NS = HEADING + 12  # the newest interval between IMU samples (fill)
REFUSED_ROW = HEADING + 13  # three: newest measurements refused one after the other, per stream
FROM_NS = HEADING + 16  # late fixes that are valid before are out of reach
LEAPT_NS = HEADING + 17  # stamp of the newest ping that was used and leaps (reopen)
CHANGES = HEADING + 18  # between IMU samples, that were looked at (shock)
SHOCK_NS = HEADING + 19  # stamp of the newest sample that differed by far too much (shock)
COUNTERS = HEADING + 20

# What an event function (FUSED or REFUSED, too) or `advance` returns.
DONE = 0
P_NOT_DEFINITE = -1
S_NOT_DEFINITE = -2
FULL = -3
STOPPED = -4

STAND_IN = 0
SAMPLE = 1
"""Whether a sample moves the state, or what stands for one that is missing (fill)."""

STEPS_PER_TEST = 10
"""The covariance is tested for definiteness at every tenth step; its diagonal at every one."""
NO_MEASUREMENT = 0
SCALAR = 1
VECTOR = 3
"""Rows of a measurement. As attributes of a module these are variables to the compiler; numbers
in their place would have it compile a routine once for each."""


class State(NamedTuple):
    """Navigation state, covariance and everything else that changes from event to event."""

    flat: Array
    counters: Ints
    tally: Array  # (3, 3): per stream updates, gated, sum of NIS since the last output
    counting: Ints  # (1,): 0 while inputs are processed again: each counts once
    C_b_G: Array
    v_G: Array
    r_e: Array
    b_gyro_b: Array
    b_accel_b: Array
    dvl_scale_m: Array
    dvl_markov_m: Array
    usbl_bias_a: Array
    omega_ib_b: Array
    increments: Array  # (4, 3): angle and velocity of this sample, then of the one before
    sums: Array  # (6, 3): see imu.imu_step
    held: Array  # (8,): surroundings of the strapdown, held over a covariance step
    previous: Array  # (2, 3): the last sample as it came, rate and specific force
    noise: Array  # (3, 4): per stream b^k and the ratio of adapted to stated variance per axis
    previous_dt: Array  # (1,)
    swing: Array  # (3,): acceleration in body axes that late pings have missed (swing)
    P: Array
    sensitivity: Array  # (24, COLUMNS): error per unit of each common error (consider)
    memories: Array  # (3, 2, WIDTH): innovations per stream (watch)
    shared: Array  # (COLUMNS + 1, COLUMNS): what is known of the common errors (shared)
    runs: Array  # (2, 4): refused in a row that agree, DVL and depth: number, newest value
    conflict: Array  # (6,): where refused fixes say that velocity and position are off (consider)
    excess: Array  # (1,): variance of the IMU's noise above the stated one, per stated one
    steady: Array  # (7,): velocity that the DVL's scale is judged by (scale)
    carried: Array  # (2,): what was taken off the velocity since the last transition (carried)
    turn: Array  # (3, 3): of the position error's axes since the last transition (far)
    bank: Array  # (ROWS, SLOTS * KINDS): hypotheses about slow faults (hypotheses)
    windows: Array  # (3, 4): residuals of each stream since its window began (signatures)
    heading_memories: Array  # (2, WIDTH): innovations of a measured heading (watch)
    heading: Array  # (4,): counts and reference of a measured heading (heading)
    slope: Array  # (2, 3): change of rate and force between the last two samples (fill)
    span: Array  # (1,): time between those [s]
    usual: Array  # (2,): mean square of the change between two samples, rate and force (shock)
    model: Array  # (MODEL_ROWS, 7) where the vehicle's model takes part, else without rows


# Rows of State.model: P_xe, P_ee, the estimate e, the thrust.
P_XE = 0
P_EE = N
MEAN = N + E
THRUST = N + E + 1
MODEL_ROWS = N + E + 2
MODEL = MODEL_ROWS * E
IMPULSE = 3
LOCKED = 6
"""Columns of row THRUST: force in force [N], its integral over the filter step, and, in output
only, whether the DVL is in use."""


_SHAPES = {
    'C_b_G': (3, 3),
    'v_G': (3,),
    'r_e': (3,),
    'b_gyro_b': (3,),
    'b_accel_b': (3,),
    'dvl_scale_m': (3,),
    'dvl_markov_m': (3,),
    'usbl_bias_a': (3,),
    'omega_ib_b': (3,),
    'increments': (4, 3),
    'sums': (6, 3),
    'held': (8,),
    'previous': (2, 3),
    'noise': (3, 4),
    'previous_dt': (1,),
    'swing': (3,),
    'P': (N, N),
    'sensitivity': (N, consider.COLUMNS),
    'memories': (watch.STREAMS, watch.MEMORIES, watch.WIDTH),
    'shared': (consider.COLUMNS + 1, consider.COLUMNS),
    'runs': (2, 4),
    'conflict': (6,),
    'excess': (1,),
    'steady': (scale.STEADY,),
    'carried': (2,),
    'turn': (3, 3),
    'bank': (hypotheses.ROWS, hypotheses.SLOTS * hypotheses.KINDS),
    'windows': (watch.STREAMS, hypotheses.WINDOW),
    'heading_memories': (watch.MEMORIES, watch.WIDTH),
    'heading': (4,),
    'slope': (2, 3),
    'span': (1,),
    'usual': (2,),
}
FLAT = sum(int(np.prod(shape)) for shape in _SHAPES.values())
NAVIGATION = 30
"""Leading values of State.flat: C_b_G, v_G, r_e and the fifteen sensor errors."""


def make_state(*, model: bool = False) -> State:
    """Return a state of zeros, with room for a vehicle's model or without."""
    flat = np.zeros(FLAT)
    views, start = {}, 0
    for name, shape in _SHAPES.items():
        size = int(np.prod(shape))
        views[name] = flat[start : start + size].reshape(shape)
        start += size
    counters, counting = np.zeros(COUNTERS, dtype=np.int64), np.ones(1, dtype=np.int64)
    block = np.zeros((MODEL_ROWS if model else 0, E))
    return State(flat, counters, np.zeros((3, 3)), counting, **views, model=block)


class Frames(NamedTuple):
    """Quantities computed from the state: frames, earth rate, the transponder's position."""

    C_e_G: Array
    omega_ie_G: Array
    lever_G: Array
    point_e: Array
    velocity_e: Array
    height: Array  # (1,)


def make_frames() -> Frames:
    """Return frames of zeros."""
    return Frames(
        C_e_G=np.zeros((3, 3)),
        omega_ie_G=np.zeros(3),
        lever_G=np.zeros(3),
        point_e=np.zeros(3),
        velocity_e=np.zeros(3),
        height=np.zeros(1),
    )
