"""The station scenario as arrays, for experiments: no ROS, a second per run, the same from a seed.

The messages of the nodes as arrays: the same motion, station, AHRS,
packets and acoustic channel, each with its own stream made from the seed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.errors import ConfigError
from polar_nav_core.link.station_packet import decode, encode

from .acoustics import Channel, ChannelSpec, Packet
from .dynamics.sampled import SampledMotion
from .dynamics_spec import BodySpec
from .mission import load_mission
from .poses import Poses, StillPoses, TrajectoryPoses
from .randomness import stream
from .sensors.ahrs import AhrsErrors, AhrsSensor
from .sensors.station import Station, StationErrors, StationFrame
from .sound_speed import SoundSpeed
from .station_sequence import SequenceSpec, StationSequence
from .trajectory import NS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

RATE_ERROR, ANGLE_ERROR, DEPTH_ERROR_M = 0.01, 0.02, 0.05
"""Largest errors of the paper's sensors [rad/s], [rad], [m]."""
STATION_ID, VEHICLE_ID = 1, 2


@dataclass(frozen=True)
class StationScenario:
    """Scenario of a run; the defaults are the paper's scenario at full noise.

    Attributes
    ----------
    mission : str
        Mission file or name; its leader is the station, its first follower the vehicle.
    duration_s : float
        Length [s].
    noise : float
        Factor of every error amplitude of sensors and station; quanta stay.
    loss : float
        Probability that a packet is lost.
    random_delay_s : float
        Mean of a random (exponential) delay of packets: queueing, other order [s].
    heading_bias : float
        Constant error of the vehicle's heading, counter-clockwise [rad].
    station_heading_bias, station_heading_sigma : float
        Constant unstated error of the station's heading; 1-sigma of a stated one [rad].
    excitation : float
        Factor of the changes of thrust; 0.25 is +-8 N, low excitation.
    current_change, current_turn, current_period_s : float
        Swing of the current: share of its speed, angle [rad]; 0.3 and 0.6 in 1800 s is "slow".
    sound_speed, assumed_sound_speed : float
        True, and assumed by the station (0: the true one) [m/s].
    processing_s, period_s, bit_rate : float
        T_sigma [s], between interrogations [s], of the packets [bit/s].
    when_short : str
        Where the period is shorter than 3 D/c + N/v + T_sigma: 'queue' or 'refuse'.
    """

    mission: str = 'station'
    duration_s: float = 1600.0
    noise: float = 1.0
    loss: float = 0.0
    random_delay_s: float = 0.0
    heading_bias: float = 0.0
    station_heading_bias: float = 0.0
    station_heading_sigma: float = 0.0
    excitation: float = 1.0
    current_change: float = 0.0
    current_turn: float = 0.0
    current_period_s: float = 1800.0
    sound_speed: float = 1500.0
    assumed_sound_speed: float = 0.0
    processing_s: float = 0.2
    period_s: float = 2.5
    bit_rate: float = 9600.0
    when_short: str = 'queue'


@dataclass(frozen=True)
class StationFixes:
    """Packets as they arrived, in the order of reception; all arrays have one row per packet.

    Attributes
    ----------
    sequence : ndarray of int64
        Number of the interrogation, not wrapped.
    validity_s, return_s, transmit_s, receive_s : ndarray
        t3 by the packet, t4, first bit sent, packet complete [s since the start].
    range, bearing : ndarray
        By the packet [m], [rad] from the station's heading.
    range_sigma, bearing_sigma : ndarray
        1-sigma of the station's errors [m], [rad].
    station_position : ndarray, shape (n, 3)
        Station axes [m].
    station_heading, station_heading_sigma : ndarray
        By the packet [rad].
    sound_speed : ndarray
        Used for the range [m/s].
    true_position : ndarray, shape (n, 3)
        Of the transponder at t3, station axes [m].
    """

    sequence: Ints
    validity_s: Floats
    return_s: Floats
    transmit_s: Floats
    receive_s: Floats
    range: Floats
    bearing: Floats
    range_sigma: Floats
    bearing_sigma: Floats
    station_position: Floats
    station_heading: Floats
    station_heading_sigma: Floats
    sound_speed: Floats
    true_position: Floats


