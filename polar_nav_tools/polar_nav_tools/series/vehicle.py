"""Series of one vehicle as arrays, from a bag or a replay: input of scoring and report.

Made by `polar_nav_tools.bags.arrays` (a bag) or a replay (bytes of `nav/state` and `nav/receipt`),
read by score and report. Only data, no file, no ROS.

Axes: e is ECEF, G the grid frame at the vehicle (x grid east, y grid north, z up), b the body
(x forward, y left, z up). `C_b_G` maps b components to G. Stamps are integer nanoseconds, times
of validity (`header.stamp`); rows are in the order of the messages in the bag, which
for both topics is the order of their stamps in a sound bag.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self, overload

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import spilled
from polar_nav_core.level import NO_HEIGHT
from polar_nav_ros import receipt_fields

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_ROWS = 3
"""Rows of a position."""


class Series:
    """Rows of equal number in every array of a dataclass."""

    stamp_ns: Ints

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.stamp_ns)

    def rows(self, index: NDArray[np.intp] | NDArray[np.bool_] | slice) -> Self:
        """Return the samples that `index` selects (a slice, a mask or row numbers)."""
        chosen = {}
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            chosen[f.name] = _selected(value, index) if isinstance(value, np.ndarray) else value
        return type(self)(**chosen)

    def in_order(self) -> Self:
        """Return the samples by stamp; those of one stamp keep their order."""
        if spilled.ascending(self.stamp_ns):
            return self  # not a copy: half a day of estimates is large
        return self.rows(np.argsort(self.stamp_ns, kind='stable'))

    def between(self, start_ns: int, stop_ns: int) -> Self:
        """Return the samples with ``start_ns <= stamp_ns < stop_ns``."""
        return self.rows((self.stamp_ns >= start_ns) & (self.stamp_ns < stop_ns))


def _selected(
    values: NDArray[Any], index: NDArray[np.intp] | NDArray[np.bool_] | slice
) -> NDArray[Any]:
    """Rows of a column that `index` selects; of a slice a view, else copies."""
    if isinstance(index, slice):
        return values[index]
    rows = np.flatnonzero(index) if index.dtype == bool else index.astype(np.intp, copy=False)
    return spilled.chosen(values, rows)


@dataclass(frozen=True, eq=False)
class TruthSeries(Series):
    """`<vehicle>/truth` (polar_nav_msgs/VehicleTruth), N samples.

    Attributes
    ----------
    vehicle : str
        Namespace without slashes, e.g. ``follower``.
    stamp_ns : ndarray of int64, shape (N,)
        Time of validity [ns].
    sequence : ndarray of int64, shape (N,)
        Counts samples of this vehicle from 0; a gap is a lost message.
    r_e : ndarray, shape (N, 3)
        Position of base_link, ECEF [m].
    latitude, longitude, height : ndarray, shape (N,)
        Geodetic [rad, rad, m above the ellipsoid]; longitude means nothing exactly at a pole.
    depth, altitude : ndarray, shape (N,)
        Below the sea surface, positive down [m]; above the sea floor [m], NaN where unknown.
    v_G : ndarray, shape (N, 3)
        Velocity over ground, grid axes [m/s].
    C_b_G : ndarray, shape (N, 3, 3)
        Attitude, body to grid.
    omega_ib_b, f_b : ndarray, shape (N, 3)
        Angular rate against inertial space [rad/s] and specific force [m/s^2], body axes.
    current_G : ndarray, shape (N, 3)
        Water velocity over ground, grid axes [m/s].
    """

    vehicle: str
    stamp_ns: Ints
    sequence: Ints
    r_e: Floats
    latitude: Floats
    longitude: Floats
    height: Floats
    depth: Floats
    altitude: Floats
    v_G: Floats
    C_b_G: Floats
    omega_ib_b: Floats
    f_b: Floats
    current_G: Floats


SENSOR_ERRORS = ('gyro_bias_b', 'accel_bias_b', 'dvl_scale_m', 'dvl_markov_m', 'usbl_bias_a')
"""Estimated sensor errors of an `EstimateSeries`, in the order of the filter's state."""
SENSOR_SIGMAS = tuple(f'{name.rpartition("_")[0]}_sigma' for name in SENSOR_ERRORS)
"""Their 1-sigma."""


