"""Messages that no filter state can use: one by one with a reason, or as masks of columns."""

from __future__ import annotations

import math
from itertools import chain
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from .events import ControlSample, DepthSample, DvlPing, Fix, ImuSample, Verdict
from .inputs import Stamps
from .params import EngineParams

Refusal: TypeAlias = tuple[Verdict, str]
Bools: TypeAlias = NDArray[np.bool_]

# Each rule stands here twice, for one event and for the columns of a whole run; a test compares
# the two.


def unusable_local(
    params: EngineParams,
    event: ImuSample | ControlSample | DvlPing | DepthSample,
    last_imu_ns: int | None,
) -> Refusal | None:
    """Verdict and reason if a local message cannot be used; None if it can.

    A DVL ping without bottom lock is no fault.
    """
    if isinstance(event, ImuSample):
        return _unusable_imu(params, event, last_imu_ns)
    if isinstance(event, ControlSample):
        return _unusable_control(params, event)
    if isinstance(event, DvlPing):
        return _unusable_dvl(event)
    return _unusable_depth(event)


def _unusable_imu(params: EngineParams, sample: ImuSample, last_ns: int | None) -> Refusal | None:
    if not (np.isfinite(sample.omega_ib_b).all() and np.isfinite(sample.f_b).all()):
        return Verdict.NOT_FINITE, 'rate or specific force is not finite'
    C_b_G = sample.C_b_G
    if params.mode == 'station' and (C_b_G is None or not np.isfinite(C_b_G).all()):
        return Verdict.NOT_FINITE, 'no attitude, which station mode needs (an AHRS)'
    if sample.stamp_ns == last_ns:
        return Verdict.DUPLICATE, 'there was an IMU sample with this stamp before'
    return None


def usable_imu(stamps_ns: Stamps, omega_ib_b: Array, other: Array) -> Bools:
    """Mask (n,) of usable IMU samples: finite, and the first finite one of its stamp.

    Parameters
    ----------
    stamps_ns : (n,) array
        In order.
    omega_ib_b : (n, 3) array
    other : (n, 3) or (n, 3, 3) array
        What the mode needs besides: specific force, or the attitude in station mode.
    """
    usable = _finite(omega_ib_b) & _finite(other)
    good = np.flatnonzero(usable)
    usable[good[1:][np.diff(stamps_ns[good]) == 0]] = False
    return usable


def _unusable_control(params: EngineParams, sample: ControlSample) -> Refusal | None:
    if not (np.isfinite(sample.force_b).all() and np.isfinite(sample.torque_b).all()):
        return Verdict.NOT_FINITE, 'force or torque is not finite'
    largest = float(np.abs(sample.force_b).max())
    if largest > params.thrust_limit_n:
        limit = f'thrust_limit_n is {params.thrust_limit_n:g} N'
        return Verdict.IMPLAUSIBLE, f'a force of {largest:.4g} N, {limit}'
    return None


def usable_control(params: EngineParams, force_b: Array, torque_b: Array | None = None) -> Bools:
    """Mask (n,) of usable thrusts: force (n, 3) within its limit, torque (n, 3) finite if any."""
    good = np.asarray((np.abs(force_b) <= params.thrust_limit_n).all(axis=1))
    return good if torque_b is None else good & _finite(torque_b)


def _unusable_dvl(ping: DvlPing) -> Refusal | None:
    if not ping.valid or (
        np.isfinite(ping.v_m).all()
        and np.isfinite(ping.covariance_m).all()
        and (np.diagonal(ping.covariance_m) > 0.0).all()
    ):
        return None
    return Verdict.NOT_FINITE, 'dvl or its covariance is not finite and positive'


def usable_dvl(valid: Bools, v_m: Array, covariance_m: Array) -> Bools:
    """Mask (n,) of pings that are not faulty; one without bottom lock is not."""
    variances = np.diagonal(covariance_m, axis1=1, axis2=2)
    good = _finite(v_m) & _finite(covariance_m) & (variances > 0.0).all(axis=1)
    return np.asarray(~valid | good)


def _unusable_depth(sample: DepthSample) -> Refusal | None:
    if np.isfinite(sample.depth) and np.isfinite(sample.variance) and sample.variance > 0.0:
        return None
    return Verdict.NOT_FINITE, 'depth or its covariance is not finite and positive'


def usable_depth(depth: Array, variance: Array) -> Bools:
    """Mask (n,) of usable depths: finite, with a positive variance."""
    return np.asarray(np.isfinite(depth) & np.isfinite(variance) & (variance > 0.0))


def _finite(values: Array) -> Bools:
    """Mask (n,) of the rows of a (n, ...) array that are finite."""
    with np.errstate(over='ignore', invalid='ignore'):
        total = np.sum(values)
    if np.isfinite(total):  # nearly always, and many times as fast as row by row
        return np.ones(len(values), dtype=bool)
    return np.asarray(np.isfinite(values.reshape(len(values), -1)).all(axis=1))


def unusable_fix(params: EngineParams, fix: Fix) -> Refusal | None:
    """Verdict and reason if a fix cannot be used in this mode; None if it can."""
    if fix.refusal is not None:
        return fix.refusal, fix.reason
    if params.mode == 'station':
        return _unusable_polar(fix)
    # As lists: NumPy takes ten times as long for so few numbers.
    covariance_e = fix.covariance_e.tolist()
    if not all(map(math.isfinite, chain(fix.r_e.tolist(), *covariance_e))):
        return Verdict.NOT_FINITE, 'position or covariance is not finite'
    if not all(row[i] > 0.0 for i, row in enumerate(covariance_e)):
        return Verdict.NOT_FINITE, 'a variance of the position is not positive'
    if params.usbl_bias_sigma > 0.0 and not np.isfinite(fix.array_heading):
        return Verdict.NOT_FINITE, 'no heading of the array, which usbl_bias_sigma needs'
    return None


def _unusable_polar(fix: Fix) -> Refusal | None:
    polar = fix.polar
    if polar is None:
        return Verdict.BAD_FORMAT, 'no range and bearing, which station mode needs'
    values = [*polar.station, polar.station_heading, polar.range, polar.bearing]
    if not np.isfinite(values).all():
        return Verdict.NOT_FINITE, "range, bearing or the station's pose is not finite"
    if not polar.range > 0.0:
        return Verdict.NOT_FINITE, f'a range of {polar.range} m'
    return None
