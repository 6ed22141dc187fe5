"""Constants that can be calibrated: their units, priors, and manoeuvres that show them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.error_model import X
from polar_nav_core.errors import ConfigError
from polar_nav_core.kernels.sins import consider

from . import move
from .move import Move

_DEG = math.degrees(1.0)
_ERRORS = tuple(range(X.size))


@dataclass(frozen=True)
class Constant:
    """One constant, which counts as what has to be added to the stated one.

    Attributes
    ----------
    name, unit, doc : str
    factor : float
        From SI to the unit.
    prior : float
        1-sigma before the data, SI: wider than any careful installation needs.
    needs : str
        Data without which there is nothing to calibrate.
    show : str
        Manoeuvre that would show it.
    move : callable or None
        Parameters and inputs with so much more of it; None for a state of the filter.
    column : int
        Column of the common error whose rows are its own times ``sign``; -1 without one.
    sign : float
    rough : bool
        Whether those rows are too rough to estimate by: differences of runs take their place.
    states : tuple of int
        Error states of the filter that hold it, in place of a common error.
    twin : str
        Constant of another instrument that no data on board separate from this one.
    also : bool
        Calibrated on request only.
    """

    name: str
    unit: str
    doc: str
    factor: float
    prior: float
    needs: str
    show: str
    move: Move | None = None
    column: int = -1
    sign: float = 1.0
    rough: bool = False
    states: tuple[int, ...] = ()
    twin: str = ''
    also: bool = False


_TURNS = 'turns: a lawnmower or a figure of eight, not one course'
_TURNING = 'hard turns, and both ways: a lever arm shows while the vehicle turns only'

CONSTANTS = (
    Constant(
        'delay', 's', 'age of a position fix at its stated validity', 1.0, 10.0, 'fixes',
        'courses against one another, as of a lawnmower: on one course a delay is an offset',
        move.delay, consider.CLOCK, -1.0,
    ),
    Constant(
        'dvl_yaw', 'deg', 'turn of the DVL about up, counter-clockwise', _DEG, math.radians(10.0),
        'dvl', f'position fixes along {_TURNS}, with a heading that is known',
        move.dvl_turn(2), consider.DVL_YAW, -1.0,
    ),
    Constant(
        'dvl_pitch', 'deg', 'turn of the DVL about the body y axis', _DEG, math.radians(10.0),
        'dvl', 'depths along a way ahead', move.dvl_turn(1), consider.DVL_PITCH, -1.0,
    ),
    Constant(
        'dvl_roll', 'deg', 'turn of the DVL about the body x axis', _DEG, math.radians(10.0),
        'dvl', 'sway: steps to the side, or a vehicle that drifts', move.dvl_turn(0), also=True,
    ),
    Constant(
        'dvl_lever_x', 'm', 'DVL further forward', 1.0, 3.0, 'dvl', _TURNING,
        move.lever('dvl_lever_b', 0), consider.DVL_LEVER_X,
    ),
    Constant(
        'dvl_lever_y', 'm', 'DVL further to port', 1.0, 3.0, 'dvl', _TURNING,
        move.lever('dvl_lever_b', 1), consider.DVL_LEVER_Y,
    ),
    Constant(
        'dvl_lever_z', 'm', 'DVL further up', 1.0, 3.0, 'dvl',
        'rolling and pitching by some degrees per second',
        move.lever('dvl_lever_b', 2), also=True,
    ),
    Constant(
        'dvl_latency', 's', 'age of a DVL ping at its stamp', 1.0, 1.0, 'dvl',
        'changes of speed, and turns that begin and end within seconds',
        move.dvl_latency, consider.DVL_LATENCY, rough=True,
    ),
    # After what it is computed from: mounting, lever arm and stamps.
    Constant(
        'dvl_scale', '%', 'scale error of the DVL: it shows too much by', 100.0, 0.05, 'dvl',
        'long legs with position fixes: metres by the DVL against metres between fixes',
        move.dvl_scale,
    ),
    Constant(
        'range_scale', '%', 'scale error of acoustic ranges: they are too long by', 100.0, 0.05,
        'relative', 'ranges that change: a leader or ship that stays while the vehicle sails by',
        move.range_scale, consider.RANGE_SCALE,
    ),
    Constant(
        'array_yaw', 'deg', 'turn of the acoustic array about up, counter-clockwise', _DEG,
        math.radians(10.0), 'relative',
        'ways around and past the array, at ranges and bearings that change',
        move.array_yaw, consider.ARRAY_TURN, -1.0, twin="heading bias of the array's vehicle",
    ),
    Constant(
        'clock_drift', 'ppm', "rate of the clock of fixes against the vehicle's: it is fast by",
        1e6, 2e-4, 'fixes', 'hours, on courses against one another', move.clock_drift, also=True,
    ),
    Constant(
        'sea_surface', 'm', 'zero of depth: the sea surface above where it was stated', 1.0, 10.0,
        'depth', 'position fixes with heights', move.sea_surface, consider.DEPTH_ZERO,
    ),
    *(
        Constant(
            f'transponder_lever_{"xyz"[k]}', 'm', f'transponder further {where}', 1.0, 3.0,
            'fixes', f'{_TURNS}, and at several speeds', move.lever('transponder_lever_b', k),
            also=True,
        )
        for k, where in enumerate(('forward', 'to port', 'up'))
    ),
    Constant(
        'heading_bias', 'deg', 'bias of measured headings, clockwise: they are too large by', _DEG,
        math.radians(10.0), 'headings',
        'position fixes along legs, with a DVL whose yaw is known',
        states=_ERRORS[X.usbl_bias_a][:1],
    ),
    *(
        Constant(
            f'heading_{name}', 'deg', f'error of measured headings times {name} of the heading',
            _DEG, math.radians(10.0), 'headings', 'full circles', move.heading(harmonic),
            also=True,
        )
        for name, harmonic in (('sin', np.sin), ('cos', np.cos))
    ),
)  # fmt: skip
NAMES = tuple(c.name for c in CONSTANTS)


def chosen(
    params: EngineParams, inputs: Inputs, only: tuple[str, ...] = (), also: tuple[str, ...] = ()
) -> tuple[Constant, ...]:
    """Constants of a run: all that its data are about, or those that are named.

    Raises
    ------
    ConfigError
        For an unknown name, for one that the data are not about, and where nothing is left.
    """
    for name in (*only, *also):
        if name not in NAMES:
            raise ConfigError(
                f'{name!r} is no constant to calibrate; there are {", ".join(NAMES)}'
            )
    there = data_of(params, inputs)
    wanted = [c for c in CONSTANTS if (c.name in only if only else not c.also) or c.name in also]
    for c in wanted:
        if c.name in (*only, *also) and c.needs not in there:
            raise ConfigError(f'{c.name}: there are no {WHAT[c.needs]} in this run')
    found = tuple(c for c in wanted if c.needs in there)
    if not found:
        raise ConfigError('there is nothing to calibrate: no DVL, no fixes, no depths')
    return found


WHAT = {
    'fixes': 'position fixes',
    'relative': 'fixes with the vector from the array: packets of a leader',
    'dvl': 'DVL pings with bottom lock',
    'depth': 'depths',
    'headings': 'measured headings that are used',
}
"""Data that constants need, in words."""


def data_of(params: EngineParams, inputs: Inputs) -> set[str]:
    """Kinds of data in a run, keys of `WHAT`."""
    fixes = [f for f in inputs.fixes if f.refusal is None]
    there = {
        'fixes': bool(fixes),
        'relative': any(bool(f.relative_e.any()) for f in fixes),
        'dvl': bool(inputs.dvl_valid.any()),
        'depth': bool(len(inputs.depth)),
        'headings': params.uses_heading and bool(len(inputs.headings)),
    }
    return {name for name, present in there.items() if present}
