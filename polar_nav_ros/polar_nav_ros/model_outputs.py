"""Estimated drag, current and identifications as messages."""

from __future__ import annotations

import numpy as np

from polar_nav_core.engine.outputs import ModelEstimate
from polar_nav_core.identification.result import Identification
from polar_nav_msgs.msg import Identification as IdentificationMsg
from polar_nav_msgs.msg import VehicleModel, WaterCurrent

from .stamps import to_msg

GRID = 'grid'


def model_to_msg(m: ModelEstimate, stamp_ns: int) -> VehicleModel:
    """polar_nav_msgs/VehicleModel of an estimate at a stamp [ns]."""
    msg = VehicleModel()
    msg.header.stamp = to_msg(stamp_ns)
    msg.header.frame_id = GRID
    msg.v_r_b = m.v_r_b
    msg.v_r_covariance_b = np.reshape(m.v_r_covariance_b, 9)
    msg.current_g = m.current_G
    msg.current_covariance_g = np.reshape(m.current_covariance_G, 9)
    msg.drag_linear = m.drag_linear
    msg.drag_linear_sigma = m.drag_linear_sigma
    msg.drag_quadratic = m.drag_quadratic
    msg.drag_quadratic_sigma = m.drag_quadratic_sigma
    msg.drag_correlation = m.drag_correlation
    msg.heading_bias = m.heading_bias
    msg.heading_bias_sigma = m.heading_bias_sigma
    msg.current_walk = m.current_walk
    return msg


def current_to_msg(m: ModelEstimate, stamp_ns: int) -> WaterCurrent:
    """polar_nav_msgs/WaterCurrent of an estimate at a stamp [ns]."""
    msg = WaterCurrent()
    msg.header.stamp = to_msg(stamp_ns)
    msg.header.frame_id = GRID
    msg.velocity_g = m.current_G
    msg.covariance_g = np.reshape(m.current_covariance_G, 9)
    return msg


def identification_to_msg(i: Identification) -> IdentificationMsg:
    """polar_nav_msgs/Identification of a result."""
    msg = IdentificationMsg()
    msg.header.stamp = to_msg(i.stamp_ns)
    msg.header.frame_id = GRID
    msg.method = i.method
    msg.verdict = int(i.verdict)
    msg.verdict_text = i.verdict.name
    msg.reason = i.reason
    msg.trigger = i.trigger
    msg.fixes = i.fixes
    msg.first_validity = to_msg(i.first_validity_ns)
    msg.last_validity = to_msg(i.last_validity_ns)
    msg.names = list(i.names)
    msg.values = np.asarray(i.values, dtype=np.float64)
    msg.covariance = np.asarray(i.covariance, dtype=np.float64).reshape(-1)
    msg.condition_number = i.condition_number
    msg.cost = i.cost
    msg.iterations = i.iterations
    return msg
