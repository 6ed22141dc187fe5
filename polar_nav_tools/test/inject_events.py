"""Events of readings with faults: what messages with the same faults are compared with."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np

from polar_nav_core import grid
from polar_nav_core.engine.events import DvlPing, Fix
from polar_nav_core.engine.verdicts import Verdict

_INDEFINITE = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0]])


def events_of(readings, events):
    """Readings with their events, numbered on their topics as they come."""
    counts = Counter()
    for reading in readings:
        number = counts[reading.stream]
        counts[reading.stream] += 1
        yield reading, _event(reading, events[reading.number], number)


def _event(reading, event, number):
    values = reading.values
    if isinstance(event, Fix):
        return _fix(reading, event, number)
    if isinstance(event, DvlPing):  # as dvl_from_msg
        good = bool(values['valid']) and bool(np.isfinite(values['v_m']).all())
        values = {**values, 'valid': good}
    return replace(event, stamp_ns=reading.stamp_ns, sequence=number, **values)


def _fix(reading, fix, number):
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
