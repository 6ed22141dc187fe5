"""Hydroacoustic station: range and bearing of a transponder, and their packet.

t1 the station pings, t2 the transponder hears it, t3 = t2 + turn-around it replies, t4 the reply
is back, T_sigma later the packet leaves:

    c (t2 - t1) = |p_T(t2) - p_S(t1)|        c (t4 - t3) = |p_S(t4) - p_T(t3)|
    range   = [ c_used (t4 - t1 - turn_around) / 2 (1 + u_1 e_range) ] rounded to its quantum
    bearing = [ angle of p_T(t3) - p_S(t4) from the station's heading + u_2 e_bearing ] rounded

with u uniform in [-1, 1]. Station axes are the grid axes at the station's first position, fixed to
the Earth. Source: DVL-less navigation, Drones 2025, 9(4), 299 (errors, quanta, packet).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import grid
from polar_nav_core.identification.polar_fix import PolarFix
from polar_nav_core.link.station_packet import SIZE, StationReport
from polar_nav_core.params import param, vector

from ..poses import Pose, Poses
from ..randomness import stream
from ..section import Spec
from ..sound_speed import SoundSpeed
from ..trajectory import NS
from ..travel import arrival_ns

Floats = NDArray[np.float64]

BITS = 8 * SIZE
"""Of a packet."""


@dataclass(frozen=True)
class StationErrors(Spec):
    """Errors and times of a station; defaults are the paper's where it has them."""

    transponder_lever_b: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'm', -100.0, 100.0, 'Transponder from base_link of the target, body axes'
    )
    turn_around_s: float = param(
        0.0, 's', 0.0, 10.0, 'From hearing to replying in the transponder'
    )
    processing_s: float = param(
        0.2, 's', 0.0, 60.0, 'T_sigma: from the reply to the first bit of the packet'
    )
    range_error: float = param(0.01, '', 0.0, 0.5, 'Largest error of the range, as a share of it')
    range_quantum_m: float = param(0.5, 'm', 0.0, 100.0, 'Resolution of the range; 0: none')
    bearing_error_deg: float = param(1.0, 'deg', 0.0, 90.0, 'Largest error of the bearing')
    bearing_quantum_deg: float = param(0.5, 'deg', 0.0, 90.0, 'Resolution of the bearing; 0: none')
    heading_bias_deg: float = param(
        0.0, 'deg', -180.0, 180.0, "Constant error of the station's heading, to port"
    )
    heading_sigma_deg: float = param(
        0.0, 'deg', 0.0, 180.0, '1-sigma of a further constant error, drawn per run; it is stated'
    )
    range_scale: float = param(0.0, '', -0.5, 0.5, 'Constant error of the range, as a share of it')
    position_offset_m: tuple[float, ...] = vector(
        (0.0, 0.0), 'm', -1e4, 1e4, 'Constant error of the position it states, station axes x, y'
    )
    loss_probability: float = param(0.0, '', 0.0, 1.0, 'Probability of a lost cycle')
    assumed_sound_speed: float = param(
        0.0, 'm/s', 0.0, 1655.0, 'Sound speed the station assumes; 0: the true mean of the cycle'
    )

    @property
    def bearing_sigma(self) -> float:
        """Of a bearing [rad]: uniform error and rounding."""
        error, quantum = math.radians(self.bearing_error_deg), self.bearing_quantum_deg
        return math.sqrt(error**2 / 3.0 + math.radians(quantum) ** 2 / 12.0)

    def range_sigma(self, range_m: float) -> float:
        """Of a range [m]: uniform error and rounding."""
        return math.sqrt((self.range_error * range_m) ** 2 / 3.0 + self.range_quantum_m**2 / 12.0)


def least_period_s(range_m: float, sound_speed: float, bit_rate: float, spare_s: float) -> float:
    """Shortest time between interrogations: 3 D / c + N / v + T_sigma [s].

    Ping out, reply back, packet out again, its N = 192 bits, and what passes between
    (``spare_s``: processing and turn-around).
    """
    return 3.0 * range_m / sound_speed + BITS / bit_rate + spare_s


class StationFrame:
    """Grid axes at a place, fixed to the Earth."""

    def __init__(self, r_e: Floats) -> None:
        self.origin_e = np.array(r_e)
        self.C_e_S = np.asarray(grid.ecef_to_grid(self.origin_e))

    def position(self, r_e: Floats) -> Floats:
        """Position in these axes [m], any number of rows."""
        return np.asarray((r_e - self.origin_e) @ self.C_e_S.T)

    def heading(self, C_b_e: Floats) -> float:
        """Angle psi of a body's x axis, counter-clockwise from x [rad]."""
        x_S = self.C_e_S @ C_b_e[:, 0]
        return math.atan2(x_S[1], x_S[0])


