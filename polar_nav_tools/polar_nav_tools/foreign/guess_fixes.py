"""The position fixes of a guessed mapping: frame, delay, noise, and what is to fill in."""

from __future__ import annotations

import numpy as np

from polar_nav_core.errors import PolarNavError
from polar_nav_core.link.packet import Broadcast
from polar_nav_ros.adapters.layouts import FILTERED, PACKET, POSITION, USBL
from polar_nav_ros.adapters.mapping import Frame, PositionMapping, Stream

from ..bags.reader import Topic
from .candidates import LEADER_WORDS, STATE_WORDS, best_position, words
from .guess_noise import Choices
from .guess_stamps import TopicTimes, put_stamp, times_of
from .lines import Lines
from .mounting import Mount, Mounts
from .read import read_positions
from .sources import Source, field_paths, read_table


def put_fixes(
    out: Lines,
    source: Source,
    fixes: list[Topic],
    topics: list[Topic],
    reference: TopicTimes | None,
    choices: Choices,
    packets: dict[Topic, Broadcast],
    mounts: Mounts,
    *,
    deep: bool,
) -> None:
    """Write the fixes; ``deep`` is whether a sensor measures the depth."""
    if not fixes:
        out.say('No topic looks like position fixes. FILL IN, or leave it out: the run drifts.')
        out.say('fixes: [{topic: /FILL/IN, delay_s: 5.0}]')
        out.put()
        return
    out.put('fixes:')
    for topic in fixes:
        out.say(f'{topic.type}, {topic.count} messages', 2)
        out.put(f'- topic: {topic.name}', 2)
        out.put(f'type: {topic.type}', 4)
        if topic.type == PACKET:
            out.say('numbers of the vehicles in the packets', 4)
            out.put('leader_id: 1', 4)
            out.put('own_id: 2', 4)
            continue
        if topic in packets:
            _packets(out, source, topic, packets[topic])
            continue
        if topic.type == USBL:
            leader = best_position([t for t in topics if words(t, LEADER_WORDS)], STATE_WORDS)
            name = '/FILL/IN' if leader is None else leader.name
            out.say('position and attitude of the vehicle with the array', 4)
            out.put(f'leader: {{topic: {name}}}', 4)
        else:
            put_frame(out, source, topic, 4)
            _dimensions(out, source, topic, deep=deep)
            _filtered(out, topic)
            _antenna(out, mounts.of_topic(source, topic))
        _delay(out, source, topic, reference, choices)
        _sigma(out, source, topic)
    out.put()


def _dimensions(out: Lines, source: Source, topic: Topic, *, deep: bool) -> None:
    """Write whether the heights of fixes are used: where nothing else measures them."""
    layout = POSITION[topic.type]
    path = (layout.get('geodetic') or layout.get('position', ('', '', '')))[-1]
    heights = read_table(source, topic.name, [path]).columns[path] if path else np.zeros(1)
    heights = heights[np.isfinite(heights)]
    if not deep and len(heights) and np.ptp(heights) > 0.0:
        out.say('nothing else measures the height; 2 leaves the heights of fixes out', 4)
        out.put('dimensions: 3', 4)
        return
    out.say('heights of fixes are not used; 3 uses them (those in ECEF always are)', 4)
    if not deep:
        out.say('CHECK: nothing measures the height or depth, and it drifts away', 4)
    out.put('dimensions: 2', 4)


def _antenna(out: Lines, mount: Mount | None) -> None:
    """Write the located point, where the messages name a frame of the vehicle."""
    if mount is not None:
        out.say(f'the located point, {mount.source_text}', 4)
        out.put(f'transponder_lever_b: {mount.lever_text}', 4)


