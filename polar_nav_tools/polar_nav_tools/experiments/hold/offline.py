"""A run of a follower as a recorder has it, replayed as `./polar replay` does.

The bag has what the node took and published, at the times at which it did. A replay takes the
messages of it, without those that the node refused, sorts them, and knows nothing of the steady
clock: of a time without samples it hears only when it is over.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from rclpy.serialization import deserialize_message

from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import FixReceipt, NavHealth, NavState
from polar_nav_ros import topics
from polar_nav_ros.cdr import to_bytes

from ...bags import BagWriter, open_bag
from ...inject.readings import NS
from ...replay.by_message import ReplayResult, replay
from ..received import VEHICLE, description_of
from .drive import LiveRun, Recorded
from .trace import Listener, Trace

_TYPES = {topics.STATE: NavState, topics.RECEIPT: FixReceipt, topics.HEALTH: NavHealth}


def write(path: Path, params: FollowerParams, record: Sequence[Recorded], start_ns: int) -> Path:
    """Bag of a run, which must not exist."""
    names = list(dict.fromkeys(one.topic for one in record))
    with BagWriter(path, {'mission': 'faults'}, compression='none', flush_s=1e9) as writer:
        writer.add_topic(topics.RUN_INFO, topics.TYPES[topics.RUN_INFO])
        for name, kind in topics.of_vehicle(VEHICLE, names).items():
            writer.add_topic(name, kind)
        writer.write(topics.RUN_INFO, to_bytes(description_of(params)), start_ns)
        for topic, data, log_ns in record:
            writer.write(f'/{VEHICLE}/{topic}', data, log_ns)
        writer.finish()
    return path


def replayed(params: FollowerParams, record: Sequence[Recorded], start_ns: int) -> ReplayResult:
    """Replay of the bag of a run."""
    with tempfile.TemporaryDirectory(prefix='polar_nav_faults_') as folder:
        return replay(open_bag(write(Path(folder) / 'run', params, record, start_ns)))


def trace_of(result: ReplayResult, live: LiveRun, start_ns: int, until_ns: int) -> Trace:
    """What a replay published until a true time [ns]; of the live run only the clocks are used.

    Outputs of a replay have no other time than their stamps. A receipt has that of the newest
    sample that was used, and counts from a reorder window later, when a node publishes it.
    """
    listener = Listener(start_ns)
    prefix = f'/{VEHICLE}/'
    window_ns = round(result.params.reorder_window_s * NS)
    diverged = not result.of(topics.STATE)
    for output in result.outputs:
        topic = output.topic.removeprefix(prefix)
        if topic in _TYPES:
            message = deserialize_message(output.data, _TYPES[topic])
            later_ns = window_ns if topic == topics.RECEIPT else 0
            listener.hear(topic, message, live.true_ns(output.stamp_ns) + later_ns)
            if topic == topics.HEALTH:
                diverged = message.status == NavHealth.STATUS_DIVERGED
    # A navigation that ran away and came back is named by a replay, too.
    return listener.trace(until_ns, (result.divergence or 'no state') if diverged else '')


def equals(result: ReplayResult, record: Sequence[Recorded]) -> bool:
    """Whether estimates and receipts of a replay are those of the live run, bit for bit."""
    return all(
        [one.data for one in record if one.topic == topic] == result.of(topic)
        for topic in (topics.STATE, topics.RECEIPT)
    )
