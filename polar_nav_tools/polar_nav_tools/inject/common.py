"""Faults that every stream can have: silence, clocks, order, repeated and missing messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .readings import NS, VECTORS, Apply, Reading, Readings, Setting, in_order

ORDER_S = 20.0
"""Length of the faults of order [s]."""
_END_OF_TIME_NS = (2**31 - 1) * NS


def silent(stream: str) -> Apply:
    """No messages for ``size`` seconds."""

    def apply(readings: Readings, s: Setting) -> list[Reading]:
        return [r for r in readings if r.stream != stream or not s.within(r, s.size)]

    return apply


def stuck(stream: str, *names: str) -> Apply:
    """The values of the last message before it are repeated for ``size`` seconds.

    All of them, or those that are named.
    """

    def apply(readings: Readings, s: Setting) -> list[Reading]:
        last: Reading | None = None
        out: list[Reading] = []
        for r in readings:
            if r.stream == stream and not s.within(r, s.size):
                last = r if s.since_s(r) < 0.0 else last
            elif r.stream == stream and last is not None:
                old = {name: last.values[name] for name in names}
                r = r.with_values(**old) if names else replace(r, values=last.values)
            out.append(r)
        return out

    return apply


def swapped(stream: str, axis: int | None, *names: str) -> Apply:
    """One axis of these values, or a number, has the wrong sign from the start on."""

    def other(value: Any) -> Any:  # noqa: ANN401 - a number or an array
        if axis is None:
            return -value
        value = np.array(value)
        value[axis] = -value[axis]
        return value

    def apply(readings: Readings, s: Setting) -> list[Reading]:
        def turned(r: Reading) -> Reading:
            return r.with_values(**{name: other(r.values[name]) for name in names})

        return _changed(readings, stream, s, math.inf, turned)

    return apply


def first(stream: str, change: Callable[[Reading, Setting], Reading], count: int = 1) -> Apply:
    """The first message, or several, from the start on are changed."""

    def apply(readings: Readings, s: Setting) -> list[Reading]:
        out: list[Reading] = []
        left = count
        for r in readings:
            hit = left > 0 and r.stream == stream and s.since_s(r) >= 0.0
            left -= hit
            out.append(change(r, s) if hit else r)
        return out

    return apply


def not_a_number(stream: str) -> Apply:
    """The measured values of ``size`` messages are not numbers."""

    def nothing(r: Reading) -> Reading:
        return r.with_values(**{n: r.values[n] * math.nan for n in VECTORS[stream]})

    def apply(readings: Readings, s: Setting) -> list[Reading]:
        return first(stream, lambda r, _: nothing(r), round(s.size))(readings, s)

    return apply


def ahead(stream: str, count: int) -> Apply:
    """``count`` messages are stamped ``size`` seconds ahead."""
    return first(stream, lambda r, s: _restamped(r, round(s.size * NS)), count)


def end_of_time(stream: str, count: int) -> Apply:
    """``count`` messages are stamped 2^31 - 1 s, in the year 2038; one apart by the clock."""

    def stamped(r: Reading, s: Setting) -> Reading:
        return replace(r, stamp_ns=_END_OF_TIME_NS + (r.true_ns - s.at_ns) % NS)

    return first(stream, stamped, count)


def begin_of_time(stream: str) -> Apply:
    """One message is stamped 1 s, in the year 1970."""
    return first(stream, lambda r, _: replace(r, stamp_ns=NS))


def clock(streams: Sequence[str]) -> Apply:
    """The clock of all messages of these streams steps by ``size`` seconds."""

    def apply(readings: Readings, s: Setting) -> list[Reading]:
        shift_ns = round(s.size * NS)
        # A packet's validity is of its sender's clock: only its reception is stamped here.
        return [
            _restamped(r, shift_ns) if r.stream in streams and s.since_s(r) >= 0.0 else r
            for r in readings
        ]

    return apply


def clock_rate(stream: str) -> Apply:
    """The clock of a stream runs fast by ``size`` parts in a million."""

    def restamped(r: Reading, s: Setting) -> Reading:
        return _restamped(r, round(s.size * 1e-6 * NS * s.since_s(r)))

    return changed(stream, restamped, math.inf)


def added(stream: str, name: str) -> Apply:
    """``size`` is added to a value, on every axis."""
    return changed(stream, lambda r, s: r.with_values(**{name: r.values[name] + s.size}), math.inf)


def repeated(stream: str) -> Apply:
    """Every message of 20 s comes ``size`` more times."""

    def apply(readings: Readings, s: Setting) -> list[Reading]:
        out: list[Reading] = []
        for r in readings:
            copies = round(s.size) if r.stream == stream and s.within(r, ORDER_S) else 0
            out += [r] * (1 + copies)
        return out

    return apply


def reordered(stream: str) -> Apply:
    """Messages of 20 s arrive up to ``size`` seconds late each, at random."""

    def apply(readings: Readings, s: Setting) -> list[Reading]:
        def late(r: Reading) -> Reading:
            return r.delayed(round(s.rng.uniform(0.0, s.size) * NS))

        return in_order(_changed(readings, stream, s, ORDER_S, late))

    return apply


def late(stream: str) -> Apply:
    """All messages of 20 s arrive ``size`` seconds late."""

    def apply(readings: Readings, s: Setting) -> list[Reading]:
        def later(r: Reading) -> Reading:
            return r.delayed(round(s.size * NS))

        return in_order(_changed(readings, stream, s, ORDER_S, later))

    return apply


def lost(stream: str) -> Apply:
    """A share ``size`` of the messages of 20 s is lost, at random."""

    def apply(readings: Readings, s: Setting) -> list[Reading]:
        return [
            r
            for r in readings
            if r.stream != stream or not s.within(r, ORDER_S) or s.rng.random() >= s.size
        ]

    return apply


def _restamped(r: Reading, shift_ns: int) -> Reading:
    return replace(r, stamp_ns=max(0, r.stamp_ns + shift_ns))


def _changed(
    readings: Readings,
    stream: str,
    s: Setting,
    length_s: float,
    change: Callable[[Reading], Reading],
) -> list[Reading]:
    """Readings with those of a stream changed for some time."""
    return [change(r) if r.stream == stream and s.within(r, length_s) else r for r in readings]


def stuck_axis(stream: str, name: str, axis: int) -> Apply:
    """One axis of a vector keeps what the last message before says, for ``size`` seconds."""

    def apply(readings: Readings, s: Setting) -> list[Reading]:
        before = [r for r in readings if r.stream == stream and s.since_s(r) < 0.0]
        if not before:
            return list(readings)
        held = before[-1].values[name][axis]

        def change(r: Reading) -> Reading:
            vector = r.values[name].copy()
            vector[axis] = held
            return r.with_values(**{name: vector})

        return _changed(readings, stream, s, s.size, change)

    return apply


def changed(stream: str, change: Callable[[Reading, Setting], Reading], length_s: float) -> Apply:
    """All messages of a stream are changed for a time."""

    def apply(readings: Readings, s: Setting) -> list[Reading]:
        return _changed(readings, stream, s, length_s, lambda r: change(r, s))

    return apply
