"""Outputs of a live vehicle beside its estimates: odometry now, local frames, transforms.

They are made at each IMU sample, after the engine has processed what is due; of a burst of samples
that had to wait, the newest one is published. They are no part of a replay.

| topic | type | stamp |
| --- | --- | --- |
| out odometry/now | nav_msgs/Odometry | newest IMU sample |
| out odometry/local | nav_msgs/Odometry | the same |
| out odometry/depth | polar_nav_msgs/Depth | the same |
| out odometry/reset_counter | std_msgs/UInt32, latched | |
| out nav/origin | std_msgs/String (YAML), latched | |
| out /tf, /tf_static | tf2_msgs/TFMessage | newest IMU sample |
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_msgs.msg import Header, String, UInt32

from polar_nav_core import attitude, earth
from polar_nav_core.arrays import Array
from polar_nav_core.engine.now import Now, Predictor
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.error_model import X
from polar_nav_core.errors import ConfigError
from polar_nav_core.kernels.sins.odometry import NUMBERS, pose_and_twist
from polar_nav_core.kernels.sins.present import make_scratch
from polar_nav_core.local_frame import DeadReckoning, LocalFrame, frame_of_file
from polar_nav_core.output_params import OutputParams
from polar_nav_msgs.msg import Depth

from .navigation_session import NavigationSession
from .odometry_bytes import OdometryBytes
from .qos import LATCHED_QOS
from .stamps import to_msg
from .topics import ODOMETRY_DEPTH, ODOMETRY_LOCAL, ODOMETRY_NOW, ORIGIN, RESET_COUNTER
from .transforms import C_FRD_FLU, C_NED_ENU, HAS_TF, NO_TF, Broadcaster, place, transform

_QUEUE = 10
"""Who steers by the newest message has no use for a long queue of old ones."""


class LiveOutputs:
    """Publishes the state at the newest IMU sample.

    Parameters
    ----------
    node : Node
    session : NavigationSession
        What navigates.
    params : OutputParams
        Frames and limits.

    Attributes
    ----------
    frame : LocalFrame or None
        The map; None before the first state.
    silent : bool
        Whether only what is latched is published.

    Raises
    ------
    ConfigError
        For an origin file that has none, or axes that are refused at the stated place.
    """

    def __init__(self, node: Node, session: NavigationSession[Any], params: OutputParams) -> None:
        self._session, self._p, self._logger = session, params, node.get_logger()
        self._engine_params: EngineParams = session.params
        self._predictor = Predictor(self._engine_params, params)
        self._odom = DeadReckoning()
        vehicle = session.vehicle
        self.map = params.map_frame or _of(vehicle, 'map')
        self.odom = params.odom_frame or _of(vehicle, 'odom')
        self.base = params.base_frame or _of(vehicle, 'base_link')
        qos = QoSProfile(depth=_QUEUE)
        self._now = node.create_publisher(Odometry, ODOMETRY_NOW, qos)
        self._local = node.create_publisher(Odometry, ODOMETRY_LOCAL, qos)
        self._depth = node.create_publisher(Depth, ODOMETRY_DEPTH, qos)
        self._resets = node.create_publisher(UInt32, RESET_COUNTER, LATCHED_QOS)
        self._origin = node.create_publisher(String, ORIGIN, LATCHED_QOS)
        self._now_bytes = OdometryBytes(self.map, self.base)
        self._local_bytes = OdometryBytes(self.odom, self.base)
        self._numbers, self._scratch = np.empty(NUMBERS), make_scratch()
        self._moving = [
            transform(parent, child, np.zeros(3), np.eye(3))
            for parent, child in ((self.map, self.odom), (self.odom, self.base))
        ]
        self._tf = self._broadcaster(node)
        self._newest: tuple[LocalFrame, Now, tuple[Array, Array]] | None = None
        self._samples = self._jumps = 0
        self._resets.publish(UInt32(data=0))
        self.frame: LocalFrame | None = None
        self.silent = False
        self._refused = False
        initial = self._engine_params.initial_state()
        if params.origin_file:
            self._begin(frame_of_file(Path(params.origin_file).expanduser()))
        elif initial is not None:
            self._frame_at(initial.latitude, initial.longitude)  # refused at once if at all

    def _broadcaster(self, node: Node) -> Broadcaster | None:
        if not self._p.publish_tf:
            return None
        if not HAS_TF:
            self._logger.warning(NO_TF)
            return None
        broadcaster = Broadcaster(node)
        broadcaster.fix(self._mounted())
        return broadcaster

    def _mounted(self) -> list[TransformStamped]:
        """Transforms of the sensors on the vehicle, and of axes pointing down (MAVROS)."""
        p = self._engine_params
        roll, pitch, yaw = np.radians(p.dvl_rpy_deg)
        C_m_b = attitude.matrix_from_euler(yaw, pitch, roll)
        vehicle, zero, level = self._session.vehicle, np.zeros(3), np.eye(3)
        arm = self._session.engine.arm
        places = [
            ('imu', zero if arm is None else arm.lever_b, level),
            ('dvl', np.array(p.dvl_lever_b), C_m_b),
            ('depth', np.array(p.depth_lever_b), level),
            ('transponder', np.array(p.transponder_lever_b), level),
        ]
        return [
            *(transform(self.base, _of(vehicle, name), r, C) for name, r, C in places),
            transform(self.base, f'{self.base}_frd', zero, C_FRD_FLU),
            transform(self.odom, f'{self.odom}_ned', zero, C_NED_ENU),
            transform(self.map, f'{self.map}_ned', zero, C_NED_ENU),
        ]

    def _begin(self, frame: LocalFrame) -> None:
        """Fix the map frame, once."""
        self.frame = frame
        self._origin.publish(String(data=frame.as_yaml()))
        if self._tf is not None:
            self._tf.fix([transform('earth', self.map, frame.r_e, frame.C_e_m.T)])

    def following(self, take: Callable[[Any], None]) -> Callable[[Any], None]:
        """Callback of the IMU's topic, with a prediction after it."""

        def take_and_predict(message: Any) -> None:  # noqa: ANN401 - sensor_msgs/Imu
            take(message)
            self._predict()

        return take_and_predict

    def _predict(self) -> None:
        """Predict to the newest IMU sample."""
        engine = self._session.engine
        now = self._predictor.update(engine, self._session.reorder.waiting_imu())
        if now is None:
            return
        frame = self.frame or self._first_frame(now)
        if frame is None:
            return
        r_m, C_b_m, moved_m = frame.pose(now.values)
        self._odom.move(r_m, C_b_m, moved_m, now.C_turn_b)
        self._samples += 1
        self._newest = frame, now, (r_m, C_b_m)

    def publish(self) -> None:
        """Publish the newest prediction, if `now_every` samples came since the one before."""
        if self._newest is None or self._samples < self._p.now_every:
            return
        (frame, now, pose), self._newest, self._samples = self._newest, None, 0
        if now.jumps != self._jumps:
            self._jumps = now.jumps
            self._resets.publish(UInt32(data=now.jumps))
        if not self.silent:
            self._publish(frame, now, self._session.engine.clock.own_ns(now.stamp_ns), pose)

    def _first_frame(self, now: Now) -> LocalFrame | None:
        """Map frame on the surface above the first state; None where its axes are refused."""
        if self._refused:
            return None
        lat, lon, _ = earth.geodetic_from_ecef(now.r_e)
        try:
            frame = self._frame_at(float(lat), float(lon))
        except ConfigError as error:
            self._refused = True
            self._logger.error(f'no odometry/now, odometry/local, /tf: {error}')
            return None
        self._begin(frame)
        return frame

    def _frame_at(self, lat: float, lon: float) -> LocalFrame:
        """Map frame on the sea surface at a place [rad]."""
        height = self._engine_params.sea_surface_height
        return LocalFrame(earth.ecef_from_geodetic(lat, lon, height), self._p.map_axes)

    def _publish(
        self, frame: LocalFrame, now: Now, stamp_ns: int, pose: tuple[Array, Array]
    ) -> None:
        """Publish at a stamp; ``pose`` is position and attitude in the map."""
        odom, P = self._odom, self._predictor.covariance(self._session.engine)
        placed = odom.position, odom.C_b_o
        if _is_heard(self._now):
            self._fill(pose, frame.C_e_m, now, P)
            self._now.publish(self._now_bytes.of(stamp_ns, self._numbers))
        if _is_heard(self._local):
            self._fill(placed, odom.C_o_m.T @ frame.C_e_m, now, P)
            self._local.publish(self._local_bytes.of(stamp_ns, self._numbers))
        if _is_heard(self._depth):
            depth = self._engine_params.sea_surface_height - now.height
            header = Header(stamp=to_msg(stamp_ns), frame_id=self.base)
            up_e = frame.C_e_m[2]
            variance = float(up_e @ P[X.dr_e, X.dr_e] @ up_e)
            self._depth.publish(Depth(header=header, depth=depth, variance=variance))
        if self._tf is not None and self._tf.heard:
            poses, stamp = ((odom.origin, odom.C_o_m), placed), to_msg(stamp_ns)
            for moving, (r, C) in zip(self._moving, poses, strict=True):
                moving.header.stamp = stamp
                place(moving.transform, r, C)
            self._tf.send(self._moving)

    def _fill(self, pose: tuple[Array, Array], C_e: Array, now: Now, P: Array) -> None:
        """Fill the numbers of an odometry; ``pose`` and ``C_e`` (3, 3) are of its frame."""
        variance = self._engine_params.gyro_noise_density**2 / max(now.interval_s, 1e-3)
        values, numbers, scratch = now.values, self._numbers, self._scratch
        pose_and_twist(*pose, C_e, values, P, variance, numbers, scratch)


def _is_heard(publisher: Publisher) -> bool:
    """Whether anybody subscribes; to make a message costs more than to publish it."""
    return bool(publisher.get_subscription_count() > 0)


def _of(vehicle: str, name: str) -> str:
    """Name of a frame of a vehicle."""
    return f'{vehicle}/{name}' if vehicle else name
