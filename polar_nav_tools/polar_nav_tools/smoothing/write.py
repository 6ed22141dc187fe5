"""What a smoothed run is written as: a bag, and what JSON says of its passes."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.params import to_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_ros import topics
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.model_outputs import current_to_msg, model_to_msg
from polar_nav_ros.navigation_outputs import receipt_to_msg

from ..bags import BagWriter
from ..foreign.replay import Row, states_of, truth_messages
from .bag import AnySmoothed, SmoothedRun


def summary(found: AnySmoothed) -> dict[str, object]:
    """Passes and revisions for JSON."""
    return {
        'passes': found.passes,
        'moved_sigma': None if math.isinf(found.moved) else found.moved,
        'largest_turn_rad': found.largest_turn,
        'unsettled': found.unsettled,
        'revisions': [r.to_dict() for r in found.revisions],
    }


def _model_messages(track: engine_run.StationTrack, params: FollowerParams) -> Iterator[Row]:
    """Smoothed drag and current at each estimate, as a follower publishes them."""
    for k, stamp_ns in enumerate(track.stamps_ns.tolist()):
        model = track.model(k, params)
        yield stamp_ns, topics.MODEL, to_bytes(model_to_msg(model, stamp_ns))
        yield stamp_ns, topics.CURRENT, to_bytes(current_to_msg(model, stamp_ns))


def _receipts(receipts: Sequence[Receipt]) -> Iterator[Row]:
    """Messages of receipts in the order of their stamps."""
    stamps_ns = np.fromiter((r.stamp_ns for r in receipts), np.int64, len(receipts))
    for k in np.argsort(stamps_ns, kind='stable').tolist():
        receipt = receipts[k]
        yield receipt.stamp_ns, topics.RECEIPT, to_bytes(receipt_to_msg(receipt))


def write(path: Path, run: SmoothedRun) -> Path:
    """Write the smoothed track as nav/state, its fixes' receipts and the truth to a new bag.

    Raises
    ------
    BagError
        When the bag exists or cannot be written.
    """
    streams = [states_of(run.track, run.params, run.vehicle), _receipts(run.found.receipts)]
    written = [topics.STATE, topics.RECEIPT]
    if isinstance(run.found.track, engine_run.StationTrack):
        streams.append(_model_messages(run.found.track, run.params))
        written += [topics.MODEL, topics.CURRENT]
    if run.truth is not None:
        streams.append(truth_messages(run.truth))
        written.append(topics.TRUTH)
    info: dict[str, object] = {
        'smoothing_of': str(run.path),
        'engine_version': ENGINE_VERSION,
        'configuration': run.params.configuration,
        'parameters': to_mapping(run.params),
        'smoothing': summary(run.found),
    }
    with BagWriter(path, info) as writer:
        for topic in written:
            writer.add_topic(f'/{run.vehicle}/{topic}', topics.TYPES[topic])
        for stamp_ns, topic, data in heapq.merge(*streams, key=lambda row: row[0]):
            writer.write(f'/{run.vehicle}/{topic}', data, stamp_ns)
    return path
