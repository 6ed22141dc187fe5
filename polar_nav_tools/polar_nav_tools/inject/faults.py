"""The one table of faults: name, meaning, default size with its unit, and what it does.

Faults of messages change readings (`readings`): in a bag, or in a simulated run. Faults of files
change bytes (`files`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import meant

from . import common, packets
from .readings import (
    DEPTH,
    DVL,
    FIX,
    IMU,
    NS,
    STREAMS,
    THRUST,
    Apply,
    Reading,
    Readings,
    Setting,
)

_FORM = re.compile(r'(\w+)(?::([^@]+))?(?:@(.+))?')
SINS, STATION = 'sins', 'station'
_LEFT, _UP, _YAW = 1, 2, 2


@dataclass(frozen=True)
class Fault:
    """One kind of fault.

    Attributes
    ----------
    name, doc : str
    size : float
        Default.
    unit : str
        Of the size; empty for a fault without a size.
    streams : tuple of str
        Streams that it changes.
    apply : callable
    length_s : callable
        Its length [s] for a size; infinite for a fault that lasts.
    modes : tuple of str
        Modes of the engine that it is of.
    """

    name: str
    doc: str
    size: float
    unit: str
    streams: tuple[str, ...]
    apply: Apply
    length_s: Callable[[float], float]
    modes: tuple[str, ...] = (SINS, STATION)


@dataclass(frozen=True)
class Injection:
    """One fault with its size and its start, seconds since the first IMU message."""

    fault: Fault
    size: float
    at_s: float

    @property
    def text(self) -> str:
        """As on the command line."""
        size = f':{self.size:g}' if self.fault.unit else ''
        return f'{self.fault.name}{size}@{self.at_s:g}'

    def key_content(self) -> tuple[str, float, float]:
        """What it is, for the key of a task (tasks/keys.py): its functions follow from it."""
        return self.fault.name, self.size, self.at_s

    @property
    def end_s(self) -> float:
        """When it ends; infinite if it lasts [s]."""
        return self.at_s + self.fault.length_s(self.size)


def _at_once(size: float) -> float:
    del size
    return 0.0


def _for_its_size(size: float) -> float:
    return size


def _for_order(size: float) -> float:
    del size
    return common.ORDER_S


def _order_and_size(size: float) -> float:
    return common.ORDER_S + size


def _lasting(size: float) -> float:
    del size
    return math.inf


def _set(stream: str, name: str, scale: Any) -> Apply:  # noqa: ANN401 - numbers and arrays
    """One message whose value is the size times a number or an array."""
    return common.first(stream, lambda r, s: r.with_values(**{name: s.size * scale}))


def _covariance(matrix: Sequence[Sequence[float]]) -> Apply:
    value = np.array(matrix)
    return common.first(DVL, lambda r, s: r.with_values(covariance_m=s.size * value))


def _scaled(r: Reading, s: Setting) -> Reading:
    return r.with_values(v_m=r.values['v_m'] * (1.0 + s.size))


def _turned(r: Reading, s: Setting) -> Reading:
    c, k = math.cos(math.radians(s.size)), math.sin(math.radians(s.size))
    return r.with_values(
        v_m=np.array([[c, -k, 0.0], [k, c, 0.0], [0.0, 0.0, 1.0]]) @ r.values['v_m']
    )


def _yawed(r: Reading, s: Setting) -> Reading:
    return r.with_values(omega_ib_b=r.values['omega_ib_b'] + [0.0, 0.0, math.radians(s.size)])


def _in_degrees(readings: Readings, s: Setting) -> list[Reading]:
    """Rates in degrees per second, for ``size`` seconds."""

    def change(r: Reading, _: Setting) -> Reading:
        return r.with_values(omega_ib_b=np.degrees(r.values['omega_ib_b']))

    return common.changed(IMU, change, s.size)(readings, s)


def _without_lock(readings: Readings, s: Setting) -> list[Reading]:
    change = common.changed(DVL, lambda r, _: r.with_values(valid=False), s.size)
    return change(readings, s)


_ALL_MODES = {IMU: (SINS, STATION), FIX: (SINS, STATION), DEPTH: (SINS, STATION)}
_MODES = {**_ALL_MODES, DVL: (SINS,), THRUST: (STATION,)}
_WORDS = {
    IMU: 'the IMU',
    DVL: 'the DVL',
    DEPTH: 'the depth sensor',
    THRUST: 'thrust',
    FIX: 'packets',
}


def _of_every_stream(stream: str) -> list[Fault]:
    """Faults that every stream can have."""
    words, modes, one = _WORDS[stream], _MODES[stream], (stream,)
    rows: list[tuple[str, str, float, str, Apply, Callable[[float], float]]] = [
        ('silent', f'no messages of {words} for a time; inf: for good', 10.0, 's',
         common.silent(stream), _for_its_size),
        ('lost', f'{words}: a share of the messages of 20 s is lost', 0.5, '-',
         common.lost(stream), _for_order),
        ('repeated', f'{words}: every message of 20 s comes again so often', 1.0, '-',
         common.repeated(stream), _for_order),
        ('reordered', f'{words}: messages of 20 s come late by random times up to this', 0.3, 's',
         common.reordered(stream), _order_and_size),
        ('late', f'{words}: messages of 20 s come late by this', 5.0, 's',
         common.late(stream), _order_and_size),
        ('clock', f'{words}: the clock steps by this', 10.0, 's',
         common.clock(one), _lasting),
        ('clock_rate', f'{words}: the clock runs fast by this, slow where it is negative', 1000.0,
         'ppm', common.clock_rate(stream), _lasting),
    ]  # fmt: skip
    if stream != FIX:
        rows += [
            ('stuck', f'{words}: the last content again and again', 10.0, 's',
             common.stuck(stream), _for_its_size),
            ('ahead', f'{words}: one message is stamped ahead', 5.0, 's',
             common.ahead(stream, 1), _at_once),
            ('several_ahead', f'{words}: five messages are stamped ahead', 5.0, 's',
             common.ahead(stream, 5), _at_once),
            ('2038', f'{words}: one message is stamped 2^31 - 1 s', 0.0, '',
             common.end_of_time(stream, 1), _at_once),
            ('1970', f'{words}: one message is stamped 1 s', 0.0, '',
             common.begin_of_time(stream), _at_once),
            ('nan', f'{words}: so many messages are not numbers', 1.0, '-',
             common.not_a_number(stream), _at_once),
        ]  # fmt: skip
    return [
        Fault(f'{stream}_{n}', d, s, u, one, a, length, modes) for n, d, s, u, a, length in rows
    ]


_X = np.array([1.0, 0.0, 0.0])
_I = np.eye(3)
_OTHERS = (
    Fault('imu_several_2038', 'the IMU: five messages are stamped 2^31 - 1 s and after', 0.0, '',
          (IMU,), common.end_of_time(IMU, 5), _at_once),
    Fault('imu_force', 'the IMU: one absurd specific force', 1e6, 'm/s^2', (IMU,),
          _set(IMU, 'f_b', _X), _at_once, (SINS,)),
    Fault('imu_rate', 'the IMU: one absurd rate', 30.0, 'rad/s', (IMU,),
          _set(IMU, 'omega_ib_b', _X), _at_once),
    Fault('imu_swapped', 'the IMU: the rate about z has the wrong sign', 0.0, '', (IMU,),
          common.swapped(IMU, _YAW, 'omega_ib_b'), _lasting),
    Fault('imu_mirrored', 'the IMU: rate and force to port have the wrong sign', 0.0, '', (IMU,),
          common.swapped(IMU, _LEFT, 'omega_ib_b', 'f_b'), _lasting, (SINS,)),
    Fault('imu_gyro_stuck', 'the IMU: the last rate again and again, forces go on', 10.0, 's',
          (IMU,), common.stuck(IMU, 'omega_ib_b'), _for_its_size, (SINS,)),
    Fault('imu_accelerometer_stuck', 'the IMU: the last force again and again, rates go on', 10.0,
          's', (IMU,), common.stuck(IMU, 'f_b'), _for_its_size, (SINS,)),
    Fault('imu_gyro_axis_stuck', 'the IMU: the last rate about x again and again', 30.0, 's',
          (IMU,), common.stuck_axis(IMU, 'omega_ib_b', 0), _for_its_size, (SINS,)),
    Fault('imu_gyro_degrees', 'the IMU: rates in degrees for a time', 1.0, 's', (IMU,),
          _in_degrees, _for_its_size, (SINS,)),
    Fault('imu_yaw', 'the IMU: a turn about z within a second that never was', 20.0, 'deg',
          (IMU,), common.changed(IMU, _yawed, 1.0), lambda _: 1.0, (SINS,)),
    Fault('imu_gyro_step', 'the IMU: a bias of the gyros on every axis', 0.01, 'rad/s', (IMU,),
          common.added(IMU, 'omega_ib_b'), _lasting, (SINS,)),
    Fault('imu_accelerometer_step', 'the IMU: a bias of the accelerometers on every axis', 0.05,
          'm/s^2', (IMU,), common.added(IMU, 'f_b'), _lasting, (SINS,)),
    Fault('dvl_indefinite', 'the DVL: one covariance that is none', 1e-4, 'm^2/s^2', (DVL,),
          _covariance([[1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0]]), _at_once, (SINS,)),
    Fault('dvl_covariance', 'the DVL: one covariance, diagonal', 5e-324, 'm^2/s^2', (DVL,),
          _covariance(_I.tolist()), _at_once, (SINS,)),
    Fault('dvl_sigma', 'the DVL: this 1-sigma is stated for 20 s', 3e-6, 'm/s', (DVL,),
          common.changed(DVL, lambda r, s: r.with_values(covariance_m=s.size**2 * _I),
                         common.ORDER_S), _for_order, (SINS,)),
    Fault('dvl_velocity', 'the DVL: one absurd velocity', 1e300, 'm/s', (DVL,),
          _set(DVL, 'v_m', _X), _at_once, (SINS,)),
    Fault('dvl_outage', 'the DVL: no bottom lock for a time', 60.0, 's', (DVL,),
          _without_lock, _for_its_size, (SINS,)),
    Fault('dvl_scale', 'the DVL: velocities too long by a share', 0.05, '-', (DVL,),
          common.changed(DVL, _scaled, math.inf), _lasting, (SINS,)),
    Fault('dvl_turn', 'the DVL: turned about z', 3.0, 'deg', (DVL,),
          common.changed(DVL, _turned, math.inf), _lasting, (SINS,)),
    Fault('dvl_swapped', 'the DVL: the velocity to port has the wrong sign', 0.0, '', (DVL,),
          common.swapped(DVL, _LEFT, 'v_m'), _lasting, (SINS,)),
    Fault('depth_value', 'the depth sensor: one absurd depth', 1e160, 'm', (DEPTH,),
          _set(DEPTH, 'depth', 1.0), _at_once),
    Fault('depth_variance', 'the depth sensor: one absurd variance', 5e-324, 'm^2', (DEPTH,),
          _set(DEPTH, 'variance', 1.0), _at_once),
    Fault('depth_swapped', 'the depth sensor: the wrong sign', 0.0, '', (DEPTH,),
          common.swapped(DEPTH, None, 'depth'), _lasting),
    Fault('thrust_absurd', 'thrust: one absurd force', 1e6, 'N', (THRUST,),
          _set(THRUST, 'force_b', _X), _at_once, (STATION,)),
    Fault('thrust_swapped', 'thrust: the wrong sign ahead', 0.0, '', (THRUST,),
          common.swapped(THRUST, 0, 'force_b'), _lasting, (STATION,)),
    Fault('clock_step', 'the clock of all messages steps by this', 3600.0, 's', STREAMS,
          common.clock(STREAMS), _at_once),
    Fault('packet_flipped', 'packets: one bit of each is flipped (bad CRC)', 20.0, 's', (FIX,),
          packets.flipped, _for_its_size),
    Fault('packet_indefinite', 'packets: so many with a correlation of (1, 1, -1)', 1.0, '-',
          (FIX,), packets.indefinite, _at_once, (SINS,)),
    Fault('packet_jump', 'packets: one is off', 5000.0, 'm', (FIX,), packets.jump, _at_once),
    Fault('packet_displaced', 'packets: all are off', 500.0, 'm', (FIX,), packets.displaced,
          _lasting),
    Fault('packet_drift', 'packets: drift away', 0.05, 'm/s', (FIX,), packets.drift, _lasting),
    Fault('packet_replayed', 'packets: so many copies of each in 20 s, other numbers', 20.0, '-',
          (FIX,), packets.replayed, _for_order),
    Fault('packet_burnt', 'packets: forged ones use so many numbers', 600.0, '-', (FIX,),
          packets.burnt, lambda n: n * packets.FORGED_EVERY_S),
    Fault('packet_sigma', 'packets: this 1-sigma is stated for 20 s', 0.005, 'm', (FIX,),
          packets.stated_sigma, _for_order, (SINS,)),
)  # fmt: skip

FAULTS: dict[str, Fault] = {
    f.name: f for f in (*(f for stream in STREAMS for f in _of_every_stream(stream)), *_OTHERS)
}
"""Faults of messages by name."""


def parse(text: str) -> Injection:
    """Injection of a text as ``imu_silent:3@100``; ConfigError for any other."""
    match = _FORM.fullmatch(text)
    if match is None or match[1] not in FAULTS:
        asked = '' if match is None else meant(match[1], FAULTS)
        raise ConfigError(f'--fault {text}: no such fault; {asked}there are {", ".join(FAULTS)}')
    fault = FAULTS[match[1]]
    if match[2] is not None and not fault.unit:
        raise ConfigError(f'--fault {text}: {fault.name} has no size')
    if match[3] is None:
        raise ConfigError(f'--fault {text}: when? expected {fault.name}@SECONDS')
    size = fault.size if match[2] is None else _number(text, match[2])
    at_s = _number(text, match[3])
    if not 0.0 <= at_s < math.inf:
        raise ConfigError(f'--fault {text}: {match[3]} s is no time in a bag')
    return Injection(fault, size, at_s)


def _number(text: str, word: str) -> float:
    try:
        value = float(word)
    except ValueError as error:
        raise ConfigError(f'--fault {text}: {word!r} is not a number') from error
    if math.isnan(value):
        raise ConfigError(f'--fault {text}: {word!r} is not a number')
    return value


def inject(readings: Readings, injections: Sequence[Injection], seed: int) -> list[Reading]:
    """Readings with all faults, one after another: a pure function of its arguments.

    Parameters
    ----------
    readings : sequence of Reading
        In the order of arrival.
    injections : sequence of Injection
    seed : int
        Of what is drawn at random; each fault has its own stream.

    Raises
    ------
    ConfigError
        For a fault of a stream that there is not, or at a time after its end.
    """
    start_ns = min((r.true_ns for r in readings if r.stream == IMU), default=0)
    out = list(readings)
    for number, one in enumerate(injections):
        at_ns = start_ns + round(one.at_s * NS)
        if not any(r.stream in one.fault.streams and r.true_ns >= at_ns for r in readings):
            streams = ' or '.join(one.fault.streams)
            raise ConfigError(f'{one.text}: no message of {streams} from then on')
        rng = np.random.default_rng([seed, number])
        out = one.fault.apply(out, Setting(at_ns, one.size, rng))
    return out
