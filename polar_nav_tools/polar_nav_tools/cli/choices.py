"""Words that options take, for their help: written out, since their modules load the compiler.

A test compares each with the module that decides.
"""

from __future__ import annotations

from polar_nav_sim.resources import mission_names

PACES = ('lockstep', 'realtime')
LEADERS = ('perfect', 'own')
FORMATS = ('tum', 'csv', 'kml')
FRAMES = ('ecef', 'enu', 'grid', 'epsg:3413', 'epsg:3995', 'epsg:3031')
CONFIGURATIONS = (
    'conventional_akf',
    'modified_akf',
    'conventional_akf_published',
    'modified_akf_published',
    'default',
    'published',
    'ignore',
    'tagged',
    'back_propagate',
    'clone',
    'rewind',
)
IMU_CLASSES = ('bmi088', 'fog', 'icm20948', 'navigation', 'stim300', 'vn100')
DVL_CLASSES = (
    'a50_performance',
    'a50_standard',
    'pathfinder_600',
    'workhorse_1200',
    'workhorse_300',
)
REFERENCES = ('bottom', 'water')
STAMPS = ('header', 'log')
MISSIONS = ', '.join(mission_names())


def one_of(words: tuple[str, ...]) -> str:
    """Placeholder of an option in a help: its words."""
    return '|'.join(words)
