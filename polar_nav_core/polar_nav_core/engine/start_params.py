"""Parameters of the start: where the initial state comes from, and that state."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..params import NodeParams, choice, param, vector
from .events import InitialState


@dataclass(frozen=True)
class StartParams(NodeParams):
    """Initial state, of either mode, and its alignment."""

    initialize: str = choice(
        'auto',
        ('auto', 'parameters', 'alignment', 'service'),
        'Where the initial state comes from; auto: from parameters where latitude, longitude, '
        'height and heading are stated, else from an alignment (docs/start.md)',
    )
    align_window_s: float = param(
        10.0, 's', 1.0, 600.0, 'Alignment: time that gravity and measured headings are averaged'
    )
    align_heading: str = choice(
        'auto',
        ('auto', 'measured', 'gyrocompass', 'course'),
        'Alignment: the only method whose heading counts; auto: the most certain one',
    )
    initial_latitude_deg: float = param(80.0, 'deg', -90.0, 90.0, 'Geodetic latitude')
    initial_longitude_deg: float = param(120.0, 'deg', -360.0, 360.0, 'Longitude')
    initial_height: float = param(-100.0, 'm', -12000.0, 9000.0, 'Height above the ellipsoid')
    initial_v_G: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'm/s', -50.0, 50.0, 'Velocity, grid axes'
    )
    initial_roll_deg: float = param(0.0, 'deg', -180.0, 180.0, 'Roll')
    initial_pitch_deg: float = param(0.0, 'deg', -90.0, 90.0, 'Pitch, positive nose down')
    initial_grid_heading_deg: float = param(
        0.0, 'deg', -360.0, 360.0, 'Heading, clockwise from grid north'
    )
    initial_sigma_position: float = param(5.0, 'm', 1e-3, 1e6, '1-sigma per horizontal axis')
    initial_sigma_height: float = param(5.0, 'm', 1e-3, 1e6, '1-sigma')
    initial_sigma_velocity: float = param(0.01, 'm/s', 1e-6, 100.0, '1-sigma per axis')
    initial_sigma_tilt_deg: float = param(0.5 / 60, 'deg', 1e-7, 90.0, '1-sigma of roll and pitch')
    initial_sigma_heading_deg: float = param(5.0 / 60, 'deg', 1e-7, 180.0, '1-sigma')

    def initial_state(self) -> InitialState | None:
        """State to start from, or None when it comes by service or from an alignment."""
        if self.initialize in ('service', 'alignment'):
            return None
        return InitialState(
            latitude=math.radians(self.initial_latitude_deg),
            longitude=math.radians(self.initial_longitude_deg),
            height=self.initial_height,
            v_G=(self.initial_v_G[0], self.initial_v_G[1], self.initial_v_G[2]),
            roll=math.radians(self.initial_roll_deg),
            pitch=math.radians(self.initial_pitch_deg),
            grid_heading=math.radians(self.initial_grid_heading_deg),
            sigma_position_horizontal=self.initial_sigma_position,
            sigma_position_vertical=self.initial_sigma_height,
            sigma_velocity=self.initial_sigma_velocity,
            sigma_tilt=math.radians(self.initial_sigma_tilt_deg),
            sigma_heading=math.radians(self.initial_sigma_heading_deg),
        )
