"""Rows of DVL and depth."""

from __future__ import annotations

from . import faults as f
from .row import DEPTH, DVL, HEADING, RACETRACK, SINS, START_S, Row, scene_of

DVL_ROWS = (
    Row('dvl_scale_1pc', 'DVL too long', '1 %', f.DvlGain(scale=0.01), (DVL,)),
    Row(
        'dvl_sound_speed',
        'DVL that assumes 1500 m/s in polar water of 1439 m/s',
        '4.2 %',
        f.DvlGain(scale=0.042),
        (DVL,),
    ),
    *(
        Row(
            f'dvl_turned_{deg:g}deg',
            'DVL turned about its vertical axis, initial heading known to 5 arcmin',
            f'{deg:g} deg',
            f.DvlGain(turn_deg=deg),
            (DVL, HEADING),
        )
        for deg in (0.3, 1.0)
    ),
    Row(
        'dvl_turned_1deg_no_heading',
        'DVL turned about its vertical axis, level, no other heading: 5 deg, 1 deg/h stated',
        '1 deg',
        f.DvlGain(turn_deg=1.0),
        (DVL, HEADING),
        invisible=True,
        scene=scene_of(initial_sigma_heading_deg=5.0, gyro_bias_dph=1.0, oscillating=False),
    ),
    Row(
        'dvl_slow_unstated',
        "unstated slow DVL errors of the simulator's size, on turns",
        '5 mm/s, 300 s; 0.01 %',
        f.DvlSlow(
            sigma=0.005,
            tau_s=300.0,
            scale_sigma=1e-4,
            known={'dvl_markov_sigma': 0.005, 'dvl_scale_sigma': 1e-4},
        ),
        (DVL,),
        scene=scene_of(
            mission='racetrack', duration_s=900.0, dvl_markov_sigma=1e-5, dvl_scale=1e-6
        ),
    ),
    Row(
        'dvl_slow_real_unstated',
        'unstated slow DVL errors of a real vehicle, on turns',
        '0.03 m/s, 300 s; 0.5 %',
        f.DvlSlow(
            sigma=0.03,
            tau_s=300.0,
            scale_sigma=5e-3,
            known={'dvl_markov_sigma': 0.03, 'dvl_scale_sigma': 5e-3},
        ),
        (DVL,),
        scene=scene_of(
            mission='racetrack', duration_s=900.0, dvl_markov_sigma=1e-5, dvl_scale=1e-6
        ),
    ),
    *(
        Row(
            f'dvl_lever_2m_{name}',
            f'DVL 2 m ahead of where it is stated, {name}',
            '2 m',
            f.DvlPlace(lever_b=(2.0, 0.0, 0.0)),
            (DVL,),
            scene=scene,
        )
        for name, scene in (('straight', SINS), ('racetrack', RACETRACK))
    ),
    *(
        Row(
            f'dvl_lag_{name}',
            f'DVL pings late, {name}',
            '0.5 s',
            f.DvlPlace(lag_s=0.5),
            (DVL,),
            scene=scene,
        )
        for name, scene in (('straight', SINS), ('racetrack', RACETRACK))
    ),
    Row(
        'dvl_bad_pings',
        'bad pings stated as good',
        '5 % with 1 m/s',
        f.DvlBadPings(share=0.05, sigma=1.0),
        (DVL,),
    ),
    Row(
        'dvl_stuck',
        'DVL repeats one ping, on turns',
        'stuck',
        f.DvlStuck(start_s=START_S),
        (DVL,),
        scene=RACETRACK,
    ),
    Row(
        'dvl_out_10min',
        'no bottom lock for ten minutes',
        '600 s',
        f.DvlOut(length_s=600.0, start_s=START_S, obvious=True),
        (DVL,),
    ),
)

DEPTH_ROWS = (
    Row(
        'depth_bias_0.3m',
        "depth off by a day's air pressure, from mid-run",
        '0.3 m',
        f.DepthError(bias_m=0.3, start_s=START_S),
        (DEPTH,),
    ),
    Row(
        'depth_stuck_dive',
        'barometer sticks while the vehicle dives',
        'stuck',
        f.DepthError(stuck=True, start_s=200.0),
        (DEPTH,),
        scene=scene_of(mission='dive', duration_s=600.0),
    ),
)
