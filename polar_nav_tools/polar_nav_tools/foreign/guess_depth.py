"""The depth sensor of a guessed mapping: unit and sign by the size of its numbers."""

from __future__ import annotations

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_ros.adapters.layouts import DEPTH
from polar_nav_ros.adapters.mapping import PRESSURE_UNITS

from ..bags.reader import Topic
from .lines import Lines
from .sources import Source, read_table

_PRESSURE = 'sensor_msgs/msg/FluidPressure'
_ATMOSPHERE = 101325.0
"""[Pa]."""
_GAUGE = 0.5e5
"""Absolute pressures are above it, on the highest lake, too [Pa]."""
_AT_SURFACE = 1.5e5
"""Those of a vehicle that has been within some metres of the surface are below it [Pa]."""
_PRESSURES = (0.3e5, 1.3e8)
"""Absolute pressures at which a vehicle can be, as `check_values` has them [Pa]."""


def put_depth_unit(out: Lines, source: Source, topic: Topic) -> None:
    """Write unit and sign of a depth sensor: what its numbers show, else what is to fill in."""
    path = DEPTH[topic.type].get('pressure', DEPTH[topic.type].get('depth', ('',)))[0]
    values = read_table(source, topic.name, [path]).columns[path].astype(np.float64)
    values = values[np.isfinite(values)]
    if topic.type == _PRESSURE:
        _put_pressure_unit(out, values)
    elif topic.type.startswith('std_msgs/msg/Float'):
        said = f'{np.median(values):.5g}' if len(values) else 'no number'
        out.say(f'FILL IN the unit: not in the type, the median is {said}', 2)
        out.put('unit: FILL_IN', 2)
    if len(values) and np.median(values) < 0.0:
        out.say(f'the median is {np.median(values):.4g}: heights, for a depth is positive', 2)
        out.put('positive: up', 2)


def _put_pressure_unit(out: Lines, values: Array) -> None:
    """Write the unit in which the least pressure is nearest to that of the air, unless Pa fits."""
    if not len(values):
        out.say('no pressure in it; absolute pressure in Pa, as the type says', 2)
        out.put('unit: Pa', 2)
        return
    median, least = float(np.median(values)), float(np.quantile(values, 0.01))
    fits = [u for u, s in PRESSURE_UNITS.items() if _PRESSURES[0] < median * s < _PRESSURES[1]]
    absolute = [u for u in fits if _GAUGE < least * PRESSURE_UNITS[u] < _AT_SURFACE]
    if 'Pa' in fits and least > _GAUGE:
        out.say('absolute pressure in Pa, as the type says', 2)
        if least > _AT_SURFACE:
            out.say(
                f'CHECK: the least are {least:.4g}, none at the surface. Gauge pressures, zero', 2
            )
            out.say(
                'there, look the same and are 10 m too shallow: `atmospheric_pressure: 0.0`', 2
            )
        out.put('unit: Pa', 2)
    elif 'Pa' in fits:
        out.say(f'the least are {least:.4g}, under half of the pressure of the air: gauge', 2)
        out.say('pressure in Pa, which is zero at the surface', 2)
        out.put('atmospheric_pressure: 0.0', 2)
        out.put('unit: Pa', 2)
    elif absolute:
        unit = min(absolute, key=lambda u: abs(np.log(least * PRESSURE_UNITS[u] / _ATMOSPHERE)))
        out.say(f'no absolute pressure in Pa, as the type says: the median is {median:.4g},', 2)
        out.say(
            f'the least {least:.4g}, which in {unit} is nearest to the air: FILL IN another', 2
        )
        out.put(f'unit: {unit}', 2)
    else:
        out.say(f'FILL IN: the median is {median:.4g}, which is absolute pressure in no unit;', 2)
        out.say('of gauge pressure (zero at the surface) atmospheric_pressure is 0.0', 2)
        out.put('unit: FILL_IN', 2)
