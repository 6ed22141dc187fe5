"""Identification of drag and current from a recorded bag, for `./polar identify`.

In: a bag with a vehicle's AHRS, thrust and depth, and the packets of a hydroacoustic station. Out:
`Identified`, the identification with the truth beside it where the bag has one. The packets are
read as follower_node reads them, and the identification is the engine's own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np

from polar_nav_core.engine.events import Fix
from polar_nav_core.identification.identifier import Identifier, identify
from polar_nav_core.identification.params import METHODS, IdentificationParams
from polar_nav_core.identification.result import Identification
from polar_nav_core.identification.triggers import OFFLINE
from polar_nav_core.identification.window import Window, position_fix
from polar_nav_core.params import from_mapping
from polar_nav_follower.measurements.station_fix import StationNumbers, station_fix_from_packet
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import AcousticPacket
from polar_nav_ros.readers import attitudes
from polar_nav_ros.stamps import to_ns
from polar_nav_ros.topics import AHRS, CONTROL, DEPTH, RX, TRUE_MODEL

from ..bags import arrays
from ..bags.errors import BagError, WrongRequestError
from ..bags.reader import Bag
from ..bags.tables import read_tables
from ..replay.described import NOTHING_DESCRIBED, descriptions_of
from ..replay.recorded import decoded
from ..scoring import Column, Table
from ..scoring.json_values import record
from ..series.vehicle import Floats

UNITS = {
    'drag_linear': 'N s/m',
    'drag_quadratic': 'N s²/m²',
    'current_x': 'm/s',
    'current_y': 'm/s',
    'start_x': 'm',
    'start_y': 'm',
    'heading_bias': 'rad',
}
_STAMP = arrays.STAMP[0]
_QUATERNION = tuple(f'orientation.{axis}' for axis in 'xyzw')
_RATE, _SURGE = 'angular_velocity.z', 'wrench.force.x'
_FIELDS = {
    AHRS: (arrays.STAMP, _QUATERNION, _RATE, 'orientation_covariance'),
    CONTROL: (arrays.STAMP, _SURGE),
    DEPTH: (arrays.STAMP, 'depth'),
}
_TRUTH_FIELDS = (arrays.STAMP, 'drag_linear', 'drag_quadratic', 'current_g', 'heading_bias')

Progress = Callable[[float], None]
P = TypeVar('P')


@dataclass(frozen=True)
class Material:
    """Input of an identification: a window, numbers of its packets and of those with a fix."""

    window: Window | None
    packets: int
    readable: int


@dataclass(frozen=True)
class Identified:
    """One identification of a bag.

    Attributes
    ----------
    vehicle : str
    result : Identification
    packets, readable : int
        Packets received until then, and those that hold a fix of this station for this vehicle.
    truth : mapping of str to float
        True values by name, means over the window; only those in the bag.
    notes : tuple of str
        Sentences about shortcomings of the data.
    """

    vehicle: str
    result: Identification
    packets: int
    readable: int
    truth: Mapping[str, float]
    notes: tuple[str, ...]

    def table(self) -> Table:
        """Table of the parameters with sigma and truth, a row each."""
        r = self.result
        sigmas = np.sqrt(np.diag(r.covariance))
        rows = []
        for name, value, sigma in zip(r.names, r.values.tolist(), sigmas.tolist(), strict=True):
            row: dict[str, object] = {'name': name, 'unit': UNITS[name]}
            row |= {'value': value, 'sigma': sigma}
            if name in self.truth:
                error = value - self.truth[name]
                row |= {'truth': self.truth[name], 'error': error, 'ratio': error / sigma}
            rows.append(row)
        columns = [
            Column('name', 'parameter'),
            Column('value', 'value', digits=4),
            Column('sigma', '1-sigma', digits=2),
        ]
        if self.truth:
            columns += [
                Column('truth', 'truth', digits=4),
                Column('error', 'error', digits=2),
                Column('ratio', 'error / sigma', digits=2),
            ]
        columns.append(Column('unit', 'unit'))
        return Table(f'{self.vehicle}, method {r.method}', tuple(columns), tuple(rows))

    def to_dict(self) -> dict[str, object]:
        """Identification as values for JSON."""
        r = self.result
        return record(
            {
                'vehicle': self.vehicle,
                'method': r.method,
                'verdict': r.verdict.name,
                'reason': r.reason,
                'packets': self.packets,
                'readable': self.readable,
                'fixes': r.fixes,
                'first_validity_ns': r.first_validity_ns,
                'last_validity_ns': r.last_validity_ns,
                'values': dict(zip(r.names, r.values.tolist(), strict=True)),
                'sigmas': dict(zip(r.names, np.sqrt(np.diag(r.covariance)).tolist(), strict=True)),
                'covariance': r.covariance,
                'condition_number': r.condition_number,
                'cost': r.cost,
                'iterations': r.iterations,
                'truth': dict(self.truth),
                'notes': list(self.notes),
            }
        )


class RecordedRun:
    """Data of a bag for identifications of one vehicle.

    Parameters
    ----------
    bag : Bag
    vehicle : str, optional
        Which one, when there are several.
    changes : mapping, optional
        Parameters (``identify_*``, ``model_*``, ``station_*``) instead of the recorded ones.
    progress : callable, optional
        Called with the share of the bag that was read.

    Raises
    ------
    BagError
        When there is no such vehicle, or a topic is missing or holds nothing that could be used.
    ConfigError
        For a parameter that there is not, or a value out of range.
    """

    def __init__(
        self,
        bag: Bag,
        vehicle: str | None = None,
        changes: Mapping[str, Any] | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.bag = bag
        self.vehicle = choose_vehicle(bag, vehicle)
        described = descriptions_of(bag).get(self.vehicle, NOTHING_DESCRIBED)
        stated = described.params | dict(changes or {})
        self.params = _known(IdentificationParams, stated)
        self._follower = _known(FollowerParams, stated)
        self._stated = described.stated | set(changes or {})
        self.notes: list[str] = []
        topics = {name: f'/{self.vehicle}/{name}' for name in (*_FIELDS, RX, TRUE_MODEL)}
        bag.require([topics[name] for name in (*_FIELDS, RX)])
        wanted: dict[str, Any] = {topics[name]: columns for name, columns in _FIELDS.items()}
        if topics[TRUE_MODEL] in bag.topics:
            wanted[topics[TRUE_MODEL]] = _TRUTH_FIELDS
        tables = read_tables(bag, wanted, [topics[RX]], progress=progress)
        self._columns = {name: tables.columns[topics[name]] for name in _FIELDS}
        self._truth = tables.columns.get(topics[TRUE_MODEL])
        self._messages = tables.payloads[topics[RX]]
        self._fixes = self._read_packets(topics[RX])
        self.start_ns = int(self._columns[AHRS][_STAMP][0])

    def material(self, *, fixes: int | None = None, until_s: float | None = None) -> Material:
        """Input of an identification at a time of the run.

        Parameters
        ----------
        fixes : int, optional
            Largest number of fixes, the newest ones; by default that of the parameter.
        until_s : float, optional
            Seconds after the first AHRS message; by default the end.
        """
        params = self.params
        if fixes is not None:
            least = min(params.identify_least_fixes, fixes)
            params = replace(params, identify_fixes=fixes, identify_least_fixes=least)
        end = np.iinfo(np.int64).max
        if until_s is not None:
            end = self.start_ns + round(until_s * 1e9)
        identifier = Identifier(params)
        self._feed_log(identifier, int(end))
        depth = self._columns[DEPTH]
        when = depth[_STAMP]
        received = [f for f in self._fixes if f.receive_ns <= end]
        for fix in received:
            if fix.polar is None:
                continue
            there = int(np.searchsorted(when, fix.validity_ns, side='right')) - 1
            z = self._height_above_station(float(depth['depth'][max(there, 0)]))
            identifier.add_fix(position_fix(fix.validity_ns, fix.polar, z))
        readable = sum(f.polar is not None for f in received)
        return Material(identifier.window(), len(received), readable)

    def identified(self, material: Material, method: str) -> Identified:
        """Identification by one of `METHODS`."""
        if method not in METHODS:
            raise ValueError(f'method {method!r} is none of {", ".join(METHODS)}')
        window = material.window
        stamp_ns = 0 if window is None else int(window.validity_ns[-1])
        result = identify(window, self.params, stamp_ns=stamp_ns, trigger=OFFLINE, method=method)
        return Identified(
            self.vehicle,
            result,
            material.packets,
            material.readable,
            self._true_values(result),
            tuple(self.notes),
        )

    def _read_packets(self, topic: str) -> list[Fix]:
        """Fixes of the packets in the order of the bag, or the reason for none."""
        numbers = StationNumbers()
        out = []
        for arrival, data in enumerate(self._messages):
            m = decoded(self.bag, topic, data, AcousticPacket)
            fix, _ = station_fix_from_packet(
                bytes(m.data),
                m.source,
                m.sequence,
                arrival,
                to_ns(m.transmit_time),
                to_ns(m.receive_time),
                self._follower,
                numbers,
            )
            out.append(fix)
        if all(f.polar is None for f in out):
            raise BagError(
                f'{self.bag.path}: none of {len(out)} packets on {topic} holds a fix of a station '
                f'for this vehicle; the first: {out[0].reason}'
            )
        return out

    def _feed_log(self, identifier: Identifier, end_ns: int) -> None:
        ahrs = self._columns[AHRS]
        C_b_G = attitudes(ahrs[_QUATERNION[0]], ahrs['orientation_covariance'][:, 0])
        psi = np.arctan2(C_b_G[:, 1, 0], C_b_G[:, 0, 0])
        pitch = -np.arcsin(np.clip(C_b_G[:, 2, 0], -1.0, 1.0))
        if not np.isfinite(psi).any():
            raise BagError(
                f'{self.bag.path}: no message on /{self.vehicle}/{AHRS} has an orientation; '
                'imu_node gives one with its parameter ahrs'
            )
        for values in _rows(end_ns, ahrs[_STAMP], psi, pitch, ahrs[_RATE]):
            identifier.add_heading(*values)
        thrust = self._columns[CONTROL]
        for stamp_ns, force in _rows(end_ns, thrust[_STAMP], thrust[_SURGE]):
            identifier.add_control(stamp_ns, np.array([force, 0.0, 0.0]))

    def _height_above_station(self, depth: float) -> float:
        """Height of the vehicle in the station frame [m]; NaN where the station's is not known."""
        if 'station_height' not in self._stated:
            note = 'station_height is not known: slant ranges are treated as horizontal'
            if note not in self.notes:
                self.notes.append(note)
            return float('nan')
        return float(self._follower.sea_surface_height) - depth - self._follower.station_height

    def _true_values(self, result: Identification) -> dict[str, float]:
        """Means of ``truth/model`` over the window, by the names of the parameters."""
        truth = self._truth
        if truth is None or not result.fixes:
            return {}
        when = truth[_STAMP]
        inside = (when >= result.first_validity_ns) & (when <= result.last_validity_ns)
        if not inside.any():
            return {}
        out = {
            name: float(np.mean(truth[name][inside]))
            for name in ('drag_linear', 'drag_quadratic', 'heading_bias')
        }
        current: Floats = np.mean(truth['current_g'][inside], axis=0)
        out |= {'current_x': float(current[0]), 'current_y': float(current[1])}
        return {name: out[name] for name in result.names if name in out}


