"""Error models of commercial instruments, each number with its source.

Comments name the source of each line: a data sheet; ``unconfirmed`` where the number is from
memory and no data sheet was at hand to check it; ``ours`` where no source states it. A number that
a data sheet states as typical or as a limit, without a distinction, is used as 1-sigma.

Temperature: data sheets state the residual over their whole range. That it changes by its own RMS
over 20 K is ours; the deck is then 12 K warmer than the water (the defaults of ImuErrors).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from . import presets
from .absolute import AbsoluteErrors
from .compass import CompassErrors
from .depth import DepthErrors
from .dvl import DvlErrors
from .imu import MICRO_G, ImuErrors
from .presets import Preset
from .reference import ReferenceErrors
from .usbl import UsblErrors

_ZERO = (0.0, 0.0, 0.0)
_DEG_S_ROOT_HZ = math.radians(1.0)
_DEG_ROOT_HOUR = math.radians(1.0) / 60.0
_M_S_ROOT_HOUR = 1.0 / 60.0
_DEG_S_IN_DPH = 3600.0
_SURE_OF_NOTHING_DEG = 180.0 / math.sqrt(3.0)
"""1-sigma of an unknown heading."""
_MEMORY = 'unconfirmed (no data sheet at hand)'

_STIM300 = ImuErrors(
    gyro_bias_dph=_ZERO,
    gyro_turn_on_sigma_dph=5.0,  # bias error over temperature: TS1524
    gyro_noise_density=(0.15 * _DEG_ROOT_HOUR,) * 3,  # TS1524
    gyro_instability_sigma_dph=0.5,  # TS1524
    gyro_instability_tau_s=1000.0,  # ours
    gyro_scale_sigma=5e-4,  # 500 ppm: TS1524
    gyro_misalignment_sigma=1e-3,  # 1 mrad: TS1524
    gyro_temperature_sigma_dph=5.0 / 20.0,  # 5 deg/h over temperature: TS1524; per 20 K: ours
    gyro_g_sigma_dph=1.0,  # linear acceleration effect: TS1524
    gyro_range=math.radians(400.0),  # TS1524
    accel_bias_ug=_ZERO,
    accel_turn_on_sigma_ug=750.0,  # on-off repeatability, 10 g: TS1524
    accel_noise_density=(0.06 * _M_S_ROOT_HOUR,) * 3,  # TS1524
    accel_instability_sigma_ug=50.0,  # TS1524
    accel_instability_tau_s=1000.0,  # ours
    accel_scale_sigma=3e-4,  # 300 ppm: TS1524
    accel_misalignment_sigma=1e-3,  # 1 mrad: TS1524
    accel_temperature_sigma_ug=2000.0 / 20.0,  # 2 mg over temperature: TS1524; per 20 K: ours
    accel_range=98.0665,  # 10 g: TS1524
)
_FOG = ImuErrors(
    gyro_bias_dph=_ZERO,
    gyro_turn_on_sigma_dph=1.0,  # ours
    gyro_noise_density=(0.012 * _DEG_ROOT_HOUR,) * 3,  # unconfirmed
    gyro_instability_sigma_dph=0.05,  # unconfirmed
    gyro_instability_tau_s=1000.0,  # ours
    gyro_scale_sigma=1e-4,  # ours
    gyro_misalignment_sigma=4e-4,  # ours
    gyro_temperature_sigma_dph=1.0 / 20.0,  # ours
    gyro_range=math.radians(490.0),  # unconfirmed
    accel_bias_ug=_ZERO,
    accel_turn_on_sigma_ug=1000.0,  # ours
    accel_noise_density=(120.0 * MICRO_G,) * 3,  # unconfirmed
    accel_instability_sigma_ug=50.0,  # ours, as the STIM300
    accel_instability_tau_s=1000.0,  # ours
    accel_scale_sigma=5e-4,  # ours
    accel_misalignment_sigma=1e-3,  # ours
    accel_temperature_sigma_ug=1000.0 / 20.0,  # ours
    accel_range=98.0665,  # 10 g: KVH technical manual of the 1775, same family
)
_VN100 = ImuErrors(
    gyro_bias_dph=_ZERO,
    gyro_turn_on_sigma_dph=100.0,  # ours
    gyro_noise_density=(0.0035 * _DEG_S_ROOT_HZ,) * 3,  # unconfirmed
    gyro_instability_sigma_dph=7.0,  # 5 to 10: unconfirmed
    gyro_instability_tau_s=300.0,  # ours
    gyro_scale_sigma=1e-3,  # ours
    gyro_misalignment_sigma=1e-3,  # ours
    gyro_temperature_sigma_dph=5.0,  # ours
    gyro_g_sigma_dph=20.0,  # ours
    gyro_range=math.radians(2000.0),  # unconfirmed
    accel_bias_ug=_ZERO,
    accel_turn_on_sigma_ug=5000.0,  # ours
    accel_noise_density=(140.0 * MICRO_G,) * 3,  # unconfirmed
    accel_instability_sigma_ug=40.0,  # unconfirmed
    accel_instability_tau_s=300.0,  # ours
    accel_scale_sigma=1e-3,  # ours
    accel_misalignment_sigma=1e-3,  # ours
    accel_temperature_sigma_ug=100.0,  # ours
    accel_range=16.0 * 9.80665,  # unconfirmed
)
_BMI088 = ImuErrors(
    gyro_bias_dph=_ZERO,
    gyro_turn_on_sigma_dph=1.0 * _DEG_S_IN_DPH,  # zero-rate offset 1 deg/s: unconfirmed
    gyro_noise_density=(0.014 * _DEG_S_ROOT_HZ,) * 3,  # BST-BMI088-DS001
    gyro_instability_sigma_dph=5.0,  # ours
    gyro_instability_tau_s=300.0,  # ours
    gyro_scale_sigma=5e-3,  # ours
    gyro_misalignment_sigma=5e-3,  # ours
    gyro_temperature_sigma_dph=0.015 * _DEG_S_IN_DPH,  # 0.015 deg/s/K: unconfirmed
    gyro_g_sigma_dph=0.1 * _DEG_S_IN_DPH,  # 0.1 deg/s/g: unconfirmed
    gyro_range=math.radians(2000.0),  # BST-BMI088-DS001, largest range
    accel_bias_ug=_ZERO,
    accel_turn_on_sigma_ug=20e3,  # zero-g offset 20 mg: unconfirmed
    accel_noise_density=(175.0 * MICRO_G,) * 3,  # 160 to 190: unconfirmed
    accel_instability_sigma_ug=50.0,  # ours
    accel_instability_tau_s=300.0,  # ours
    accel_scale_sigma=5e-3,  # ours
    accel_misalignment_sigma=5e-3,  # ours
    accel_temperature_sigma_ug=200.0,  # 0.2 mg/K: unconfirmed
    accel_range=24.0 * 9.80665,  # BST-BMI088-DS001, largest range
)
_ICM20948 = ImuErrors(
    gyro_bias_dph=_ZERO,
    gyro_turn_on_sigma_dph=5.0 * _DEG_S_IN_DPH,  # 5 deg/s: unconfirmed
    gyro_noise_density=(0.015 * _DEG_S_ROOT_HZ,) * 3,  # unconfirmed
    gyro_instability_sigma_dph=10.0,  # ours
    gyro_instability_tau_s=300.0,  # ours
    gyro_scale_sigma=1e-2,  # ours
    gyro_misalignment_sigma=2e-2,  # as the accelerometers: ours
    gyro_temperature_sigma_dph=0.05 * _DEG_S_IN_DPH,  # 0.05 deg/s/K: unconfirmed
    gyro_g_sigma_dph=0.1 * _DEG_S_IN_DPH,  # ours
    gyro_range=math.radians(2000.0),  # DS-000189 v1.3, largest range
    accel_bias_ug=_ZERO,
    accel_turn_on_sigma_ug=50e3,  # 50 mg on a board: DS-000189 v1.3, table 2
    accel_noise_density=(230.0 * MICRO_G,) * 3,  # DS-000189 v1.3, table 2
    accel_instability_sigma_ug=100.0,  # ours
    accel_instability_tau_s=300.0,  # ours
    accel_scale_sigma=5e-3,  # 0.5 %: DS-000189 v1.3, table 2
    accel_misalignment_sigma=2e-2,  # cross-axis 2 %: DS-000189 v1.3, table 2
    accel_temperature_sigma_ug=800.0,  # 0.8 mg/K: DS-000189 v1.3, table 2
    accel_range=16.0 * 9.80665,  # DS-000189 v1.3, table 2, largest range
)

IMU: dict[str, Preset[ImuErrors]] = {
    **presets.IMU,
    'stim300': Preset(_STIM300, 'Sensonor data sheet TS1524 (STIM300, 10 g); see the comments'),
    'fog': Preset(_FOG, f'class of the KVH 1750: {_MEMORY}, the rest ours'),
    'vn100': Preset(_VN100, f'VectorNav VN-100: {_MEMORY}, the rest ours'),
    'bmi088': Preset(
        _BMI088, f'Bosch data sheet BST-BMI088-DS001-14, revision 1.4, September 2018; {_MEMORY}'
    ),
    'icm20948': Preset(
        _ICM20948, f'TDK data sheet DS-000189, revision 1.3: accelerometer; gyro {_MEMORY}'
    ),
}
"""Models of IMUs, by name."""

_NO_SCALE = DvlErrors(scale=_ZERO)
_A50 = replace(
    _NO_SCALE,
    markov_sigma=0.001,  # 0.1 cm/s long term: Water Linked documentation
    noise_sigma=0.005,  # ours
    min_altitude_m=0.05,  # Water Linked documentation
    max_altitude_m=50.0,  # Water Linked documentation
    misalignment_sigma_deg=0.5,  # ours: mounted by hand
)
_WORKHORSE = replace(_NO_SCALE, misalignment_sigma_deg=0.2)  # ours: aligned once
_A50_SOURCE = (
    'Water Linked documentation (docs.waterlinked.com): 0.05 to 50 m, 0.1 cm/s, 5 to 6 Hz'
)

DVL: dict[str, Preset[DvlErrors]] = {
    **presets.DVL,
    'a50_standard': Preset(
        # 1 % and, in firmware 1.3.1, a constant 1500 m/s: Water Linked documentation and forum
        replace(_A50, scale_sigma=0.01, assumed_sound_speed=1500.0),
        f'{_A50_SOURCE}, 1 %, 1500 m/s; noise and mounting are ours',
        rate_hz=5.0,
    ),
    'a50_performance': Preset(
        # 0.1 %; its sound speed can be set: Water Linked documentation
        replace(_A50, scale_sigma=0.001),
        f'{_A50_SOURCE}, 0.1 %, sound speed set; noise and mounting are ours',
        rate_hz=5.0,
    ),
    'workhorse_1200': Preset(
        # 0.2 % and 1 mm/s, 30 m: unconfirmed; noise, nearest altitude: ours
        replace(
            _WORKHORSE,
            scale_sigma=0.002,
            markov_sigma=0.001,
            noise_sigma=0.003,
            min_altitude_m=0.5,
            max_altitude_m=30.0,
        ),
        f'Teledyne Workhorse Navigator 1200 kHz: {_MEMORY}; noise, mounting and rate are ours',
        rate_hz=5.0,
    ),
    'workhorse_300': Preset(
        # 0.4 % and 2 mm/s, 200 m: unconfirmed; noise, nearest altitude: ours
        replace(
            _WORKHORSE,
            scale_sigma=0.004,
            markov_sigma=0.002,
            noise_sigma=0.01,
            min_altitude_m=1.0,
            max_altitude_m=200.0,
        ),
        f'Teledyne Workhorse Navigator 300 kHz: {_MEMORY}; noise, mounting and rate are ours',
        rate_hz=2.0,
    ),
    'pathfinder_600': Preset(
        # 0.2 %, 90 m: unconfirmed; phased array: definition of marine_acoustic_msgs/Dvl
        replace(
            _WORKHORSE,
            scale_sigma=0.002,
            markov_sigma=0.001,
            noise_sigma=0.005,
            min_altitude_m=0.3,
            max_altitude_m=90.0,
            phased_array=True,
        ),
        f'Teledyne Pathfinder 600 kHz, phased array: {_MEMORY}; noise, mounting, rate are ours',
        rate_hz=5.0,
    ),
}
"""Models of DVLs, by name."""

USBL: dict[str, Preset[UsblErrors]] = {
    **presets.USBL,
    'ship': Preset(
        # 0.1 % of the slant range in both directions together, 0.1 m: unconfirmed
        UsblErrors(cosine_sigma=1e-3 / math.sqrt(2.0), range_sigma_m=0.1),
        f'ship class, calibrated: {_MEMORY}',
    ),
    'mid': Preset(
        # 0.3 to 0.5 deg installed: unconfirmed; half of its variance in the mounting: ours
        UsblErrors(
            cosine_sigma=math.radians(0.4) / math.sqrt(2.0),
            misalignment_sigma_deg=0.4 / math.sqrt(2.0),
            range_sigma_m=0.2,
        ),
        f'middle class as installed: {_MEMORY}; noise and mounting share its variance: ours',
    ),
    'seatrac': Preset(
        # 1 deg: unconfirmed; 0.1 m: resolution of its range field
        UsblErrors(cosine_sigma=math.radians(1.0), range_sigma_m=0.1, misalignment_sigma_deg=0.5),
        f'small class (Blueprint Subsea SeaTrac X150): {_MEMORY}; mounting is ours',
    ),
}
"""Models of USBLs, by name."""

DEPTH: dict[str, Preset[DepthErrors]] = {
    'default': Preset(DepthErrors(), 'ours: white noise alone'),
    'quartz': Preset(
        DepthErrors(
            noise_sigma_m=0.01, air_pressure_sigma_hpa=12.0, drift_sigma_m=0.05, drift_tau_s=1e4
        ),
        'ours: a resonant quartz sensor, zeroed at standard air pressure',
    ),
    'strain': Preset(
        DepthErrors(
            noise_sigma_m=0.02,
            quantum_m=0.002,
            air_pressure_sigma_hpa=12.0,
            drift_sigma_m=0.3,
            drift_tau_s=3600.0,
        ),
        'ours: a 30 bar strain gauge that cools, zeroed at standard air pressure',
    ),
}
"""Models of depth sensors, by name."""

AHRS: dict[str, Preset[CompassErrors]] = {
    'consumer': Preset(
        CompassErrors(drift_deg=2.0),
        'ours: a calibrated MEMS AHRS; 1.5 deg coloured, 2 deg over an hour',
        rate_hz=10.0,
    ),
    'uncalibrated': Preset(
        CompassErrors(drift_deg=2.0, hard_iron_nt=1000.0, soft_iron=0.02),
        'ours: the same with the iron of its vehicle left in',
        rate_hz=10.0,
    ),
}
"""Models of AHRSs with a magnetometer, by name."""

ABSOLUTE: dict[str, Preset[AbsoluteErrors]] = {
    'ugps': Preset(
        AbsoluteErrors(
            period_s=2.0, horizontal_sigma_m=1.5, vertical_sigma_m=3.0, available_s=1e6
        ),
        'ours: a short-baseline system in calm water, all the time, errors white',
    ),
}
"""Models of absolute positions, by name."""


@dataclass(frozen=True)
class Gyrocompass:
    """Gyrocompass, its error inversely proportional to the horizontal part of Earth's rotation.

    Attributes
    ----------
    heading_deg, tilt_deg : float
        1-sigma at the equator, times the secant of the latitude; of roll and pitch, everywhere.
    """

    heading_deg: float
    tilt_deg: float

    def at(self, latitude: float) -> ReferenceErrors:
        """Errors at a latitude [rad]; near a pole the heading is unknown."""
        level = abs(math.cos(latitude))
        sigma = min(self.heading_deg / max(level, 1e-12), _SURE_OF_NOTHING_DEG)
        return ReferenceErrors(tilt_sigma_deg=self.tilt_deg, heading_sigma_deg=sigma)


HEADING: Mapping[str, Preset[Gyrocompass]] = {
    'octans': Preset(Gyrocompass(0.1, 0.01), f'iXblue OCTANS, 0.1 deg sec L: {_MEMORY}'),
    'phins': Preset(Gyrocompass(0.01, 0.01), f'iXblue Phins, 0.01 deg sec L: {_MEMORY}'),
    'phins_c3': Preset(Gyrocompass(0.15, 0.05), f'iXblue Phins C3, 0.15 deg sec L: {_MEMORY}'),
}
"""Gyrocompasses of a leader; everything else of its navigation is perfect."""
