"""Faults of acoustic packets: damaged, forged, displaced, replayed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from .common import ORDER_S, changed, first
from .readings import FIX, NS, Reading, Readings, Setting, in_order

FORGED_EVERY_S = 0.01
"""Time between forged packets [s]."""
_FAR_M = 2000.0
_REPLAY_EVERY_S = 0.05
_NUMBERS_APART = 1000
_HEADER_BITS = 8
"""Bits of the packet's version: a packet of another format is another fault."""


def flipped(readings: Readings, s: Setting) -> list[Reading]:
    """One bit of every packet of ``size`` seconds is flipped on the way: the CRC is bad."""

    def flip(r: Reading, s: Setting) -> Reading:
        return r.with_values(flipped_bit=int(s.rng.integers(_HEADER_BITS, 160)))

    return changed(FIX, flip, s.size)(readings, s)


def indefinite(readings: Readings, s: Setting) -> list[Reading]:
    """``size`` packets state a correlation of (1, 1, -1), which no covariance has."""
    change = first(FIX, lambda r, _: r.with_values(indefinite=True), round(s.size))
    return change(readings, s)


def jump(readings: Readings, s: Setting) -> list[Reading]:
    """One packet states a position ``size`` metres off."""
    return first(FIX, lambda r, s: _moved(r, s.size))(readings, s)


def displaced(readings: Readings, s: Setting) -> list[Reading]:
    """All packets from the start on state a position ``size`` metres off."""
    return changed(FIX, lambda r, s: _moved(r, s.size), math.inf)(readings, s)


def drift(readings: Readings, s: Setting) -> list[Reading]:
    """Stated positions drift away at ``size`` metres per second."""
    return changed(FIX, lambda r, s: _moved(r, s.size * s.since_s(r)), math.inf)(readings, s)


def replayed(readings: Readings, s: Setting) -> list[Reading]:
    """Every packet of 20 s comes ``size`` more times, under other numbers."""
    out: list[Reading] = []
    for r in readings:
        out.append(r)
        if r.stream == FIX and s.within(r, ORDER_S):
            out += [_copy(r, k, _NUMBERS_APART + k, _REPLAY_EVERY_S) for k in _upto(s.size)]
    return in_order(out)


def burnt(readings: Readings, s: Setting) -> list[Reading]:
    """Forged packets, 2 km off, use the next ``size`` numbers within seconds."""
    heard = [r for r in readings if r.stream == FIX and s.since_s(r) >= 0.0]
    if not heard:
        return list(readings)
    forged = (_copy(heard[0], k, k, FORGED_EVERY_S) for k in _upto(s.size))
    return in_order([*readings, *(_moved(r, _FAR_M) for r in forged)])


def stated_sigma(readings: Readings, s: Setting) -> list[Reading]:
    """Every packet of 20 s states a 1-sigma of ``size`` metres on every axis."""
    return changed(FIX, lambda r, s: r.with_values(sigma=s.size), ORDER_S)(readings, s)


def _upto(size: float) -> range:
    return range(1, round(size) + 1)


def _moved(r: Reading, by_m: float) -> Reading:
    return r.with_values(moved_G=r.values['moved_G'] + np.array([by_m, 0.0, 0.0]))


def _copy(r: Reading, k: int, ahead: int, every_s: float) -> Reading:
    """Copy number k of a packet, with a number ahead of its own."""
    later = r.delayed(round(k * every_s * NS))
    return replace(later, values={**r.values, 'ahead': ahead, 'forged': k})