@dataclass(frozen=True)
class StationRun:
    """One run; row k of every array is at t_s[k].

    Attributes
    ----------
    scenario, seed
        Scenario and seed of the run.
    start_ns : int
        Stamp of t = 0.
    t_s : ndarray, shape (n,)
        Time since the start [s], 100 Hz.
    omega_ib_b : ndarray, shape (n, 3)
        Mean rate as measured over the interval that ends at the time [rad/s].
    C_b_G : ndarray, shape (n, 3, 3)
        Attitude as measured, body to grid.
    force_b, torque_b : ndarray, shape (n, 3)
        Thrust from the time on, body axes, exact [N], [N m].
    depth : ndarray, shape (n,)
        As measured, positive down [m].
    fixes : StationFixes
        Packets that arrived.
    sent : int
        Packets that the station sent.
    p, v : ndarray, shape (n, 3)
        True position [m] and velocity over ground [m/s], station axes.
    v_r_b : ndarray, shape (n, 3)
        True velocity through the water, body axes [m/s].
    current : ndarray, shape (n, 3)
        True velocity of the water, station axes [m/s].
    true_omega_b : ndarray, shape (n, 3)
        True mean rate over the interval that ends at the time, against inertial space [rad/s].
    true_C_b_G : ndarray, shape (n, 3, 3)
        True attitude against the station's axes.
    psi : ndarray, shape (n,)
        True heading, counter-clockwise from x, continuous [rad].
    true_depth : ndarray, shape (n,)
        [m].
    station_depth : float
        Depth of the station's first position [m]: z = station_depth - depth, but for the Earth's
        curvature (0.1 m at 1.1 km).
    body : BodySpec
        The true inertia, drag and buoyancy.
    """

    scenario: StationScenario
    seed: int
    start_ns: int
    t_s: Floats
    omega_ib_b: Floats
    C_b_G: Floats
    force_b: Floats
    torque_b: Floats
    depth: Floats
    fixes: StationFixes
    sent: int
    p: Floats
    v: Floats
    v_r_b: Floats
    current: Floats
    true_omega_b: Floats
    true_C_b_G: Floats
    psi: Floats
    true_depth: Floats
    station_depth: float
    body: BodySpec


def simulate(scenario: StationScenario, seed: int) -> StationRun:
    """Arrays of one run, equal to the bit for the same scenario and seed.

    Raises
    ------
    ConfigError
        For a scenario that cannot be run: its mission, a period too short for the range.
    """
    s = scenario
    world = _world(
        s.mission,
        s.duration_s,
        s.excitation,
        s.current_change,
        s.current_turn,
        s.current_period_s,
    )
    motion = world.motion
    errors = StationErrors(
        processing_s=s.processing_s,
        range_error=0.01 * s.noise,
        bearing_error_deg=1.0 * s.noise,
        heading_bias_deg=math.degrees(s.station_heading_bias),
        heading_sigma_deg=math.degrees(s.station_heading_sigma),
        assumed_sound_speed=s.assumed_sound_speed,
    )
    fixes, sent = _fixes(s, seed, world, errors)
    ahrs = AhrsSensor(
        AhrsErrors(
            ahrs_rate_error=RATE_ERROR * s.noise,
            ahrs_angle_error=ANGLE_ERROR * s.noise,
            ahrs_heading_bias_deg=math.degrees(s.heading_bias),
        ),
        stream(seed, f'{world.vehicle}/ahrs'),
    )
    omega_ib_b, C_b_G = ahrs.measure(0, motion.omega_ib_b, motion.C_b_S)
    noise = stream(seed, f'{world.vehicle}/depth').uniform(-1.0, 1.0, len(motion.t_s))
    return StationRun(
        scenario=s,
        seed=seed,
        start_ns=world.start_ns,
        t_s=motion.t_s,
        omega_ib_b=omega_ib_b,
        C_b_G=C_b_G,
        force_b=motion.force_b,
        torque_b=motion.torque_b,
        depth=motion.depth + DEPTH_ERROR_M * s.noise * noise,
        fixes=fixes,
        sent=sent,
        p=motion.p,
        v=motion.v,
        v_r_b=motion.v_r_b,
        current=motion.current,
        true_omega_b=motion.omega_ib_b,
        true_C_b_G=motion.C_b_S,
        psi=motion.psi,
        true_depth=motion.depth,
        station_depth=world.own.pose(0).depth,
        body=world.body,
    )


