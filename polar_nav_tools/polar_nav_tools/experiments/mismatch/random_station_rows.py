"""Rows of station mode drawn at random: a fault, or two, of any kind and size.

As `random_rows`, whose rows are of the strapdown mode.
"""

from __future__ import annotations

import math

from polar_nav_sim.offline_station import StationScenario

from ..draws import OneOf, Size
from . import station_faults as s
from . import station_motion as m
from .draws import Draw, Kind
from .row import STATION
from .scenes import StationScene

RANDOM_STATION = 'random-station:'
"""Before a number, or two with a dash between, in the name of a row."""
_STARTS_S = OneOf((0.0, 400.0, 800.0))
_SCENES = {
    'station': STATION,
    'low excitation': StationScene(StationScenario(excitation=0.25)),
    'half lost': StationScene(StationScenario(loss=0.5)),
    'swinging current': StationScene(StationScenario(current_change=0.3, current_turn=0.6)),
}
_LATER, _LENGTH = OneOf((400.0, 800.0)), OneOf((10.0, 60.0, 200.0, math.inf))
KINDS: tuple[Kind[s.StationFault], ...] = (
    (s.StationError, {'range_scale': Size(0.002, 0.1, signed=True)}),
    (s.StationError, {'bearing_deg': Size(0.2, 20.0, signed=True)}),
    (s.StationError, {'station_m': Size(5.0, 300.0, signed=True)}),
    (
        s.RangeOutliers,
        {
            'share': Size(0.02, 0.7),
            'size_m': Size(5.0, 200.0),
            'one_sided': OneOf((False, True)),
        },
    ),
    (s.Validity, {'late_s': Size(0.1, 10.0, signed=True)}),
    (s.FixesOff, {'range_m': Size(3.0, 300.0, signed=True), 'length_s': _LENGTH}),
    (s.FixesOff, {'range_mps': Size(0.01, 1.0, signed=True), 'start_s': _LATER}),
    (s.FixesOff, {'bearing_deg': Size(0.5, 60.0, signed=True), 'length_s': _LENGTH}),
    (s.FixesOff, {'bearing_dph': Size(2.0, 200.0, signed=True), 'start_s': _LATER}),
    (s.FixesOff, {'mirrored': OneOf((True,)), 'start_s': _LATER, 'length_s': _LENGTH}),
    (s.AhrsHeading, {'offset_deg': Size(0.5, 90.0, signed=True), 'length_s': _LENGTH}),
    (s.AhrsHeading, {'drift_deg_h': Size(1.0, 300.0, signed=True)}),
    (s.AhrsDeviation, {'deg': Size(0.5, 30.0)}),
    (
        s.AhrsOut,
        {'length_s': Size(2.0, 300.0), 'start_s': _LATER, 'obvious': OneOf((True,))},
    ),
    (s.ThrustStated, {'factor': Size(0.3, 3.0)}),
    (s.ThrustLate, {'late_s': Size(0.3, 30.0)}),
    (
        s.ThrustGlitch,
        {
            'force_n': Size(100.0, 1e7, signed=True),
            'held_s': Size(0.01, 10.0),
            'silent_s': OneOf((0.0, 10.0, 100.0)),
            'start_s': _LATER,
        },
    ),
    (s.DepthOff, {'bias_m': Size(0.5, 100.0, signed=True)}),
    (s.DepthOff, {'stuck': OneOf((True,)), 'start_s': _LATER}),
    (m.ThrusterDead, {'start_s': _LATER}),
    (m.Held, {'length_s': Size(5.0, 400.0), 'start_s': _LATER}),
    (
        m.CurrentReverses,
        {
            'speed_mps': Size(0.1, 2.0),
            'length_s': Size(20.0, 600.0),
            'again': OneOf((False, True)),
            'start_s': _LATER,
        },
    ),
    (
        m.CurrentBegins,
        {'speed_mps': Size(0.1, 2.0), 'ramp_s': Size(5.0, 300.0), 'start_s': _LATER},
    ),
    (m.DragGrows, {'share': Size(0.1, 5.0), 'ramp_s': Size(10.0, 600.0), 'start_s': _LATER}),
)
"""Kinds of faults, each as likely as the other, and what of them is drawn."""


def _both(one: s.StationFault, other: s.StationFault) -> s.StationFault:
    return s.StationBoth(
        one=one,
        other=other,
        start_s=min(one.start_s, other.start_s),
        obvious=one.obvious or other.obvious,
    )


random_station_row = Draw('random_station', _SCENES, KINDS, _STARTS_S, _both).row
