"""Errors of an IMU by name, unit and limit; :mod:`polar_nav_sim.sensors.imu` is their model."""

from __future__ import annotations

import math
from dataclasses import dataclass

from polar_nav_core.params import param, sigma, vector

from ..section import Spec

G0 = 9.80665
DPH = math.radians(1.0) / 3600.0
"""One degree per hour [rad/s]."""
MICRO_G = 1e-6 * G0
"""One millionth of standard gravity [m/s^2]."""

# Polar cooperative navigation, section 6.1: (0.001 deg/h)^2 and (1e-7 g0)^2 are taken as variances
# of white noise per filter period of 0.1 s, hence these densities.
_GYRO_DENSITY = 0.001 * DPH * math.sqrt(0.1)
_ACCEL_DENSITY = 0.1 * MICRO_G * math.sqrt(0.1)


@dataclass(frozen=True)
class ImuErrors(Spec):
    """Errors of an IMU; defaults are those of polar cooperative navigation, section 6.1."""

    gyro_bias_dph: tuple[float, ...] = vector(
        (0.03, 0.03, 0.03), 'deg/h', -1e5, 1e5, 'Constant gyro bias'
    )
    gyro_turn_on_sigma_dph: float = sigma(
        0.0, 'deg/h', 1e5, '1-sigma of a further constant gyro bias, drawn per run'
    )
    gyro_noise_density: tuple[float, ...] = vector(
        (_GYRO_DENSITY,) * 3, 'rad/s/sqrt(Hz)', 0.0, 1.0, 'White gyro noise (angle random walk)'
    )
    gyro_instability_sigma_dph: float = sigma(
        0.0, 'deg/h', 1e5, '1-sigma of the in-run gyro bias (Gauss-Markov)'
    )
    gyro_instability_tau_s: float = param(1000.0, 's', 0.1, 1e7, 'Its correlation time')
    gyro_random_walk: float = param(
        0.0, 'rad/s^2/sqrt(Hz)', 0.0, 1.0, 'Random walk of the gyro bias'
    )
    gyro_scale: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), '', -0.5, 0.5, 'Gyro scale factor error'
    )
    gyro_misalignment: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'rad', -0.5, 0.5, 'Rotation vector of the gyro triad against the body'
    )
    gyro_quantum: float = param(0.0, 'rad', 0.0, 0.1, 'Angle per count; 0: no quantization')
    gyro_range: float = param(0.0, 'rad/s', 0.0, 1e3, 'Saturation; 0: none')
    accel_bias_ug: tuple[float, ...] = vector(
        (1.0, 1.0, 1.0), '1e-6 g0', -1e6, 1e6, 'Constant accelerometer bias'
    )
    accel_turn_on_sigma_ug: float = sigma(
        0.0, '1e-6 g0', 1e6, '1-sigma of a further constant bias, drawn per run'
    )
    accel_noise_density: tuple[float, ...] = vector(
        (_ACCEL_DENSITY,) * 3, 'm/s^2/sqrt(Hz)', 0.0, 1.0, 'White noise (velocity random walk)'
    )
    accel_instability_sigma_ug: float = sigma(
        0.0, '1e-6 g0', 1e6, '1-sigma of the in-run accelerometer bias (Gauss-Markov)'
    )
    accel_instability_tau_s: float = param(1000.0, 's', 0.1, 1e7, 'Its correlation time')
    accel_random_walk: float = param(
        0.0, 'm/s^3/sqrt(Hz)', 0.0, 1.0, 'Random walk of the accelerometer bias'
    )
    accel_scale: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), '', -0.5, 0.5, 'Accelerometer scale factor error'
    )
    accel_misalignment: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'rad', -0.5, 0.5, 'Rotation vector of the triad against the body'
    )
    accel_quantum: float = param(0.0, 'm/s', 0.0, 1.0, 'Velocity per count; 0: no quantization')
    accel_range: float = param(0.0, 'm/s^2', 0.0, 1e4, 'Saturation; 0: none')
    gyro_scale_sigma: float = sigma(
        0.0, '', 0.5, '1-sigma of a further scale factor error per gyro, drawn per run'
    )
    gyro_misalignment_sigma: float = sigma(
        0.0, 'rad', 0.5, '1-sigma of each cross-axis term of the gyros, drawn per run'
    )
    accel_scale_sigma: float = sigma(
        0.0, '', 0.5, '1-sigma of a further scale factor error per axis, drawn per run'
    )
    accel_misalignment_sigma: float = sigma(
        0.0, 'rad', 0.5, '1-sigma of each cross-axis term, drawn per run'
    )
    gyro_temperature_sigma_dph: float = sigma(
        0.0, 'deg/h/K', 1e5, '1-sigma of the gyro bias per degree, drawn per run'
    )
    accel_temperature_sigma_ug: float = sigma(
        0.0, '1e-6 g0/K', 1e6, '1-sigma of the bias per degree, drawn per run'
    )
    temperature_start_c: float = param(
        10.0, 'deg C', -60.0, 80.0, 'Of the IMU at the start, where the biases above hold'
    )
    temperature_end_c: float = param(
        -1.8, 'deg C', -60.0, 80.0, 'Where it goes exponentially: that of the water'
    )
    temperature_tau_s: float = param(1800.0, 's', 1.0, 1e6, 'Time constant of that')
    gyro_g_sigma_dph: float = sigma(
        0.0, 'deg/h/g0', 1e5, '1-sigma of each gyro bias per g along each axis, drawn per run'
    )
    bias_step_s: float = param(0.0, 's', 0.0, 1e6, 'When the steps below happen, after the start')
    gyro_step_dph: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'deg/h', -1e5, 1e5, 'Step of the gyro bias'
    )
    accel_step_ug: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), '1e-6 g0', -1e6, 1e6, 'Step of the accelerometer bias'
    )
    bias_steps_per_hour: float = param(
        0.0, '1/h', 0.0, 3600.0, 'Further steps at random times, all six biases at once'
    )
    gyro_step_sigma_dph: float = sigma(0.0, 'deg/h', 1e5, '1-sigma of each of them')
    accel_step_sigma_ug: float = sigma(0.0, '1e-6 g0', 1e6, '1-sigma of each of them')
    vibration_rms_g: float = param(0.0, 'g0', 0.0, 100.0, 'Vibration of the vehicle, RMS')
    vibration_from_s: float = param(0.0, 's', 0.0, 1e6, 'Since when it vibrates')
    gyro_vibration_sigma_dph: float = sigma(
        0.0, 'deg/h/g0^2', 1e5, '1-sigma of the rectified vibration per gyro, drawn per run'
    )
    accel_vibration_sigma_ug: float = sigma(
        0.0, '1e-6 g0/g0^2', 1e6, '1-sigma of the rectified vibration, drawn per run'
    )
