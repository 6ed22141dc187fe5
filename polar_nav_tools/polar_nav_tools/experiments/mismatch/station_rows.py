"""Rows of station mode: 1600 s of the mission ``station``, faults from the second half on."""

from __future__ import annotations

from typing import Any

from polar_nav_sim.offline_station import StationScenario

from . import station_faults as s
from . import station_motion as m
from .culprits import DEPTH, FIXES, HEADING, IMU, MODEL
from .row import STATION, Row, row
from .scenes import StationScene


def _station_row(
    name: str,
    fault: s.StationFault,
    culprits: tuple[str, ...],
    *,
    invisible: bool = False,
    **scenario: Any,  # noqa: ANN401 - of StationScenario
) -> Row:
    scene = StationScene(StationScenario(**scenario)) if scenario else STATION
    return row(f'station_{name}', fault, culprits, invisible=invisible, scene=scene)


STATION_ROWS = (
    _station_row('thruster_dead', m.ThrusterDead(start_s=800.0), (MODEL,)),
    _station_row('thrust_20pc_less', s.ThrustStated(factor=1.25), (MODEL,)),
    _station_row('heading_3deg', s.AhrsHeading(offset_deg=3.0), (HEADING,)),
    _station_row('heading_drift', s.AhrsHeading(drift_deg_h=5.0), (HEADING,)),
    _station_row(
        'heading_30deg_60s',
        s.AhrsHeading(offset_deg=30.0, start_s=900.0, length_s=60.0),
        (HEADING, MODEL),
    ),
    _station_row('range_1pc', s.StationError(range_scale=0.01), (FIXES,)),
    _station_row(
        'bearing_1deg', s.StationError(bearing_deg=1.0), (FIXES, HEADING), invisible=True
    ),
    _station_row('position_20m', s.StationError(station_m=20.0), (FIXES,), invisible=True),
    *(
        _station_row(
            f'current_{speed:g}_reverses',
            m.CurrentReverses(speed_mps=speed, length_s=270.0, start_s=800.0),
            (MODEL,),
        )
        for speed in (0.47, 1.2)
    ),
    _station_row(
        'current_1.2_swings',
        m.CurrentReverses(speed_mps=1.2, length_s=270.0, start_s=400.0, again=True),
        (MODEL,),
    ),
    _station_row('outliers_30pc', s.RangeOutliers(share=0.3, size_m=30.0), (FIXES,)),
    _station_row(
        'outliers_30pc_long', s.RangeOutliers(share=0.3, size_m=30.0, one_sided=True), (FIXES,)
    ),
    _station_row('held_120s', m.Held(start_s=900.0, length_s=120.0), (MODEL,)),
    *(
        _station_row(
            f'thrust_absurd_{ms:g}ms',
            s.ThrustGlitch(force_n=1e6, held_s=1e-3 * ms, start_s=900.0),
            (MODEL,),
        )
        for ms in (10.0, 100.0)
    ),
    _station_row(
        'thrust_absurd_silent',
        s.ThrustGlitch(force_n=1e6, held_s=0.01, silent_s=30.0, start_s=900.0),
        (MODEL,),
    ),
    _station_row(
        'thrust_silent_30s', s.ThrustGlitch(silent_s=30.0, start_s=900.0, obvious=True), (MODEL,)
    ),
    _station_row(
        'thrust_ends', s.ThrustGlitch(silent_s=1e4, start_s=900.0, obvious=True), (MODEL,)
    ),
    _station_row(
        'ahrs_gap_60s',
        s.AhrsOut(length_s=60.0, start_s=900.0, obvious=True),
        (HEADING, MODEL, IMU),
    ),
    *(
        _station_row(f'validity_{name}_1s', s.Validity(late_s=late_s), (FIXES,))
        for name, late_s in (('late', 1.0), ('early', -1.0))
    ),
    _station_row('thrust_20pc_more', s.ThrustStated(factor=0.8, start_s=800.0), (MODEL,)),
    _station_row('thrust_20pc_more_start', s.ThrustStated(factor=0.8), (MODEL,)),
    _station_row('thrust_reversed', s.ThrustStated(factor=-1.0, start_s=800.0), (MODEL,)),
    _station_row('thrust_late_5s', s.ThrustLate(late_s=5.0, start_s=800.0), (MODEL,)),
    *(
        _station_row(
            f'drag_grows_{100 * share:g}pc',
            m.DragGrows(share=share, ramp_s=300.0, start_s=600.0),
            (MODEL,),
        )
        for share in (0.3, 1.0)
    ),
    *(
        _station_row(
            f'current_begins_{speed:g}mps',
            m.CurrentBegins(speed_mps=speed, ramp_s=20.0, start_s=800.0),
            (MODEL,),
        )
        for speed in (0.2, 0.5)
    ),
    _station_row(
        'bearing_mirrored_30s', s.FixesOff(mirrored=True, start_s=900.0, length_s=30.0), (FIXES,)
    ),
    _station_row('bearing_mirrored', s.FixesOff(mirrored=True, start_s=900.0), (FIXES,)),
    *(
        _station_row(
            f'range_slot_{name}',
            s.FixesOff(range_m=75.0, start_s=900.0, length_s=length_s),
            (FIXES,),
        )
        for name, length_s in (('30s', 30.0), ('300s', 300.0), ('for_good', 1e4))
    ),
    _station_row('range_step_15m', s.FixesOff(range_m=15.0, start_s=800.0), (FIXES,)),
    _station_row('range_drifts', s.FixesOff(range_mps=0.05, start_s=800.0), (FIXES,)),
    _station_row('bearing_drifts', s.FixesOff(bearing_dph=20.0, start_s=800.0), (FIXES,)),
    _station_row('bearing_step_3deg', s.FixesOff(bearing_deg=3.0, start_s=800.0), (FIXES,)),
    _station_row('heading_deviation_8deg', s.AhrsDeviation(deg=8.0), (HEADING, MODEL)),
    _station_row(
        'heading_drifts_60dph', s.AhrsHeading(drift_deg_h=60.0, start_s=600.0), (HEADING,)
    ),
    _station_row('depth_off_10m', s.DepthOff(bias_m=10.0, start_s=800.0), (DEPTH,)),
    _station_row('depth_stuck', s.DepthOff(stuck=True, start_s=400.0), (DEPTH,)),
    _station_row(
        'both_thrust_and_range',
        s.StationBoth(
            one=s.ThrustStated(factor=1.15, start_s=800.0),
            other=s.FixesOff(range_mps=0.03, start_s=800.0),
            start_s=800.0,
        ),
        (MODEL, FIXES),
    ),
    _station_row('control', s.StationFault(), ()),
    _station_row('control_loss', s.StationFault(), (), loss=0.5),
)
