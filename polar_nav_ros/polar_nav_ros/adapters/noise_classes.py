"""Noise parameters of the engine for instruments by name, for mapping files live and offline.

The numbers of a class are those of the simulation's table of instruments
(`polar_nav_sim.sensors.instruments`, which has their sources); a test of `polar_nav_tools` holds
both equal, since a vehicle's node does not import the simulation.
"""

from __future__ import annotations

import math
from dataclasses import fields

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.params import default_of

_UNKNOWN_SOUND_SPEED = 0.03
"""1-sigma of the scale of a DVL that assumes a sound speed: 1500 m/s is 4.2 % off at -1.8 C."""
_STATED_SOUND_SPEED = 0.003
"""The same where the velocity is corrected by a stated sound speed of the water: 4 m/s, ours."""
_INSTALLED_MARKOV = 0.02
"""Least slow error of an installed DVL [m/s]. Data sheets state 1 to 5 mm/s; runs of real vehicles
need 0.02 to 0.05 to be honest in turns: ours."""
_CURRENT, _CURRENT_TAU_S = 0.2, 1800.0
"""Velocity through the water taken for that over ground is off by the current: ours [m/s], [s]."""

IMU: dict[str, dict[str, float]] = {
    'bmi088': {
        'gyro_bias_sigma': 0.017540358650704357,
        'gyro_noise_density': 0.0009392401437876834,
        'gyro_bias_walk': 7.284080996918905e-05,
        'accel_bias_sigma': 0.20803103933328204,
        'accel_noise_density': 0.0017161637499999998,
        'max_imu_noise_factor': 1000.0,
        'accel_bias_walk': 0.0005469729241177762,
    },
    'fog': {
        'gyro_bias_sigma': 4.854193199229469e-06,
        'gyro_noise_density': 5.299596786957904e-05,
        'gyro_bias_walk': 6.82898810851044e-08,
        'accel_bias_sigma': 0.01471814493953573,
        'accel_noise_density': 0.0011767979999999997,
        'max_imu_noise_factor': 1.0,
        'accel_bias_walk': 0.000138141723132149,
    },
    'icm20948': {
        'gyro_bias_sigma': 0.0872839276116092,
        'gyro_noise_density': 0.002879793265790644,
        'gyro_bias_walk': 0.00024274532738984125,
        'accel_bias_sigma': 0.5303765978572722,
        'accel_noise_density': 0.0022555294999999998,
        'max_imu_noise_factor': 1000.0,
        'accel_bias_walk': 0.0021834779592756846,
    },
    'navigation': {
        'gyro_bias_sigma': 4.84813681109536e-08,
        'gyro_noise_density': 5.817764173314431e-07,
        'gyro_bias_walk': 7e-10,
        'accel_bias_sigma': 0.000980665,
        'accel_noise_density': 0.0001,
        'max_imu_noise_factor': 1.0,
        'accel_bias_walk': 2e-06,
    },
    'stim300': {
        'gyro_bias_sigma': 2.483930960496526e-05,
        'gyro_noise_density': 0.00014988507166916175,
        'gyro_bias_walk': 3.5410464260950345e-07,
        'accel_bias_sigma': 0.012615941736082863,
        'accel_noise_density': 0.001,
        'max_imu_noise_factor': 1000.0,
        'accel_bias_walk': 0.00027363842368413783,
    },
    'vn100': {
        'gyro_bias_sigma': 0.0004955782427659973,
        'gyro_noise_density': 0.00019139029424020357,
        'gyro_bias_walk': 7.289243549596034e-06,
        'accel_bias_sigma': 0.05095835796630672,
        'accel_noise_density': 0.0013729309999999998,
        'max_imu_noise_factor': 1000.0,
        'accel_bias_walk': 0.0002746323950791929,
    },
}
"""Parameters by class, as `polar_nav_tools.foreign.instrument_noise` derives them, SI."""
POOR_GYROS = ('bmi088', 'icm20948')
"""Gyros too poor to navigate by (1 deg/s at the start): with an AHRS its roll and pitch are
measurements, too, unless the mapping says otherwise."""
DVL: dict[str, dict[str, float]] = {
    'a50_performance': {
        'scale': 0.001,
        'markov_sigma': 0.001,
        'markov_tau': 300.0,
        'sigma': 0.005,
        'misalignment_sigma_deg': 0.5,
        'lever_sigma': 0.0,
        'assumed_sound_speed': 0.0,
    },
    'a50_standard': {
        'scale': 0.01,
        'markov_sigma': 0.001,
        'markov_tau': 300.0,
        'sigma': 0.005,
        'misalignment_sigma_deg': 0.5,
        'lever_sigma': 0.0,
        'assumed_sound_speed': 1500.0,
    },
    'pathfinder_600': {
        'scale': 0.002,
        'markov_sigma': 0.001,
        'markov_tau': 300.0,
        'sigma': 0.005,
        'misalignment_sigma_deg': 0.2,
        'lever_sigma': 0.0,
        'assumed_sound_speed': 0.0,
    },
    'workhorse_1200': {
        'scale': 0.002,
        'markov_sigma': 0.001,
        'markov_tau': 300.0,
        'sigma': 0.003,
        'misalignment_sigma_deg': 0.2,
        'lever_sigma': 0.0,
        'assumed_sound_speed': 0.0,
    },
    'workhorse_300': {
        'scale': 0.004,
        'markov_sigma': 0.002,
        'markov_tau': 300.0,
        'sigma': 0.01,
        'misalignment_sigma_deg': 0.2,
        'lever_sigma': 0.0,
        'assumed_sound_speed': 0.0,
    },
}
"""Errors by class: scale without the sound speed [-], slow error [m/s] and its time constant [s],
white noise [m/s], misalignment [deg], lever arm [m], assumed sound speed [m/s] (0: no matter)."""
IMU_CLASSES = tuple(IMU)
DVL_CLASSES = tuple(DVL)
COMMON = (
    'fix_range_scale_sigma',
    'fix_heading_sigma_deg',
    'fix_clock_sigma',
    'fix_offset_sigma',
    'depth_offset_sigma',
)
"""Parameters of errors that fixes, or depths, have in common; no class of instrument has them."""


