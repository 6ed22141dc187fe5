"""Everything that the compiled filter reads and writes, as named groups of arrays.

`State` is all that changes with time: two flat arrays and named views into the first, so that a
snapshot is two copies. The other groups are settings, scratch, the stored past, the log of linear
steps (for `clone`), the streams of measurements and the rows of output.
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
from . import consider, hypotheses
from .columns import WIDTH
from .compass import Heading
from .hypotheses import LEARNED as LEARNED
from .model import E
from .update import COUPLED, Ints, N

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
COUNTERS = HEADING + 16

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
    calm: Array  # (4,): velocity that the DVL's scale is judged by (scale)
    bank: Array  # (ROWS, SLOTS * KINDS): hypotheses about slow faults (hypotheses)
    windows: Array  # (3, 4): residuals of each stream since its window began (signatures)
    heading_memories: Array  # (2, WIDTH): innovations of a measured heading (watch)
    heading: Array  # (4,): counts and reference of a measured heading (heading)
    slope: Array  # (2, 3): change of rate and force between the last two samples (fill)
    span: Array  # (1,): time between those [s]
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
    'calm': (4,),
    'bank': (hypotheses.ROWS, hypotheses.SLOTS * hypotheses.KINDS),
    'windows': (watch.STREAMS, hypotheses.WINDOW),
    'heading_memories': (watch.MEMORIES, watch.WIDTH),
    'heading': (4,),
    'slope': (2, 3),
    'span': (1,),
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
    back_propagates: bool  # fixes of the streams are late: they stand where they were received
    forgetting: float
    floor: float
    ceiling: float
    robust: int  # how fixes far off are weighted down: index in order.ROBUST_FIXES
    robust_threshold: float  # NIS of a fix from which on
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
    gap_variances: Array  # (2,): see gap
    reopen_ns: int  # how long a gate stays shut at least before it opens again; 0: for good
    most_excess: float  # largest State.excess; 0: the IMU's noise is as stated
    considers: bool  # some common error has a sigma, even of a leader that does not drift
    common: Array  # (COLUMNS,): sigmas of the common errors (consider)
    aiding: Aiding
    heading: Heading


MODEL_WORK = 63
"""Rows of Work.model."""


class Work(NamedTuple):
    """Scratch; H, R, z, x, K, S and nis hold the last update."""

    F15: Array
    M: Array
    LP: Array
    L: Array
    S: Array
    PHt: Array
    K: Array
    w: Array
    H: Array
    R: Array
    stated: Array
    z: Array
    x: Array
    q: Array
    J: Array  # (3, COLUMNS): innovation per unit of each common error, by itself
    moved: Array  # (3, COLUMNS): the same, with what the estimate has taken of it
    wide: Array  # (3, 3): S with the common errors
    wide_L: Array  # its factor
    per_sigma: Array  # (3, COLUMNS): moved, per sigma of each common error
    learned: Array  # (3, COLUMNS): scratch of shared.learn
    residual: Array  # (3,): innovation less what is known of the common errors
    narrow: Array  # (3, 3): its covariance
    narrow_L: Array  # its factor
    D: Array  # (3, 24): G - K S/2 of the last update, transposed
    nis: Array  # (2,): NIS, and by how much S was enlarged after the gate
    age: Array  # (1,): of the fix in H, R, z [s]
    signatures: Array  # (SCRATCH, SLOTS * KINDS): scratch of signatures
    powers: Array  # (9, 3): scratch of the same
    evidence: Array  # (3,): scratch of the same
    C_m_G: Array
    C_mean: Array
    C_a_G: Array
    C_e_G: Array  # (3, 3): grid frame at another place than that of Frames
    f_mean: Array
    omega_mean: Array
    omega: Array
    f: Array
    owed: Array  # (2, 3): angle and velocity that a sample has to make up for (fill)
    line: Array  # (4,): of the course between two samples (fill.begin_sample)
    bend: Array  # (2, 3): second derivative of rate and force on it
    acceleration: Array  # (3,): in body axes
    point_e: Array
    velocity_e: Array
    model: Array  # (MODEL_WORK, 7) of the vehicle's model, rows as in aiding
    model_slopes: Array  # (6, 24): F_ex and Phi_ex of the vehicle's model


def make_work() -> Work:
    """Return scratch arrays."""

    def three() -> Array:
        return np.zeros(3)

    def square() -> Array:
        return np.zeros((3, 3))

    rows = (3, N)
    return Work(
        F15=np.zeros((COUPLED, COUPLED)),
        M=np.zeros((N, N)),
        LP=np.zeros((N, N)),
        L=square(),
        S=square(),
        PHt=np.zeros(rows),
        K=np.zeros(rows),
        w=three(),
        H=np.zeros(rows),
        R=square(),
        stated=square(),
        z=three(),
        x=np.zeros(N),
        q=np.zeros(N),
        J=np.zeros((3, consider.COLUMNS)),
        moved=np.zeros((3, consider.COLUMNS)),
        wide=square(),
        wide_L=square(),
        per_sigma=np.zeros((3, consider.COLUMNS)),
        learned=np.zeros((3, consider.COLUMNS)),
        residual=three(),
        narrow=square(),
        narrow_L=square(),
        D=np.zeros(rows),
        nis=np.array([0.0, 1.0]),
        age=np.zeros(1),
        signatures=np.zeros((hypotheses.SCRATCH, hypotheses.SLOTS * hypotheses.KINDS)),
        powers=np.zeros((9, 3)),
        evidence=three(),
        C_m_G=square(),
        C_mean=square(),
        C_a_G=square(),
        C_e_G=square(),
        f_mean=three(),
        omega_mean=three(),
        acceleration=three(),
        omega=three(),
        f=three(),
        owed=np.zeros((2, 3)),
        line=np.zeros(4),
        bend=np.zeros((2, 3)),
        point_e=three(),
        velocity_e=three(),
        model=np.zeros((MODEL_WORK, E)),
        model_slopes=np.zeros((6, N)),
    )


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
    fix_outcomes: Array  # (n, 9): fused, NIS, innovation, its variances, enlargement
    fix_notes: Ints  # (n, 3): steps gone back over, stamp of the state, rows of output so far
    control_stamps: Ints  # nothing comes here without a vehicle's model
    control_force_b: Array
    heading_stamps: Ints  # nothing comes here without a reference of headings
    headings: Array  # clockwise from it [rad]
    heading_up_b: Array  # (n, 3): the vertical of the AHRS, or NaN


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


class Rows(NamedTuple):
    """Rows of output: stamps, leading values of the state, covariance, tally since the last."""

    io: Ints  # (3,): stamp that is due (-1: none), number of rows, when the next one is due
    stamps: Ints
    flat: Array  # (n, 30), then State.model where there is one
    P: Array  # (n, 24, 24), or without rows
    derived: Array  # (n, nav_columns.WIDTH), or without rows
    tally: Array
    scratch: Array
    total: Array  # (24, 24): covariance with the common errors


def make_rows(capacity: int, *, model: bool = False, derived: bool = False) -> Rows:
    """Return empty rows for ``capacity`` outputs; with none, no output is written.

    With ``derived`` they hold the columns of `describe` in place of the covariance.
    """
    return Rows(
        np.array([-1, 0, 0 if capacity else NEVER_NS], dtype=np.int64),
        np.zeros(capacity, dtype=np.int64),
        np.zeros((capacity, NAVIGATION + (MODEL if model else 0))),
        np.zeros((0 if derived else capacity, N, N)),
        np.zeros((capacity if derived else 0, WIDTH)),
        np.zeros((capacity, 3, 3)),
        np.zeros((2, 3, 3)),
        np.zeros((N, N)),
    )


NO_ROWS = make_rows(0)
"""For a filter whose outputs nobody reads."""
