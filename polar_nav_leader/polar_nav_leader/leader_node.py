"""Leader: turns what its array heard into a fix for the follower, as a packet for the modem.

| topic | type | stamp |
| --- | --- | --- |
| in usbl/fix | polar_nav_msgs/UsblFix | t3, when the transponder replied |
| in odometry | nav_msgs/Odometry | validity |
| out acomms/tx | polar_nav_msgs/AcousticPacket | t5, first bit |
| out broadcast | polar_nav_msgs/LeaderBroadcast | t3 |
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

from nav_msgs.msg import Odometry

from polar_nav_msgs.msg import AcousticPacket, LeaderBroadcast, UsblFix
from polar_nav_ros.broadcasts import broadcast_to_msg
from polar_nav_ros.diagnostics import Diagnosis, Level
from polar_nav_ros.node import PolarNode, run

from . import convert
from .leader import Leader
from .params import LeaderParams


class LeaderNode(PolarNode[LeaderParams]):
    """Thin: a message in, one call of :class:`Leader`, packets out."""

    def __init__(self) -> None:
        super().__init__('leader_node', LeaderParams)
        self._leader = Leader(self.params)
        self._tx = self.advertise(AcousticPacket, 'acomms/tx')
        self._broadcast = self.advertise(LeaderBroadcast, 'broadcast')
        self._sequence = 0
        self.subscribe(Odometry, 'odometry', self._on_odometry)
        self.subscribe(UsblFix, 'usbl/fix', self._on_fix)

    def diagnose(self) -> Diagnosis:
        """What was sent, what waits, what could not be used."""
        counts = dict(self._leader.counts)
        values = {**counts, 'waiting': self._leader.waiting, **self.taken_counts()}
        refused = sum(n for name, n in counts.items() if name != 'sent')
        if refused:
            return Diagnosis(Level.WARN, f'{refused} fixes could not be used', values)
        return Diagnosis(Level.OK, f'{counts.get("sent", 0)} fixes sent', values)

    def _on_odometry(self, message: Odometry) -> None:
        p = self.params
        self._leader.add_state(
            convert.state_from_msg(message, p.position_sigma, math.radians(p.attitude_sigma_deg))
        )
        self._send_due()

    def _on_fix(self, message: UsblFix) -> None:
        self._leader.add_measurement(convert.measurement_from_msg(message))
        self._send_due()

    def _send_due(self) -> None:
        for packet in self._leader.due():
            target = self.params.follower
            self._broadcast.publish(broadcast_to_msg(packet.broadcast, self.vehicle, target))
            self._tx.publish(
                convert.packet_to_msg(
                    packet.data,
                    self.vehicle,
                    target,
                    self._sequence,
                    packet.transmit_ns,
                    self.params.bit_rate,
                )
            )
            self._sequence += 1


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(LeaderNode, args)


if __name__ == '__main__':
    sys.exit(main())