@dataclass(frozen=True)
class StationCycle:
    """One cycle as it happened: times [ns], true geometry at t4 and t3, station axes."""

    sequence: int
    t1_ns: int
    t2_ns: int
    t3_ns: int
    t4_ns: int
    position: Floats
    heading: float
    line: Floats
    sound_speed: float


@dataclass(frozen=True)
class StationReading:
    """Reading of a cycle, and the time of its packet."""

    cycle: StationCycle
    transmit_ns: int
    polar: PolarFix

    def report(self, source: int, target: int) -> StationReport:
        """Content of the packet."""
        return StationReport(
            source=source,
            target=target,
            sequence=self.cycle.sequence,
            validity_ns=self.cycle.t3_ns,
            station_position=self.polar.station,
            station_heading=self.polar.station_heading,
            station_heading_sigma=self.polar.station_heading_sigma,
            range=self.polar.range,
            bearing=self.polar.bearing,
            sound_speed=self.polar.sound_speed,
        )


class Station:
    """One station and the transponder of one vehicle.

    Parameters
    ----------
    errors : StationErrors
        Its errors.
    water : SoundSpeed
        Sound speed.
    run_seed : int
        Every cycle has its own stream, named by source, target and sequence.
    source, target : str
        Names of station and vehicle.
    frame : StationFrame
        Axes at its first position.
    """

    def __init__(
        self,
        errors: StationErrors,
        water: SoundSpeed,
        run_seed: int,
        source: str,
        target: str,
        frame: StationFrame,
    ) -> None:
        self._e = errors
        self._water = water
        self._seed = run_seed
        self._name = f'{source}/station/{target}'
        self._transponder_b = np.array(errors.transponder_lever_b)
        once = stream(run_seed, f'{source}/station/heading').standard_normal()
        self._heading_error = math.radians(
            errors.heading_bias_deg + errors.heading_sigma_deg * float(once)
        )
        self.frame = frame

    def cycle(self, sequence: int, t1_ns: int, station: Poses, target: Poses) -> StationCycle:
        """Times and true geometry of the cycle that begins at t1.

        Raises
        ------
        NotYet
            While the poses do not reach t4.
        """
        from_e, from_depth = _place(station.pose(t1_ns))
        t2_ns = arrival_ns(self._water, t1_ns, from_e, from_depth, target, self._transponder_b)
        t3_ns = t2_ns + round(self._e.turn_around_s * NS)
        reply_e, reply_depth = target.pose(t3_ns).point(self._transponder_b)
        t4_ns = arrival_ns(self._water, t3_ns, reply_e, reply_depth, station, _NO_ARM)
        pose = station.pose(t4_ns)
        back_e, back_depth = _place(pose)
        return StationCycle(
            sequence,
            t1_ns,
            t2_ns,
            t3_ns,
            t4_ns,
            self.frame.position(back_e),
            self.frame.heading(pose.C_b_e),
            self.frame.C_e_S @ (reply_e - back_e),
            self._water.mean(reply_depth, back_depth),
        )

    def read(self, cycle: StationCycle) -> StationReading | None:
        """Reading of a cycle; None without a reply."""
        e = self._e
        rng = stream(self._seed, f'{self._name}/{cycle.sequence}')
        lost, u_range, u_bearing = rng.random(3).tolist()
        if lost < e.loss_probability:
            return None
        # The packet states whole metres per second: the station computes with what it states.
        speed = float(round(e.assumed_sound_speed or cycle.sound_speed))
        travel_s = (cycle.t4_ns - cycle.t1_ns) / NS - e.turn_around_s
        range_m = 0.5 * speed * travel_s * (1.0 + e.range_error * (2.0 * u_range - 1.0))
        range_m *= 1.0 + e.range_scale
        bearing = math.atan2(cycle.line[1], cycle.line[0]) - cycle.heading
        bearing += math.radians(e.bearing_error_deg) * (2.0 * u_bearing - 1.0)
        range_m = _rounded(range_m, e.range_quantum_m)
        bearing = _rounded(bearing, math.radians(e.bearing_quantum_deg))
        return StationReading(
            cycle=cycle,
            transmit_ns=cycle.t4_ns + round(e.processing_s * NS),
            polar=PolarFix(
                station=cycle.position + np.array([*e.position_offset_m, 0.0]),
                station_heading=math.remainder(cycle.heading + self._heading_error, 2.0 * math.pi),
                station_heading_sigma=math.radians(e.heading_sigma_deg),
                range=range_m,
                range_sigma=e.range_sigma(range_m),
                bearing=math.remainder(bearing, 2.0 * math.pi),
                bearing_sigma=e.bearing_sigma,
                sound_speed=speed,
            ),
        )


_NO_ARM = np.zeros(3)


def _place(pose: Pose) -> tuple[Floats, float]:
    """Position of the station: that of its base_link, where its array is."""
    return pose.r_e, pose.depth


def _rounded(value: float, quantum: float) -> float:
    return quantum * round(value / quantum) if quantum > 0.0 else value