def choose_vehicle(bag: Bag, vehicle: str | None) -> str:
    """Vehicle to identify: the one named, or the only one with an AHRS.

    Raises
    ------
    BagError
        When there is none, or several and none was named.
    """
    ending = f'/{AHRS}'
    found = sorted(t.removesuffix(ending).strip('/') for t in bag.topics if t.endswith(ending))
    if vehicle is not None:
        return vehicle
    if len(found) == 1:
        return found[0]
    if not found:
        raise BagError(
            f'{bag.path} has no topic <vehicle>/{AHRS}: identification needs the attitude of an '
            f'AHRS, the thrust on <vehicle>/{CONTROL} and the fixes of a station; record a '
            'mission with one, as `./polar demo --mission station` does'
        )
    raise WrongRequestError(
        f'{bag.path} has several vehicles ({", ".join(found)}): name one with --vehicle'
    )


def _known(cls: type[P], stated: Mapping[str, Any]) -> P:
    """Parameters of a class from those that the bag and the user state; others are left out."""
    names = {f.name for f in fields(cls)}  # type: ignore[arg-type]
    return from_mapping(cls, {name: value for name, value in stated.items() if name in names})


def _rows(end_ns: int, stamps: Any, *columns: Any) -> Any:  # noqa: ANN401 - columns of a bag
    """Rows of columns up to a stamp, in the order of their stamps, as plain numbers."""
    order = np.argsort(stamps, kind='stable')
    order = order[stamps[order] <= end_ns]
    return zip(*(column[order].tolist() for column in (stamps, *columns)), strict=True)
