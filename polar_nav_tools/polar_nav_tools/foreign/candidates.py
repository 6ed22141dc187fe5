"""Which topic of a bag may be what, by its type and its name."""

from __future__ import annotations

from polar_nav_ros.adapters.layouts import DEPTH, PACKET, POSITION, USBL, VELOCITY
from polar_nav_ros.topics import STATE, TYPES, estimates_beside

from ..bags.reader import Topic

TRUTH_WORDS = ('truth', 'reference', 'ground', 'ppk', 'post')
FIX_WORDS = ('usbl', 'acoustic', 'acomms', 'lbl', 'modem', 'fix', 'track')
FIX_TYPES = ('sensor_msgs/msg/NavSatFix',)
"""Types that are fixes whatever their topic is called."""
DVL_WORDS = ('dvl', 'a50', 'a125', 'nortek', 'nucleus', 'pathfinder', 'wayfinder', 'workhorse')
"""The instrument, and makes of it."""
STATE_WORDS = ('odom', 'nav', 'state', 'estimate', 'ins', 'pose', 'gps', 'gnss')
LEADER_WORDS = ('leader', 'ship', 'vessel', 'surface', 'master')
RAW_WORDS = ('raw',)
SENSOR_WORDS = ('imu', 'ahrs', 'ins', 'sensor', 'sensors', 'data', 'driver', 'device', 'mavros')
"""First parts of topics that are no vehicle's name."""


def outputs_of(topics: list[Topic]) -> set[str]:
    """Return topics that a navigation of this project made: estimates, and no measurements."""
    return estimates_beside(t.name for t in topics if t.type == TYPES[STATE])


def words(topic: Topic, some: tuple[str, ...]) -> int:
    """Count the words that stand in the name of a topic."""
    name = topic.name.lower()
    return sum(word in name for word in some)


def best(topics: list[Topic], some: tuple[str, ...]) -> Topic | None:
    """Topic with most of the words, then with most messages, not a leader's."""
    if not topics:
        return None
    return max(topics, key=lambda t: (-words(t, LEADER_WORDS), words(t, some), t.count))


def best_position(
    topics: list[Topic], some: tuple[str, ...], *, require: bool = False
) -> Topic | None:
    """Return the best topic of positions, if required only one with some of the words."""
    found = [t for t in topics if t.type in POSITION and (words(t, some) or not require)]
    return best(found, some)


def vehicle(imu: Topic | None) -> str:
    """Return the first part of the name of the IMU's topic, where that may be a vehicle's."""
    parts = [] if imu is None else imu.name.strip('/').split('/')
    return parts[0] if len(parts) > 1 and parts[0].lower() not in SENSOR_WORDS else 'vehicle'


def of_vehicle(topics: list[Topic], name: str) -> list[Topic]:
    """Return the topics in the namespace of a vehicle."""
    return [t for t in topics if t.name.startswith(f'/{name.strip("/")}/')]


def twins(imu: Topic | None, topics: list[Topic]) -> list[str]:
    """Return vehicles beside that of the IMU: namespaces with a topic of its name and type."""
    if imu is None:
        return []
    own, _, rest = imu.name.strip('/').partition('/')
    alike = [t.name.strip('/').partition('/') for t in topics if t.type == imu.type]
    return sorted({first for first, _, end in alike if end and end == rest and first != own})


def near(topic: Topic, imu: Topic) -> bool:
    """Whether a topic may be of the same vehicle: not in the namespace of a leader."""
    return not words(topic, LEADER_WORDS) or bool(words(imu, LEADER_WORDS))


def dvl_of(topics: list[Topic]) -> Topic | None:
    """Return the topic that looks most like a DVL."""
    typed = [t for t in topics if t.type in VELOCITY and 'dvl' in t.type.lower()]
    named = [t for t in topics if t.type in VELOCITY and words(t, DVL_WORDS)]
    return best(typed or named, DVL_WORDS)


def depth_of(topics: list[Topic]) -> Topic | None:
    """Return the topic that looks most like depth or pressure."""
    named = ('depth', 'pressure')
    found = [t for t in topics if t.type in DEPTH and words(t, named)]
    typed = [t for t in found if t.type == 'polar_nav_msgs/msg/Depth']
    other = [t for t in topics if t.type == 'sensor_msgs/msg/FluidPressure']
    return best(typed or found or other, named)


def fixes_of(
    mine: list[Topic], truth: Topic | None, topics: list[Topic], packets: list[Topic]
) -> list[Topic]:
    """Return the topics of position fixes: acoustic packets, else USBL, else one by its name.

    Without one of such a name it is one of a type that is always a fix. ``packets``
    are those of other types whose bytes are packets.
    """
    packets = [t for t in mine if t.type == PACKET and t.name.endswith('rx')] or packets
    if packets:
        return packets
    usbl = [t for t in topics if t.type == USBL]
    if usbl:
        return usbl
    other = [t for t in mine if t.type in POSITION and t != truth and not t.name.endswith(STATE)]
    found = [t for t in other if words(t, FIX_WORDS)]
    found = found or [t for t in other if t.type in FIX_TYPES]
    one = best(found, FIX_WORDS[:-2])
    return [] if one is None else [one]
