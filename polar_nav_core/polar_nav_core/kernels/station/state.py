"""What the compiled filter of station mode reads and writes, as named groups of arrays.

The filter is a bank: B members that differ in the density q_c of the current's random walk only.
State of a member (docs/derivations/station.md): velocity through the water, body axes; position,
station frame A; current along x and y; ln of total surge drag; share of it that is quadratic;
measured minus true heading; stated minus true heading of the station.
"""

from __future__ import annotations

from typing import NamedTuple

from ...arrays import Array

# Kernels read these as attributes of this module.
from ...order import CONTROL_RANK as CONTROL_RANK
from ...order import DEPTH_RANK as DEPTH_RANK
from ...order import DEPTH_ROW as DEPTH_ROW
from ...order import FIX_RANK as FIX_RANK
from ...order import FIX_ROW as FIX_ROW
from ...order import FUSED as FUSED
from ...order import GATED as GATED
from ...order import IMU_RANK as IMU_RANK
from ...order import NIS_SUM as NIS_SUM
from ...order import REFUSED as REFUSED
from ...order import ROBUST_HUBER as ROBUST_HUBER
from ...order import ROBUST_MAHALANOBIS as ROBUST_MAHALANOBIS
from ...order import UNDECIDED as UNDECIDED
from ...order import UPDATES as UPDATES
from ..sins.update import Ints

N = 12
V_R, POSITION, CURRENT, DRAG, SHARE, HEADING, STATION = 0, 3, 6, 8, 9, 10, 11
"""First index of each block of the state."""
DYNAMIC = 6
"""States with dynamics: velocity and position."""
HORIZONTAL = slice(POSITION, POSITION + 2)
"""The horizontal position; for Python, not for kernels."""

# Indexes of Bank.counters: stamp of the newest IMU sample [ns], inputs taken; stamp of the newest
# thrust [ns], 0 for none; refused fixes in a row and the validity of the first of them [ns]; when
# the gate was opened last [ns], and how often; gaps between AHRS samples, length of the newest and
# stamp of its end [ns]; how often the model was loosened, and when last [ns];
# turns of the AHRS against its rates, and when the newest began [ns]; when each slot of
# hypotheses began [ns], 0 for an empty one, when the next begin, and of which stamp they are; how
# far off the first of the refused fixes in a row is, if farther than a vehicle can have come (2),
# the way to fixes that were refused at first and followed at last (2), and that to the fix for
# which the gate was opened, until one is fused (2), along x and y [mm]; whether fixes that jumped
# are among those followed.
STAMP, IMU, CONTROL, DEPTH, FIX = 0, 1, 2, 3, 4
THRUST_NS, RUN, RUN_NS, OPENED_NS, OPENINGS = 5, 6, 7, 8, 9
GAPS, GAP_NS, GAP_END_NS = 10, 11, 12
LOOSENED, LOOSENED_NS, TURNS, TURN_NS = 13, 14, 15, 16
SLOTS = 5
BORN_NS = 17
BIRTH_NS, SIGNATURES_NS, LEAP_MM = BORN_NS + SLOTS, BORN_NS + SLOTS + 1, BORN_NS + SLOTS + 2
FOLLOWED_MM, OPENED_MM, JUMPED, COUNTERS = LEAP_MM + 2, LEAP_MM + 4, LEAP_MM + 6, LEAP_MM + 7

# Bank.flat: thrust (3), vertical at the vehicle (3), place where that holds (3), its height,
# C_A_G (9), 1-sigma of the station's heading, sum of the directions of refused fixes in a row (2).
FORCE, UP, PLACE, HEIGHT, AXES, SIGMA, SIDE, FLAT = 0, 3, 6, 9, 10, 19, 20, 22

# Bank.loose: sum of whitened innovations (2), stamp from which on it grows [s], density by which
# the current walks further while the model is loose [m^2/s^3], stamp of the newest fix [s], square
# of the present turn of the AHRS against its rates, as far as it is in P [rad^2].
SUM_X, SUM_Y, SINCE_S, EXTRA, NEWEST_S, TURNED_2, LOOSE = 0, 1, 2, 3, 4, 5, 6

# Columns of Bank.S: scale of ranges, turn of the station's array, offset of the station's stated
# position along x and y, zero of depth.
RANGE_SCALE, TURN, OFFSET, DEPTH_ZERO, COMMON = 0, 1, 2, 4, 5

