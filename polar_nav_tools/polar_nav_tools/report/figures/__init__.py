"""Pictures of a report, one function each; `draw_all` puts them into their order."""

from .base import Clock, Picture
from .close_up import close_up
from .errors import horizontal_error, position_error, tilt_error, velocity_heading_error
from .fixes import fix_delays, fix_story
from .honesty import honesty
from .polar_map import polar_map

__all__ = [
    'Clock',
    'Picture',
    'close_up',
    'fix_delays',
    'fix_story',
    'honesty',
    'horizontal_error',
    'polar_map',
    'position_error',
    'tilt_error',
    'velocity_heading_error',
]
