"""Injected faults drawn at random: one, or two at once, of any kind and size in any scene.

The other rows are what somebody thought of. A row of a number is the same wherever it is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...inject.faults import FAULTS, SINS, STATION, Fault, Injection
from ..draws import OneOf, Size
from ..mismatch.row import TACTICAL
from ..mismatch.scenes import Scene
from .row import DURATION_S, START_S, Row, inertial, station

_TWO = 0.3
"""Share of rows with two faults."""
_LATER_S = OneOf((0.0, 5.0, 20.0))
"""How long after the first one the second one begins."""

_COUNT, _LENGTH = OneOf((1.0, 5.0, 30.0)), Size(0.2, 60.0)
_OF_EVERY_STREAM: Mapping[str, Size | OneOf] = {
    'silent': _LENGTH,
    'lost': Size(0.05, 0.95),
    'repeated': _COUNT,
    'reordered': Size(0.02, 10.0),
    'late': Size(0.1, 20.0),
    'clock': Size(0.02, 5e3, signed=True),
    'clock_rate': Size(30.0, 3e3, signed=True),
    'stuck': _LENGTH,
    'ahead': Size(0.01, 100.0),
    'several_ahead': Size(0.01, 100.0),
    'nan': OneOf((1.0, 10.0, 300.0)),
}
_SIZES: Mapping[str, Size | OneOf] = {
    'imu_force': Size(5.0, 1e6, signed=True),
    'imu_rate': Size(0.1, 1e3, signed=True),
    'imu_gyro_stuck': _LENGTH,
    'imu_accelerometer_stuck': _LENGTH,
    'imu_gyro_axis_stuck': _LENGTH,
    'imu_gyro_degrees': Size(0.1, 10.0),
    'imu_yaw': Size(0.5, 180.0, signed=True),
    'imu_gyro_step': Size(1e-4, 0.1, signed=True),
    'imu_accelerometer_step': Size(1e-3, 1.0, signed=True),
    'dvl_indefinite': Size(1e-6, 1.0),
    'dvl_covariance': OneOf((5e-324, 1e-12, 1e-8, 1.0, 1e6, 1e300)),
    'dvl_sigma': Size(1e-6, 10.0),
    'dvl_velocity': OneOf((0.5, 3.0, 30.0, 1e6, 1e300)),
    'dvl_outage': _LENGTH,
    'dvl_scale': Size(0.01, 0.5, signed=True),
    'dvl_turn': Size(1.0, 90.0, signed=True),
    'depth_value': OneOf((-100.0, 1.0, 10.0, 1000.0, 1e160)),
    'depth_variance': OneOf((5e-324, 1e-12, 1.0, 1e308)),
    'thrust_absurd': Size(10.0, 1e6, signed=True),
    'clock_step': Size(0.05, 1e5, signed=True),
    'packet_flipped': _LENGTH,
    'packet_indefinite': _COUNT,
    'packet_jump': Size(5.0, 1e5),
    'packet_displaced': Size(5.0, 1e4),
    'packet_drift': Size(0.05, 10.0),
    'packet_replayed': _COUNT,
    'packet_burnt': OneOf((10.0, 100.0, 600.0)),
    'packet_sigma': Size(1e-3, 1e5, most=1.3e4),  # a packet holds no larger one
}
"""What the size of a fault is drawn from; one that is not here has none, or that of its stream."""
_OF_A_STATION = {'packet_jump': Size(5.0, 2e3), 'packet_displaced': Size(5.0, 2e3)}
"""A packet of a station holds a place within 3 km."""


def _size_of(fault: Fault, mode: str) -> Size | OneOf | None:
    """What the size of a fault is drawn from in a mode; None for one without a size."""
    if not fault.unit:
        return None
    if mode == STATION and fault.name in _OF_A_STATION:
        return _OF_A_STATION[fault.name]
    return _SIZES.get(fault.name) or _OF_EVERY_STREAM[fault.name.partition('_')[2]]


@dataclass(frozen=True)
class _Draw:
    """What rows are drawn from.

    Attributes
    ----------
    scenes : mapping of str to Scene
    mode : str
        Mode of the engine.
    without : tuple of str
        Streams that there are not.
    """

    scenes: Mapping[str, Scene]
    mode: str
    without: Sequence[str] = ()

    def row(self, prefix: str, number: int) -> Row:
        rng = np.random.default_rng(number)
        name = OneOf(tuple(self.scenes)).draw(rng)
        injections = [self._injection(rng, START_S)]
        if rng.random() < _TWO:
            injections.append(self._injection(rng, START_S + _LATER_S.draw(rng)))
        texts = ' '.join(one.text for one in injections)
        return Row(f'{prefix}{number} {texts} ({name})', tuple(injections), self.scenes[name])

    def _injection(self, rng: np.random.Generator, at_s: float) -> Injection:
        known = [
            fault
            for fault in FAULTS.values()
            if self.mode in fault.modes and not set(fault.streams) <= set(self.without)
        ]
        fault = known[int(rng.integers(len(known)))]
        of = _size_of(fault, self.mode)
        # As rounded as it is said, so that `./polar inject` makes the same.
        size = fault.size if of is None else float(f'{of.draw(rng):.3g}')
        return Injection(fault, size, at_s)


_DRAWS = {
    'random:': _Draw(
        {
            'straight': inertial(),
            'racetrack': inertial(mission='racetrack'),
            'lawnmower': inertial(mission='lawnmower'),
            'dive': inertial(mission='dive'),
            'tactical': replace(TACTICAL, world=replace(TACTICAL.world, duration_s=DURATION_S)),
        },
        SINS,
    ),
    'random-no-dvl:': _Draw(
        {
            'straight': inertial(dvl_rate_hz=0.0),
            'racetrack': inertial(mission='racetrack', dvl_rate_hz=0.0),
        },
        SINS,
        ('dvl',),
    ),
    'random-station:': _Draw({'station': station()}, STATION),
}
PREFIXES = tuple(_DRAWS)
"""Before a number, or two with a dash between, in the name of a row."""


def random_row(prefix: str, number: int) -> Row:
    """Return the row of a number, the same wherever it is drawn."""
    return _DRAWS[prefix].row(prefix, number)
