"""Tracks of whole runs in both modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TypeVar

import numpy as np

from .. import nav_columns
from ..arrays import Array
from .inputs import Stamps
from .lever import Rates, Rows
from .outputs import ModelEstimate
from .params import EngineParams
from .station.filter import model_of


@dataclass(frozen=True)
class Track:
    """Estimates of a run, one row each.

    Attributes
    ----------
    stamps_ns : (k,) array
    r_e, v_G : (k, 3) arrays
        Position, ECEF [m]; velocity, grid axes [m/s].
    C_b_G : (k, 3, 3) array
    P : (k, 24, 24) array
        Covariance of the error state, or of its leading states where no more is asked for; without
        rows where only `derived` is.
    sensor_errors : (k, 15) array
        Gyro bias, accelerometer bias, DVL scale, DVL Markov velocity, USBL bias as estimated.
    local_statistics : (k, 2, 3) array
        Of DVL and depth since the row before: used, gated, sum of NIS (outputs.LOCAL_DOF).
    fixes : (k, 3) array
        Fixes received, fixes fused, newest validity [ns].
    model : (k, 31) array
        Of vehicle and water; `filter.aiding.estimate_of` names what stands in a row. Without the
        vehicle's model, (k, 0).
    derived : (k, nav_columns.WIDTH) array
        Columns derived from state and covariance (`nav_columns`), in place of P; without rows
        unless asked for.
    """

    stamps_ns: Stamps
    r_e: Array
    v_G: Array
    C_b_G: Array
    P: Array
    sensor_errors: Array
    local_statistics: Array
    fixes: Stamps
    model: Array = field(default_factory=lambda: np.zeros((0, 0)))
    derived: Array = field(default_factory=lambda: np.zeros((0, nav_columns.WIDTH)))

    def at_base_link(self, lever_b: Array, rates: Rates, gyro_noise_density: float) -> Track:
        """Estimates of base_link from those of the IMU's point, with their covariance.

        Parameters
        ----------
        lever_b : (3,) array
            IMU from base_link [m].
        rates : Rates
            With the estimates' stamps among its own.
        gyro_noise_density : float
            [rad/s/sqrt(Hz)]
        """
        rows = Rows.of(self.r_e, self.v_G, self.P)
        rate, bias_b = rates.at(self.stamps_ns), self.sensor_errors[:, 0:3]
        rows.move(lever_b, gyro_noise_density, rate, bias_b, self.C_b_G)
        return replace(self, r_e=rows.r_e, v_G=rows.v_G, P=rows.P)


@dataclass(frozen=True)
class StationTrack:
    """Estimates of a run in station mode, one row each.

    Attributes
    ----------
    stamps_ns : (k,) array
    r_e, v_G : (k, 3) arrays
        Position, ECEF [m]; velocity, grid axes [m/s].
    C_b_G : (k, 3, 3) array
    P : (k, 9, 9) array
        Covariance of attitude, velocity and position errors.
    x, P_x : (k, 12), (k, 12, 12) arrays
        State of kernels.station.state and its covariance.
    walk : (k,) array
        Density q_c in use [m^2/s^3].
    weight : (k, B) array
        Of the bank's members.
    local_statistics : (k, 2, 3) array
        Of DVL and depth since the row before, as in `Track`.
    fixes : (k, 3) array
        Fixes received, fixes fused, newest validity [ns].
    """

    stamps_ns: Stamps
    r_e: Array
    v_G: Array
    C_b_G: Array
    P: Array
    x: Array
    P_x: Array
    walk: Array
    weight: Array
    local_statistics: Array
    fixes: Stamps

    def model(self, k: int, params: EngineParams) -> ModelEstimate:
        """Estimated drag and current of row k."""
        return model_of(self.x[k], self.P_x[k], float(self.walk[k]), params.model_speed)


T = TypeVar('T', bound=Track | StationTrack)


def copied(track: T) -> T:
    """The same track, which shares no memory with it."""
    return type(track)(**{f.name: getattr(track, f.name).copy() for f in fields(track)})


def in_one_piece(track: T) -> T:
    """The same track with each column contiguous; those that are so are no copies."""
    columns = {f.name: np.ascontiguousarray(getattr(track, f.name)) for f in fields(track)}
    return type(track)(**columns)


def joined(tracks: Sequence[T]) -> T:
    """One track of several of the same kind, one after the other."""
    names = [f.name for f in fields(tracks[0])]
    return type(tracks[0])(**{n: np.concatenate([getattr(t, n) for t in tracks]) for n in names})