# Tables of Bank.signatures: one for each member, the last one for their mixture. Rows after the
# state: Lambda and zeta, Lambda between both of a pair (at the first of them), the table's own
# statistic, logarithms of the member's weight when the hypothesis began and of its likelihood
# without a fault since then, statistic of the whole bank (in the last table). Hypothesis of kind k
# in slot i: column KINDS i + k. Kinds: a current that grows and one that has begun, along x and y;
# a deviation of the AHRS as the sine and cosine of the heading; drag that has changed; a heading
# of the AHRS that drifts; ranges and bearings that do.
LAMBDA, ZETA, CROSS, OWN, PRIOR, LIKELIHOOD, STATISTIC = range(N, N + 7)
SIGNATURE_ROWS = N + 7
GROWS, BEGINS, DEVIATES, DRAGS, TURNS, RANGES, BEARINGS, KINDS = 0, 2, 4, 6, 7, 8, 9, 10

# Columns of Streams.fixes.
X, Y, Z, PSI, RANGE, BEARING, RANGE_VARIANCE, BEARING_VARIANCE, PSI_SIGMA, FIX_COLUMNS = range(10)

# Columns of Streams.outcomes: decision, NIS, innovation (2), its covariance (3), inflation, place
# in polar coordinates from the station (2), factor on the covariance that opened the gate for it
# (negative: less the variance that the position got [m^2]), unexplained way with which it loosened
# the model [m^2; 0: it did not] and how long that took [s], Bank.loose[EXTRA] after it, how far
# off it was when it opened the gate (2) [m].
DECIDED, NIS, Z0, Z1, S00, S01, S11, INFLATION, DISTANCE, AZIMUTH, OPENING = range(11)
WAY, LASTED_S, FURTHER, FOLLOWED, OUTCOME = 11, 12, 13, 14, 16

# What `advance` returns.
DONE, FULL, NOT_DEFINITE = 0, -3, -1

IGNORE, TAGGED, BACK_PROPAGATE = 0, 1, 2
"""Ways to bring a late fix to the present."""


class Bank(NamedTuple):
    """Members of the bank and everything else that changes from event to event."""

    x: Array  # (B, 12)
    P: Array  # (B, 12, 12)
    log_weight: Array  # (B,), up to a constant
    weight: Array  # (B,), sum 1
    S: Array  # (B, 12, COMMON): change of the error per unit of each common error
    memories: Array  # (watch.STREAMS, watch.MEMORIES, watch.WIDTH) of innovations
    signatures: Array  # (B + 1, SIGNATURE_ROWS, KINDS SLOTS): hypotheses about slow faults
    flat: Array  # (FLAT,)
    loose: Array  # (LOOSE,)
    counters: Ints  # (COUNTERS,)
    tally: Array  # (2, 3): rows and columns of outputs.LOCAL_DOF
    counting: Ints  # (1,): 0 while inputs are processed again: each counts once


class Settings(NamedTuple):
    """Constants of a run: model, noise, gates, lever arms."""

    inertia: Array  # (3,) [kg]
    drag_linear: Array  # (3,), of sway and heave [N s/m]
    drag_quadratic: Array  # (3,) [N s^2/m^2]
    net_buoyancy: float  # [N]
    speed: float  # where total drag is stated [m/s]
    q_v: float  # densities: of v_r [m^2/s^3]
    q_xy: float  # of position [m^2/s]
    q_z: float
    q_drag: float  # of ln Dt and f [1/s]
    q_heading: float  # [rad^2/s]
    q_current: Array  # (B,) [m^2/s^3]
    station_tau: float  # correlation time of the station's heading error [s]
    forgetting: float  # of log-likelihoods, per fix
    robust: int  # index in order.ROBUST_FIXES
    robust_threshold: float
    gates: Array  # (3,): by degrees of freedom
    attitude_variance: float  # of the AHRS, per axis and sample [rad^2]
    attitude_tau: float  # time constant of its smoothing [s]; 0 for none
    omega_ie_A: Array  # (3,): rate of the Earth, station axes [rad/s]
    published: bool  # the filter of Eqs. 8-13: states are v over ground, body axes, and position
    shifted: bool  # its stored positions are shifted by each correction
    fix_variance: float  # its R of x and y [m^2]
    origin_e: Array  # (3,): of the station frame, ECEF [m]
    C_e_A: Array  # (3, 3)
    surface: float  # height of the sea surface [m]
    lever_fix_b: Array  # (3,): transponder from base_link [m]
    lever_depth_b: Array  # (3,)
    max_step_s: float  # a longer interval between IMU samples is taken in parts
    common: Array  # (COMMON,): 1-sigma of each common error
    shares: bool  # whether any of them is stated
    reopen_ns: int  # fixes refused for so long may open the gate; 0 for never
    max_speed: float  # that the vehicle can have [m/s]
    doubt: float  # log likelihood ratio from which on the model is loosened; 0: never
    gap_ns: int  # a longer interval between AHRS samples is a gap
    thrust_ns: int  # a thrust that is older is unknown; 0: it holds for ever
    snapshot_every: int  # IMU samples
    output_ns: int


