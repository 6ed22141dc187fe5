"""How the classes of instruments in mapping files follow from the simulation's table.

An IMU or a DVL that can be bought has one error model here, with a source beside each number:
:mod:`polar_nav_sim.sensors.instruments`. What a filter of 24 states has no state for (scale,
misalignment, temperature) becomes noise or a larger bias, by the rules beside the functions. The
results stand in `polar_nav_ros.adapters.noise_classes`, which a vehicle's node can import.
"""

from __future__ import annotations

import math

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.params import default_of
from polar_nav_sim.sensors.imu import DPH, G0, MICRO_G
from polar_nav_sim.sensors.instruments import DVL, IMU

_TURN, _TURN_EVERY_S = math.pi, 600.0
"""Scale and misalignment of gyros count as if a vehicle turned round so often: ours."""
_MEMS_GYRO, _MEMS_FACTOR = 2e-5, 1000.0
"""From this noise of the gyros on [rad/s/rt-Hz] an IMU on a vehicle may be far noisier than its
data sheet (vibration, aliasing): the filter may raise its noise up to this factor (ours)."""


def imu_parameters(name: str) -> dict[str, float]:
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


def dvl_errors(name: str) -> dict[str, float]:
    """Return the errors of a DVL by its class, as `noise_classes.DVL` lists them."""
    e = DVL[name].errors
    return {
        'scale': math.hypot(max(map(abs, e.scale)), e.scale_sigma),
        'markov_sigma': e.markov_sigma,
        'markov_tau': e.markov_tau_s,
        'sigma': e.noise_sigma,
        'misalignment_sigma_deg': e.misalignment_sigma_deg,
        'lever_sigma': e.lever_sigma_m,
        'assumed_sound_speed': 0.0 if e.phased_array else e.assumed_sound_speed,
    }


def source_of(role: str, name: str) -> str:
    """Return where the numbers of a class are from; the role is ``imu`` or ``dvl``."""
    return IMU[name].source if role == 'imu' else DVL[name].source


def _default(name: str) -> float:
    return float(default_of(EngineParams, name))
