"""Places where longitude or true north fail, as variants of one straight mission."""

from polar_nav_sim.mission import load_mission

PLACES = {
    'exact north pole': (90.0, 0.0),
    'exact south pole': (-90.0, 77.0),
    'just off the north pole': (89.9999999, -120.0),
    '+180 degrees': (85.0, 180.0),
    '-180 degrees': (-85.0, -180.0),
    'longitude wrap': (89.99, 179.999),
    'ordinary': (80.0, 120.0),
}
"""Latitude and longitude of the start [deg]."""


def mission_at(place, **changes):
    latitude, longitude = PLACES[place]
    return load_mission('demo').with_overrides(
        {
            'path.latitude_deg': latitude,
            'path.longitude_deg': longitude,
            'path.course_deg': 40.0,
            'duration_s': 60.0,
            **changes,
        }
    )