@dataclass(frozen=True)
class _World:
    """Motion and places of a scenario, common to its seeds."""

    station: str
    vehicle: str
    start_ns: int
    end_ns: int
    own: StillPoses
    frame: StationFrame
    motion: SampledMotion
    body: BodySpec


@lru_cache(maxsize=2)
def _world(
    name: str, duration_s: float, excitation: float, change: float, turn: float, period_s: float
) -> _World:
    plain = load_mission(name)
    vehicle = plain.followers[0]
    dynamics = f'vehicles.{vehicle}.dynamics'
    mission = plain.with_overrides(
        {
            'duration_s': duration_s,
            f'{dynamics}.law.excitation': excitation,
            f'{dynamics}.current.change': change,
            f'{dynamics}.current.turn_deg': math.degrees(turn),
            f'{dynamics}.current.period_s': period_s,
        }
    )
    if not mission.formation[mission.leader].fixed:
        raise ConfigError(f'mission {name}: its leader is no fixed station')
    own = StillPoses(TrajectoryPoses(mission.truth(mission.leader)).pose(mission.start_ns))
    frame = StationFrame(own.pose(0).r_e)
    truth = mission.dynamics(vehicle)
    steps = round((mission.end_ns - mission.start_ns) / NS / truth.motion.step_s)
    return _World(
        mission.leader,
        vehicle,
        mission.start_ns,
        mission.end_ns,
        own,
        frame,
        SampledMotion(truth, steps + 1, frame),
        truth.spec.body,
    )


def _fixes(
    s: StationScenario, seed: int, world: _World, errors: StationErrors
) -> tuple[StationFixes, int]:
    """Packets that arrived in order of reception, and the number of sent ones."""
    water = SoundSpeed.constant(s.sound_speed)
    station = Station(errors, water, seed, world.station, world.vehicle, world.frame)
    spec = SequenceSpec(period_s=s.period_s, bit_rate=s.bit_rate, when_short=s.when_short)
    start_ns = world.start_ns
    sequence = StationSequence(station, world.own, world.motion, spec, errors, start_ns, start_ns)
    channel_spec = ChannelSpec(
        detection_delay_s=0.0,
        loss_probability=s.loss,
        random_delay='exponential',
        random_delay_mean_s=s.random_delay_s,
    )
    poses: dict[str, Poses] = {world.station: world.own, world.vehicle: world.motion}
    channel = Channel(channel_spec, water, seed, poses)
    places: dict[int, Floats] = {}
    for r in sequence.advance(world.end_ns):
        number = r.cycle.sequence
        places[number] = r.cycle.position + r.cycle.line
        data = encode(r.report(STATION_ID, VEHICLE_ID))
        channel.send(Packet(world.station, world.vehicle, number, r.transmit_ns, s.bit_rate, data))
    arrivals = channel.arrived(world.end_ns)
    reports = [decode(a.data, a.receive_ns) for a in arrivals]

    def seconds(stamps_ns: list[int]) -> Floats:
        return (np.array(stamps_ns, dtype=np.int64) - start_ns) / NS

    ranges = np.array([t.range for t in reports])
    fixes = StationFixes(
        sequence=np.array([a.sequence for a in arrivals], dtype=np.int64),
        validity_s=seconds([t.validity_ns for t in reports]),
        return_s=seconds([t.return_ns for t in reports]),
        transmit_s=seconds([a.packet.transmit_ns for a in arrivals]),
        receive_s=seconds([a.receive_ns for a in arrivals]),
        range=ranges,
        bearing=np.array([t.bearing for t in reports]),
        range_sigma=np.array([errors.range_sigma(float(r)) for r in ranges]),
        bearing_sigma=np.full(len(reports), errors.bearing_sigma),
        station_position=np.array([t.station_position for t in reports]).reshape(-1, 3),
        station_heading=np.array([t.station_heading for t in reports]),
        station_heading_sigma=np.array([t.station_heading_sigma for t in reports]),
        sound_speed=np.array([t.sound_speed for t in reports]),
        true_position=np.array([places[a.sequence] for a in arrivals]).reshape(-1, 3),
    )
    return fixes, channel.counts['sent']
