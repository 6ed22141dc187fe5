"""absolute_fix_node: ``truth`` -> ``absolute/fix``, a stated noise, within windows of time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from sensor_msgs.msg import NavSatFix

from polar_nav_core.grid import ecef_to_grid
from polar_nav_ros import topics
from polar_nav_ros.process import run

from ..convert import absolute_fix_to_msg, frame_id
from ..params import AbsoluteFixParams
from ..randomness import stream
from ..schedule import Schedule
from ..sensors.noise import CHUNK, Draws
from ..trajectory import NS
from ..truth_cdr import TruthSample
from .truth_listener import TruthListener, stream_name


class AbsoluteFixNode(TruthListener[AbsoluteFixParams]):
    """Node of GNSS at the surface or a beacon under the ice: positions within windows of time."""

    def __init__(self, **kwargs: Any) -> None:  # noqa: ANN401 - passed on to rclpy
        super().__init__('absolute_fix_node', AbsoluteFixParams, **kwargs)
        p = self.params
        self._stream = stream_name(self, 'absolute')
        self._frame = frame_id(self.vehicle, 'absolute')
        self._lever_b = np.array(p.lever_b)
        self._sigma = np.array([*[p.horizontal_sigma_m] * 2, p.vertical_sigma_m])
        self._schedule = Schedule(1.0 / p.period_s)
        self._draws = Draws(stream(p.seed, self._stream), 3)
        self._pub = self.advertise(NavSatFix, topics.ABSOLUTE)
        self.listen()

    def wanted(self, since_start_ns: int) -> int | None:
        """Return the number of the due fix; None outside of the windows."""
        k = self._schedule.due(since_start_ns)
        p = self.params
        since_s = since_start_ns / NS - p.first_s
        if p.repeat_s > 0.0 and since_s > 0.0:
            since_s %= p.repeat_s
        return k if 0.0 <= since_s < p.available_s else None

    def measure(self, k: int, sample: TruthSample) -> None:
        """Publish the position with this fix's error."""
        chunk, row = divmod(k, CHUNK)
        while self._draws.chunk < chunk:
            self._draws.advance()
        r_e, C_b_G = sample.vector('r_e'), sample.C_b_G
        error_G = C_b_G @ self._lever_b + self._sigma * self._draws.rows[row]
        p = self.params
        self._pub.publish(
            absolute_fix_to_msg(
                sample.stamp_ns,
                self._frame,
                r_e + ecef_to_grid(r_e).T @ error_G,
                p.horizontal_sigma_m,
                p.vertical_sigma_m,
            )
        )

    def facts(self) -> dict[str, object]:
        """Name of the random stream."""
        return {'random_stream': self._stream}


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(AbsoluteFixNode, args)
