"""Rows of position fixes: leader, array, clock, lever arm, outliers, delays."""

from __future__ import annotations

import math
from dataclasses import replace

from ..schedule import FixSpec
from . import faults as f
from .row import FIXES, RACETRACK, SINS, START_S, Row, scene_of

LEVEL = scene_of(oscillating=False)

FIX_ROWS = (
    *(
        Row(
            f'fix_offset_{m:g}m_start',
            'fixes off by a constant from the start (a leader with a constant error)',
            f'{m:g} m',
            f.FixOffset(offset_m=m),
            (FIXES,),
            invisible=True,
        )
        for m in (3.0, 10.0)
    ),
    *(
        Row(
            f'fix_offset_{m:g}m_mid',
            'fixes off by a constant from mid-run on',
            f'{m:g} m',
            f.FixOffset(offset_m=m, start_s=START_S),
            (FIXES,),
        )
        for m in (3.0, 10.0)
    ),
    *(
        Row(
            f'fix_drift_{mps:g}mps',
            'fixes drift away from mid-run on',
            f'{mps:g} m/s',
            f.FixOffset(drift_mps=mps, start_s=START_S),
            (FIXES,),
        )
        for mps in (0.05, 0.01)
    ),
    Row(
        'fix_drift_0.003mps_start',
        'fixes drift from the start, more slowly than the DVL can detect',
        '0.003 m/s',
        f.FixOffset(drift_mps=0.003),
        (FIXES,),
        invisible=True,
    ),
    Row(
        'fix_jump_20m_20s',
        'fixes jump and come back, as filtered USBL does',
        '20 m for 20 s',
        f.FixOffset(offset_m=20.0, start_s=700.0, length_s=20.0),
        (FIXES,),
    ),
    Row(
        'fix_coloured',
        'errors of fixes that stay for a minute, unstated (size ours)',
        '2 m, 60 s',
        f.FixColoured(sigma=2.0, tau_s=60.0),
        (FIXES,),
    ),
    Row(
        'fix_noise_3m',
        'white noise of fixes larger than stated (size ours)',
        '3 m, stated 1 m',
        f.FixColoured(sigma=3.0),
        (FIXES,),
    ),
    Row(
        'range_1pc_formation',
        'range scale of a leader that stays abeam at 1 km',
        '1 %',
        f.LeaderFrame(scale=0.01),
        (FIXES,),
        invisible=True,
    ),
    Row(
        'range_1pc_fixed',
        'range scale of a leader that stays where it is',
        '1 %',
        f.LeaderFrame(scale=0.01, formation=False),
        (FIXES,),
    ),
    Row(
        'array_turned_formation',
        "leader's array turned, leader abeam at 1 km",
        '0.5 deg',
        f.LeaderFrame(turn_deg=0.5),
        (FIXES,),
        invisible=True,
    ),
    Row(
        'leader_own',
        'a leader that navigates by itself: errors common to all fixes, sigma stated for each',
        "leader_alone's drift",
        f.LeaderOwn(),
        (FIXES,),
        invisible=True,
        scene=scene_of(duration_s=1800.0),
    ),
    *(
        Row(
            f'clock_{name}_{where}',
            f'validity stated late, {where}',
            size,
            f.FixClock(offset_s=offset_s, rate_ppm=ppm),
            (FIXES,),
            invisible=scene is SINS,
            scene=scene,
        )
        for where, scene in (('straight', SINS), ('racetrack', RACETRACK))
        for name, size, offset_s, ppm in (
            ('50ms', '50 ms', 0.05, 0.0),
            ('1s', '1 s', 1.0, 0.0),
            ('20ppm', '20 ppm', 0.0, 20.0),
        )
        if name != '20ppm' or scene is SINS
    ),
    *(
        Row(
            f'transponder_lever_2m_{where}',
            f'transponder 2 m ahead of where it is stated, {where}',
            '2 m',
            f.FixLever(lever_b=(2.0, 0.0, 0.0)),
            (FIXES,),
            invisible=scene is LEVEL,
            scene=scene,
        )
        for where, scene in (('straight', LEVEL), ('racetrack', RACETRACK))
    ),
    *(
        Row(
            f'outliers_{100 * share:g}pc',
            'outliers of 10 to 30 m from the start',
            f'{100 * share:g} %',
            f.FixOutliers(share=share),
            (FIXES,),
        )
        for share in (0.1, 0.3)
    ),
    Row(
        'fix_out_15min',
        'no fix after five minutes',
        '900 s',
        f.FixOut(start_s=300.0, obvious=True),
        (FIXES,),
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
    return Row(
        f'delay_{delay_s:g}s_{name}',
        f'fixes late with {name.upper()} noise, all of it stated; wrong is how it is treated',
        f'{delay_s:g} s',
        fault,
        (),
        scene=replace(scene, fixes=fixes),
    )


DELAY_ROWS = (
    _delay_row(30.0, 'stim300', 0.15, 100.0),
    _delay_row(60.0, 'stim300', 0.15, 100.0),
    _delay_row(60.0, 'fog', 0.02, 50.0),
)