@dataclass(frozen=True, eq=False)
class EstimateSeries(Series):
    """`<vehicle>/nav/state` (polar_nav_msgs/NavState), N samples.

    Covariances are of the estimate's error, grid axes, as published: ``P_attitude_G`` is that of
    phi_G in ``Chat = exp(-[phi x]) C``. A ``sigma`` is one standard deviation. Nothing is filled
    in: a number that the filter did not have is NaN, as in the message.

    Attributes
    ----------
    vehicle : str
        Namespace without slashes.
    configuration : str
        Filter configuration of the first sample; `configurations` has all of them.
    configurations : tuple of str
        Distinct ones in order of first use. More than one: the bag mixes runs.
    stamp_ns : ndarray of int64, shape (N,)
        Time of validity [ns].
    status : ndarray of uint8, shape (N,)
        NavState.STATUS_*: 1 navigating, 2 diverged (numbers are NaN).
    r_e : ndarray, shape (N, 3)
        Position of base_link, ECEF [m].
    latitude, longitude, height, depth : ndarray, shape (N,)
        [rad, rad, m above the ellipsoid, m below the sea surface].
    v_G : ndarray, shape (N, 3)
        Velocity over ground, grid axes at the estimate [m/s].
    C_b_G : ndarray, shape (N, 3, 3)
        Attitude, body to grid, from the published quaternion.
    roll, pitch, grid_heading, true_heading, true_heading_sigma, convergence : ndarray, shape (N,)
        As in NavState [rad].
    P_position_G, P_velocity_G, P_attitude_G : ndarray, shape (N, 3, 3)
        [m^2], [(m/s)^2], [rad^2].
    gyro_bias_b, gyro_bias_sigma : ndarray, shape (N, 3)
        [rad/s].
    accel_bias_b, accel_bias_sigma : ndarray, shape (N, 3)
        [m/s^2].
    dvl_scale_m, dvl_scale_sigma : ndarray, shape (N, 3)
        [-].
    dvl_markov_m, dvl_markov_sigma : ndarray, shape (N, 3)
        [m/s].
    usbl_bias_a, usbl_bias_sigma : ndarray, shape (N, 3)
        [m].
    fixes_received, fixes_fused : ndarray of int64, shape (N,)
        Up to the stamp.
    age_of_last_fix : ndarray, shape (N,)
        Stamp minus validity of the newest fused fix [s]; NaN before the first.
    local_statistics : ndarray, shape (N, 2, 3)
        Of the DVL (row 0) and depth (row 1) measurements since the sample before: number used,
        number refused by the gate, sum of the NIS of those used. Zeros in a bag of a version that
        did not state.
    """

    vehicle: str
    configuration: str
    configurations: tuple[str, ...]
    stamp_ns: Ints
    status: NDArray[np.uint8]
    r_e: Floats
    latitude: Floats
    longitude: Floats
    height: Floats
    depth: Floats
    v_G: Floats
    C_b_G: Floats
    roll: Floats
    pitch: Floats
    grid_heading: Floats
    true_heading: Floats
    true_heading_sigma: Floats
    convergence: Floats
    P_position_G: Floats
    P_velocity_G: Floats
    P_attitude_G: Floats
    gyro_bias_b: Floats
    gyro_bias_sigma: Floats
    accel_bias_b: Floats
    accel_bias_sigma: Floats
    dvl_scale_m: Floats
    dvl_scale_sigma: Floats
    dvl_markov_m: Floats
    dvl_markov_sigma: Floats
    usbl_bias_a: Floats
    usbl_bias_sigma: Floats
    fixes_received: Ints
    fixes_fused: Ints
    age_of_last_fix: Floats
    local_statistics: Floats


