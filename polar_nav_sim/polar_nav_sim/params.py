"""Parameters of the nodes of this package: one dataclass each, made of the models' own."""

from __future__ import annotations

from dataclasses import dataclass

from polar_nav_core.params import NodeParams, choice, flag, param, text, texts

from .acoustics import ChannelSpec
from .sensors.absolute import AbsoluteErrors
from .sensors.ahrs import AhrsErrors
from .sensors.clock import ClockErrors
from .sensors.compass import REFERENCES, CompassErrors
from .sensors.depth import DepthErrors
from .sensors.dvl import DvlErrors
from .sensors.imu import ImuErrors
from .sensors.reference import ReferenceErrors
from .sensors.station import StationErrors
from .sensors.usbl import UsblErrors
from .sound_speed import WaterSpec
from .station_sequence import SequenceSpec

_SEED = 'Seed of the run; every random stream is made from it and its own name'


@dataclass(frozen=True)
class TruthParams(NodeParams):
    """Parameters of truth_node."""

    mission: str = text('demo', 'Mission file, or the name of one that comes with polar_nav_sim')
    duration_s: float = param(0.0, 's', 0.0, 7 * 86400.0, 'Length; 0: that of the mission')
    overrides: tuple[str, ...] = texts((), 'Changes of the mission, as path.speed_mps=2.0')
    pace: str = choice(
        'realtime', ('realtime', 'lockstep'), 'Wait for no node, or wait for all and lose nothing'
    )
    realtime_factor: float = param(1.0, '', 0.01, 1000.0, 'Mission seconds per second (realtime)')
    start_delay_s: float = param(
        0.0, 's', 0.0, 60.0, 'Before the first sample, for others to find this node (realtime)'
    )
    window_s: float = param(0.2, 's', 0.001, 10.0, 'Truth published at a time (lockstep)')
    expected_nodes: tuple[str, ...] = texts(
        (), 'Fully qualified names of the nodes that acknowledge (lockstep, or presence)'
    )
    gather_s: float = param(
        20.0,
        's',
        0.0,
        600.0,
        'Longest wait for the expected nodes before the first sample (realtime)',
    )
    max_behind_s: float = param(
        0.0,
        's',
        0.0,
        60.0,
        'The clock waits for expected nodes that are behind by more (realtime); 0: for none',
    )
    stall_s: float = param(
        10.0, 's', 0.5, 3600.0, 'Log nodes that delay the truth after this wall time'
    )
    exit_at_end: bool = flag(False, 'End with status 0 after the mission, when all is received')
    commands: bool = flag(
        False, 'Obey control/setpoint and control/thrust_command of vehicles with dynamics'
    )
    command_timeout_s: float = param(
        1.0, 's', 0.01, 3600.0, "A thrust command holds so long, then the vehicle's loops again"
    )


@dataclass(frozen=True)
class VehicleParams(TruthParams):
    """Parameters of vehicle_node."""

    mission: str = text(
        'station', 'Mission file, or the name of one that comes with polar_nav_sim'
    )


@dataclass(frozen=True)
class ImuParams(ImuErrors, AhrsErrors, ClockErrors, NodeParams):
    """Parameters of imu_node."""

    seed: int = param(1, '', 0, 2**31 - 1, _SEED)
    ahrs: bool = flag(
        False, 'Also publish imu/data: rates and the attitude of base_link in the local grid axes'
    )


@dataclass(frozen=True)
class DvlParams(DvlErrors, WaterSpec, ClockErrors, NodeParams):
    """Parameters of dvl_node."""

    seed: int = param(1, '', 0, 2**31 - 1, _SEED)
    rate_hz: float = param(5.0, 'Hz', 0.01, 50.0, 'Pings per second')


@dataclass(frozen=True)
class DepthParams(DepthErrors, ClockErrors, NodeParams):
    """Parameters of depth_node."""

    seed: int = param(1, '', 0, 2**31 - 1, _SEED)
    rate_hz: float = param(10.0, 'Hz', 0.01, 100.0, 'Samples per second')


@dataclass(frozen=True)
class AhrsParams(CompassErrors, ClockErrors, NodeParams):
    """Parameters of ahrs_node."""

    seed: int = param(1, '', 0, 2**31 - 1, _SEED)
    rate_hz: float = param(10.0, 'Hz', 0.01, 100.0, 'Samples per second')
    reference: str = choice('magnetic', REFERENCES, 'What its headings count from')


@dataclass(frozen=True)
class UsblParams(UsblErrors, WaterSpec, ClockErrors, NodeParams):
    """Parameters of usbl_node."""

    seed: int = param(1, '', 0, 2**31 - 1, _SEED)
    targets: tuple[str, ...] = texts(('follower',), 'Vehicles with a transponder, asked in turn')
    period_s: float = param(2.0, 's', 0.1, 3600.0, 'Between interrogations')
    first_ping_s: float = param(1.0, 's', 0.0, 3600.0, 'First interrogation after the start')


@dataclass(frozen=True)
class StationParams(StationErrors, SequenceSpec, WaterSpec, NodeParams):
    """Parameters of station_node."""

    seed: int = param(1, '', 0, 2**31 - 1, _SEED)
    target: str = text('auv', 'Vehicle with the transponder')
    own_id: int = param(1, '', 0, 255, 'Number of this station in its packets')
    target_id: int = param(2, '', 0, 255, 'Number of that vehicle in the packets')


@dataclass(frozen=True)
class LeaderReferenceParams(ReferenceErrors, ClockErrors, NodeParams):
    """Parameters of leader_reference_node."""

    seed: int = param(1, '', 0, 2**31 - 1, _SEED)
    rate_hz: float = param(10.0, 'Hz', 0.1, 100.0, 'Odometry messages per second')


@dataclass(frozen=True)
class AbsoluteFixParams(AbsoluteErrors, ClockErrors, NodeParams):
    """Parameters of absolute_fix_node: GNSS at the surface, or a beacon under the ice."""

    seed: int = param(1, '', 0, 2**31 - 1, _SEED)


@dataclass(frozen=True)
class AcousticLinkParams(ChannelSpec, WaterSpec, NodeParams):
    """Parameters of acoustic_link_node."""

    seed: int = param(1, '', 0, 2**31 - 1, _SEED)
    vehicles: tuple[str, ...] = texts(('leader', 'follower'), 'Vehicles that have a modem')