def imu_noise(name: str) -> dict[str, float]:
    """Return the parameters of an IMU by its class, one of `IMU_CLASSES`, SI."""
    return dict(IMU[name])


def dvl_noise(name: str, *, water: bool = False, corrected: bool = False) -> dict[str, float]:
    """Return the parameters of a DVL by its class, SI.

    Parameters
    ----------
    name : str
        Class, one of `DVL_CLASSES`.
    water : bool
        Its velocity is relative to the water.
    corrected : bool
        Its velocity is corrected for the sound speed of the water.
    """
    e = DVL[name]
    sound = _STATED_SOUND_SPEED if corrected else _UNKNOWN_SOUND_SPEED
    slow = max(e['markov_sigma'], _INSTALLED_MARKOV)
    return {
        'dvl_scale_sigma': max(
            1e-9, math.hypot(e['scale'], sound if e['assumed_sound_speed'] else 0.0)
        ),
        'dvl_markov_sigma': math.hypot(slow, _CURRENT) if water else slow,
        'dvl_markov_tau': _CURRENT_TAU_S if water else e['markov_tau'],
        'dvl_sigma': e['sigma'],
        'dvl_misalignment_sigma_deg': max(
            e['misalignment_sigma_deg'], _default('dvl_misalignment_sigma_deg')
        ),
        'dvl_lever_sigma': max(e['lever_sigma'], _default('dvl_lever_sigma')),
        'dvl_latency_sigma': _default('dvl_latency_sigma'),
    }


def assumed_sound_speed(name: str) -> float:
    """Return what a DVL of a class assumes where nobody sets it [m/s]; 0: it does not matter."""
    return DVL[name]['assumed_sound_speed']


def common_noise() -> dict[str, float]:
    """Return the sigmas of common errors that the engine takes where nothing is stated."""
    return {name: _default(name) for name in COMMON}


def unit_of(name: str) -> str:
    """Return the unit of a parameter of the engine."""
    units = {f.name: str(f.metadata.get('unit', '')) for f in fields(EngineParams)}
    return units[name]


def _default(name: str) -> float:
    return float(default_of(EngineParams, name))


NAMES = (*imu_noise('stim300'), *dvl_noise('a50_standard'), *COMMON, 'depth_sigma')
"""Parameters that stand under ``noise`` in a mapping."""
