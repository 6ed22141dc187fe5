"""Rows of DVL and depth."""

from __future__ import annotations

from polar_nav_core.engine.params import EngineParams

from . import dvl_faults as f
from .culprits import DEPTH, DVL, HEADING, IMU
from .row import LEVEL, RACETRACK, SINS, START_S, TACTICAL, row, scene_of

NOT_STATED = {
    name: getattr(EngineParams(), name)
    for name in ('dvl_scale_sigma', 'dvl_markov_sigma', 'dvl_markov_tau')
}
"""Slow errors of a DVL for a user who states none: the engine's defaults."""

DVL_ROWS = (
    row('dvl_scale_1pc', f.DvlGain(scale=0.01), (DVL,)),
    row('dvl_sound_speed', f.DvlGain(scale=0.042), (DVL,)),
    *(
        row(f'dvl_turned_{deg:g}deg', f.DvlGain(turn_deg=deg), (DVL, HEADING))
        for deg in (0.3, 1.0)
    ),
    *(
        row(
            f'dvl_turned_{deg:g}deg_no_heading',
            f.DvlGain(turn_deg=deg),
            (DVL, HEADING),
            invisible=True,
            beyond_stated=deg > 0.6,
            scene=scene_of(initial_sigma_heading_deg=5.0, gyro_bias_dph=1.0, oscillating=False),
        )
        for deg in (0.6, 1.0)
    ),
    *(
        row(
            f'dvl_slow_{name}unstated',
            f.DvlSlow(
                sigma=sigma,
                tau_s=300.0,
                scale_sigma=scale,
                known={'dvl_markov_sigma': sigma, 'dvl_scale_sigma': scale},
            ),
            (DVL,),
            scene=scene_of(
                NOT_STATED,
                mission='racetrack',
                duration_s=900.0,
                dvl_markov_sigma=1e-5,
                dvl_scale=1e-6,
            ),
        )
        for name, sigma, scale in (('', 0.005, 1e-4), ('real_', 0.03, 5e-3))
    ),
    *(
        row(f'dvl_lever_2m_{name}', f.DvlPlace(lever_b=(2.0, 0.0, 0.0)), (DVL,), scene=scene)
        for name, scene in (('straight', SINS), ('racetrack', RACETRACK))
    ),
    *(
        row(f'dvl_lag_{name}', f.DvlPlace(lag_s=0.5), (DVL,), scene=scene)
        for name, scene in (('straight', SINS), ('racetrack', RACETRACK))
    ),
    row(
        'dvl_lever_0.2m_level',
        f.DvlPlace(lever_b=(0.2, 0.0, 0.0)),
        (DVL,),
        invisible=True,
        scene=LEVEL,
    ),
    row('dvl_lag_0.1s_level', f.DvlPlace(lag_s=0.1), (DVL,), invisible=True, scene=LEVEL),
    row('dvl_mirrored', f.DvlMirrored(start_s=START_S), (DVL,)),
    *(
        row(
            f'dvl_water_{name}',
            f.DvlWater(current=0.4, ramp_s=ramp_s, start_s=START_S),
            (DVL, IMU),
            scene=scene,
        )
        for name, ramp_s, scene in (
            ('at_once', 0.0, SINS),
            ('slowly', 300.0, SINS),
            ('slowly_racetrack', 300.0, RACETRACK),
            ('slowly_tactical', 300.0, TACTICAL),
        )
    ),
    *(
        row(
            f'dvl_scale_grows_{name}',
            f.DvlScaleGrows(scale=0.03, ramp_s=300.0, start_s=START_S),
            (DVL,),
            scene=scene,
        )
        for name, scene in (('straight', SINS), ('racetrack', RACETRACK))
    ),
    row('dvl_bad_pings', f.DvlBadPings(share=0.05, sigma=1.0), (DVL,)),
    row('dvl_stuck', f.DvlStuck(start_s=START_S), (DVL,), scene=RACETRACK),
    row('dvl_out_10min', f.DvlOut(length_s=600.0, start_s=START_S, obvious=True), (DVL,)),
)

DEPTH_ROWS = (
    row('depth_zero_1m', f.DepthError(bias_m=1.0), (DEPTH,), invisible=True),
    row('depth_drift_0.01mps', f.DepthError(drift_mps=0.01, start_s=START_S), (DEPTH,)),
    row('depth_bias_0.3m', f.DepthError(bias_m=0.3, start_s=START_S), (DEPTH,)),
    row(
        'depth_stuck_dive',
        f.DepthError(stuck=True, start_s=200.0),
        (DEPTH,),
        scene=scene_of(mission='dive', duration_s=600.0),
    ),
)
