"""Whether a saved state can be gone on from: by its content, and by its age."""

from __future__ import annotations

import reprlib

from .fix_record import FixRecord
from .params import EngineParams
from .plausibility import initial_problem
from .saved import SavedState
from .sins import resume as sins
from .station import resume as station
from .station.arrays import make_bank, make_settings


def saved_problem(params: EngineParams, saved: SavedState) -> str:
    """Sentence about a saved state that a filter of these parameters cannot use; empty if it can.

    It must be of the same kind of filter, finite, and a covariance.
    """
    problem = initial_problem(saved)
    if problem:
        return problem
    try:
        for record in saved.records:
            FixRecord(1).unpack(record)
    except ValueError as error:
        return str(error)
    if params.mode == 'station':
        members = len(make_settings(params).q_current)
        return station.problem_of(saved, make_bank(members))
    return sins.problem_of(saved, model=params.model_aiding)


def vehicle_problem(saved: SavedState, vehicle: str) -> str:
    """Sentence about a saved state of another vehicle; empty where none of the two is named."""
    if not (saved.vehicle and vehicle) or saved.vehicle == vehicle:
        return ''
    return f'the state is of vehicle {reprlib.repr(saved.vehicle)}, this one is {vehicle!r}'


def age_problem(saved: SavedState, stamp_ns: int, max_age_s: float) -> str:
    """Sentence about a saved state that is too old at a stamp [ns], or newer; else empty."""
    age_s = (stamp_ns - saved.stamp_ns) * 1e-9
    if age_s < 0.0:
        return f'the state is {-age_s:.1f} s newer than the first IMU sample'
    if age_s > max_age_s:
        return f'the state is {age_s:.1f} s old, state_max_age_s is {max_age_s:g} s'
    return ''
