"""Parameters that nodes declared once and no longer do: what they did, and what to use instead.

Every bag states all parameters of its nodes, so a name that disappears must stay readable. A
replay leaves it out and names it; a node or a command that is started with it refuses it with the
sentence below. A retired name is never used again for something else.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Retired:
    """One retired parameter.

    Attributes
    ----------
    name : str
    engine_version : int
        The engine that no longer declares it; recordings of this engine, from before the change,
        and of earlier ones may state it.
    did : str
        Its effect, after 'it'.
    instead : str
        What to use now, as a clause.
    """

    name: str
    engine_version: int
    did: str
    instead: str

    def __str__(self) -> str:
        return f'retired with engine {self.engine_version}: it {self.did}; {self.instead}'


_ALL = (
    Retired(
        'publish_decoded',
        1,
        'had no effect',
        'acomms/decoded and acomms/station_decoded are always published',
    ),
    Retired(
        'published_depth_variance',
        1,
        'had no effect',
        'the variance of depth is the one in its message, or depth_sigma squared',
    ),
)

RETIRED = {one.name: one for one in _ALL}
"""By name."""