class Streams(NamedTuple):
    """Rings of measurements; number i stands at i % length."""

    counts: Ints  # (4,): IMU, control, depth, fix
    imu_stamps: Ints
    omega_ib_b: Array  # (n, 3)
    C_b_G: Array  # (n, 3, 3), smoothed
    unexplained: Array  # (n,): turn of the AHRS against its rates, about up [rad]
    control_stamps: Ints
    force_b: Array  # (n, 3)
    depth_stamps: Ints
    depth: Array
    depth_variance: Array
    fix_stamps: Ints
    fixes: Array  # (n, FIX_COLUMNS)
    outcomes: Array  # (n, OUTCOME)
    fix_points: Array  # (n, B, 12): where fixes are linearised
    fix_inflations: Array  # (n, B)


class Tape(NamedTuple):
    """What a smoother needs, gathered since its newest node (kernels.station.tape).

    Without members (B = 0) nothing is gathered.
    """

    Psi: Array  # (B, 12, 12): transition of the error
    vector: Array  # (B, 12, 1 + COMMON)
    information: Array  # (B, 12, 12)
    H: Array  # (B, 2, 12): rows of the newest fix


class Log(NamedTuple):
    """Stored past: points of linearisation, corrections and snapshots."""

    counts: Ints  # (1,): snapshots taken
    points: Array  # (n, B, 12): state before IMU sample number i stands at i % n
    jumps: Array  # (n, B, 12): corrections between two IMU samples; none kept for n = 0
    x: Array  # (s, B, 12), and so on as in Bank
    P: Array
    log_weight: Array
    weight: Array
    S: Array
    memories: Array
    signatures: Array
    flat: Array
    loose: Array
    counters: Ints
    good: Bank  # newest sound state, tested in full
    tape: Tape  # for a smoother


class Rows(NamedTuple):
    """Rows of output: one estimate each."""

    io: Ints  # (2,): stamp of the row that is due or -1, rows written
    stamps: Ints
    r_e: Array  # (k, 3)
    v_G: Array
    C_b_G: Array  # (k, 3, 3)
    P: Array  # (k, 9, 9): attitude, velocity, position as in the error state of the SINS
    x: Array  # (k, 12): mean of the bank
    P_x: Array  # (k, 12, 12)
    walk: Array  # (k,): q_c
    weight: Array  # (k, B)
    tally: Array  # (k, 2, 3)


class Work(NamedTuple):
    """Scratch arrays."""

    a: Array  # (3,)
    F: Array  # (3, 3)
    d1: Array  # (3,)
    d2: Array
    R: Array  # (3, 3)
    C_A: Array  # (3, 3): body to station frame by the AHRS
    C_G: Array  # (3, 3)
    omega: Array  # (3,)
    up: Array  # (3,)
    lever: Array  # (3,)
    v3: Array  # (3,)
    g: Array  # (3,)
    M: Array  # (6, 12)
    point: Array  # (12,)
    d: Array  # (12,)
    H: Array  # (2, 12)
    T: Array  # (6, 12): velocity and position, grid axes and ECEF, with the state
    TP: Array  # (6, 12)
    Phi: Array  # (12, 13): transition since a fix's validity, and the corrections since
    A: Array  # (12, 14)
    L: Array  # (12, 12)
    z: Array  # (B, 2)
    S: Array  # (B, 3)
    wide: Array  # (B, 3): S with the common errors
    J: Array  # (B, 2, COMMON): innovation per unit of each common error
    common: Array  # (12, COMMON)
    z3: Array  # (3,)
    S3: Array  # (3, 3)
    PHt: Array  # (B, 2, 12)
    inflation: Array  # (B,)
    change: Array  # (2, KINDS SLOTS): of an innovation, by the hypotheses
    nis: Array  # (4,): of the last depth: NIS, innovation, its variance, 1 where fused
