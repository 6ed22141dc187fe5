"""Messages that a follower used of its mapped sources: those that nav/inputs names, in its order.

With best effort the recorder may have lost some of them, and may have others that the follower
never got. The former are counted by topic, the latter are left out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from polar_nav_core.engine.params import EngineParams
from polar_nav_msgs.msg import Inputs
from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.adapters.live import Source, Sources, Taken
from polar_nav_ros.source_ports import digest_of
from polar_nav_ros.stamps import to_ns
from polar_nav_ros.topics import INPUTS

from ..bags.decode import Decoder, constants_of
from ..bags.errors import BagError
from ..bags.reader import Bag


@dataclass(frozen=True)
class Used:
    """Messages of mapped sources that a follower used.

    Attributes
    ----------
    text, place : str
        The mapping file, and where it is from.
    blocks : list of list of (str, Taken)
        By topic of the session, in the order in which they were used, as nav/inputs has them.
    constants : mapping of str to mapping
        Constants of the types, by topic of the session.
    lacks : list of str
        One sentence for each topic of which the bag lacks messages, or nav/inputs blocks.
    """

    text: str
    place: str
    blocks: list[list[tuple[str, Taken]]] = field(default_factory=list)
    constants: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    lacks: list[str] = field(default_factory=list)

    def sources(self, params: EngineParams) -> Sources:
        """Sources of the mapping file for some parameters, bound to the types in the bag."""
        sources = Sources(mapping_file.parse(self.text, self.place), params)
        samples: dict[str, Any] = {}
        for topic, taken in (row for block in self.blocks for row in block):
            samples.setdefault(topic, taken.message)
        for source in sources:
            if source.topic in samples:
                source.bind(samples[source.topic], self.constants[source.topic])
        return sources


def used_of(bag: Bag, vehicle: str, text: str, params: EngineParams) -> Used:
    """Messages that a follower with a mapping file used, out of its bag.

    Parameters
    ----------
    bag : Bag
    vehicle : str
    text : str
        The mapping file, as the node described it.
    params : EngineParams

    Raises
    ------
    BagError
        When the bag does not hold what was used.
    """
    place = f'{bag.path}: sources of /{vehicle}/follower_node'
    record = f'/{vehicle}/{INPUTS}'
    if record not in bag.topics or not bag.topics[record].count:
        raise BagError(
            f'{bag.path} has no message on {record}: which messages of its sources the follower '
            'used is not known'
        )
    if bag.injected:
        raise BagError(f'{bag.path}: faults do not go with mapped sources yet: nothing to replay')
    sources = list(Sources(mapping_file.parse(text, place), params))
    blocks = _once(message for _, message in bag.read(record))
    lacks = _missing_blocks(record, [block for block in blocks if block is not None])
    names = _names(bag, sources, blocks)
    pool = _pool(bag, {name for name in names if name in bag.topics})
    decoder = Decoder(str(bag.path))
    decode = {name: decoder.for_channel(bag.channel(name)) for name in pool}
    used, missing = Counter[str](), Counter[str]()
    taken = Counter[tuple[int, int]]()  # two sources may read one topic
    found: list[list[tuple[str, Taken]]] = []
    for block in blocks:
        found.append([])
        if block is None:
            continue
        for number, arrival_ns, stamp_ns, digest in _rows(block):
            name = names[number]
            used[name] += 1
            waiting = pool.get(name, {}).get(digest, [])
            at = taken[number, digest]
            if at >= len(waiting):
                missing[name] += 1
                continue
            taken[number, digest] += 1
            message = decode[name](waiting[at])
            found[-1].append((sources[number].topic, Taken(message, arrival_ns, stamp_ns)))
    lacks += [
        f'{missing[name]:,} of {used[name]:,} messages of {name} that the follower used are not in'
        ' the bag'
        for name in sorted(missing)
    ]
    constants = {
        source.topic: constants_of(bag.channel(name))
        for source, name in zip(sources, names, strict=True)
        if name in pool
    }
    return Used(text, place, found, constants, lacks)


def _once(messages: Iterable[Inputs]) -> list[Inputs | None]:
    """Blocks in their order; None for one that a recorder that was started again heard twice."""
    seen = set[tuple[int, int]]()
    found: list[Inputs | None] = []
    for block in messages:
        key = block.sequence, to_ns(block.header.stamp)
        found.append(None if key in seen else block)
        seen.add(key)
    return found


def _names(bag: Bag, sources: list[Source], blocks: list[Inputs | None]) -> list[str]:
    """Full names of the topics of the sources."""
    there = [list(block.topics) for block in blocks if block is not None]
    names = there[0]
    if any(others != names for others in there) or len(names) != len(sources):
        raise BagError(f'{bag.path}: nav/inputs names other topics than the mapping file')
    return names


def _rows(block: Inputs) -> list[tuple[int, int, int, int]]:
    """Index of the source, arrival, stamp that counted [ns] and digest of each message."""
    columns = (block.source, block.arrival, block.mapped, block.digest)
    lengths = {len(column) for column in columns}
    if len(lengths) > 1 or any(n >= len(block.topics) for n in block.source):
        raise BagError('a message on nav/inputs is damaged')
    return list(zip(*([int(v) for v in column] for column in columns), strict=True))


def _pool(bag: Bag, names: set[str]) -> dict[str, dict[int, list[bytes]]]:
    """Recorded bytes by topic and digest, equal ones in their order."""
    pool: dict[str, dict[int, list[bytes]]] = {name: {} for name in names}
    for name, _, data in bag.messages(names) if names else ():
        pool[name].setdefault(digest_of(data), []).append(data)
    return pool


def _missing_blocks(record: str, blocks: list[Inputs]) -> list[str]:
    """Sentence on blocks that the bag lacks, by their numbers; empty without any.

    A node that was started again counts from 0.
    """
    lost, due = 0, 0
    for number in (int(block.sequence) for block in blocks):
        lost += number - (due if number >= due else 0)
        due = number + 1
    if not lost:
        return []
    said = f'{lost:,} of {len(blocks) + lost:,} messages of {record} are not in the bag'
    if blocks[0].sequence:
        said += f'; {blocks[0].sequence:,} of them are from before the recording began'
    return [said]
