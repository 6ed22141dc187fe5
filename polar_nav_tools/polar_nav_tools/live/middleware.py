"""Settings of the middleware (Fast DDS) for one graph: this host only, unless asked for more.

Comes in: the environment of the user. Goes out: the variables that nodes get, and the profile file
that they name. On this host only means: every socket is bound to 127.0.0.1, discovery goes to
127.0.0.1, and no multicast group is joined. ROS 2's own `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST`
keeps packets in, too, but binds its sockets to every address, where strangers can reach them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'
RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
_PEERS = 'ROS_STATIC_PEERS'
_FILE_NAME = 'fastdds.xml'

_LOOPBACK = """\
  <!-- Shared memory, and UDP on the loopback interface only. A unicast locator of its own keeps
       the participant from listening to multicast. -->
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>polar_nav_memory</transport_id>
      <type>SHM</type>
    </transport_descriptor>
    <transport_descriptor>
      <transport_id>polar_nav_loopback</transport_id>
      <type>UDPv4</type>
      <interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>
      <maxInitialPeersRange>64</maxInitialPeersRange>
    </transport_descriptor>
  </transport_descriptors>
  <participant profile_name="polar_nav_participant" is_default_profile="true">
    <rtps>
      <userTransports>
        <transport_id>polar_nav_memory</transport_id>
        <transport_id>polar_nav_loopback</transport_id>
      </userTransports>
      <useBuiltinTransports>false</useBuiltinTransports>
      <builtin>
        <metatrafficUnicastLocatorList><locator/></metatrafficUnicastLocatorList>
        <initialPeersList>
          <locator><udpv4><address>127.0.0.1</address></udpv4></locator>
        </initialPeersList>
      </builtin>
    </rtps>
  </participant>
"""
_HEARTBEAT = """\
  <!-- Readers acknowledge, and ask again for what is missing, at the heartbeats of the writer.
       They come every 3 s by default: a lost message holds up a lockstep run that long, and a
       node that ends waits that long to know that its last words arrived. -->
  <data_writer profile_name="polar_nav" is_default_profile="true">
    <times>
      <heartbeatPeriod><sec>0</sec><nanosec>100000000</nanosec></heartbeatPeriod>
    </times>
  </data_writer>
"""


def profile(*, network: bool) -> str:
    """Fast DDS profile of a graph that keeps to this host, or of one that may use the network."""
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">\n'
        f'{"" if network else _LOOPBACK}{_HEARTBEAT}</profiles>\n'
    )


def middleware_environment(
    folder: Path, env: Mapping[str, str], *, network: bool
) -> dict[str, str]:
    """Variables of the middleware for the nodes of one graph.

    Parameters
    ----------
    folder : Path
        Gets the profile.
    env : mapping
        Environment of the user. A profile file that it names stays in use; without `network`, ROS
        2's LOCALHOST then keeps the packets on this host.
    network : bool
        Discover and be discovered as the environment says, on every interface.
    """
    keeps_own = bool(env.get(PROFILES))
    added: dict[str, str] = {}
    if not keeps_own:
        folder.mkdir(parents=True, exist_ok=True)
        file = folder / _FILE_NAME
        file.write_text(profile(network=network), encoding='utf-8')
        added[PROFILES] = str(file.absolute())
    if not network:
        # LOCALHOST would add a transport without a list of interfaces to those of the profile.
        added[RANGE] = 'LOCALHOST' if keeps_own else 'SYSTEM_DEFAULT'
        added[_PEERS] = ''
    return added
