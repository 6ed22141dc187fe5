"""The acoustic packet's message to an event.

Messages that every vehicle has are read and written in polar_nav_ros; besides the node and the
session, this is the only place of the package that knows both worlds.
"""

from __future__ import annotations

from polar_nav_core.engine.events import Fix
from polar_nav_core.packet import Broadcast
from polar_nav_msgs.msg import AcousticPacket
from polar_nav_ros.stamps import to_ns

from .measurements.fix import fix_from_packet
from .params import FollowerParams


def fix_from_msg(
    msg: AcousticPacket, number: int, params: FollowerParams
) -> tuple[Fix, Broadcast | None]:
    """polar_nav_msgs/AcousticPacket as an event and, when its bytes can be read, their content."""
    return fix_from_packet(
        bytes(msg.data),
        msg.source,
        msg.sequence,
        number,
        to_ns(msg.transmit_time),
        to_ns(msg.receive_time),
        params,
    )
