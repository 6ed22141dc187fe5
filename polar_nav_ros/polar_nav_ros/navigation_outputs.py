"""Estimates and receipts of the engine to messages: the same for every vehicle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from geometry_msgs.msg import Quaternion
from numpy.typing import NDArray
from sensor_msgs.msg import TimeReference

from polar_nav_core import nav_columns
from polar_nav_core.engine.events import ClockStep
from polar_nav_core.engine.outputs import LOCAL_GATED, NIS_SUM, UPDATES, Estimate, Receipt
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_msgs.msg import FixReceipt, NavState

from . import receipt_fields
from .stamps import to_msg, to_ns


def nav_to_msg(
    e: Estimate,
    params: EngineParams,
    vehicle: str,
    frame_id: str = 'earth',
    row: NDArray[np.float64] | None = None,
) -> NavState:
    """polar_nav_msgs/NavState of an estimate; ``frame_id`` is the frame of positions.

    ``row`` are the columns of `nav_columns` where they are known: the covariance is not read then.
    """
    if row is None:
        row = nav_columns.describe(e.r_e[None], e.C_b_G[None], e.P[None])[0]
    derived = {name: float(row[k]) for name, k in nav_columns.COLUMNS.items()}
    x, y, z, w = row[nav_columns.QUATERNION].tolist()
    sigma = row[nav_columns.SIGMA]
    msg = NavState()
    msg.header.stamp = to_msg(e.stamp_ns)
    msg.header.frame_id = frame_id
    msg.child_frame_id = f'{vehicle}/base_link'
    msg.configuration = params.configuration
    msg.status = NavState.STATUS_NAVIGATING
    msg.r_e = e.r_e
    for name, value in derived.items():
        setattr(msg, name, value)
    msg.depth = params.sea_surface_height - derived['height']
    msg.v_g = e.v_G
    msg.orientation = Quaternion(x=x, y=y, z=z, w=w)
    msg.position_covariance_g = row[nav_columns.POSITION_COVARIANCE_G]
    msg.velocity_covariance_g = row[nav_columns.VELOCITY_COVARIANCE_G]
    msg.attitude_covariance_g = row[nav_columns.ATTITUDE_COVARIANCE_G]
    msg.gyro_bias_b = e.gyro_bias_b
    msg.gyro_bias_sigma = sigma[9:12]
    msg.accel_bias_b = e.accel_bias_b
    msg.accel_bias_sigma = sigma[12:15]
    msg.dvl_scale_m = e.dvl_scale_m
    msg.dvl_scale_sigma = sigma[15:18]
    msg.dvl_markov_m = e.dvl_markov_m
    msg.dvl_markov_sigma = sigma[18:21]
    msg.usbl_bias_a = e.usbl_bias_a
    msg.usbl_bias_sigma = sigma[21:24]
    msg.fixes_received = e.fixes_received
    msg.fixes_fused = e.fixes_fused
    msg.age_of_last_fix = (e.stamp_ns - e.last_validity_ns) * 1e-9 if e.fixes_fused else math.nan
    dvl, depth = e.local_statistics
    msg.dvl_updates, msg.dvl_gated = int(dvl[UPDATES]), int(dvl[LOCAL_GATED])
    msg.dvl_nis_sum = float(dvl[NIS_SUM])
    msg.depth_updates, msg.depth_gated = int(depth[UPDATES]), int(depth[LOCAL_GATED])
    msg.depth_nis_sum = float(depth[NIS_SUM])
    return msg


def clock_step_to_msg(step: ClockStep) -> TimeReference:
    """sensor_msgs/TimeReference of a step of a clock: two times of one message.

    ``header.stamp`` is in the engine's time, ``time_ref`` its stamp by the clock of its topic;
    ``source`` is the topic and the number of the message on it, from 0, as ``imu/data_raw 6012``.
    """
    msg = TimeReference(source=f'{step.topic} {step.number}')
    msg.header.stamp = to_msg(step.stamp_ns)
    msg.time_ref = to_msg(step.own_ns)
    return msg


def clock_step_from_msg(msg: TimeReference) -> ClockStep:
    """Step of a clock of a recorded sensor_msgs/TimeReference; ValueError for any other."""
    topic, _, number = str(msg.source).rpartition(' ')
    if not (topic and number.isdecimal()):
        raise ValueError(f'its source is {msg.source!r}, not a topic and a number')
    return ClockStep(topic, int(number), to_ns(msg.header.stamp), to_ns(msg.time_ref))


def receipt_to_msg(r: Receipt) -> FixReceipt:
    """polar_nav_msgs/FixReceipt of a receipt."""
    msg = FixReceipt(verdict=int(r.verdict), verdict_text=r.verdict.name, age=r.age_s)
    msg.header.stamp = to_msg(r.stamp_ns)
    for name, field in receipt_fields.TIMES.items():
        setattr(msg, field, to_msg(getattr(r, name)))
    for name, field in (receipt_fields.VALUES | receipt_fields.AXES).items():
        setattr(msg, field, getattr(r, name))
    return msg


def receipt_from_msg(msg: FixReceipt) -> Receipt:
    """Receipt of a recorded polar_nav_msgs/FixReceipt."""
    values: dict[str, Any] = {
        'stamp_ns': to_ns(msg.header.stamp),
        'verdict': Verdict(msg.verdict),
        **{name: getattr(msg, field) for name, field in receipt_fields.VALUES.items()},
        **{name: to_ns(getattr(msg, field)) for name, field in receipt_fields.TIMES.items()},
        **{name: np.array(getattr(msg, field)) for name, field in receipt_fields.AXES.items()},
    }
    return Receipt(**values)
