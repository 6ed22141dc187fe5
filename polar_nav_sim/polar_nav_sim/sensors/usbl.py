"""USBL: one two-way cycle with moving ends, and its reading.

t1 the array pings, t2 the transponder hears it, t3 = t2 + turn-around it replies, t4 the reply is
back:

    c (t2 - t1) = |p_T(t2) - p_A(t1)|        c (t4 - t3) = |p_A(t4) - p_T(t3)|

with p_A, p_T the positions of array and transponder (lever arms included). The instrument reports

    direction    = C_e_a(t4) (p_T(t3) - p_A(t4)) / |...|, noise on its x and y cosines
    round_trip   = t4 - t1 + noise
    range        = c_assumed (round_trip - turn_around) / 2

so the array's motion between t1 and t4 is still in the range, as it is in a real one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.attitude import exp
from polar_nav_core.params import flag, param, sigma, vector

from ..poses import Poses
from ..randomness import stream
from ..sound_speed import SoundSpeed
from ..trajectory import NS
from ..travel import arrival_ns
from .dvl import Mounting

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class UsblErrors(Mounting):
    """Errors and geometry of a USBL array and its transponder; the mounting is the array's."""

    transponder_lever_b: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'm', -100.0, 100.0, 'Transponder from base_link of the target, body axes'
    )
    turn_around_s: float = param(
        0.1, 's', 0.0, 10.0, 'From hearing to replying in the transponder'
    )
    cosine_sigma: float = sigma(
        1e-3, '', 0.5, '1-sigma of each of the x and y direction cosines (1e-3: 0.06 degrees)'
    )
    range_sigma_m: float = param(0.3, 'm', 0.0, 1000.0, '1-sigma of the range')
    tells_depth: bool = flag(True, 'Whether the transponder sends its depth with the reply')
    told_depth_sigma_m: float = param(0.05, 'm', 1e-4, 100.0, '1-sigma of that depth')
    loss_probability: float = param(0.0, '', 0.0, 1.0, 'Probability of a lost cycle')
    outlier_probability: float = param(0.0, '', 0.0, 1.0, 'Probability of a reply by another way')
    outlier_range_m: float = param(
        100.0, 'm', 0.0, 1e5, 'Such a reply is late by up to this, uniformly'
    )
    outlier_cosine_sigma: float = sigma(
        0.2, '', 1.0, '1-sigma of its further error of the direction cosines'
    )
    assumed_sound_speed: float = param(
        0.0, 'm/s', 0.0, 1700.0, 'Sound speed the array assumes; 0: the true mean of the cycle'
    )
    range_scale: float = param(0.0, '', -0.5, 0.5, 'Constant error of the range, as a share of it')
    range_scale_sigma: float = sigma(
        0.0, '', 0.5, '1-sigma of a further such error, drawn per run'
    )
    misalignment_sigma_deg: float = sigma(
        0.0, 'deg', 90.0, '1-sigma about each axis of a wrong mounting, drawn per run'
    )


@dataclass(frozen=True)
class Cycle:
    """One cycle as it happened: times [ns] and the true geometry at t4 and t3.

    Attributes
    ----------
    direction_a : ndarray, shape (3,)
        From the array at t4 to the transponder at t3, array axes, unit length.
    sound_speed : float
        Mean of the reply's way [m/s].
    reply_depth : float
        Of the transponder at t3 [m].
    """

    sequence: int
    t1_ns: int
    t2_ns: int
    t3_ns: int
    t4_ns: int
    direction_a: Floats
    sound_speed: float
    reply_depth: float


@dataclass(frozen=True)
class Reading:
    """Reading of a cycle; names as in polar_nav_msgs/UsblFix."""

    cycle: Cycle
    direction_a: Floats
    round_trip_s: float
    turn_around_s: float
    range_m: float
    sound_speed: float
    cosine_variance: float
    range_variance: float
    target_depth: float
    target_depth_variance: float


