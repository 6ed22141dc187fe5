"""Base of the nodes that measure truth: the messages of their vehicle's truth."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any, TypeVar

from polar_nav_core.params import NodeParams
from polar_nav_msgs.msg import VehicleTruth
from polar_nav_ros import topics
from polar_nav_ros.diagnostics import Diagnosis, Level
from polar_nav_ros.node import PolarNode

from ..sensors.clock import ClockErrors
from ..truth_cdr import TruthSample, decode, since_start_ns

P = TypeVar('P', bound=NodeParams)


class TruthListener(PolarNode[P], ABC):
    """Subscribes to ``truth``; a subclass selects samples and measures them.

    Messages that cannot be read or run backwards are counted and left out.
    """

    def __init__(self, name: str, params_cls: type[P], **kwargs: Any) -> None:  # noqa: ANN401
        super().__init__(name, params_cls, **kwargs)
        self._last_ns = -1
        self._refused = 0
        p = self.params
        self._own_clock = p if isinstance(p, ClockErrors) else ClockErrors()

    def listen(self) -> None:
        """Subscribe; called when the subclass is complete."""
        self.subscribe(VehicleTruth, topics.TRUTH, self._on_truth, raw=True)

    @abstractmethod
    def wanted(self, since_start_ns: int) -> int | None:
        """Return the number of the measurement that is due at a sample, or None."""

    @abstractmethod
    def measure(self, k: int, sample: TruthSample) -> None:
        """Make measurement ``k`` of a sample and publish it."""

    def facts(self) -> dict[str, object]:
        """Numbers for diagnostics beside the counts."""
        return {}

    def diagnose(self) -> Diagnosis:
        """Counts, and whether truth was refused."""
        values = {**self.taken_counts(), **self.published_counts(), **self.facts()}
        if self._refused:
            values['refused'] = self._refused
            text = f'{self._refused} truth messages unreadable or running backwards'
            return Diagnosis(Level.WARN, text, values)
        return Diagnosis(values=values)

    def _on_truth(self, data: bytes) -> None:
        try:
            since_ns = since_start_ns(data)
        except ValueError as error:
            self._refuse(str(error))
            return
        if since_ns <= self._last_ns:
            self._refuse(f'{since_ns} ns after the start comes after {self._last_ns} ns')
            return
        self._last_ns = since_ns
        k = self.wanted(since_ns)
        if k is not None:
            sample = decode(data)
            stamp_ns = self._own_clock.reads_ns(sample.stamp_ns, since_ns)
            self.measure(k, replace(sample, stamp_ns=stamp_ns))

    def _refuse(self, why: str) -> None:
        self._refused += 1
        self.get_logger().warning(f'truth refused: {why}', throttle_duration_sec=5.0)


def stream_name(node: Any, sensor: str) -> str:  # noqa: ANN401 - any PolarNode
    """Name of a sensor's random stream: vehicle and sensor."""
    return f'{node.vehicle}/{sensor}' if node.vehicle else sensor
