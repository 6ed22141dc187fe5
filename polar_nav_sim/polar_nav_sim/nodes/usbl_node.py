"""usbl_node: truth of its own vehicle and of the targets -> ``usbl/fix``, one per reply heard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from polar_nav_core.errors import ConfigError
from polar_nav_core.warm import forgo_blas, warm_places
from polar_nav_msgs.msg import UsblFix, VehicleTruth
from polar_nav_ros import topics
from polar_nav_ros.diagnostics import Diagnosis, Level
from polar_nav_ros.node import PolarNode
from polar_nav_ros.process import run
from polar_nav_ros.stamps import stamp_ns_of_cdr

from ..convert import frame_id, usbl_to_msg
from ..interrogator import Interrogator
from ..params import UsblParams
from ..poses import TruthHistory
from ..sensors.usbl import Reading, Usbl
from ..sound_speed import SoundSpeed
from ..trajectory import NS
from ..truth_cdr import since_start_ns

_HORIZON_NS = 60 * NS
"""Stored truth [s], longer than any cycle: 40 km of sound there and back."""


class UsblNode(PolarNode[UsblParams]):
    """One array; it publishes when the truth stamps that drive it reach t4."""

    def __init__(self, **kwargs: Any) -> None:  # noqa: ANN401 - passed on to rclpy
        super().__init__('usbl_node', UsblParams, **kwargs)
        warm_places()
        p = self.params
        if not p.targets or self.vehicle in p.targets:
            raise ConfigError(
                f'parameter targets: {list(p.targets)} must name other vehicles than'
                f' {self.vehicle!r}'
            )
        water = SoundSpeed.from_spec(p)
        self._frame = frame_id(self.vehicle, 'usbl')
        self._histories = {name: TruthHistory(_HORIZON_NS) for name in ('', *p.targets)}
        arrays = {t: Usbl(p, water, p.seed, self.vehicle, t) for t in p.targets}
        self._interrogator = Interrogator(arrays, self._histories, p.period_s, p.first_ping_s)
        self._started = False
        self._start_ns = 0
        self._refused = 0
        self._pub = self.advertise(UsblFix, topics.USBL)
        for name in self._histories:
            topic = f'/{name}/{topics.TRUTH}' if name else topics.TRUTH
            self.subscribe(VehicleTruth, topic, partial(self._on_truth, name), raw=True)

    def diagnose(self) -> Diagnosis:
        """Counts, lost cycles, random streams."""
        values = {
            **self.taken_counts(),
            **self.published_counts(),
            'interrogations': self._interrogator.sequence,
            'lost_cycles': self._interrogator.lost,
            'random_stream': f'{self.vehicle}/usbl/<target>/<sequence>',
        }
        if self._refused:
            values['refused'] = self._refused
            text = f'{self._refused} truth messages unreadable or running backwards'
            return Diagnosis(Level.WARN, text, values)
        return Diagnosis(values=values)

    def _on_truth(self, name: str, data: bytes) -> None:
        try:
            stamp_ns, since_ns = stamp_ns_of_cdr(data), since_start_ns(data)
        except ValueError as error:
            self._refuse(str(error))
            return
        if not self._histories[name].add(stamp_ns, data):
            self._refuse(f'{name or self.vehicle}: stamp {stamp_ns} is not newer than the last')
            return
        if not self._started and name == '':
            self._started = True
            self._interrogator.begin(stamp_ns - since_ns, stamp_ns)
            self._start_ns = stamp_ns - since_ns
        for target, reading in self._interrogator.advance():
            stamped = self._by_own_clock(reading)
            self._pub.publish(usbl_to_msg(stamped, self.vehicle, target, self._frame))

    def _by_own_clock(self, reading: Reading) -> Reading:
        """Return the reading with the times of the vehicle's clock."""
        c = reading.cycle
        t1, t2, t3, t4 = (
            self.params.reads_ns(t_ns, t_ns - self._start_ns)
            for t_ns in (c.t1_ns, c.t2_ns, c.t3_ns, c.t4_ns)
        )
        return replace(reading, cycle=replace(c, t1_ns=t1, t2_ns=t2, t3_ns=t3, t4_ns=t4))

    def _refuse(self, why: str) -> None:
        self._refused += 1
        self.get_logger().warning(f'truth refused: {why}', throttle_duration_sec=5.0)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    forgo_blas()
    return run(UsblNode, args)
