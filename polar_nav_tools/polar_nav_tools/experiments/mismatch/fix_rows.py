"""Rows of position fixes: leader, array, clock, lever arm, outliers, delays."""

from __future__ import annotations

import math
from dataclasses import replace

from ..schedule import FixSpec
from . import dvl_faults as d
from . import faults as f
from . import fix_faults as g
from .culprits import DEPTH, DVL, FIXES, IMU
from .row import LEVEL, RACETRACK, SINS, START_S, TACTICAL, Row, row, scene_of

FIX_ROWS: tuple[Row, ...] = (
    *(
        row(
            f'fix_offset_{m:g}m_start',
            f.FixOffset(offset_m=m),
            (FIXES,),
            invisible=True,
            beyond_stated=m > 0.6,
        )
        for m in (0.6, 3.0, 10.0)
    ),
    *(
        row(f'fix_offset_{m:g}m_mid', f.FixOffset(offset_m=m, start_s=START_S), (FIXES,))
        for m in (3.0, 10.0)
    ),
    *(
        row(f'fix_drift_{mps:g}mps', f.FixOffset(drift_mps=mps, start_s=START_S), (FIXES,))
        for mps in (0.05, 0.01)
    ),
    row(
        'fix_drift_0.003mps_start',
        f.FixOffset(drift_mps=0.003),  # grows to 3.6 m
        (FIXES,),
        invisible=True,
        beyond_stated=True,
    ),
    row('fix_jump_20m_20s', f.FixOffset(offset_m=20.0, start_s=700.0, length_s=20.0), (FIXES,)),
    row('fix_offset_700m_start', f.FixOffset(offset_m=700.0), (FIXES,)),
    row('start_500m_off', f.StartOff(north_m=500.0), (FIXES,)),
    row('array_turns_3deg', f.LeaderFrame(turn_deg=3.0, start_s=START_S), (FIXES,)),
    row(
        'fix_one_sided_40pc',
        f.FixOneSided(share=0.4, offset_m=8.0, length_s=300.0, start_s=START_S),
        (FIXES,),
    ),
    row('fix_heavy_tails', f.FixTails(sigma=2.0), (FIXES,)),
    row('fix_coloured', f.FixColoured(sigma=2.0, tau_s=60.0), (FIXES,)),
    row('fix_noise_3m', f.FixColoured(sigma=3.0), (FIXES,)),
    row('range_1pc_formation', f.LeaderFrame(scale=0.01), (FIXES,), invisible=True),
    row('range_1pc_fixed', f.LeaderFrame(scale=0.01, formation=False), (FIXES,)),
    *(
        row(f'array_turned_{name}formation', f.LeaderFrame(turn_deg=deg), (FIXES,), invisible=True)
        for name, deg in (('', 0.5), ('0.6deg_', 0.6))
    ),
    row(
        'leader_own',
        f.LeaderOwn(),  # metres, and not in `leader_sigma` of its packets
        (FIXES,),
        invisible=True,
        beyond_stated=True,
        scene=scene_of(duration_s=1800.0),
    ),
    *(
        row(
            f'clock_{name}_{where}',
            f.FixClock(offset_s=offset_s, rate_ppm=ppm),
            (FIXES,),
            invisible=scene is SINS,
            beyond_stated=scene is SINS and offset_s > 0.02,
            scene=scene,
        )
        for where, scene in (('straight', SINS), ('racetrack', RACETRACK))
        for name, offset_s, ppm in (
            ('20ms', 0.02, 0.0),
            ('50ms', 0.05, 0.0),
            ('1s', 1.0, 0.0),
            ('20ppm', 0.0, 20.0),
        )
        if scene is SINS or name in ('50ms', '1s')
    ),
    *(
        row(
            f'transponder_lever_2m_{where}',
            f.FixLever(lever_b=(2.0, 0.0, 0.0)),
            (FIXES,),
            invisible=scene is LEVEL,
            beyond_stated=scene is LEVEL,
            scene=scene,
        )
        for where, scene in (('straight', LEVEL), ('racetrack', RACETRACK))
    ),
    *(
        row(f'outliers_{100 * share:g}pc', f.FixOutliers(share=share), (FIXES,))
        for share in (0.1, 0.3)
    ),
    row('fix_out_15min', f.FixOut(start_s=300.0, obvious=True), (FIXES,)),
)

_NO_DVL = scene_of(dvl_rate_hz=0.0)

