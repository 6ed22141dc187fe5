"""Services beside those of commands: sensors off and on, and places in the map and on the Earth.

| service | type | |
| --- | --- | --- |
| ~/use/<topic> | std_srvs/SetBool | false: messages of the topic are not used; a stamped event |
| fromLL, toLL | polar_nav_msgs/FromLL, ToLL | geodetic place to point in the map, and back |
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeAlias

import numpy as np
from rclpy.node import Node
from std_srvs.srv import SetBool

from polar_nav_core import earth
from polar_nav_core.local_frame import LocalFrame
from polar_nav_msgs.srv import FromLL, ToLL

from .topics import CONTROL, USBL

Switch: TypeAlias = Callable[[str, bool], str]
"""Switches the sensor of a topic; returns an error sentence or nothing."""
MapOf: TypeAlias = Callable[[], LocalFrame | None]

_NO_MAP = 'there is no map frame yet: neither an origin_file nor a first state'
_NOT_FINITE = 'a coordinate is not finite, or a latitude beyond 90 degrees'
_FARTHEST = 1e9
"""From the map or above the ellipsoid [m]: numbers of a place near the Earth."""
_FAR = f'a coordinate is beyond {_FARTHEST:.0e} m'
_NOT_SWITCHED = (CONTROL, USBL)


def add_switches(node: Node, topics: Iterable[str], switch: Switch) -> None:
    """Add a service ``~/use/<topic>`` for each sensor that can be done without.

    Parameters
    ----------
    node : Node
    topics : iterable of str
        Those of the session.
    switch : callable
    """

    def answer(topic: str) -> Callable[[SetBool.Request, SetBool.Response], SetBool.Response]:
        def on_call(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
            response.message = switch(topic, bool(request.data))
            response.success = not response.message
            return response

        return on_call

    for topic in topics:
        if topic not in _NOT_SWITCHED:
            node.create_service(SetBool, f'~/use/{topic.strip("/")}', answer(topic))


def add_map_services(node: Node, map_of: MapOf, frame_id: str) -> None:
    """Add the services fromLL and toLL.

    Parameters
    ----------
    node : Node
    map_of : callable
        Map frame; None while there is none.
    frame_id : str
        Its name.
    """

    def from_ll(request: FromLL.Request, response: FromLL.Response) -> FromLL.Response:
        frame = map_of()
        place = request.latitude, request.longitude, request.height
        usable = bool(np.isfinite(place).all()) and abs(request.latitude) <= 90.0
        response.message = _problem(frame, usable, abs(request.height))
        response.success = not response.message
        if frame is not None and response.success:
            lat, lon = np.radians(place[:2])
            r_m = frame.position(earth.ecef_from_geodetic(lat, lon, request.height))
            p = response.map_point
            p.x, p.y, p.z = r_m.tolist()
            response.frame_id = frame_id
        return response

    def to_ll(request: ToLL.Request, response: ToLL.Response) -> ToLL.Response:
        frame, p = map_of(), request.map_point
        r_m = np.array([p.x, p.y, p.z])
        response.message = _problem(frame, bool(np.isfinite(r_m).all()), abs(r_m).max())
        response.success = not response.message
        if frame is not None and response.success:
            lat, lon, height = earth.geodetic_from_ecef(frame.r_e + frame.C_e_m.T @ r_m)
            response.latitude = float(np.degrees(lat))
            response.longitude = float(np.degrees(lon))
            response.height = float(height)
        return response

    node.create_service(FromLL, 'fromLL', from_ll)
    node.create_service(ToLL, 'toLL', to_ll)


def _problem(frame: LocalFrame | None, usable: bool, farthest: float) -> str:
    """Sentence on why a place cannot be given; empty if it can."""
    if frame is None:
        return _NO_MAP
    if not usable:
        return _NOT_FINITE
    return '' if farthest <= _FARTHEST else _FAR
