"""The estimate as nav_msgs/Odometry and sensor_msgs/NavSatFix, for standard ROS tools."""

from __future__ import annotations

import math

import numpy as np
from nav_msgs.msg import Odometry
from sensor_msgs.msg import NavSatFix, NavSatStatus

from polar_nav_core import attitude, grid
from polar_nav_core.arrays import Array
from polar_nav_msgs.msg import NavState

NOT_ESTIMATED = 1e6
"""Variance of a rate [rad^2/s^2] of which nothing is known."""


def odometry_of(state: NavState, omega_eb_b: Array | None = None) -> Odometry:
    """nav_msgs/Odometry: pose of base_link in `earth` (C_b_e), twist in base_link.

    Covariances are in the axes that nav_msgs/Odometry asks for, and finite: readers invert them.
    The rate against the earth, body axes [rad/s], is not estimated: where it is unknown it is
    zero, and its variance is `NOT_ESTIMATED` in any case.
    """
    C_e_G = grid.ecef_to_grid(state.r_e)
    q = state.orientation
    C_b_G = attitude.matrix_from_quaternion([q.x, q.y, q.z, q.w])
    C_b_e = C_e_G.T @ C_b_G
    v_b = C_b_G.T @ np.asarray(state.v_g)
    x, y, z, w = attitude.quaternion_from_matrix(C_b_e)
    odometry = Odometry(header=state.header, child_frame_id=state.child_frame_id)
    position, orientation = odometry.pose.pose.position, odometry.pose.pose.orientation
    position.x, position.y, position.z = (float(v) for v in state.r_e)
    orientation.x, orientation.y, orientation.z, orientation.w = (
        float(x),
        float(y),
        float(z),
        float(w),
    )
    linear, angular = odometry.twist.twist.linear, odometry.twist.twist.angular
    linear.x, linear.y, linear.z = (float(v) for v in v_b)
    rate = np.zeros(3) if omega_eb_b is None else omega_eb_b
    angular.x, angular.y, angular.z = (float(w) for w in rate)
    pose = np.zeros((6, 6))
    pose[:3, :3] = C_e_G.T @ np.reshape(state.position_covariance_g, (3, 3)) @ C_e_G
    pose[3:, 3:] = C_e_G.T @ np.reshape(state.attitude_covariance_g, (3, 3)) @ C_e_G
    odometry.pose.covariance = pose.reshape(36)
    twist = np.zeros((6, 6))
    twist[:3, :3] = C_b_G.T @ np.reshape(state.velocity_covariance_g, (3, 3)) @ C_b_G
    twist[3:, 3:] = NOT_ESTIMATED * np.eye(3)
    odometry.twist.covariance = twist.reshape(36)
    return odometry


def fix_of(state: NavState) -> NavSatFix:
    """sensor_msgs/NavSatFix: latitude, longitude [deg] and height [m] for maps.

    The covariance is east-north-up, turned from grid axes by the convergence.
    """
    fix = NavSatFix(header=state.header)
    fix.status = NavSatStatus(status=NavSatStatus.STATUS_FIX, service=0)
    fix.latitude = math.degrees(state.latitude)
    fix.longitude = math.degrees(state.longitude)
    fix.altitude = state.height
    if math.isfinite(state.convergence):
        c, s = math.cos(state.convergence), math.sin(state.convergence)
        C_G_g = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        covariance = C_G_g @ np.reshape(state.position_covariance_g, (3, 3)) @ C_G_g.T
        fix.position_covariance = covariance.reshape(9)
        fix.position_covariance_type = NavSatFix.COVARIANCE_TYPE_KNOWN
    return fix
