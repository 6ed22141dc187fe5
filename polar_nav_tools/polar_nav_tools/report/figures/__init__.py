"""Figures of a report, one function each; `draw_all` returns all in order."""

from .base import Clock, Picture
from .close_up import close_up
from .errors import horizontal_error, position_error, tilt_error, velocity_heading_error
from .fixes import fix_delays, fix_story
from .honesty import honesty
from .model import current_arrow, model_parameters
from .polar_map import polar_map

__all__ = [
    'Clock',
    'Picture',
    'close_up',
    'current_arrow',
    'fix_delays',
    'fix_story',
    'honesty',
    'horizontal_error',
    'model_parameters',
    'polar_map',
    'position_error',
    'tilt_error',
    'velocity_heading_error',
]
