"""Parameters of the leader node, and with them the specification of the leader's own system.

The defaults below that differ from the engine's are that specification; `docs/leader.md` gives
the reasons and the drift that follows. The instruments that the simulation gives a leader are the
presets `leader` of polar_nav_sim (a test holds both together).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from polar_nav_core.engine.methods import CONFIGURATIONS
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import choice, flag, param, sigma, text, vector

NAVIGATION = ('odometry', 'own')


@dataclass(frozen=True)
class LeaderParams(EngineParams):
    """Parameters of leader_node."""

    navigation: str = choice(
        'odometry',
        NAVIGATION,
        'odometry: another node publishes odometry, this one reads it; own: this node navigates '
        'with its own sensors and publishes odometry',
    )
    sources: str = text(
        '',
        'Mapping file of its sensors and position fixes (docs/live.md; navigation own); empty: '
        'topics of this project',
    )
    autostart: bool = flag(
        True, 'Navigate and publish at once; false: wait for the lifecycle transitions'
    )
    own_id: int = param(1, '', 0, 255, 'Number of this vehicle in its packets')
    follower: str = text('follower', 'Name of the follower that fixes are sent to')
    follower_id: int = param(2, '', 0, 255, 'Number of that follower in the packets')
    array_lever_b: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'm', -100.0, 100.0, 'USBL array from base_link, body axes'
    )
    array_rpy_deg: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'deg', -360.0, 360.0, 'Mounting of the array: roll, pitch, yaw'
    )
    formation: bool = flag(
        True, 'Assume that the follower moves as the leader during the turn-around'
    )
    processing_delay_s: float = param(
        0.3, 's', 0.0, 60.0, 'From the reply at the array (t4) to the first bit sent (t5)'
    )
    bit_rate: float = param(9600.0, 'bit/s', 1.0, 1e7, 'Of the acoustic modem')
    position_sigma: float = sigma(0.0, 'm', 1e4, '1-sigma per axis where the odometry states none')
    velocity_sigma: float = sigma(
        0.0, 'm/s', 100.0, '1-sigma per axis where the odometry states none'
    )
    attitude_sigma_deg: float = sigma(
        0.0, 'deg', 90.0, '1-sigma per axis where the odometry states none'
    )
    odometry_history_s: float = param(
        30.0, 's', 1.0, 600.0, 'Stored states of the leader; longer than a round trip'
    )

    # Absolute fixes are valid when they are received and state their noise: nothing to adapt, a
    # gate, and no need for a long history.
    configuration: str = choice(
        'default',
        (*CONFIGURATIONS, 'custom'),
        'Named set of delay handling, noise adaptation and gate (navigation own)',
    )
    max_delay_s: float = param(5.0, 's', 0.1, 120.0, 'Oldest fix that is still used')
    history_s: float = param(10.0, 's', 0.2, 130.0, 'Length of the stored history')

    initial_sigma_position: float = param(
        1.0, 'm', 1e-3, 1e6, '1-sigma per horizontal axis: GNSS at the surface'
    )
    initial_sigma_height: float = param(0.5, 'm', 1e-3, 1e6, '1-sigma')
    initial_sigma_tilt_deg: float = param(0.005, 'deg', 1e-7, 90.0, '1-sigma of roll and pitch')
    initial_sigma_heading_deg: float = param(
        0.06, 'deg', 1e-7, 180.0, '1-sigma: a gyrocompass of that gyro bias at 80 degrees north'
    )
    gyro_bias_sigma: float = param(
        1.4544e-8, 'rad/s', 1e-12, 1.0, '1-sigma of the constant gyro bias (0.003 deg/h)'
    )
    gyro_noise_density: float = param(
        2.909e-7, 'rad/s/sqrt(Hz)', 0.0, 1.0, 'Angle random walk (0.001 deg/sqrt(h))'
    )
    accel_bias_sigma: float = param(
        2.942e-4, 'm/s^2', 1e-12, 10.0, '1-sigma of the constant accelerometer bias (30e-6 g)'
    )
    accel_noise_density: float = param(
        4.903e-5, 'm/s^2/sqrt(Hz)', 0.0, 10.0, 'Velocity random walk (5e-6 g/sqrt(Hz))'
    )
    dvl_scale_sigma: float = param(5e-4, '', 1e-9, 0.5, '1-sigma of the DVL scale error')
    dvl_markov_sigma: float = param(
        0.002, 'm/s', 1e-9, 10.0, 'Steady 1-sigma of the DVL Markov velocity'
    )
    dvl_sigma: float = param(
        0.003, 'm/s', 1e-6, 10.0, 'White noise per ping where the message states none'
    )
    transponder_lever_b: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0),
        'm',
        -100.0,
        100.0,
        'What absolute fixes locate (antenna, transponder) from base_link',
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sources and self.navigation != 'own':
            raise ConfigError(
                'parameter sources: a leader takes a mapping file with `navigation: own`; with '
                '`odometry` another node navigates'
            )
        needed = self.reorder_window_s + self.output_period_s
        # In lockstep the packet's stamp counts and not when it is handed over.
        late = self.processing_delay_s < needed and not math.isclose(
            self.processing_delay_s, needed
        )
        if self.navigation == 'own' and not self.lockstep and late:
            raise ConfigError(
                f'parameter processing_delay_s: {self.processing_delay_s} s is shorter than '
                f'reorder_window_s + output_period_s, {needed:.3f} s: the leader would have '
                'no state of that time yet'
            )
