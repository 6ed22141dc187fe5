"""Parameters of the engine: configuration, errors of the sensors, filter."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..dvl import SOUND_SPEED_LIMITS
from ..errors import ConfigError
from ..identification.params import IdentificationParams
from ..order import ROBUST_FIXES
from ..params import choice, param, sigma, vector
from .heading_params import HeadingParams
from .limit_params import LimitParams
from .methods import (
    COMPILED_NOISE,
    CONFIGURATIONS,
    DELAY_HANDLING,
    NOISE_ADAPTATION,
    NOISE_OF,
    STATION_CONFIGURATIONS,
    STATION_DELAYS,
    Configuration,
)
from .plausibility import initial_problem
from .start_params import StartParams
from .station_params import StationParams

NO_CEILING = 1e300
"""An adaptive_ceiling that no variance reaches: that of engine 1."""
NO_RESERVE: dict[str, float] = {'gyro_bias_walk': 0.0, 'accel_bias_walk': 0.0}
"""Parameters of a world whose IMU has constant biases, and whose gravity is the normal one."""
NO_COMMON_ERRORS: dict[str, float] = dict.fromkeys(
    (
        'fix_range_scale_sigma',
        'fix_heading_sigma_deg',
        'fix_clock_sigma',
        'fix_offset_sigma',
        'dvl_misalignment_sigma_deg',
        'dvl_lever_sigma',
        'dvl_latency_sigma',
        'depth_offset_sigma',
        'station_range_scale_sigma',
        'station_turn_sigma_deg',
        'station_position_sigma',
    ),
    0.0,
)
"""Parameters of a world whose fixes and sensors have no error in common but what is estimated."""


@dataclass(frozen=True)
class EngineParams(StartParams, IdentificationParams, StationParams, LimitParams, HeadingParams):
    """Parameters of a vehicle's navigation in either mode; nodes add their own."""

    mode: str = choice(
        'sins',
        ('sins', 'station'),
        'Strapdown with DVL, or a vehicle model with an AHRS and the fixes of a station',
    )
    configuration: str = choice(
        'default',
        (*CONFIGURATIONS, 'custom'),
        'Named set of delay handling, noise adaptation and gate',
    )
    delay_handling: str = choice(
        'back_propagate', DELAY_HANDLING, 'Late fixes; used when configuration is custom'
    )
    noise_adaptation: str = choice(
        'none', NOISE_ADAPTATION, 'Measurement noise; used when configuration is custom'
    )
    gate_probability: float = param(
        0.9999,
        '',
        0.5,
        1.0,
        'Chi-square gate keeps this share of good measurements, 1.0 is no gate; used when custom',
    )
    robust_fixes: str = choice(
        'none',
        ROBUST_FIXES,
        'Less weight for position fixes far off, besides the gate; used when custom',
    )
    max_gated_s: float = param(
        300.0, 's', 1.0, 86400.0, 'Fixes that are gated for longer are an error in diagnostics'
    )
    lost_radius: float = param(
        1000.0, 'm', 1.0, 1e7, 'Horizontal 95 % radius from which on the vehicle counts as lost'
    )
    reorder_window_s: float = param(
        0.05, 's', 0.0, 10.0, 'Stamp time that messages may come out of order'
    )
    output_period_s: float = param(0.1, 's', 0.01, 10.0, 'Time between estimates')
    filter_period_s: float = param(0.1, 's', 0.01, 1.0, 'Time between covariance steps')
    imu_sample: str = choice(
        'mean',
        ('mean', 'instant'),
        'Whether IMU samples are means over the interval or values at the stamp',
    )
    max_delay_s: float = param(60.0, 's', 0.1, 120.0, 'Oldest fix that is still used')
    history_s: float = param(65.0, 's', 0.2, 130.0, 'Length of the stored history')

    gyro_bias_sigma: float = param(
        1.454e-7, 'rad/s', 1e-12, 1.0, '1-sigma of the constant gyro bias (0.03 deg/h)'
    )
    gyro_noise_density: float = param(1.533e-9, 'rad/s/sqrt(Hz)', 0.0, 1.0, 'Angle random walk')
    gyro_bias_walk: float = param(
        7e-10,
        'rad/s/sqrt(s)',
        0.0,
        1.0,
        'Random walk of the gyro bias: an instability of 0.01 deg/h in 80 min',
    )
    accel_bias_sigma: float = param(
        9.80665e-6, 'm/s^2', 1e-12, 10.0, '1-sigma of the constant accelerometer bias (1e-6 g)'
    )
    accel_noise_density: float = param(
        3.101e-7, 'm/s^2/sqrt(Hz)', 0.0, 10.0, 'Velocity random walk'
    )
    accel_bias_walk: float = param(
        2e-6,
        'm/s^2/sqrt(s)',
        0.0,
        10.0,
        'Random walk of the accelerometer bias: gravity anomalies of 20 mGal over 20 km at 2 m/s',
    )

    dvl_scale_sigma: float = param(
        0.004,
        '',
        1e-9,
        0.5,
        '1-sigma of the DVL scale error: a Workhorse 300; 0.03 with an unknown sound speed',
    )
    dvl_markov_sigma: float = param(
        0.02,
        'm/s',
        1e-9,
        10.0,
        'Steady 1-sigma of the DVL Markov velocity: as installed (data sheets: 0.001 to 0.005)',
    )
    dvl_markov_tau: float = param(300.0, 's', 0.1, 1e6, 'Its correlation time')
    dvl_sigma: float = param(
        0.005,
        'm/s',
        1e-6,
        10.0,
        'White noise per ping where the message states none, or less than 0.001, which no DVL has',
    )
    water_sound_speed: float = param(
        0.0,
        'm/s',
        0.0,
        1700.0,
        'Of the water at the vehicle; corrects a DVL that states the one it assumed; 0: unknown',
    )
    dvl_lever_b: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'm', -100.0, 100.0, 'DVL from base_link, body axes'
    )
    dvl_rpy_deg: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'deg', -360.0, 360.0, 'Mounting of the DVL: roll, pitch, yaw'
    )
    dvl_turn_velocity: str = choice(
        'carried',
        ('carried', 'known', 'measured'),
        'Velocity that an error of attitude turns, in the rows of a DVL ping: as known with the '
        'ping, and the heading by that which the covariance was made with, so that no correction '
        'of it shows one (carried: docs/derivations/measurements.md, 1); as known, for all axes '
        '(engines 6 to 16); or as measured, noise and all (up to engine 5)',
    )
    dvl_scale_velocity: str = choice(
        'steady',
        ('steady', 'predicted'),
        'Velocity that a scale error of the DVL multiplies, in the rows of a ping: without what '
        'is jitter of the estimate, or the predicted one (up to engine 14, but for noisy IMUs)',
    )
    depth_sigma: float = param(
        0.05, 'm', 1e-6, 100.0, 'Noise of depth where the message states none'
    )
    depth_lever_b: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'm', -100.0, 100.0, 'Pressure sensor from base_link'
    )
    sea_surface_height: float = param(
        0.0, 'm', -12000.0, 9000.0, 'Of the sea (or lake) surface above the ellipsoid'
    )
    transponder_lever_b: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0),
        'm',
        -100.0,
        100.0,
        'Transponder (what position fixes locate) from base_link',
    )
    usbl_bias_sigma: float = sigma(
        0.0, 'm', 1000.0, 'Steady 1-sigma of a slowly varying USBL error; 0: not estimated'
    )
    usbl_bias_tau: float = param(600.0, 's', 1.0, 1e6, 'Its correlation time')
    leader_error_tau: float = param(
        5400.0,
        's',
        0.0,
        1e6,
        'Correlation time of the error that fixes share with their leader (position, heading; its '
        'sigma comes with each packet); 0: each fix has its own; not used with usbl_bias_sigma',
    )

    leader_drift_sigma: float = sigma(
        1.0,
        '',
        10.0,
        'Of what the position error of a leader has grown by, in its stated sigmas: 1-sigma of '
        'constant errors (turn and scale of its way, start) that enlarge what is published',
    )
    leader_link: str = choice(
        'kept',
        ('kept', 'present'),
        'What the stated heading of a leader may have turned of its way. kept: what its sigma has '
        'grown by, and nothing for good once packets show that something else holds it; present: '
        'what the present packet allows (up to engine 8)',
    )
    leader_shape: str = choice(
        'way',
        ('way', 'round'),
        'Shape of the position error of a leader that dead reckons along its stated heading. way: '
        'as its way tells, as far as it sails straight; round: the same in all directions (up to '
        'engine 26)',
    )
    fix_range_scale_sigma: float = sigma(
        0.005, '', 0.5, '1-sigma of a scale error that all ranges share (sound speed)'
    )
    fix_heading_sigma_deg: float = sigma(
        0.3, 'deg', 90.0, "1-sigma of the leader's array being turned, constant"
    )
    fix_clock_sigma: float = sigma(
        0.01, 's', 100.0, '1-sigma of the constant offset between the clocks of both vehicles'
    )
    fix_offset_sigma: float = sigma(
        0.3, 'm', 1e4, '1-sigma per axis of a constant error that all position fixes share'
    )
    dvl_misalignment_sigma_deg: float = sigma(
        0.3, 'deg', 90.0, '1-sigma of yaw and pitch of the DVL against its stated mounting'
    )
    dvl_lever_sigma: float = sigma(
        0.1, 'm', 100.0, '1-sigma per horizontal axis of the error of dvl_lever_b'
    )
    dvl_latency_sigma: float = sigma(
        0.05, 's', 100.0, '1-sigma of the age of a ping that its stamp does not tell'
    )
    depth_offset_sigma: float = sigma(
        0.5, 'm', 1000.0, '1-sigma of the zero of depth: air pressure, tide, geoid'
    )
    reopen_after_s: float = param(
        10.0,
        's',
        0.0,
        86400.0,
        'A gate that refuses agreeing pings or depths opens again after this, with the covariance '
        'enlarged; 0 is never',
    )
    forgetting: float = param(
        0.99, '', 0.5, 0.999999, 'Forgetting factor b of all noise adaptations'
    )
    adaptive_floor: float = param(
        0.5,
        '',
        1e-3,
        1.0,
        'adaptive_r and sage_husa take no variance below this share of the stated one',
    )
    adaptive_ceiling: float = param(
        25.0,
        '',
        1.0,
        NO_CEILING,
        'adaptive_r and sage_husa take no variance above so many times the stated one',
    )
    published_start: float = param(
        0.0,
        '',
        0.0,
        1e6,
        'Measurements that d_k counts as seen before the first, in sage_husa_unguarded and '
        'sage_husa_published; 0 as printed',
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.history_s < self.max_delay_s + self.filter_period_s:
            raise ConfigError(
                f'parameter history_s: {self.history_s} s is shorter than max_delay_s '
                f'{self.max_delay_s} s and one filter step of {self.filter_period_s} s'
            )
        if self.mode == 'station' and self.configuration not in ('default', 'custom'):
            raise ConfigError(
                f'parameter configuration: {self.configuration} does not go with mode station; '
                'that takes default, custom'
            )
        if 0.0 < self.water_sound_speed < SOUND_SPEED_LIMITS[0]:
            raise ConfigError(
                f'parameter water_sound_speed: {self.water_sound_speed} m/s is of no water; '
                f'{SOUND_SPEED_LIMITS[0]:g} to {SOUND_SPEED_LIMITS[1]:g}, or 0 for unknown'
            )
        chosen = self.resolved()
        if self.mode == 'station' and chosen.noise_adaptation != 'none':
            raise ConfigError(
                f'parameter noise_adaptation: {chosen.noise_adaptation} does not go with mode '
                'station; that takes none'
            )
        possible = STATION_DELAYS[self.station_filter]
        if self.mode == 'station' and chosen.delay_handling not in possible:
            raise ConfigError(
                f'parameter delay_handling: {chosen.delay_handling} does not go with '
                f'station_filter {self.station_filter}; that takes {", ".join(possible)}'
            )
        possible = NOISE_OF.get(chosen.delay_handling, NOISE_ADAPTATION)
        if chosen.noise_adaptation not in possible:
            raise ConfigError(
                f'parameter noise_adaptation: {chosen.noise_adaptation} does not go with '
                f'delay_handling {chosen.delay_handling}; that takes {", ".join(possible)}'
            )
        if self.model_aiding and self.mode == 'sins':
            self._check_model_aiding(chosen)
        initial = self.initial_state()
        if initial is not None and initial_problem(initial):
            raise ConfigError(f'parameters initial_*: {initial_problem(initial)}')
        if self.uses_heading and self.usbl_bias_sigma > 0.0:
            raise ConfigError(
                'parameter heading_reference: headings do not go with usbl_bias_sigma, both are '
                'estimated in the same three states'
            )

    def _check_model_aiding(self, chosen: Configuration) -> None:
        """Refuse settings that the seven states of the model cannot be combined with."""
        if chosen.delay_handling == 'clone':
            raise ConfigError(
                'parameter delay_handling: clone does not go with model_aiding, its stored steps '
                'are of the 24 states; that takes '
                f'{", ".join(d for d in DELAY_HANDLING if d != "clone")}'
            )
        if chosen.noise_adaptation not in COMPILED_NOISE:
            raise ConfigError(
                f'parameter noise_adaptation: {chosen.noise_adaptation} does not go with '
                f'model_aiding, its Q is of the 24 states; that takes {", ".join(COMPILED_NOISE)}'
            )
        model = self.vehicle_model()
        slope = model.drag_linear + 2.0 * model.drag_quadratic * self.model_speed
        shortest_s = float((model.inertia / slope.clip(1e-12)).min())
        if self.filter_period_s > shortest_s:
            raise ConfigError(
                f'parameter filter_period_s: {self.filter_period_s} s is longer than the '
                f'{shortest_s:.3f} s in which drag stops the vehicle of parameters model_*'
            )

    @property
    def uses_heading(self) -> bool:
        """Whether measured headings are used."""
        return self.mode == 'sins' and self.heading_reference != 'none'

    @property
    def uses_water_track(self) -> bool:
        """Whether velocities through the water are used, while there is no bottom lock."""
        return self.mode == 'sins' and self.model_aiding and self.water_track_sigma > 0.0

    def resolved(self) -> Configuration:
        """Return the configuration in force."""
        if self.configuration == 'custom':
            return Configuration(
                self.delay_handling,
                self.noise_adaptation,
                self.gate_probability,
                'as set',
                self.robust_fixes,
            )
        if self.mode == 'station':
            return STATION_CONFIGURATIONS[self.station_filter]
        named = CONFIGURATIONS[self.configuration]
        if self.model_aiding and named.delay_handling == 'clone':
            return replace(named, delay_handling='rewind')  # stored steps are of the 24 states
        return named
