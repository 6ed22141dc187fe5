"""Readings of a run's inputs as arrays, and events of readings, for runs of the engine."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from polar_nav_core import grid
from polar_nav_core.engine.events import (
    ControlSample,
    DepthSample,
    DvlPing,
    Event,
    Fix,
    ImuSample,
    Verdict,
)
from polar_nav_core.engine.inputs import Inputs, StationInputs

from .readings import DEPTH, DVL, FIX, IMU, PACKET, THRUST, Reading, Readings, in_order

_INDEFINITE = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0]])


def readings_of(inputs: Inputs | StationInputs) -> tuple[list[Reading], list[Event]]:
    """Readings in the order of arrival, and the events that they are of, by their numbers.

    Local measurements arrive at their stamps, packets at their reception.
    """
    events = list(inputs.events())
    readings = [
        Reading(_stream(e), n, e.stamp_ns, e.stamp_ns, e.stamp_ns, _values(e))
        for n, e in enumerate(events)
    ]
    return in_order(readings), events


def events_of(readings: Readings, events: list[Event]) -> Iterator[tuple[Reading, Event]]:
    """Readings with their events, numbered on their topics as they come."""
    counts: Counter[str] = Counter()
    for reading in readings:
        number = counts[reading.stream]
        counts[reading.stream] += 1
        yield reading, _event(reading, events[reading.number], number)


def _stream(event: Event) -> str:
    kinds = {ImuSample: IMU, DvlPing: DVL, DepthSample: DEPTH, ControlSample: THRUST, Fix: FIX}
    return kinds[type(event)]


def _values(event: Event) -> dict[str, Any]:
    if isinstance(event, ImuSample):
        return {'omega_ib_b': event.omega_ib_b, 'f_b': event.f_b}
    if isinstance(event, DvlPing):
        return {'v_m': event.v_m, 'covariance_m': event.covariance_m, 'valid': event.valid}
    if isinstance(event, DepthSample):
        return {'depth': event.depth, 'variance': event.variance}
    if isinstance(event, ControlSample):
        return {'force_b': event.force_b}
    return dict(PACKET)


def _event(reading: Reading, event: Event, number: int) -> Event:
    values = reading.values
    if isinstance(event, Fix):
        return _fix(reading, event, number)
    if isinstance(event, DvlPing):  # as dvl_from_msg
        good = bool(values['valid']) and bool(np.isfinite(values['v_m']).all())
        values = {**values, 'valid': good}
    return replace(event, stamp_ns=reading.stamp_ns, sequence=number, **values)


def _fix(reading: Reading, fix: Fix, number: int) -> Fix:
    v, shift_ns = reading.values, reading.stamp_ns - fix.receive_ns
    out = replace(
        fix,
        receive_ns=reading.stamp_ns,
        transmit_ns=fix.transmit_ns + shift_ns,
        sequence=fix.sequence + v['ahead'],
        order=fix.order + v['ahead'],
        arrival=number,
    )
    if v['flipped_bit'] is not None:
        return replace(
            out,
            validity_ns=0,
            r_e=np.full(3, math.nan),
            covariance_e=np.full((3, 3), math.nan),
            refusal=Verdict.BAD_CRC,
            reason='CRC does not fit',
        )
    if fix.polar is not None:
        return replace(out, polar=replace(fix.polar, station=fix.polar.station + v['moved_G']))
    covariance_e = fix.covariance_e
    if v['sigma'] is not None:
        covariance_e = v['sigma'] ** 2 * np.eye(3)
    if v['indefinite']:
        sigma = np.sqrt(np.diagonal(covariance_e))
        covariance_e = _INDEFINITE * np.outer(sigma, sigma)
    moved_e = np.zeros(3)
    if v['moved_G'].any():
        moved_e = np.asarray(grid.ecef_to_grid(fix.r_e)).T @ v['moved_G']
    return replace(
        out,
        r_e=fix.r_e + moved_e,
        relative_e=fix.relative_e + moved_e,
        covariance_e=covariance_e,
    )
