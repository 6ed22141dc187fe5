"""Noise parameters of the engine for instruments by name, out of the simulation's own table.

An IMU or a DVL that can be bought has one error model here, with a source beside each number:
:mod:`polar_nav_sim.sensors.instruments`. What a filter of 24 states has no state for (scale,
misalignment, temperature) becomes noise or a larger bias, by the rules beside the functions.
"""

from __future__ import annotations

import math
from dataclasses import fields

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.params import default_of
from polar_nav_sim.sensors.imu import DPH, G0, MICRO_G
from polar_nav_sim.sensors.instruments import DVL, IMU

_OF_PAPERS = ('paper', 'leader', 'small')
"""Beginnings of names that are no class to choose from for a recording."""
IMU_CLASSES = tuple(sorted(n for n in IMU if not n.startswith((*_OF_PAPERS, 'tactical'))))
DVL_CLASSES = tuple(sorted(n for n in DVL if not n.startswith(_OF_PAPERS)))
COMMON = (
    'fix_range_scale_sigma',
    'fix_heading_sigma_deg',
    'fix_clock_sigma',
    'fix_offset_sigma',
    'depth_offset_sigma',
)
"""Parameters of errors that fixes, or depths, have in common; no class of instrument has them."""

_TURN, _TURN_EVERY_S = math.pi, 600.0
"""Scale and misalignment of gyros count as if a vehicle turned round so often: ours."""
_UNKNOWN_SOUND_SPEED = 0.03
"""1-sigma of the scale of a DVL that assumes a sound speed: 1500 m/s is 4.2 % off at -1.8 C."""
_STATED_SOUND_SPEED = 0.003
"""The same where the velocity is corrected by a stated sound speed of the water: 4 m/s, ours."""
_INSTALLED_MARKOV = 0.02
"""Least slow error of an installed DVL [m/s]. Data sheets state 1 to 5 mm/s; runs of real vehicles
need 0.02 to 0.05 to be honest in turns: ours."""
_MEMS_GYRO, _MEMS_FACTOR = 2e-5, 1000.0
"""From this noise of the gyros on [rad/s/rt-Hz] an IMU on a vehicle may be far noisier than its
data sheet (vibration, aliasing): the filter may raise its noise up to this factor (ours)."""
_CURRENT, _CURRENT_TAU_S = 0.2, 1800.0
"""Velocity through the water taken for that over ground is off by the current: ours [m/s], [s]."""


def imu_noise(name: str) -> dict[str, float]:
    """Return the parameters of an IMU by its class, SI.

    Scale and misalignment times gravity are a bias of the accelerometers; of the gyros, a turn of
    180 degrees each ten minutes makes them an angle random walk. The in-run bias, a Gauss-Markov
    process, walks by ``sigma sqrt(2 / tau)`` at first; cooling down adds the bias that it changes
    over the root of its time constant. No walk is below the engine's default: gravity has
    anomalies, too.
    """
    e = IMU[name].errors
    cooling_k = abs(e.temperature_start_c - e.temperature_end_c) / math.sqrt(e.temperature_tau_s)
    gyro_cross = max(map(math.hypot, e.gyro_scale, e.gyro_misalignment))
    gyro_cross = math.hypot(gyro_cross, e.gyro_scale_sigma, e.gyro_misalignment_sigma)
    accel_cross = max(map(math.hypot, e.accel_scale, e.accel_misalignment))
    accel_cross = math.hypot(accel_cross, e.accel_scale_sigma, e.accel_misalignment_sigma)
    return {
        'gyro_bias_sigma': DPH
        * math.hypot(
            max(map(abs, e.gyro_bias_dph)),
            e.gyro_turn_on_sigma_dph,
            e.gyro_instability_sigma_dph,
            e.gyro_g_sigma_dph,
        ),
        'gyro_noise_density': math.hypot(
            max(e.gyro_noise_density), gyro_cross * _TURN / math.sqrt(_TURN_EVERY_S)
        ),
        'gyro_bias_walk': math.hypot(
            DPH * e.gyro_instability_sigma_dph * math.sqrt(2.0 / e.gyro_instability_tau_s),
            DPH * e.gyro_temperature_sigma_dph * cooling_k,
            e.gyro_random_walk,
            _default('gyro_bias_walk'),
        ),
        'accel_bias_sigma': math.hypot(
            MICRO_G * max(map(abs, e.accel_bias_ug)),
            MICRO_G * e.accel_turn_on_sigma_ug,
            MICRO_G * e.accel_instability_sigma_ug,
            G0 * accel_cross,
        ),
        'accel_noise_density': max(e.accel_noise_density),
        'max_imu_noise_factor': _MEMS_FACTOR if max(e.gyro_noise_density) > _MEMS_GYRO else 1.0,
        'accel_bias_walk': math.hypot(
            MICRO_G * e.accel_instability_sigma_ug * math.sqrt(2.0 / e.accel_instability_tau_s),
            MICRO_G * e.accel_temperature_sigma_ug * cooling_k,
            e.accel_random_walk,
            _default('accel_bias_walk'),
        ),
    }


def assumed_sound_speed(name: str) -> float:
    """Return what a DVL of a class assumes where nobody sets it [m/s]; 0: it does not matter."""
    e = DVL[name].errors
    return 0.0 if e.phased_array else e.assumed_sound_speed


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
    e = DVL[name].errors
    sound = _STATED_SOUND_SPEED if corrected else _UNKNOWN_SOUND_SPEED
    slow = max(e.markov_sigma, _INSTALLED_MARKOV)
    return {
        'dvl_scale_sigma': max(
            1e-9,
            math.hypot(
                max(map(abs, e.scale)), e.scale_sigma, sound if assumed_sound_speed(name) else 0.0
            ),
        ),
        'dvl_markov_sigma': math.hypot(slow, _CURRENT) if water else slow,
        'dvl_markov_tau': _CURRENT_TAU_S if water else e.markov_tau_s,
        'dvl_sigma': e.noise_sigma,
        'dvl_misalignment_sigma_deg': max(
            e.misalignment_sigma_deg, _default('dvl_misalignment_sigma_deg')
        ),
        'dvl_lever_sigma': max(e.lever_sigma_m, _default('dvl_lever_sigma')),
        'dvl_latency_sigma': _default('dvl_latency_sigma'),
    }


def common_noise() -> dict[str, float]:
    """Return the sigmas of common errors that the engine takes where nothing is stated."""
    return {name: _default(name) for name in COMMON}


def source_of(role: str, name: str) -> str:
    """Return where the numbers of a class are from; the role is ``imu`` or ``dvl``."""
    return IMU[name].source if role == 'imu' else DVL[name].source


def unit_of(name: str) -> str:
    """Return the unit of a parameter of the engine."""
    units = {f.name: str(f.metadata.get('unit', '')) for f in fields(EngineParams)}
    return units[name]


def _default(name: str) -> float:
    return float(default_of(EngineParams, name))


NAMES = (*imu_noise('stim300'), *dvl_noise('a50_standard'), *COMMON, 'depth_sigma')
"""Parameters that stand under ``noise`` in a mapping."""
