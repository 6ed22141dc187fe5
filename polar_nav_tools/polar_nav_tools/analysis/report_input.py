"""Input of a report, gathered from an analysis and its bag."""

from __future__ import annotations

import numpy as np

from polar_nav_ros.topics import DECODED, STATION_DECODED, TRUTH, TX

from ..bags import Bag
from ..bags.arrays import load_truth
from ..report.input import FixPositions, ReportInput, SentPackets, StationRanges
from ..series.vehicle import TruthSeries
from .analyse import Analysis


def report_input(analysis: Analysis, *, title: str, made: str) -> ReportInput:
    """Input of the HTML report of an analysis."""
    bag, name = analysis.bag, analysis.vehicle
    leader = leader_of(bag, name)
    first = next(iter(analysis.balances.values()), ())
    return ReportInput(
        title=title,
        subtitle=str(bag.run_info.get('mission', '')),
        runs=analysis.runs,
        leader=leader,
        fixes=fix_positions(bag, name) or _station_positions(bag, analysis, leader),
        sent=sent_packets(bag, leader.vehicle if leader is not None else None),
        counts=analysis.counts,
        balances=first,
        digests=analysis.digests(),
        metadata=_metadata(bag),
        made=made,
        comparison=analysis.comparison,
        judged=analysis.judged,
    )


def leader_of(bag: Bag, follower: str) -> TruthSeries | None:
    """Truth of the first other vehicle that the bag has, for the map."""
    for topic in bag.topics.values():
        vehicle, _, rest = topic.name.strip('/').partition('/')
        if rest == TRUTH and vehicle != follower and topic.count:
            return load_truth(bag, vehicle)
    return None


def fix_positions(bag: Bag, follower: str) -> FixPositions | None:
    """Positions of the follower from its readable packets."""
    topic = f'/{follower}/{DECODED}'
    if topic not in bag.topics or not bag.topics[topic].count:
        return None
    messages = [message for _, message in bag.read(topic)]
    stamps = [m.header.stamp for m in messages]
    return FixPositions.from_broadcasts(
        source=str(messages[0].source),
        sequence=np.array([m.sequence for m in messages], dtype=np.int64),
        stamp_ns=np.array([s.sec * 10**9 + s.nanosec for s in stamps], dtype=np.int64),
        leader_r_e=np.array([m.leader_r_e for m in messages], dtype=np.float64),
        r_lf_G=np.array([m.r_lf_g for m in messages], dtype=np.float64),
    )


def _station_positions(
    bag: Bag, analysis: Analysis, station: TruthSeries | None
) -> FixPositions | None:
    """Positions of the follower from ranges and bearings of a station."""
    topic = f'/{analysis.vehicle}/{STATION_DECODED}'
    if station is None or topic not in bag.topics or not bag.topics[topic].count:
        return None
    messages = [message for _, message in bag.read(topic)]
    stamps = [m.header.stamp for m in messages]
    ranges = StationRanges(
        station=np.array([m.station_position for m in messages], dtype=np.float64),
        heading=np.array([m.station_heading for m in messages]),
        range=np.array([m.range for m in messages]),
        bearing=np.array([m.bearing for m in messages]),
    )
    return FixPositions.from_ranges(
        source=str(messages[0].source),
        sequence=np.array([m.sequence for m in messages], dtype=np.int64),
        stamp_ns=np.array([s.sec * 10**9 + s.nanosec for s in stamps], dtype=np.int64),
        ranges=ranges,
        station=station,
        truth=next(iter(analysis.runs.values()))[0],
    )


def sent_packets(bag: Bag, leader: str | None) -> SentPackets | None:
    """All packets that the leader sent; None without any."""
    topic = f'/{leader}/{TX}'
    if leader is None or topic not in bag.topics or not bag.topics[topic].count:
        return None
    messages = [message for _, message in bag.read(topic)]
    times = [m.transmit_time for m in messages]
    return SentPackets(
        source=leader,
        sequence=np.array([m.sequence for m in messages], dtype=np.int64),
        transmit_ns=np.array([t.sec * 10**9 + t.nanosec for t in times], dtype=np.int64),
    )


def _metadata(bag: Bag) -> dict[str, dict[str, object]]:
    run = {k: v for k, v in bag.run_info.items() if not isinstance(v, dict | list)}
    nodes = {name: dict(info.get('params', {})) for name, info in bag.node_infos.items()}
    return {'run': run, **nodes}