FIX_ROWS += (
    row(
        'fix_switches_8m',
        g.FixSwitches(offset_m=8.0, period_s=240.0, start_s=START_S),
        (FIXES,),
    ),
    row(
        'fix_switches_3m',
        g.FixSwitches(offset_m=3.0, period_s=240.0, start_s=START_S),
        (FIXES,),
    ),
    row(
        'fix_other_vehicle_60s',
        f.FixOffset(offset_m=300.0, start_s=700.0, length_s=60.0),
        (FIXES,),
    ),
    row(
        'fix_other_vehicle_half',
        f.FixOneSided(share=0.5, offset_m=300.0, length_s=1e4, start_s=START_S),
        (FIXES,),
    ),
    row('fix_two_senders_4m', g.FixTwoSenders(offset_m=4.0, start_s=START_S), (FIXES,)),
    row(
        'fix_mirrored_30s',
        g.FixMirrored(distance_m=100.0, length_s=30.0, start_s=START_S),
        (FIXES,),
    ),
    row(
        'fix_mirrored_30pc',
        g.FixMirrored(distance_m=100.0, share=0.3, start_s=START_S),
        (FIXES,),
    ),
    *(
        row(
            f'clock_{name}_mid_{where}',
            f.FixClock(offset_s=offset_s, rate_ppm=ppm, start_s=START_S),
            (FIXES,),
            scene=scene,
        )
        for name, offset_s, ppm, where, scene in (
            ('2s', 2.0, 0.0, 'straight', SINS),
            ('2s', 2.0, 0.0, 'racetrack', RACETRACK),
            ('-2s', -2.0, 0.0, 'racetrack', RACETRACK),
            ('500ppm', 0.0, 500.0, 'racetrack', RACETRACK),
        )
    ),
    *(
        row(f'fix_times_2s_{name}', g.FixTimes(most_s=2.0, start_s=START_S), (FIXES,), scene=scene)
        for name, scene in (('straight', SINS), ('racetrack', RACETRACK))
    ),
    *(
        row(
            f'fix_offset_{metres:g}m_mid{end}',
            f.FixOffset(offset_m=metres, start_s=START_S),
            (FIXES,),
            scene=scene,
        )
        for metres, end, scene in (
            (1.5, '', SINS),
            (2.0, '', SINS),
            (2.0, '_racetrack', RACETRACK),
            (2.0, '_tactical', TACTICAL),
        )
    ),
    row('fix_rounded_11m', g.FixRounded(step_m=11.0, start_s=START_S), (FIXES,)),
    row('fix_rounded_11m_start', g.FixRounded(step_m=11.0), (FIXES,)),
    *(
        row(
            f'fix_waves_{metres:g}m_{period_s:g}s{end}',
            g.FixWaves(amplitude_m=metres, period_s=period_s, start_s=START_S),
            (FIXES,),
            scene=scene,
        )
        for metres, period_s, end, scene in (
            (3.0, 60.0, '', SINS),
            (3.0, 300.0, '', SINS),
            (3.0, 300.0, '_tactical', TACTICAL),
            (3.0, 300.0, '_no_dvl', _NO_DVL),
        )
    ),
    *(
        row(f'fix_walks{end}', g.FixWalks(density=0.2, start_s=START_S), (FIXES,), scene=scene)
        for end, scene in (('', SINS), ('_tactical', TACTICAL))
    ),
    row(
        'fix_off_on_course_5m',
        g.FixOffOnCourse(offset_m=5.0, start_s=START_S),
        (FIXES,),
        scene=RACETRACK,
    ),
    row('fix_smoothed_3s', g.FixSmoothed(tau_s=3.0, start_s=START_S), (FIXES,), scene=RACETRACK),
    row('fix_height_5m', g.FixHeight(up_m=5.0, start_s=START_S), (FIXES,)),
    row(
        'range_grows_1pc',
        g.FrameDrifts(scale=0.01, ramp_s=300.0, start_s=START_S),
        (FIXES,),
    ),
    row('array_drifts_5dph', g.FrameDrifts(turn_dph=5.0, start_s=START_S), (FIXES,)),
    *(
        row(
            f'fix_drift_0.05mps_{name}',
            f.FixOffset(drift_mps=0.05, start_s=START_S),
            (FIXES,),
            scene=scene,
        )
        for name, scene in (('tactical', TACTICAL), ('no_dvl', _NO_DVL))
    ),
    row(
        'both_fixes_and_dvl_drift',
        g.both(
            f.FixOffset(drift_mps=0.03, start_s=START_S),
            d.DvlBias(bias_m=(0.0, -0.03, 0.0), start_s=START_S),
        ),
        (FIXES, DVL),
    ),
    row(
        'both_gyro_and_fixes',
        g.both(
            f.ImuStep(gyro_dph=0.3, start_s=START_S),
            f.FixOffset(offset_m=3.0, start_s=START_S),
        ),
        (FIXES, IMU),
        scene=RACETRACK,
    ),
    row(
        'both_scale_and_outliers',
        g.both(d.DvlGain(scale=0.005, start_s=START_S), f.FixOutliers(share=0.2)),
        (FIXES, DVL),
        scene=RACETRACK,
    ),
    row(
        'both_depth_and_height',
        g.both(d.DepthError(bias_m=3.0, start_s=START_S), g.FixHeight(up_m=-3.0, start_s=START_S)),
        (FIXES, DEPTH),
    ),
)


def _delay_row(delay_s: float, name: str, gyro_deg_rt_h: float, accel_ug_rt_hz: float) -> Row:
    """Row of late fixes with a poorer IMU, all stated: the fault is the delay handling."""
    noise = {
        'gyro_noise_density': math.radians(gyro_deg_rt_h) / 60.0,
        'accel_noise_density': accel_ug_rt_hz * f.UG,
    }
    scene = scene_of(
        duration_s=480.0,
        gyro_bias_dph=5.0,
        accel_bias_g=750e-6,
        initial_sigma_tilt_deg=0.1,
        initial_sigma_heading_deg=1.0,
    )
    fault = f.ImuNoise(
        gyro_density=noise['gyro_noise_density'],
        accel_density=noise['accel_noise_density'],
        for_all=noise,
        known=noise,
        obvious=True,
    )
    fixes = FixSpec(period_s=1.0, first_s=1.0, delay_s=delay_s)
    return row(f'delay_{delay_s:g}s_{name}', fault, (), scene=replace(scene, fixes=fixes))


DELAY_ROWS = (
    _delay_row(30.0, 'stim300', 0.15, 100.0),
    _delay_row(60.0, 'stim300', 0.15, 100.0),
    _delay_row(60.0, 'fog', 0.02, 50.0),
)
