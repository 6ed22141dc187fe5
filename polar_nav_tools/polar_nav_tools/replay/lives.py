"""Lives of a follower in a bag: one that is killed and started again begins anew in the same bag.

Each life is replayed by itself, from the first message of each topic that its node took (it names
them on nav/clock, where it has a state file) and, where it was restored, from the saved state
that it published. A node that was killed has processed everything before its last output, and
nothing that counts after it; what came until the next one was started, nobody has taken.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from polar_nav_core import spilled
from polar_nav_core.engine.outputs import Receipt
from polar_nav_msgs.msg import Command, FixReceipt
from polar_nav_ros import topics
from polar_nav_ros.navigation_outputs import receipt_from_msg
from polar_nav_ros.stamps import to_ns

from ..bags.errors import BagError
from .life import Life, never_an_event
from .records import Heard, Live, Records

_OWN = (topics.COMMAND, topics.RESTORE)
"""Inputs that the node itself publishes."""
_NO_LIMIT = 1 << 62


def lives_of(records: Records, imu: str, *, injected: bool = False) -> list[Life]:
    """Lives in a bag, one at least; those that published nothing are left out.

    Parameters
    ----------
    records : Records
    imu : str
        Topic of the IMU, with whose first message a life begins.
    injected : bool
        Whether faults were put into the bag: what was counted is of other messages.
    """
    if injected:
        return [_life(records, (0, _NO_LIMIT), {}, last=True, limited=False)]
    bounds = [*_begins(records, imu), _NO_LIMIT]
    first = records.outputs['place'][:1]
    if len(bounds) == 1 or (first < bounds[0]).any():
        bounds.insert(0, 0)  # from before the recording, or without a state file
    found: list[Life] = []
    taken_to: dict[str, int] = {}
    for begin, end in pairwise(bounds):
        last = end == _NO_LIMIT
        starts = _starts(records, begin, end, taken_to)
        if starts is not None:
            taken_to |= starts
        life = _life(records, (begin, end), starts, last=last)
        if starts is not None and found:  # what it missed of the first, the recorder has counted
            life = replace(life, found_ns=_found_ns(records, imu, begin, end))
        if life.published or (last and not found):
            found.append(life)
    return found


def _begins(records: Records, imu: str) -> list[int]:
    """Place from which on each life that names its first messages is recorded.

    A node publishes nothing before its first sample of the IMU, and one that was killed nothing
    after that of the next; what it says of itself may be recorded later, as may its names.
    """
    out: list[int] = []
    before = 0
    for place, step in records.steps:
        if step.is_start and step.topic == imu:
            own = [born for born in records.births if before < born < place]
            taken = [k for k in records.of(step) if before < k < place]
            out.append(min(*own[-1:], *taken[-1:], place))
            before = place
    return out


def _starts(
    records: Records, begin: int, end: int, after: Mapping[str, int]
) -> dict[str, int] | None:
    """Place of the first message that a life took, by topic; None where it names none.

    Of messages with the same stamp it is the one that was recorded nearest to its naming.
    """
    named = [(p, step) for p, step in records.steps if begin <= p < end and step.is_start]
    found: dict[str, int] = {}
    for place, step in named:
        same = [k for k in records.of(step) if k > after.get(step.topic, 0)]
        # One that the recorder has lost: the node took those that came after it, too.
        found[step.topic] = min(same, key=lambda k: abs(k - place), default=place)
    return found if named else None


def _found_ns(records: Records, imu: str, begin: int, end: int) -> int:
    """Newest IMU stamp [ns] before the recorder had found a node that was started again.

    It names its starts before it publishes anything else, and the recorder gets that as soon as it
    has found it.
    """
    named = min(p for p, step in records.steps if begin <= p < end and step.is_start)
    rows, newest_ns = records.inputs, 0
    for part in spilled.parts(len(rows)):
        some = rows[part]
        before = (some['topic'] == records.number(imu)) & (some['place'] < named)
        newest_ns = max(newest_ns, int(some['stamp_ns'][before].max(initial=0)))
    return newest_ns


def _life(
    records: Records,
    bounds: tuple[int, int],
    starts: Mapping[str, int] | None,
    *,
    last: bool,
    limited: bool = True,
) -> Life:
    begin, end = bounds
    outputs = records.outputs
    mine = (outputs['place'] >= begin) & (outputs['place'] < end)
    hole = next((place for place in records.holes if begin <= place < end), _NO_LIMIT)
    newest = int(outputs['place'][mine].max(initial=begin))
    limits = next((t for p, t in reversed(records.ends) if begin <= p < end), None)
    # The last one, too, where it names its starts: it was not started again, or runs still.
    killed = limits is None and limited and (not last or bool(starts))
    most = {
        topic: _NO_LIMIT if limits is None or not limited else limits.get(full, _NO_LIMIT)
        for full, topic in records.by_name.items()
    }
    inputs = records.inputs

    def may_be_mine(rows: NDArray[Any]) -> NDArray[np.bool_]:
        found = np.zeros(len(rows), dtype=bool)
        place = rows['place']
        for topic, number in records.topics.items():
            if topic in _OWN or topic in records.mapped:
                # The node itself has published it, or that it used it.
                wanted = (place >= begin) & (place < end)
            else:
                wanted = place >= (starts.get(topic, _NO_LIMIT) if starts else 0)
                if killed:
                    wanted &= place <= newest
            found |= wanted & (rows['topic'] == number)
        return found

    heard = spilled.by_rows(may_be_mine, inputs)
    refused: list[Receipt] = []
    times: Counter[int] = Counter()
    for at, data in records.receipts:
        if begin <= at < end:
            receipt = deserialize_message(data, FixReceipt)
            if never_an_event(receipt):
                refused.append(receipt_from_msg(receipt))
            if receipt.topic == topics.RX and not receipt.revision:
                times[to_ns(receipt.receive_time)] += 1
    _keep_those_with_a_receipt(records, heard, times, most.get(topics.RX, _NO_LIMIT))
    newest_ns = _newest_ns(records, mine)
    dropped: dict[str, tuple[int, int]] = {}
    for topic, number in records.topics.items():
        limit = most.get(topic, _NO_LIMIT)
        taken = came = 0
        for part in spilled.parts(len(inputs)):
            rows = part.start + np.flatnonzero(heard[part] & (inputs['topic'][part] == number))
            came += int((inputs['stamp_ns'][rows] <= newest_ns).sum())
            heard[rows[max(0, limit - taken) :]] = False
            taken += len(rows)
        if topic not in _OWN and came > limit:
            dropped[topic] = came - limit, came
    return Life(
        messages=Heard(records, heard),
        live=Live(records.read_outputs, records.compared, mine & (outputs['place'] < hole)),
        refused=refused,
        steps=[s for p, s in records.steps if begin <= p < end and not s.is_start],
        arrivals_ns=() if limited else inputs['arrival_ns'][heard],
        until_ns=newest_ns if killed else None,
        torn=hole != _NO_LIMIT,
        dropped=dropped,
    )


def _keep_those_with_a_receipt(
    records: Records, heard: NDArray[np.bool_], times: Counter[int], most: int
) -> None:
    """Leave out the packets that a node never took of more than its queue holds.

    In a flood the middleware drops packets for the node that the recorder gets. The node gives
    every packet that it takes a receipt with its time of reception (``times``), and has counted
    them.
    """
    number = records.number(topics.RX)
    packets = spilled.by_rows(lambda r, h: h & (r['topic'] == number), records.inputs, heard)
    if np.count_nonzero(packets) <= most or times.total() != most:
        return
    for row, (topic, message) in enumerate(records.read_inputs()):
        if topic == topics.RX and packets[row]:
            time_ns = to_ns(message().receive_time)
            heard[row] = times[time_ns] > 0
            times[time_ns] -= 1


def _newest_ns(records: Records, mine: NDArray[np.bool_]) -> int:
    """Stamp of the newest output [ns], by the last one of each topic; 0 without one."""
    outputs, newest_ns = records.outputs, 0
    for topic in records.compared:
        rows = np.flatnonzero(mine & (outputs['topic'] == records.number(topic)))
        if len(rows):
            newest_ns = max(newest_ns, int(outputs['stamp_ns'][rows[-1]]))
    return newest_ns


def taken_counts(shutdown: Command) -> dict[str, int]:
    """Messages per full topic name that a node had received at its end, from its last command.

    Raises
    ------
    BagError
        When the command has not one count for each topic: its bytes were changed.
    """
    names, counts = list(shutdown.taken_topics), [int(n) for n in shutdown.taken_counts]
    if len(names) != len(counts):
        raise BagError(
            f'the last message on {topics.COMMAND} is damaged: it names {len(names)} topics and '
            f'{len(counts)} counts'
        )
    return dict(zip(names, counts, strict=True))