class Usbl:
    """A USBL array on one vehicle and a transponder on another.

    Parameters
    ----------
    errors : UsblErrors
        Errors and geometry.
    water : SoundSpeed
        Sound speed.
    run_seed : int
        Every cycle has its own stream, named by source, target and sequence: pace never changes
        it.
    source, target : str
        The vehicles.
    """

    def __init__(
        self, errors: UsblErrors, water: SoundSpeed, run_seed: int, source: str, target: str
    ) -> None:
        self._e = errors
        self._water = water
        self._seed = run_seed
        self._name = f'{source}/usbl/{target}'
        self._arm_b = errors.arm_b
        self._C_a_b = errors.C_s_b
        # Of the array, not of the pair: all targets share its errors.
        common = stream(run_seed, f'{source}/usbl/array').standard_normal(4)
        self._range_scale = errors.range_scale + errors.range_scale_sigma * float(common[3])
        if errors.misalignment_sigma_deg > 0.0:
            turn = math.radians(errors.misalignment_sigma_deg) * common[:3]
            self._C_a_b = np.asarray(self._C_a_b @ exp(turn))
        self._transponder_b = np.array(errors.transponder_lever_b)

    def cycle(self, sequence: int, t1_ns: int, array: Poses, target: Poses) -> Cycle:
        """Times and true geometry of the cycle that begins at t1.

        Raises
        ------
        NotYet
            While the poses do not reach t4.
        """
        from_e, from_depth = array.pose(t1_ns).point(self._arm_b)
        t2_ns = arrival_ns(self._water, t1_ns, from_e, from_depth, target, self._transponder_b)
        t3_ns = t2_ns + round(self._e.turn_around_s * NS)
        reply_e, reply_depth = target.pose(t3_ns).point(self._transponder_b)
        t4_ns = arrival_ns(self._water, t3_ns, reply_e, reply_depth, array, self._arm_b)
        pose = array.pose(t4_ns)
        back_e, back_depth = pose.point(self._arm_b)
        line_a = self._C_a_b.T @ pose.C_b_e.T @ (reply_e - back_e)
        length = float(np.linalg.norm(line_a))
        if length == 0.0:
            raise ValueError(f'{self._name}: array and transponder are at the same place')
        speed = self._water.mean(reply_depth, back_depth)
        direction_a = line_a / length
        return Cycle(sequence, t1_ns, t2_ns, t3_ns, t4_ns, direction_a, speed, reply_depth)

    def read(self, cycle: Cycle) -> Reading | None:
        """Reading of a cycle; None without a reply."""
        e = self._e
        rng = stream(self._seed, f'{self._name}/{cycle.sequence}')
        lost, strange, late = rng.random(3)
        w = rng.standard_normal(6)
        if lost < e.loss_probability:
            return None
        outlier = 1.0 if strange < e.outlier_probability else 0.0
        c_xy = cycle.direction_a[:2] + e.cosine_sigma * w[:2]
        c_xy = c_xy + outlier * e.outlier_cosine_sigma * w[2:4]
        error_m = e.range_sigma_m * w[4] + outlier * e.outlier_range_m * late
        speed = e.assumed_sound_speed or cycle.sound_speed
        true_s = (cycle.t4_ns - cycle.t1_ns) / NS
        if self._range_scale != 0.0:
            way_s = true_s - e.turn_around_s
            error_m += 0.5 * cycle.sound_speed * way_s * self._range_scale
        round_trip_s = true_s + 2.0 * error_m / cycle.sound_speed
        return Reading(
            cycle=cycle,
            direction_a=_unit(c_xy, float(cycle.direction_a[2])),
            round_trip_s=round_trip_s,
            turn_around_s=e.turn_around_s,
            range_m=0.5 * speed * (round_trip_s - e.turn_around_s),
            sound_speed=speed,
            cosine_variance=e.cosine_sigma**2,
            range_variance=e.range_sigma_m**2,
            target_depth=cycle.reply_depth + e.told_depth_sigma_m * w[5]
            if e.tells_depth
            else math.nan,
            target_depth_variance=e.told_depth_sigma_m**2 if e.tells_depth else 0.0,
        )


def _unit(c_xy: Floats, c_z: float) -> Floats:
    """Unit vector with the measured x and y cosines, on the side where the transponder is.

    Cosines that noise has made too long for any direction are shortened to the horizon of the
    array.
    """
    square = float(c_xy @ c_xy)
    if square >= 1.0:
        return np.array([*(c_xy / math.sqrt(square)), 0.0])
    return np.array([*c_xy, math.copysign(math.sqrt(1.0 - square), c_z)])