@dataclass(frozen=True, slots=True)
class ReceiptRecord:
    """One `<vehicle>/nav/receipt` (polar_nav_msgs/FixReceipt).

    Beside the fields of the engine's `outputs.Receipt` it has those of the message only: age and
    name of the verdict. A time is None where the message has zero: unknown, or without such an
    event.

    Attributes
    ----------
    stamp_ns : int
        Stamp time of the decision [ns].
    verdict, verdict_text : int, str
        FixReceipt constant and its name (`FUSED`, `GATED`, ...).
    reason : str
        One sentence with the numbers that decided.
    topic, source, sequence : str, str, int
        Topic, sender and number of the message.
    revision : int
        0 at first; a replayed fix whose verdict changed has higher ones.
    validity_ns, transmit_ns, receive_ns, fused_ns : int or None
        Times of the fix [ns].
    age_s : float
        receive minus validity [s].
    delay_handling : str
        ignore, tagged, back_propagate, clone or rewind.
    steps_rolled_back : int
        Stored filter steps between validity and use.
    innovation_G, innovation_variance_G : ndarray, shape (3,)
        Measured minus predicted position [m] and its variance [m^2], grid axes; NaN if not
        computed.
    nis, degrees_of_freedom, gate : float, int, float
        Normalized innovation squared, its degrees of freedom, the threshold (inf: no gate). Of
        a fix without a height the degrees are two.
    """

    stamp_ns: int
    verdict: int
    verdict_text: str
    reason: str
    topic: str
    source: str
    sequence: int
    revision: int
    validity_ns: int | None
    transmit_ns: int | None
    receive_ns: int | None
    fused_ns: int | None
    age_s: float
    delay_handling: str
    steps_rolled_back: int
    innovation_G: Floats
    innovation_variance_G: Floats
    nis: float
    degrees_of_freedom: int
    gate: float

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> ReceiptRecord:
        """Record of a receipt from its values by name: those of the event and of its row."""
        found: dict[str, Any] = {n: values[n] or None for n in receipt_fields.TIMES}
        found |= {n: values[n] for n in (*receipt_fields.VALUES, *receipt_fields.AXES)}
        found |= {n: values[n] for n in ('stamp_ns', 'verdict', 'verdict_text', 'age_s')}
        return cls(degrees_of_freedom=found.pop('dof'), **found)

    def counted_by_variance(self) -> ReceiptRecord:
        """Receipt of an engine that counted three rows of every position (`DOF_STATED`).

        Its innovation has no better known height than its fix, so that its variance stands for
        what the fix stated. One of a vehicle that knows no height itself is taken for one of a
        fix without: nothing in the message tells them apart.
        """
        if self.degrees_of_freedom != _ROWS or not self.innovation_variance_G[2] > NO_HEIGHT:
            return self
        return replace(self, degrees_of_freedom=_ROWS - 1)

    @property
    def axes(self) -> NDArray[np.bool_]:
        """Whether the fix says something of grid east, north and up, shape (3,).

        A station does not measure the height, and a fix without one states that it does not.
        """
        known = np.isfinite(self.innovation_variance_G)
        # Beside the rows of a velocity, as the filters that are printed have them, three more.
        known[2] &= self.degrees_of_freedom % _ROWS != _ROWS - 1
        return np.asarray(known)

    @property
    def key(self) -> Key:
        """Identify the received message, the same in all its revisions.

        The reception time belongs to it: a duplicate has its original's source and sequence.
        """
        return (self.topic, self.source, self.sequence, self.receive_ns)


KEY = ('topic', 'source', 'sequence', 'receive_ns')
"""Fields of a receipt that `ReceiptRecord.key` has."""
Key = tuple[str, str, int, int | None]
"""Identity of a received message, as of `ReceiptRecord.key`."""


def last_revisions(receipts: Sequence[ReceiptRecord]) -> Sequence[ReceiptRecord]:
    """Return the last receipt of each message: the highest revision, in order of first receipt.

    Verdicts are counted from these.
    """
    places = last_places([(r.key, r.revision) for r in receipts])
    return receipts if len(places) == len(receipts) else _Chosen(receipts, places)


def last_places(keyed: Sequence[tuple[Key, int]]) -> Sequence[int]:
    """Places of the last receipt of each message, as `last_revisions`.

    Parameters
    ----------
    keyed : sequence of (tuple, int)
        Key and revision of each receipt.
    """
    revised = {key for key, revision in keyed if revision}
    if not revised:
        return range(len(keyed))
    places: list[int] = []  # of the last receipt of each message
    # Of each message that was revised: number above, revision, and how many first receipts.
    last: dict[Key, tuple[int, int, int]] = {}
    for place, (key, new) in enumerate(keyed):
        is_first = new == 0
        number, revision, firsts = last.get(key, (len(places), -1, 0))
        if is_first and firsts:
            # Two first receipts of one key are two messages (the same packet heard twice at one
            # instant); a revision belongs to the first of them, as only that one was used.
            places.append(place)
            continue
        if number == len(places):
            places.append(place)
        elif is_first or revision <= new:
            places[number] = place
        else:
            continue
        if key in revised:
            last[key] = (number, new, firsts + is_first)
    return places


class _Chosen(Sequence[ReceiptRecord]):
    """Some of the receipts, by their places."""

    def __init__(self, receipts: Sequence[ReceiptRecord], places: Sequence[int] | Ints) -> None:
        self._receipts, self._places = receipts, np.asarray(places, dtype=np.int64)

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, index: int) -> ReceiptRecord: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[ReceiptRecord]: ...

    def __getitem__(self, index: int | slice) -> ReceiptRecord | Sequence[ReceiptRecord]:
        if isinstance(index, slice):
            return _Chosen(self._receipts, self._places[index])
        return self._receipts[int(self._places[index])]
