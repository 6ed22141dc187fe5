"""Topics of the truth node for vehicles with dynamics: thrust, model, commands.

``<v>/control/thrust`` ten times a second, ``<v>/truth/model`` once a second. With commands, those
of ``<v>/control/setpoint`` hold until the next one, of ``<v>/control/thrust_command`` for a stated
time.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped

from polar_nav_msgs.msg import Setpoint, VehicleModel
from polar_nav_ros.counted import CountedPublisher
from polar_nav_ros.node import PolarNode

from ..convert import frame_id, model_to_msg, thrust_from_msg, thrust_to_msg
from ..mission import Mission
from ..params import TruthParams
from ..schedule import Schedule
from ..trajectory import NS

THRUST_HZ = 10.0
MODEL_HZ = 1.0


class VehiclePorts:
    """Control and model topics of every vehicle with dynamics.

    Parameters
    ----------
    node : PolarNode
        The truth node.
    mission : Mission
        The simulated mission.
    """

    def __init__(self, node: PolarNode[Any], mission: Mission) -> None:
        p: TruthParams = node.params
        self._node = node
        self._truths = {v: mission.dynamics(v) for v in mission.dynamic}
        self._thrust = {
            v: node.advertise(WrenchStamped, f'{v}/control/thrust') for v in self._truths
        }
        self._model = {v: node.advertise(VehicleModel, f'{v}/truth/model') for v in self._truths}
        self._period_ns = mission.imu_period_ns
        self._thrust_due, self._model_due = Schedule(THRUST_HZ), Schedule(MODEL_HZ)
        self._until: dict[str, int] = {}
        self._hold = max(1, round(p.command_timeout_s * NS / mission.imu_period_ns))
        self._made = 0
        self._topics: list[str] = []
        self.refused = 0
        for v in self._truths if p.commands else ():
            for kind, topic, take in (
                (Setpoint, f'{v}/control/setpoint', self._on_setpoint),
                (WrenchStamped, f'{v}/control/thrust_command', self._on_thrust),
            ):
                subscription = node.subscribe(kind, topic, partial(take, v))
                self._topics.append(subscription.topic_name)

    @property
    def outputs(self) -> Sequence[CountedPublisher]:
        """All publishers."""
        return [*self._thrust.values(), *self._model.values()]

    def taken(self, published: dict[str, int]) -> bool:
        """Whether every published command has been received."""
        counts = self._node.taken_counts()
        return all(counts.get(t, 0) >= published.get(t, 0) for t in self._topics)

    def before(self, k: int) -> None:
        """Prepare for samples from k on: end thrust commands that are too old."""
        self._made = k
        for v in [v for v, until in self._until.items() if k >= until]:
            self._truths[v].motion.push(None)
            del self._until[v]

    def publish(self, k: int, stamp_ns: int) -> None:
        """Publish the messages due at sample k."""
        since_ns = k * self._period_ns
        if self._thrust_due.due(since_ns) is not None:
            for v, truth in self._truths.items():
                message = thrust_to_msg(stamp_ns, frame_id(v, 'base_link'), truth.thrust(stamp_ns))
                self._thrust[v].publish(message)
        if self._model_due.due(since_ns) is not None:
            for v, truth in self._truths.items():
                s, body = truth.state(stamp_ns), truth.spec.body
                v_r_b = s.C_b_G.T @ (s.v_G - s.current_G)
                message = model_to_msg(
                    stamp_ns, v_r_b, s.current_G, body.drag_linear[0], body.drag_quadratic[0]
                )
                self._model[v].publish(message)

    def _on_setpoint(self, vehicle: str, msg: Setpoint) -> None:
        wanted = np.array([msg.heading, msg.pitch, msg.depth, msg.speed])
        if np.isinf(wanted).any():
            self._refuse(f'{vehicle}/control/setpoint', 'infinite')
            return
        self._truths[vehicle].motion.want(*wanted.tolist())

    def _on_thrust(self, vehicle: str, msg: WrenchStamped) -> None:
        tau = thrust_from_msg(msg)
        if not np.isfinite(tau).all():
            self._refuse(f'{vehicle}/control/thrust_command', 'not finite')
            return
        self._truths[vehicle].motion.push(tau)
        self._until[vehicle] = self._made + self._hold

    def _refuse(self, topic: str, why: str) -> None:
        self.refused += 1
        self._node.get_logger().warning(f'{topic} refused: {why}', throttle_duration_sec=5.0)
