"""What is wrong with a message by itself, whatever the state is: a verdict and a sentence."""

from __future__ import annotations

import math
from itertools import chain
from typing import TypeAlias

import numpy as np

from .events import ControlSample, DepthSample, DvlPing, Fix, ImuSample, Verdict
from .params import EngineParams

Refusal: TypeAlias = tuple[Verdict, str]


def unusable_local(
    params: EngineParams,
    event: ImuSample | ControlSample | DvlPing | DepthSample,
    last_imu_ns: int | None,
) -> Refusal | None:
    """Why a local message cannot be used; ``last_imu_ns`` is the stamp of the last IMU sample.

    A DVL ping without bottom lock is no fault.
    """
    if isinstance(event, ImuSample):
        return _unusable_imu(params, event, last_imu_ns)
    if isinstance(event, ControlSample):
        good = bool(np.isfinite(event.force_b).all() and np.isfinite(event.torque_b).all())
        return None if good else (Verdict.NOT_FINITE, 'force or torque is not finite')
    if isinstance(event, DvlPing):
        name = 'dvl'
        good = not event.valid or bool(
            np.isfinite(event.v_m).all()
            and np.isfinite(event.covariance_m).all()
            and (np.diagonal(event.covariance_m) > 0.0).all()
        )
    else:
        name = 'depth'
        good = bool(
            np.isfinite(event.depth) and np.isfinite(event.variance) and event.variance > 0.0
        )
    reason = f'{name} or its covariance is not finite and positive'
    return None if good else (Verdict.NOT_FINITE, reason)


def _unusable_imu(params: EngineParams, sample: ImuSample, last_ns: int | None) -> Refusal | None:
    if not (np.isfinite(sample.omega_ib_b).all() and np.isfinite(sample.f_b).all()):
        return Verdict.NOT_FINITE, 'rate or specific force is not finite'
    C_b_G = sample.C_b_G
    if params.mode == 'station' and (C_b_G is None or not np.isfinite(C_b_G).all()):
        return Verdict.NOT_FINITE, 'no attitude, which station mode needs (an AHRS)'
    if sample.stamp_ns == last_ns:
        return Verdict.DUPLICATE, 'there was an IMU sample with this stamp before'
    return None


def unusable_fix(params: EngineParams, fix: Fix) -> Refusal | None:
    """Why a fix cannot be used in this mode."""
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
