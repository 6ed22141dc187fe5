"""A track as KML 2.2 with the time of each place (`gx:Track`), for Google Earth and QGIS."""

from __future__ import annotations

from collections.abc import Iterator
from xml.sax.saxutils import escape

import numpy as np

from ..series.vehicle import Floats, Ints

_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2">
<Document><Placemark><name>{name}</name><gx:Track><altitudeMode>absolute</altitudeMode>
"""
_TAIL = '</gx:Track></Placemark></Document></kml>\n'


def kml_lines(
    name: str, stamp_ns: Ints, longitude: Floats, latitude: Floats, height: Floats
) -> Iterator[str]:
    """Lines of a file with one track; times are UTC to the millisecond.

    Parameters
    ----------
    name : str
        What a viewer calls it.
    stamp_ns : (n,) array
        Since 1970 [ns].
    longitude, latitude, height : (n,) arrays
        [rad, rad, m].
    """
    yield _HEAD.format(name=escape(name))
    for text in np.datetime_as_string(stamp_ns.astype('datetime64[ns]'), unit='ms'):
        yield f'<when>{text}Z</when>\n'
    degrees = np.rad2deg(np.column_stack([longitude, latitude]))
    for (lon, lat), h in zip(degrees.tolist(), height.tolist(), strict=True):
        yield f'<gx:coord>{lon!r} {lat!r} {h!r}</gx:coord>\n'
    yield _TAIL
