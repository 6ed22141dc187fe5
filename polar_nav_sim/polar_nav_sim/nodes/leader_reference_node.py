"""leader_reference_node: ``truth`` -> ``odometry``, in place of the leader's own navigation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry

from polar_nav_core.grid import earth_rate, ecef_to_grid
from polar_nav_core.warm import forgo_blas, warm_places
from polar_nav_ros import topics
from polar_nav_ros.process import run

from ..convert import frame_id, odometry_to_msg
from ..params import LeaderReferenceParams
from ..randomness import stream
from ..schedule import Schedule
from ..sensors.reference import ReferenceSystem
from ..truth_cdr import TruthSample
from .truth_listener import TruthListener, stream_name


class LeaderReferenceNode(TruthListener[LeaderReferenceParams]):
    """Truth with stated errors."""

    def __init__(self, **kwargs: Any) -> None:  # noqa: ANN401 - passed on to rclpy
        super().__init__('leader_reference_node', LeaderReferenceParams, **kwargs)
        warm_places()
        p = self.params
        self._stream = stream_name(self, 'reference')
        self._child = frame_id(self.vehicle, 'base_link')
        self._schedule = Schedule(p.rate_hz)
        self._system = ReferenceSystem(p, self._schedule.period_s, stream(p.seed, self._stream))
        self._variance = np.square(self._system.sigma)
        self._pub = self.advertise(Odometry, topics.ODOMETRY)
        self.listen()

    def wanted(self, since_start_ns: int) -> int | None:
        """Return the number of the due sample, or None."""
        return self._schedule.due(since_start_ns)

    def measure(self, k: int, sample: TruthSample) -> None:
        """Publish the pose and twist with this sample's errors."""
        error = self._system.error(k)
        r_e, C_b_G = sample.vector('r_e'), sample.C_b_G
        C_G_e = ecef_to_grid(r_e).T
        C_nav_G = error.attitude(C_b_G)
        omega_eb_b = sample.vector('omega_ib_b') - C_b_G.T @ earth_rate(r_e)
        pose_covariance_e, twist_covariance_b = np.zeros((6, 6)), np.zeros((6, 6))
        dr, dv, phi = np.split(self._variance, 3)
        pose_covariance_e[:3, :3] = C_G_e @ np.diag(dr) @ C_G_e.T
        pose_covariance_e[3:, 3:] = C_G_e @ np.diag(phi) @ C_G_e.T
        twist_covariance_b[:3, :3] = C_nav_G.T @ np.diag(dv) @ C_nav_G
        self._pub.publish(
            odometry_to_msg(
                sample.stamp_ns,
                self._child,
                r_e + C_G_e @ error.dr_G,
                C_G_e @ C_nav_G,
                C_nav_G.T @ (sample.vector('v_g') + error.dv_G),
                omega_eb_b,
                pose_covariance_e,
                twist_covariance_b,
            )
        )

    def facts(self) -> dict[str, object]:
        """Name of the random stream."""
        return {'random_stream': self._stream}


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    forgo_blas()
    return run(LeaderReferenceNode, args)
