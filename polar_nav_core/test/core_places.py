"""Places that every position-dependent test goes through, and the reference vectors."""

import json
from pathlib import Path

import numpy as np

from polar_nav_core import earth

A, B = 6378137.0, 6378137.0 * (1.0 - 1.0 / 298.257223563)

# name: (latitude, longitude [deg], height [m])
PLACES = {
    'exact north pole': (90.0, 0.0, -100.0),
    'exact south pole': (-90.0, 0.0, 30.0),
    '0.3 m from the north pole': (90.0 - 2.7e-6, 17.0, 0.0),
    '89.99N at 180E': (89.99, 180.0, -50.0),
    '89.99N at 180W': (89.99, -180.0, -50.0),
    '80N 120E': (80.0, 120.0, -100.0),
    '75S 60W': (-75.0, -60.0, -400.0),
    '70N 90E': (70.0, 90.0, -4000.0),
    '10N 30E': (10.0, 30.0, 1000.0),
    'equator, Greenwich': (0.0, 0.0, 0.0),
    'equator, 89E': (0.0, 89.0, 0.0),
}


def position(name):
    """ECEF position; x = y = 0 to the bit at the exact poles."""
    lat, lon, h = PLACES[name]
    if abs(lat) == 90.0:
        return np.array([0.0, 0.0, np.copysign(B + h, lat)])
    return earth.ecef_from_geodetic(np.radians(lat), np.radians(lon), h)


VECTORS = json.loads((Path(__file__).parent / 'data' / 'polar.json').read_text())
STATES = {state['name']: state for state in VECTORS['states']}