def _sigma(out: Lines, source: Source, topic: Topic) -> None:
    """Write the 1-sigma of a source's fixes: to fill in where no message states one."""
    if topic.type != USBL:
        try:
            rows = read_positions(
                source, PositionMapping(Stream(topic.name), Frame(None), np.eye(3))
            )
        except PolarNavError:
            rows = None  # its frame is still to fill in
        if rows is not None and not (rows.covariance_e[:, 0, 0] > 0.0).any():
            out.say('no message states a covariance: FILL IN the 1-sigma of a fix [m]', 4)
            out.put('sigma: FILL_IN', 4)
            _alike(out, topic)
            return
    out.say("sigma: [5.0, 5.0]   # horizontal, vertical [m], in place of the messages'", 4)
    _alike(out, topic)


def _alike(out: Lines, topic: Topic) -> None:
    """Write how to say that errors are alike, of fixes that are not asked about it."""
    if topic.type not in (*FILTERED, USBL):
        out.say(
            'correlation_s: 60.0   # for how long an error lasts (multipath, sound speed, a', 4
        )
        out.say('receiver that smooths); without it, a hundred fixes count ten times as much', 4)


def _filtered(out: Lines, topic: Topic) -> None:
    if topic.type in FILTERED:
        out.say(
            'FILL IN over how long its errors resemble one another [s]: the time constant of', 4
        )
        out.say('the filter that made these positions; 0 where each is measured anew', 4)
        out.put('correlation_s: FILL_IN', 4)


def _packets(out: Lines, source: Source, topic: Topic, first: Broadcast) -> None:
    out.say('its bytes are packets of a leader, by their checksum; numbers as in the first', 4)
    out.put(f'leader_id: {first.source}', 4)
    out.put(f'own_id: {first.target}', 4)
    if 'header.stamp.sec' not in field_paths(source, topic.name):
        out.say('no header: received when it was recorded', 4)
        out.put('clock: log', 4)


def _delay(
    out: Lines,
    source: Source,
    topic: Topic,
    reference: TopicTimes | None,
    choices: Choices,
) -> None:
    try:
        times = times_of(source, topic.name)
    except PolarNavError as error:
        out.say(f'not read: {error}', 4)
        return
    before = len(out.lines)
    logged = put_stamp(out, times, reference, choices.clock, delayed=True, indent=4)
    if logged:
        out.say('so a delay is not known: FILL IN time_offset_s: -DELAY, where there is one', 4)
        return
    if times.stamps_ns is None or any('FILL_IN' in line for line in out.lines[before:]):
        return
    lag = (times.log_ns - times.stamps_ns) * 1e-9
    if reference is not None:
        lag = lag - reference.behind_log_ns * 1e-9
    median = float(np.median(lag))
    if abs(median) < 0.05:
        out.say(f'recorded {median:.3g} s after their stamps: either the stamps are those of', 4)
        out.say('arrival (then FILL IN time_offset_s: -DELAY, and delay_sigma_s where it', 4)
        out.say('varies), or there is no delay', 4)
        return
    out.say(
        f'recorded {median:.3g} s after their stamps ({lag.min():.3g} to {lag.max():.3g} s):', 4
    )
    out.say('taken as the delay; `delay_s` states one instead', 4)


def put_frame(out: Lines, source: Source, topic: Topic, indent: int) -> None:
    """Write the frame of a topic's positions: what shows it, else what is to fill in."""
    if 'latitude' in field_paths(source, topic.name):
        return
    try:
        read_positions(source, PositionMapping(Stream(topic.name), Frame(None), np.eye(3)))
    except PolarNavError as error:
        why = str(error)
    else:
        return
    try:
        rows = read_positions(
            source, PositionMapping(Stream(topic.name), Frame('earth'), np.eye(3))
        )
    except PolarNavError as error:
        out.say(f'not read: {error}', indent)
        return
    if (rows.given & rows.plausible).any():
        out.say(
            'distances from zero are those of the surface from the centre of the earth', indent
        )
        out.put('frame: earth', indent)
        return
    out.say(f'FILL IN {why.partition("frame is missing: ")[2]}', indent)
    out.put('frame: FILL_IN', indent)
    out.say('for enu and ned:', indent)
    out.say('origin: {latitude_deg: .., longitude_deg: .., height: ..}', indent)
