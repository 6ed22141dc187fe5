"""Rows of the IMU, of gravity and of the start."""

from __future__ import annotations

import math

from . import faults as f
from . import heading_faults as h
from . import imu_faults as g
from .culprits import DVL, FIXES, HEADING, IMU
from .row import LEVEL, RACETRACK, SINS, START_S, TACTICAL, Row, row, scene_of

IMU_ROWS: tuple[Row, ...] = (
    *(
        row(f'accel_step_{ug:g}ug', f.ImuStep(accel_ug=ug, start_s=START_S), (IMU,))
        for ug in (2.0, 5.0, 50.0, 1000.0)
    ),
    *(
        row(f'gyro_step_{dph:g}dph', f.ImuStep(gyro_dph=dph, start_s=START_S), (IMU,))
        for dph in (0.1, 1.0, 10.0, 100.0)
    ),
    *(
        row(
            f'gravity_{mgal:g}mgal',
            f.GravitySwell(mgal=mgal, period_s=3600.0),
            (IMU,),
            scene=scene_of(duration_s=1800.0),
        )
        for mgal in (1.0, 3.0, 10.0, 30.0)
    ),
    *(
        row(
            f'gravity_{mgal:g}mgal_no_dvl',
            f.GravitySwell(mgal=mgal, period_s=3600.0),
            (IMU,),
            scene=scene_of(duration_s=1800.0, dvl_rate_hz=0.0),
        )
        for mgal in (3.0, 10.0, 30.0)
    ),
    row(
        'accel_step_5ug_no_dvl',
        f.ImuStep(accel_ug=5.0, start_s=START_S),
        (IMU,),
        scene=scene_of(dvl_rate_hz=0.0),
    ),
    row(
        'imu_temperature',
        f.ImuStep(gyro_dph=0.05, accel_ug=50.0, ramp_s=600.0, start_s=START_S),
        (IMU,),
    ),
    row('imu_scale', f.ImuGain(gyro_ppm=50.0, accel_ppm=50.0), (IMU,), scene=RACETRACK),
    row('imu_misalignment', f.ImuGain(misalignment_arcsec=20.0), (IMU,), scene=RACETRACK),
    row('imu_g_dependence', f.ImuGain(g_dependence_dph=0.1), (IMU,)),
    *(
        row(
            f'imu_blow_{name}',
            f.ImuBlow(g=3.0, length_s=0.2, start_s=START_S),
            (IMU, DVL),
            scene=scene,
        )
        for name, scene in (('straight', SINS), ('racetrack', RACETRACK))
    ),
    *(
        row(
            f'imu_turned_1deg_{name}',
            f.ImuTurned(deg=1.0, axis=axis, start_s=START_S),
            (IMU, DVL, HEADING),
            scene=scene,
        )
        for name, axis, scene in (
            ('yaw', (0.0, 0.0, 1.0), SINS),
            ('roll', (1.0, 0.0, 0.0), RACETRACK),
        )
    ),
    row(
        'imu_vibration',
        f.ImuNoise(
            gyro_density=0.0,
            accel_density=100.0 * f.UG,
            start_s=START_S,
            known={'accel_noise_density': 100.0 * f.UG},
        ),
        (IMU,),
    ),
    row(
        'imu_mems',
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

IMU_ROWS += (
    row('imu_skew_0.2deg', g.ImuSkew(deg=0.2), (IMU, DVL), scene=RACETRACK),
    row('imu_skew_0.2deg_tactical', g.ImuSkew(deg=0.2), (IMU, DVL), scene=TACTICAL),
    row('gyro_scale_500ppm', f.ImuGain(gyro_ppm=500.0), (IMU, HEADING), scene=RACETRACK),
    row('gyro_scale_5000ppm_tactical', f.ImuGain(gyro_ppm=5e3), (IMU, HEADING), scene=TACTICAL),
    row(
        'gyro_g_dependence_1dph',
        f.ImuGain(g_dependence_dph=1.0),
        (IMU, HEADING),
        scene=RACETRACK,
    ),
    *(
        row(
            f'imu_warms_{name}',
            g.ImuWarms(gyro_dph=dph, accel_ug=ug, tau_s=300.0, start_s=start_s),
            (IMU,),
            scene=scene,
        )
        for name, dph, ug, start_s, scene in (
            ('straight', 0.2, 50.0, START_S, SINS),
            ('dive', 0.2, 50.0, 100.0, scene_of(mission='dive', duration_s=900.0)),
            ('tactical', 20.0, 1000.0, START_S, TACTICAL),
        )
    ),
    row('imu_clock_1000ppm', f.ImuGain(gyro_ppm=1e3, accel_ppm=1e3), (IMU,), scene=RACETRACK),
    *(
        row(f'imu_stamps_{name}', stamps, (IMU, DVL), scene=scene)
        for name, stamps, scene in (
            ('late_50ms', g.ImuStamps(late_s=0.05, start_s=START_S), SINS),
            ('late_50ms_racetrack', g.ImuStamps(late_s=0.05, start_s=START_S), RACETRACK),
            ('jitter_5ms', g.ImuStamps(jitter_s=0.005, start_s=START_S), SINS),
            ('tick_16ms', g.ImuStamps(tick_s=1.0 / 64.0, start_s=START_S), SINS),
            ('tick_16ms_tactical', g.ImuStamps(tick_s=1.0 / 64.0, start_s=START_S), TACTICAL),
        )
    ),
    row(
        'imu_bursts_0.3s',
        g.ImuBursts(every_s=10.0, length_s=0.3, start_s=START_S, obvious=True),
        (IMU,),
        scene=RACETRACK,
    ),
    *(
        row(
            f'imu_bursts_80ms_{name}',
            g.ImuBursts(every_s=2.0, length_s=0.08, start_s=START_S, obvious=True),
            (IMU,),
            scene=scene,
        )
        for name, scene in (('racetrack', RACETRACK), ('tactical', TACTICAL))
    ),
    *(
        row(
            f'{name}_stuck',
            g.ImuAxisStuck(axis=axis, gyro=gyro, start_s=START_S),
            (IMU, DVL, HEADING),
            scene=scene,
        )
        for name, axis, gyro, scene in (
            ('gyro_z', 2, True, RACETRACK),
            ('gyro_z_level', 2, True, LEVEL),
            ('gyro_z_tactical', 2, True, TACTICAL),
            ('accel_x_level', 0, False, LEVEL),
            ('accel_z_tactical', 2, False, TACTICAL),
        )
    ),
    row(
        'imu_spikes',
        g.ImuSpikes(every_s=10.0, rate=0.5, force=20.0, start_s=START_S),
        (IMU, DVL),
        scene=RACETRACK,
    ),
    row('imu_upside_down', g.ImuAxesMistaken(signs=(1.0, -1.0, -1.0)), (IMU, DVL, HEADING)),
    row(
        'imu_backwards',
        g.ImuAxesMistaken(signs=(-1.0, -1.0, 1.0)),
        (IMU, DVL, HEADING),
        scene=TACTICAL,
    ),
    row(
        'start_swapped',
        g.StartSwapped(),
        (FIXES,),
        scene=scene_of(latitude_deg=45.0, longitude_deg=70.0),
    ),
)

HEADING_ROWS = tuple(
    row(
        f'heading_{error:g}deg_sigma_{label}',
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
        (180.0, 5.0, '5deg'),
    )
)


def _compass(name: str, fault: h.HeadingOff, *, right: bool = False) -> Row:
    """Row of a wrong AHRS on a tactical vehicle; ``right``: the control, without an error."""
    return row(name, fault, () if right else (HEADING,), scene=TACTICAL)


COMPASS_ROWS = (
    _compass('compass_control', h.HeadingOff(error_deg=0.0, for_all=h.STATED), right=True),
    _compass('compass_declination_20deg', h.HeadingOff(error_deg=20.0, for_all=h.STATED)),
    _compass(
        'compass_step_10deg', h.HeadingOff(error_deg=10.0, start_s=START_S, for_all=h.STATED)
    ),
    _compass(
        'compass_disturbed_30deg',
        h.HeadingOff(error_deg=30.0, length_s=60.0, start_s=START_S, for_all=h.STATED),
    ),
)

IMU_ROWS += tuple(
    row(
        f'imu_kick_{name}',
        g.ImuKick(deg=deg, axis=axis, start_s=START_S),
        (IMU, DVL, HEADING),
        scene=scene,
    )
    for name, deg, axis, scene in (
        ('roll_1deg', 1.0, 0, SINS),
        ('roll_3deg', 3.0, 0, SINS),
        ('roll_10deg', 10.0, 0, SINS),
        ('roll_3deg_racetrack', 3.0, 0, RACETRACK),
        ('pitch_3deg', 3.0, 1, SINS),
        ('yaw_3deg', 3.0, 2, SINS),
        ('yaw_3deg_racetrack', 3.0, 2, RACETRACK),
        ('roll_3deg_tactical', 3.0, 0, TACTICAL),
    )
)
