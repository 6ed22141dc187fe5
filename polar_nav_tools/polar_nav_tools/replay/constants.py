"""Constants of recorded messages, read by the definitions in their bag.

DVL_MODE_BOTTOM and DVL_MODE_WATER were 0 and 1 once, and are 1 and 2 now, as in
marine_acoustic_msgs. A bag carries the definitions that it was recorded with, so no ping with
bottom lock is taken for one without; any other constant that got another value is refused.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from polar_nav_msgs.msg import Dvl

from ..bags.contents import Channel
from ..bags.decode import constants_of
from ..bags.errors import BagError
from ..bags.reader import Bag
from ..bags.schemas import definition

_MODES = ('DVL_MODE_BOTTOM', 'DVL_MODE_WATER')
_NEITHER = 0


def mode_table(bag: Bag, topic: str) -> NDArray[np.uint8] | None:
    """Table from the DVL modes of a bag to the installed ones; None if they are the same.

    Raises
    ------
    BagError
        If the definition in the bag cannot be used.
    """
    if topic not in bag.topics:
        return None
    recorded = constants_of(bag.channel(topic))
    if all(recorded.get(name) == getattr(Dvl, name) for name in _MODES):
        return None
    table = np.full(256, _NEITHER, dtype=np.uint8)
    for name in _MODES:
        if name in recorded:
            table[int(recorded[name])] = getattr(Dvl, name)
    return table


def require_same(bag: Bag, topics: Iterable[str]) -> None:
    """Raise BagError if constants in a bag have other values than the installed ones.

    Raises
    ------
    BagError
        Naming the first one that was given another meaning since.
    """
    for topic in topics:
        if topic not in bag.topics:
            continue
        channel = bag.channel(topic)
        here = _installed(channel)
        for name, value in constants_of(channel).items():
            if name not in _MODES and here.get(name, value) != value:
                raise BagError(
                    f'{bag.path}: {topic} was recorded with {name} = {value} in {channel.type}, '
                    f'which is {here[name]} here; replay it with the version that recorded it'
                )


def _installed(channel: Channel) -> dict[str, object]:
    """Constants of the installed type of that name; none where there is no such type."""
    try:
        text = definition(channel.type).text
    except BagError:
        return {}
    return constants_of(Channel(channel.topic, channel.type, 'cdr', 'ros2msg', text, {}))
