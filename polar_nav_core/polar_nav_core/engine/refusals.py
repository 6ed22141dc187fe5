"""Messages that no filter state can use: one by one with a reason, or as masks of columns."""

from __future__ import annotations

import math
from itertools import chain

import numpy as np

from .. import spilled
from ..arrays import Array, Bools
from ..kernels.limits import AXIS, EARTH
from .events import ControlSample, DepthSample, DvlPing, Fix, HeadingSample, ImuSample, Local
from .imu_sequence import refusals_in_columns
from .inputs import Stamps
from .params import EngineParams
from .plausibility import (
    LEAST_DEPTH,
    LEAST_VARIANCE,
    MOST_RANGE,
    MOST_VARIANCE,
    NO_GRID_NORTH,
    all_within,
    are_attitudes,
    are_covariances,
    is_attitude,
    is_covariance,
    is_variance,
    within,
)
from .verdicts import Refusal, Verdict

MOST_HEADING = 4.0 * math.pi
"""Largest size of a heading [rad]: two turns either way."""
_LENGTH = 1e-2
"""Largest departure of a direction's length from 1."""
# Each rule stands here twice, for one event and for the columns of a whole run; a test compares
# the two.


def unusable_local(
    params: EngineParams,
    event: ImuSample | ControlSample | Local,
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
        return _unusable_dvl(params, event)
    if isinstance(event, HeadingSample):
        return _unusable_heading(event)
    return _unusable_depth(params, event)


def _unusable_imu(params: EngineParams, sample: ImuSample, last_ns: int | None) -> Refusal | None:
    station = params.mode == 'station'
    if not (
        within(sample.omega_ib_b, params.max_rate)
        and (station or within(sample.f_b, params.max_specific_force))
    ):
        return _unusable_rate(params, sample)
    C_b_G = sample.C_b_G
    if station and not (C_b_G is not None and is_attitude(C_b_G)):
        if C_b_G is None or not np.isfinite(C_b_G).all():
            return Verdict.NOT_FINITE, 'no attitude, which station mode needs (an AHRS)'
        return Verdict.IMPLAUSIBLE, 'the attitude is no rotation'
    if sample.stamp_ns == last_ns:
        return Verdict.DUPLICATE, 'there was an IMU sample with this stamp before'
    return None


def _unusable_rate(params: EngineParams, sample: ImuSample) -> Refusal:
    """Verdict and reason of a sample whose rate or force is not within the limits."""
    rate, force = np.abs(sample.omega_ib_b).max(), np.abs(sample.f_b).max()
    if not (np.isfinite(rate) and (params.mode == 'station' or np.isfinite(force))):
        return Verdict.NOT_FINITE, 'rate or specific force is not finite'
    if rate > params.max_rate:
        return Verdict.IMPLAUSIBLE, f'{rate:.4g} rad/s, max_rate is {params.max_rate:g} rad/s'
    return (
        Verdict.IMPLAUSIBLE,
        f'{force:.4g} m/s^2, max_specific_force is {params.max_specific_force:g} m/s^2',
    )


def usable_imu(
    params: EngineParams, stamps_ns: Stamps, omega_ib_b: Array, other: Array
) -> tuple[Bools, dict[int, Refusal]]:
    """Mask (n,) of usable IMU samples, and by row what those before say against one.

    Usable is a sample within the limits, the first such one of its stamp, of an IMU that neither
    hangs nor leaps.

    Parameters
    ----------
    params : EngineParams
    stamps_ns : (n,) array
        In order.
    omega_ib_b : (n, 3) array
    other : (n, 3) or (n, 3, 3) array
        What the mode needs besides: specific force, or the attitude in station mode.
    """
    station = params.mode == 'station'

    def within(omega_ib_b: Array, other: Array) -> Bools:
        good = all_within(omega_ib_b, params.max_rate)
        good &= are_attitudes(other) if station else all_within(other, params.max_specific_force)
        return good

    usable = spilled.by_rows(within, omega_ib_b, other)
    refused: dict[int, Refusal] = {}
    if not station:
        refused = refusals_in_columns(params, stamps_ns, omega_ib_b, other, usable)
        usable[list(refused)] = False
    before_ns = stamps_ns[:0]  # stamp of the last one before a part
    for part in spilled.parts(len(stamps_ns)):
        good = part.start + np.flatnonzero(usable[part])
        found_ns = np.r_[before_ns, stamps_ns[good]]
        usable[good[len(good) - len(found_ns) + 1 :][np.diff(found_ns) == 0]] = False
        before_ns = found_ns[-1:]
    return usable, refused


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


def _unusable_dvl(params: EngineParams, ping: DvlPing) -> Refusal | None:
    if ping.water and not params.uses_water_track:
        return Verdict.NOT_READY, (
            'the velocity is relative to the water: no current is estimated to take it off '
            '(model_aiding, water_track_sigma), and it is no bottom lock'
        )
    if not (ping.valid or ping.water) or (
        within(ping.v_m, params.max_speed) and is_covariance(ping.covariance_m)
    ):
        return None
    if not (np.isfinite(ping.v_m).all() and np.isfinite(ping.covariance_m).all()):
        return Verdict.NOT_FINITE, 'velocity or its covariance is not finite'
    if not within(ping.v_m, params.max_speed):
        fastest = np.abs(ping.v_m).max()
        return Verdict.IMPLAUSIBLE, f'{fastest:.4g} m/s, max_speed is {params.max_speed:g} m/s'
    return _unusable_covariance('velocity', ping.covariance_m)


def usable_dvl(params: EngineParams, valid: Bools, v_m: Array, covariance_m: Array) -> Bools:
    """Mask (n,) of pings that are not faulty; one without bottom lock is not."""

    def good(valid: Bools, v_m: Array, covariance_m: Array) -> Bools:
        return ~valid | (all_within(v_m, params.max_speed) & are_covariances(covariance_m))

    return spilled.by_rows(good, valid, v_m, covariance_m)


def _unusable_covariance(name: str, P: Array) -> Refusal:
    """Verdict and reason of a finite matrix that is no covariance."""
    variances = np.diagonal(P)
    if not (variances > 0.0).all():
        return Verdict.NOT_FINITE, f'a variance of the {name} is not positive'
    if not ((variances >= LEAST_VARIANCE) & (variances <= MOST_VARIANCE)).all():
        extreme = variances.min() if variances.min() < LEAST_VARIANCE else variances.max()
        return Verdict.IMPLAUSIBLE, f'a variance of the {name} is {extreme:.4g}'
    return Verdict.NOT_FINITE, f'the covariance of the {name} is not positive definite'


def _unusable_depth(params: EngineParams, sample: DepthSample) -> Refusal | None:
    depth, variance = sample.depth, sample.variance
    if LEAST_DEPTH <= depth <= params.max_depth and is_variance(variance):
        return None
    if not (math.isfinite(depth) and math.isfinite(variance)):
        return Verdict.NOT_FINITE, 'depth or its variance is not finite'
    if not variance > 0.0:
        return Verdict.NOT_FINITE, 'the variance of the depth is not positive'
    if not is_variance(variance):
        return Verdict.IMPLAUSIBLE, f'a variance of the depth is {variance:.4g}'
    return Verdict.IMPLAUSIBLE, f'a depth of {depth:.4g} m, max_depth is {params.max_depth:g} m'


def usable_depth(params: EngineParams, depth: Array, variance: Array) -> Bools:
    """Mask (n,) of usable depths: within the limits, with a variance of usual size."""
    return np.asarray(
        (depth >= LEAST_DEPTH)
        & (depth <= params.max_depth)
        & (variance >= LEAST_VARIANCE)
        & (variance <= MOST_VARIANCE)
    )


def _unusable_heading(sample: HeadingSample) -> Refusal | None:
    if bool(usable_heading(np.array([sample.heading]), sample.up_b[None])[0]):
        return None
    if not math.isfinite(sample.heading):
        return Verdict.NOT_FINITE, 'the heading is not finite'
    if abs(sample.heading) > MOST_HEADING:
        return Verdict.IMPLAUSIBLE, f'a heading of {sample.heading:.4g} rad'
    return Verdict.IMPLAUSIBLE, 'the vertical of the AHRS is no direction'


def usable_heading(headings: Array, up_b: Array) -> Bools:
    """Mask (n,) of usable headings [rad], with up (n, 3) a direction or NaN where not measured."""
    with np.errstate(all='ignore'):
        length = np.sqrt((up_b * up_b).sum(axis=1))
        up = np.isnan(up_b).all(axis=1) | (np.abs(length - 1.0) <= _LENGTH)
        return np.asarray((np.abs(headings) <= MOST_HEADING) & up)


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
    values = chain(fix.r_e.tolist(), fix.relative_e.tolist(), *fix.covariance_e.tolist())
    if not all(map(math.isfinite, values)):
        return Verdict.NOT_FINITE, 'position or covariance is not finite'
    if not is_covariance(fix.covariance_e):
        return _unusable_covariance('position', fix.covariance_e)
    x, y, z = fix.r_e.tolist()
    distance = math.hypot(x, y, z)
    if not EARTH[0] < distance < EARTH[1]:
        return Verdict.IMPLAUSIBLE, f"{distance:.4g} m from the Earth's centre"
    if math.hypot(x, z) < AXIS:
        return Verdict.IMPLAUSIBLE, NO_GRID_NORTH
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
    sigmas = (polar.range_sigma, polar.bearing_sigma, polar.station_heading_sigma)
    if not polar.range <= MOST_RANGE or not np.abs(polar.station).max() <= EARTH[1]:
        return Verdict.IMPLAUSIBLE, f'a range of {polar.range:.4g} m'
    # What is not above zero is left open: parameters have it.
    if any(s > 0.0 and not is_variance(s * s) for s in sigmas):
        return Verdict.IMPLAUSIBLE, 'a sigma of range, bearing or heading is none'
    return None
