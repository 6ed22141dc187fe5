"""Rows of DVL and depth."""

from __future__ import annotations

from polar_nav_core.engine.params import EngineParams

from . import dvl_faults as f
from .culprits import DEPTH, DVL, HEADING, IMU
from .row import LEVEL, RACETRACK, SINS, START_S, TACTICAL, Row, row, scene_of

NOT_STATED = {
    name: getattr(EngineParams(), name)
    for name in ('dvl_scale_sigma', 'dvl_markov_sigma', 'dvl_markov_tau')
}
"""Slow errors of a DVL for a user who states none: the engine's defaults."""

DVL_ROWS: tuple[Row, ...] = (
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

DEPTH_ROWS: tuple[Row, ...] = (
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

_PITCHED = ((0.0, 0.0, 0.035), (0.0, 0.0, 0.0), (-0.035, 0.0, 0.0))
"""A DVL pitched by 2 degrees."""
_BEAM_LOST = ((0.02, 0.0, 0.0), (0.0, 0.0, 0.0), (0.03, 0.0, 0.0))
"""Of three beams: 2 % long, and a tilted bottom shows as 3 % of climb."""
_UP_FLIPPED = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -2.0))
_ICE = 0.2
"""Drift of ice [m/s]."""

DVL_ROWS += (
    *(
        row(
            f'dvl_bias_{1000.0 * size:g}mmps_{name}',
            f.DvlBias(bias_m=(size, 0.5 * size, 0.0), start_s=START_S),
            (DVL,),
            scene=scene,
        )
        for size, name, scene in (
            (0.03, 'straight', SINS),
            (0.03, 'racetrack', RACETRACK),
            (0.1, 'tactical', TACTICAL),
        )
    ),
    row('dvl_one_sided_3pc', f.DvlOneSided(share=0.03, size=0.5, start_s=START_S), (DVL,)),
    row('dvl_one_sided_30pc', f.DvlOneSided(share=0.3, size=0.05, start_s=START_S), (DVL,)),
    *(
        row(
            f'dvl_freezes_5s_{name}',
            f.DvlFreezes(length_s=5.0, every_s=30.0, start_s=START_S),
            (DVL,),
            scene=scene,
        )
        for name, scene in (('racetrack', RACETRACK), ('tactical', TACTICAL))
    ),
    row('dvl_late_varies', f.DvlLate(most_s=0.6, start_s=START_S), (DVL,), scene=RACETRACK),
    *(
        row(
            f'dvl_late_grows_{name}',
            f.DvlLate(most_s=3.0, ramp_s=300.0, start_s=START_S),
            (DVL, HEADING),
            scene=scene,
        )
        for name, scene in (('racetrack', RACETRACK), ('tactical', TACTICAL))
    ),
    row(
        'dvl_beam_lost',
        f.DvlMixes(matrix=_BEAM_LOST, noise=0.005, start_s=START_S),
        (DVL,),
        scene=RACETRACK,
    ),
    row('dvl_pitched_2deg', f.DvlMixes(matrix=_PITCHED), (DVL,)),
    row(
        'dvl_up_flipped_dive',
        f.DvlMixes(matrix=_UP_FLIPPED),
        (DVL, DEPTH),
        scene=scene_of(mission='dive', duration_s=600.0),
    ),
    row(
        'dvl_noise_5x', f.DvlMixes(matrix=((0.0,) * 3,) * 3, noise=0.025, start_s=START_S), (DVL,)
    ),
    row('dvl_rounded_0.1', f.DvlRounded(step=0.1, start_s=START_S), (DVL,)),
    row('dvl_knots', f.DvlGain(scale=0.944), (DVL,)),
    row('dvl_turned_45deg', f.DvlGain(turn_deg=45.0), (DVL, HEADING), scene=TACTICAL),
    row('dvl_turns_3deg', f.DvlGain(turn_deg=3.0, start_s=START_S), (DVL, HEADING)),
    row(
        'dvl_turns_3deg_tactical',
        f.DvlGain(turn_deg=3.0, start_s=START_S),
        (DVL, HEADING),
        scene=TACTICAL,
    ),
    *(
        row(
            f'dvl_fish_{name}',
            f.DvlFish(speed=0.5, length_s=10.0, every_s=60.0, start_s=START_S),
            (DVL, IMU),
            scene=scene,
        )
        for name, scene in (('straight', SINS), ('tactical', TACTICAL))
    ),
    row(
        'dvl_ice',
        f.DvlWater(current=_ICE, ramp_s=20.0, start_s=START_S),
        (DVL, IMU),
        scene=TACTICAL,
    ),
)

_DIVE = scene_of(mission='dive', duration_s=600.0)
DEPTH_ROWS += (
    row('depth_tide_1mph', f.DepthError(drift_mps=1.0 / 3600.0), (DEPTH,)),
    row('depth_scale_3pc_dive', f.DepthGain(scale=0.03), (DEPTH,), scene=_DIVE),
    row('depth_cut_off_dive', f.DepthGain(limit_m=60.0), (DEPTH,), scene=_DIVE),
    row('depth_trails_5s_dive', f.DepthGain(tau_s=5.0), (DEPTH,), scene=_DIVE),
    row('depth_spikes_5pc', f.DepthSpikes(share=0.05, size_m=5.0, start_s=START_S), (DEPTH,)),
    row('depth_jumps_10m', f.DepthError(bias_m=10.0, start_s=START_S), (DEPTH,)),
)
