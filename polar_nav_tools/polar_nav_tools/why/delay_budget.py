"""Delay budget of an acoustic link: the longest age of a fix, and the history to store for it.

A fix is valid at t3, when the transponder replies, and is used when its packet is complete:

    age = reply's way + leader's processing + packets before it + bits / bit rate + way
          + detection + random part + retries * (packet + detection + random part
                                                 + way there and back + turn-around)

A modem that waits for an acknowledgement repeats a packet after a time-out: the last try is the
one above, each failed try lasts a whole time-out. The vehicles are assumed at their longest
distance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_core.link.packet import SIZE
from polar_nav_core.params import check, default_of, from_mapping, param
from polar_nav_leader.params import LeaderParams
from polar_nav_sim.params import AcousticLinkParams, UsblParams

from ..scoring import Column, Table

_LINK, _USBL = AcousticLinkParams, UsblParams


@dataclass(frozen=True)
class LinkBudget:
    """Parameters of an acoustic link; the defaults are those of the nodes."""

    range_m: float = param(
        default_of(_LINK, 'max_range_m'), 'm', 1.0, 1e6, 'Longest distance of the vehicles'
    )
    sound_speed: float = param(
        default_of(_LINK, 'sound_speed'), 'm/s', 1300.0, 1700.0, 'Lowest on the way'
    )
    bit_rate: float = param(
        default_of(LeaderParams, 'bit_rate'), 'bit/s', 1.0, 1e7, 'Of the modem'
    )
    packet_bytes: int = param(SIZE, 'B', 1, 65535, "Of one packet, with the modem's own")
    turn_around_s: float = param(
        default_of(_USBL, 'turn_around_s'), 's', 0.0, 10.0, 'Of the transponder, and of a retry'
    )
    processing_s: float = param(
        default_of(LeaderParams, 'processing_delay_s'), 's', 0.0, 60.0, 'In the leader, t4 to t5'
    )
    detection_s: float = param(
        default_of(_LINK, 'detection_delay_s'), 's', 0.0, 60.0, 'Synchronization and decoding'
    )
    random_s: float = param(
        2.0 * default_of(_LINK, 'random_delay_mean_s'), 's', 0.0, 600.0, 'Longest random delay'
    )
    retries: int = param(0, '', 0, 100, 'Times that a packet is sent anew')
    followers: int = param(1, '', 1, 64, 'That share the channel and are asked in turn')
    fix_period_s: float = param(
        default_of(_USBL, 'period_s'), 's', 0.1, 3600.0, 'Between interrogations of the array'
    )
    margin: float = param(0.2, '', 0.0, 10.0, 'Added to the longest delay, as a share of it')
    jitter_s: float = param(
        default_of(EngineParams, 'reorder_window_s'),
        's',
        0.0,
        10.0,
        'Stamp time that messages may come out of order in the vehicle',
    )

    def __post_init__(self) -> None:
        check(self)

    @property
    def travel_s(self) -> float:
        """One-way travel time [s] through the water."""
        return self.range_m / self.sound_speed

    @property
    def packet_s(self) -> float:
        """Duration [s] of a packet at the bit rate."""
        return 8 * self.packet_bytes / self.bit_rate

    @property
    def timeout_s(self) -> float:
        """Duration [s] of a failed try."""
        once = self.packet_s + self.detection_s + self.random_s
        return once + 2.0 * self.travel_s + self.turn_around_s


@dataclass(frozen=True)
class Part:
    """One contribution to the age of a fix."""

    name: str
    seconds: float
    how: str


@dataclass(frozen=True)
class DelayBudget:
    """Result of a delay budget: the contributions, the longest age, the follower's parameters.

    Attributes
    ----------
    parts : tuple of Part
        Contributions to the age, in the order of the way.
    longest_s : float
        Their sum: the longest age of a received fix [s].
    cycle_s : float
        From the ping to the use of the fix, without waiting for other followers [s].
    pending : int
        Largest number of fixes under way to one follower at a time.
    channel_share : float
        Share of the time with a signal in the water; above 1 the fix period is too short.
    parameters : dict of str to float
        To set in the follower.
    problems : tuple of str
        Sentences about parameters that the follower would refuse; empty if there are none.
    """

    parts: tuple[Part, ...]
    longest_s: float
    cycle_s: float
    pending: int
    channel_share: float
    parameters: dict[str, float]
    problems: tuple[str, ...]

    def table(self) -> Table:
        """Table of the contributions and their sum."""
        columns = (
            Column('part', 'contribution'),
            Column('seconds', 'delay', 's', 4),
            Column('percent', 'share', '%'),
            Column('how', 'made of'),
        )
        rows = [
            {
                'part': p.name,
                'seconds': p.seconds,
                'percent': 100.0 * p.seconds / self.longest_s,
                'how': p.how,
            }
            for p in self.parts
        ]
        total = {'part': 'longest delay', 'seconds': self.longest_s, 'percent': 100.0, 'how': ''}
        return Table('Age of a fix when it is received', columns, (*rows, total))

    def yaml(self, node: str = '/**') -> str:
        """Text of a ROS 2 parameter file; doubles keep their dot."""
        lines = [f'{node}:', '  ros__parameters:']
        lines += [f'    {name}: {value:.2f}' for name, value in self.parameters.items()]
        return '\n'.join(lines) + '\n'

    def to_dict(self) -> dict[str, object]:
        """Budget as values for JSON."""
        return {
            'parts': [{'name': p.name, 'seconds': p.seconds, 'how': p.how} for p in self.parts],
            'longest_delay_s': self.longest_s,
            'cycle_s': self.cycle_s,
            'fixes_pending': self.pending,
            'channel_share': self.channel_share,
            'parameters': dict(self.parameters),
            'problems': list(self.problems),
        }


def delay_budget(b: LinkBudget) -> DelayBudget:
    """Longest age of a fix on a link, and the follower's parameters for it."""
    way = f'{b.range_m:g} m / {b.sound_speed:g} m/s'
    others = b.followers - 1
    parts = (
        Part('reply to the array', b.travel_s, f'{way} (t3 to t4)'),
        Part('processing in the leader', b.processing_s, 't4 to t5'),
        Part('waiting for the channel', others * b.packet_s, f'packets to {others} others'),
        Part(
            'failed tries',
            b.retries * b.timeout_s,
            f'{b.retries} x {b.timeout_s:.3f} s: packet, detection, there and back, turn-around',
        ),
        Part('packet', b.packet_s, f'{8 * b.packet_bytes} bit / {b.bit_rate:g} bit/s'),
        Part('packet to the follower', b.travel_s, way),
        Part('detection', b.detection_s, 'synchronization, decoding'),
        Part('random', b.random_s, 'longest'),
    )
    longest_s = sum(p.seconds for p in parts)
    step_s = float(default_of(EngineParams, 'filter_period_s'))
    max_delay_s = _up(max(longest_s * (1.0 + b.margin), _limit('max_delay_s', 'lo')))
    parameters = {
        'max_delay_s': max_delay_s,
        'history_s': _up(max_delay_s + b.jitter_s + 2.0 * step_s),
        'reorder_window_s': b.jitter_s,
    }
    busy_s = 2.0 * b.travel_s + b.turn_around_s + (1 + b.retries) * (b.packet_s + b.travel_s)
    share = busy_s / b.fix_period_s
    return DelayBudget(
        parts=parts,
        longest_s=longest_s,
        cycle_s=longest_s + b.travel_s + b.turn_around_s - others * b.packet_s,
        pending=max(1, math.ceil(longest_s / (b.fix_period_s * b.followers))),
        channel_share=share,
        parameters=parameters,
        problems=tuple(_problems(parameters)),
    )


def _problems(parameters: dict[str, float]) -> list[str]:
    """Sentences about parameters that the follower would refuse."""
    try:
        from_mapping(EngineParams, parameters)
    except ConfigError as error:
        return [f'the follower cannot be set so: {error}']
    return []


def _limit(name: str, which: str) -> float:
    f = next(f for f in fields(EngineParams) if f.name == name)
    return float(f.metadata[which])


def _up(seconds: float) -> float:
    """Time [s] rounded up to a tenth of a second, except for rounding errors."""
    return math.ceil(10.0 * seconds - 1e-6) / 10.0
