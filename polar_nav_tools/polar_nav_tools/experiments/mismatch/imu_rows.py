"""Rows of the IMU, of gravity and of the start."""

from __future__ import annotations

import math

from . import faults as f
from .row import DVL, HEADING, IMU, RACETRACK, START_S, Row, scene_of

IMU_ROWS = (
    *(
        Row(
            f'accel_step_{ug:g}ug',
            'all accelerometers step at once',
            f'{ug:g} ug',
            f.ImuStep(accel_ug=ug, start_s=START_S),
            (IMU,),
        )
        for ug in (2.0, 5.0, 50.0, 1000.0)
    ),
    *(
        Row(
            f'gyro_step_{dph:g}dph',
            'all gyros step at once',
            f'{dph:g} deg/h',
            f.ImuStep(gyro_dph=dph, start_s=START_S),
            (IMU,),
        )
        for dph in (0.1, 1.0)
    ),
    *(
        Row(
            f'gravity_{mgal:g}mgal',
            'gravity swell of 10.8 km with its deflection of the vertical, 30 minutes',
            f'{mgal:g} mGal',
            f.GravitySwell(mgal=mgal, period_s=3600.0),
            (IMU,),
            scene=scene_of(duration_s=1800.0),
        )
        for mgal in (1.0, 3.0, 10.0, 30.0)
    ),
    Row(
        'imu_temperature',
        'gyro and accelerometer biases drift with temperature for 10 minutes (size ours)',
        '0.05 deg/h, 50 ug',
        f.ImuStep(gyro_dph=0.05, accel_ug=50.0, ramp_s=600.0, start_s=START_S),
        (IMU,),
    ),
    Row(
        'imu_scale',
        'scale factors of gyros and accelerometers, from the start, on turns (size ours)',
        '50 ppm, 50 ppm',
        f.ImuGain(gyro_ppm=50.0, accel_ppm=50.0),
        (IMU,),
        scene=RACETRACK,
    ),
    Row(
        'imu_misalignment',
        'gyro axes out of square, from the start, on turns (size ours)',
        '20 arcsec',
        f.ImuGain(misalignment_arcsec=20.0),
        (IMU,),
        scene=RACETRACK,
    ),
    Row(
        'imu_g_dependence',
        'gyro drift that depends on specific force, from the start (STIM300 has 1)',
        '0.1 deg/h/g',
        f.ImuGain(g_dependence_dph=0.1),
        (IMU,),
    ),
    Row(
        'imu_vibration',
        'vibration: white noise of the accelerometers far above the stated one (size ours)',
        '100 ug/rtHz',
        f.ImuNoise(
            gyro_density=0.0,
            accel_density=100.0 * f.UG,
            start_s=START_S,
            known={'accel_noise_density': 100.0 * f.UG},
        ),
        (IMU,),
    ),
    Row(
        'imu_mems',
        'a MEMS IMU (BMI088 noise) where a tactical one is stated, as polar map wrote it',
        '0.84 deg/rt-h, 175 ug/rtHz',
        f.ImuNoise(
            gyro_density=math.radians(0.014),
            accel_density=175.0 * f.UG,
            known={
                'gyro_noise_density': math.radians(0.014),
                'accel_noise_density': 175.0 * f.UG,
            },
        ),
        (IMU,),
        scene=scene_of(
            duration_s=600.0,
            imu='tactical',
            gyro_bias_dph=5.0,
            accel_bias_g=750e-6,
            initial_sigma_tilt_deg=0.1,
            initial_sigma_heading_deg=1.0,
        ),
    ),
)

HEADING_ROWS = tuple(
    Row(
        f'heading_{error:g}deg_sigma_{label}',
        'initial heading off',
        f'{error:g} deg, stated {label}',
        f.HeadingStart(
            error_deg=error,
            for_all={'initial_sigma_heading_deg': sigma},
            known={'initial_sigma_heading_deg': error},
        ),
        (HEADING, DVL, IMU),
    )
    for error, sigma, label in (
        (5.0, 5.0 / 60.0, '5arcmin'),
        (5.0, 5.0, '5deg'),
        (20.0, 5.0 / 60.0, '5arcmin'),
    )
)
