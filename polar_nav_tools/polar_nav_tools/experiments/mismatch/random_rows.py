"""Rows drawn at random: a fault, or two, of any kind and size in any scene.

The other rows are what somebody thought of. A row of a number is the same wherever it is drawn.
Nobody is named as its culprit: any report is right.
"""

from __future__ import annotations

import math

from ..draws import OneOf, Size, Way
from . import dvl_faults as d
from . import faults as f
from . import fix_faults as x
from . import imu_faults as m
from .draws import Draw, Kind
from .faults import Fault
from .row import LEVEL, RACETRACK, SINS, START_S, TACTICAL, scene_of

RANDOM = 'random:'
"""Before a number, or two with a dash between, in the name of a row."""
_STARTS_S = OneOf((0.0, 200.0, START_S))
_SCENES = {
    'straight': SINS,
    'level': LEVEL,
    'racetrack': RACETRACK,
    'tactical': TACTICAL,
    'lawnmower': scene_of(mission='lawnmower', duration_s=1200.0),
    'dive': scene_of(mission='dive', duration_s=900.0),
}


_RAMP, _AXIS = OneOf((0.0, 300.0)), OneOf((0, 1, 2))
_SHARE, _LENGTH = Size(0.02, 0.7), OneOf((10.0, 60.0, 200.0, math.inf))
_LATER = OneOf((200.0, START_S))
"""Of faults that begin in mid-run: from the start on there would be nothing that they change."""
KINDS: tuple[Kind[Fault], ...] = (
    (f.ImuStep, {'gyro_dph': Size(0.05, 50.0, signed=True), 'ramp_s': _RAMP}),
    (f.ImuStep, {'accel_ug': Size(3.0, 3000.0, signed=True), 'ramp_s': _RAMP}),
    (f.ImuGain, {'gyro_ppm': Size(50.0, 2e4)}),
    (f.ImuGain, {'accel_ppm': Size(50.0, 2e4)}),
    (f.ImuNoise, {'gyro_density': Size(1e-6, 1e-3), 'accel_density': Size(1e-5, 1e-2)}),
    (
        f.ImuTurned,
        {
            'deg': Size(0.1, 10.0, signed=True),
            'axis': OneOf(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))),
            'start_s': _LATER,
        },
    ),
    (m.ImuKick, {'deg': Size(0.3, 30.0, signed=True), 'axis': _AXIS, 'start_s': _LATER}),
    (m.ImuSkew, {'deg': Size(0.05, 3.0)}),
    (m.ImuStamps, {'late_s': Size(0.01, 0.5)}),
    (m.ImuStamps, {'jitter_s': Size(0.001, 0.02)}),
    (m.ImuStamps, {'tick_s': Size(0.005, 0.05)}),
    (m.ImuBursts, {'every_s': Size(0.5, 30.0), 'length_s': Size(0.05, 0.4)}),
    (m.ImuAxisStuck, {'axis': _AXIS, 'gyro': OneOf((True, False)), 'start_s': _LATER}),
    (m.ImuSpikes, {'every_s': Size(0.5, 60.0), 'rate': Size(0.05, 3.0), 'force': Size(0.5, 30.0)}),
    (f.StartOff, {'north_m': Size(10.0, 3000.0), 'start_s': OneOf((0.0,))}),
    (f.HeadingStart, {'error_deg': Size(1.0, 170.0, signed=True), 'start_s': OneOf((0.0,))}),
    (f.FixOffset, {'offset_m': Size(1.0, 100.0), 'length_s': _LENGTH, 'start_s': _LATER}),
    (f.FixOffset, {'drift_mps': Size(0.005, 1.0, signed=True), 'start_s': _LATER}),
    (f.FixClock, {'offset_s': Size(0.02, 10.0, signed=True)}),
    (f.FixClock, {'rate_ppm': Size(20.0, 2000.0)}),
    (f.FixLever, {'lever_b': Way(0.5, 10.0)}),
    (f.FixOutliers, {'share': _SHARE, 'low_m': Size(2.0, 20.0), 'high_m': Size(20.0, 200.0)}),
    (f.FixColoured, {'sigma': Size(0.5, 10.0), 'tau_s': Size(5.0, 600.0)}),
    (f.FixTails, {'sigma': Size(0.5, 5.0)}),
    (f.LeaderFrame, {'scale': Size(0.002, 0.1)}),
    (f.LeaderFrame, {'turn_deg': Size(0.3, 20.0, signed=True)}),
    (x.FixSwitches, {'offset_m': Size(2.0, 30.0), 'period_s': Size(10.0, 300.0)}),
    (x.FixWaves, {'amplitude_m': Size(1.0, 20.0), 'period_s': Size(20.0, 1200.0)}),
    (x.FixWalks, {'density': Size(0.05, 3.0)}),
    (x.FixTimes, {'most_s': Size(0.1, 10.0)}),
    (x.FixRounded, {'step_m': Size(1.0, 60.0)}),
    (x.FixTwoSenders, {'offset_m': Size(1.0, 50.0)}),
    (x.FixOffOnCourse, {'offset_m': Size(1.0, 20.0)}),
    (x.FixSmoothed, {'tau_s': Size(1.0, 60.0)}),
    (x.FixHeight, {'up_m': Size(1.0, 60.0, signed=True)}),
    (x.FrameDrifts, {'turn_dph': Size(2.0, 200.0)}),
    (x.FrameDrifts, {'scale': Size(0.003, 0.1), 'ramp_s': Size(30.0, 600.0)}),
    (d.DvlGain, {'scale': Size(0.003, 0.3, signed=True)}),
    (d.DvlGain, {'turn_deg': Size(0.2, 30.0, signed=True)}),
    (d.DvlWater, {'current': Size(0.03, 1.0), 'ramp_s': OneOf((0.0, 60.0, 600.0))}),
    (d.DvlScaleGrows, {'scale': Size(0.005, 0.2, signed=True), 'ramp_s': Size(20.0, 900.0)}),
    (
        d.DvlSlow,
        {'sigma': Size(0.005, 0.2), 'tau_s': Size(10.0, 1e3), 'scale_sigma': OneOf((1e-4,))},
    ),
    (d.DvlPlace, {'lever_b': Way(0.1, 5.0)}),
    (d.DvlPlace, {'lag_s': Size(0.02, 2.0)}),
    (d.DvlLate, {'most_s': Size(0.05, 2.0)}),
    (d.DvlBadPings, {'share': _SHARE, 'sigma': Size(0.05, 3.0)}),
    (d.DvlStuck, {'start_s': _LATER}),
    (d.DvlOut, {'length_s': Size(20.0, 800.0)}),
    (d.DvlBias, {'bias_m': Way(0.01, 0.5)}),
    (d.DvlOneSided, {'share': _SHARE, 'size': Size(0.03, 2.0)}),
    (d.DvlFreezes, {'length_s': Size(1.0, 30.0), 'every_s': Size(30.0, 120.0)}),
    (d.DvlRounded, {'step': Size(0.01, 0.5)}),
    (
        d.DvlFish,
        {'speed': Size(0.1, 1.5), 'length_s': Size(2.0, 60.0), 'every_s': Size(60.0, 300.0)},
    ),
    (d.DepthError, {'bias_m': Size(0.5, 40.0, signed=True)}),
    (d.DepthError, {'drift_mps': Size(0.002, 0.3, signed=True)}),
    (d.DepthError, {'stuck': OneOf((True,)), 'start_s': _LATER}),
    (d.DepthGain, {'scale': Size(0.005, 0.3, signed=True)}),
    (d.DepthGain, {'tau_s': Size(1.0, 60.0)}),
    (d.DepthSpikes, {'share': _SHARE, 'size_m': Size(0.5, 50.0)}),
)
"""Kinds of faults, each as likely as the other, and what of them is drawn."""


random_row = Draw('random', _SCENES, KINDS, _STARTS_S, x.both).row
