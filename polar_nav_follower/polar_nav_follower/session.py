"""Session of a follower: navigation with fixes from acoustic packets.

Its mode determines the inputs: a SINS with DVL and the packets of a leader, or the attitude of an
AHRS with thrust and the packets of a hydroacoustic station.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from polar_nav_core.engine.events import Fix
from polar_nav_core.link.packet import Broadcast
from polar_nav_ros.adapters.live import Source, Sources, Taken
from polar_nav_ros.broadcasts import broadcast_to_msg
from polar_nav_ros.navigation_session import NavigationSession, Published, Reader
from polar_nav_ros.topics import (
    AHRS,
    COMMAND,
    CONTROL,
    DECODED,
    DEPTH,
    DVL,
    IMU,
    RESTORE,
    RX,
    STATION_DECODED,
)

from . import convert
from .measurements.fix import fix_from_packet
from .measurements.station_fix import StationNumbers
from .params import FollowerParams

INPUTS = (IMU, DVL, DEPTH, RX, COMMAND)
"""Topics that a follower with SINS and DVL subscribes to."""


def in_station_mode(params: FollowerParams) -> bool:
    """Whether the fixes are a station's ranges and bearings, which needs the vehicle's model."""
    return params.mode == 'station'


def sensors_of(params: FollowerParams, sources: Sources | None = None) -> tuple[str, ...]:
    """Topics of the vehicle's own sensors that a follower subscribes to; the first is the IMU."""
    if in_station_mode(params):
        return (AHRS, CONTROL, DEPTH)
    found = (IMU, DVL, DEPTH, CONTROL) if params.model_aiding else (IMU, DVL, DEPTH)
    return found if sources is None else sources.sensors(found)


def inputs_of(params: FollowerParams, sources: Sources | None = None) -> tuple[str, ...]:
    """All topics that a follower takes: those it subscribes to, and its own commands."""
    own = (COMMAND, RESTORE) if params.state_file else (COMMAND,)
    return (*sensors_of(params, sources), RX, *own)


class Session(NavigationSession[FollowerParams]):
    """Navigation session of a follower in either mode.

    Parameters
    ----------
    params : FollowerParams
        Everything that can be chosen.
    vehicle : str
        Name of the vehicle, for frame ids.
    sources : Sources, optional
        Those of a mapping file, in place of this project's own topics; bound to their types.
    """

    def __init__(
        self, params: FollowerParams, vehicle: str, sources: Sources | None = None
    ) -> None:
        station = in_station_mode(params)
        readers: dict[str, Reader] = {
            RX: self._station_fix_from_msg if station else self._fix_from_msg
        }
        for source in sources or ():
            readers[source.topic] = self._packet_reader(source) or source.event
        super().__init__(
            params,
            vehicle,
            readers,
            imu_lever_b=sources.imu_lever_b if sources else (0.0, 0.0, 0.0),
            frame_id=params.frame_id,
            sensors=sensors_of(params, sources),
        )
        self._decoded: list[Published] = []
        self._numbers = StationNumbers()

    def _before_event(self) -> Iterator[Published]:
        yield from self.decoded()

    def decoded(self) -> Iterator[Published]:
        """Readable contents of the packets received since the last call."""
        yield from self._decoded
        self._decoded.clear()

    def _packet_reader(self, source: Source) -> Reader | None:
        """Reader of a mapped topic of packets; None for another one."""
        if source.role != 'packet':
            return None

        def read(taken: Taken, number: int) -> Fix | None:
            row = source.packet(taken, number)
            if row is None:
                return None
            arrival = source.arrival(number)
            return self._with_content(*fix_from_packet(*row[:3], arrival, *row[3:], self.params))

        return read

    def _fix_from_msg(self, message: Any, number: int) -> Fix:  # noqa: ANN401
        return self._with_content(*convert.fix_from_msg(message, number, self.params))

    def _with_content(self, fix: Fix, broadcast: Broadcast | None) -> Fix:
        """Return the fix of a packet, after its content is kept for `decoded`."""
        if broadcast is not None:
            target = self._name(broadcast.target)
            readable = broadcast_to_msg(broadcast, fix.source, target, self.params.frame_id)
            self._decoded.append(Published.of(DECODED, readable))
        return fix

    def _station_fix_from_msg(self, message: Any, number: int) -> Fix:  # noqa: ANN401
        fix, report = convert.station_fix_from_msg(message, number, self.params, self._numbers)
        if report is not None:
            target = self._name(report.target)
            readable = convert.station_report_to_msg(report, fix.source, target, self.params)
            self._decoded.append(Published.of(STATION_DECODED, readable))
        return fix

    def _name(self, number: int) -> str:
        """Name of a vehicle by its number in a packet."""
        return self.vehicle if number == self.params.own_id else str(number)
